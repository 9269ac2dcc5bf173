"""Draw the pictures of docs/gallery.md again, each by the command under it: `make gallery`."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

from clbvh.cli import main

REPOSITORY = Path(__file__).parents[1]
PAGE = REPOSITORY / "docs" / "gallery.md"

_COMMAND = re.compile(r"^`clbvh (render [^`]+)`$", re.MULTILINE)


def list_commands() -> list[list[str]]:
    """Return the words of each command behind `clbvh`."""
    return [shlex.split(command) for command in _COMMAND.findall(PAGE.read_text(encoding="utf-8"))]


if __name__ == "__main__":
    for words in list_commands():
        print("clbvh", *words, flush=True)
        sys.argv = ["clbvh", *words]
        try:
            main()
        except SystemExit as end:
            if end.code:
                raise
