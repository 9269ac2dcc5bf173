"""Draw the pictures of the pages again, each by the command under it: `make gallery`.

A command stands alone on its line, behind "Made by" or in a list, and names the picture's file. The pictures get
palettes of 256 colours, which nobody sees and which make them less than half as large: the repository keeps every
version of them.
"""

from __future__ import annotations

import io
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

from PIL import Image

REPOSITORY = Path(__file__).parents[1]
PICTURES = "docs/pictures/"

_COMMAND = re.compile(rf"^(?:Made by |- )?`((?:clbvh|python) [^`]*{PICTURES}[^`]+)`", re.MULTILINE)
_COLOURS = 256


def list_commands() -> dict[str, list[str]]:
    """Return the words of the command of each picture, by the picture's path in the repository."""
    pages = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").rglob("*.md"))]
    commands = {}
    for page in pages:
        for command in _COMMAND.findall(page.read_text(encoding="utf-8")):
            words = shlex.split(command)
            commands[next(word for word in words if word.startswith(PICTURES))] = words
    return commands


def draw(words: list[str]) -> None:
    """Run a command with this Python and this clbvh."""
    program = [sys.executable, "-m", "clbvh"] if words[0] == "clbvh" else [sys.executable]
    paths = filter(None, (str(REPOSITORY), os.environ.get("PYTHONPATH")))
    (REPOSITORY / "out").mkdir(exist_ok=True)
    subprocess.run(
        [*program, *words[1:]], check=True, cwd=REPOSITORY, env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    )


def reduce_colours(path: Path) -> None:
    """Write a picture with a palette, or as it is where that is smaller."""
    with Image.open(path) as image:
        rgb = image.convert("RGB")
    palette = rgb.quantize(_COLOURS, method=Image.Quantize.MEDIANCUT, kmeans=2)
    # Without dithering there are rings on smooth surfaces.
    reduced = rgb.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG)
    data = io.BytesIO()
    reduced.save(data, "PNG", optimize=True)
    if data.tell() < path.stat().st_size:
        path.write_bytes(data.getvalue())


if __name__ == "__main__":
    wanted = sys.argv[1:]
    for picture, words in list_commands().items():
        if not wanted or Path(picture).stem in wanted:
            print(shlex.join(words), flush=True)
            draw(words)
            reduce_colours(REPOSITORY / picture)
