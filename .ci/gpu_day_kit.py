"""Packs what a GPU's first day needs on a machine without a network: its script, and wheels for Linux and one Python.

`gpu_day_kit.py [FOLDER]` builds clbvh's wheel for Linux x86-64 in a folder, and makes the archive there.
Exit code 1 if the archive is too large.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

from build_wheels import build, find_wheel

from clbvh.device.host.targets import TARGETS

HERE = Path(__file__).resolve().parent

PYTHON, NAME, MOST_BYTES = "3.12", "clbvh-gpu-day", 60_000_000
_RUN = f"""#!/bin/sh
# Installs clbvh from the wheels beside this file, for Python {PYTHON}, and runs the day in the folder gpu-day.
set -eu
cd "$(dirname "$0")"
"${{PYTHON:-python3}}" -m venv venv
venv/bin/pip install --quiet --no-index --find-links wheels clbvh Jinja2
exec venv/bin/python gpu_day.py "$@"
"""


def make_kit(folder: Path) -> int:
    """Build the wheel, pack it with all that it needs and the scripts, and return the exit code."""
    (target,) = (target for target in TARGETS if target.name == "linux-x86_64")
    build(target, folder)
    wheel = find_wheel(target, folder)
    with tempfile.TemporaryDirectory() as temporary:
        kit = Path(temporary) / NAME
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
        command += ["--only-binary", ":all:", "--python-version", PYTHON, "--dest", str(kit / "wheels")]
        for platform in ("manylinux2014", "manylinux_2_17", "manylinux_2_27", "manylinux_2_28"):
            command += ["--platform", f"{platform}_x86_64"]
        subprocess.run([*command, str(wheel), "Jinja2"], check=True)
        for script in ("gpu_day.py", "gpu_report.py"):
            shutil.copy(HERE / script, kit)
        (kit / "run").write_text(_RUN, encoding="utf-8")
        (kit / "run").chmod(0o755)
        path = folder / f"{NAME}.tar.gz"
        with tarfile.open(path, "w:gz") as archive:
            archive.add(kit, NAME)
    size = path.stat().st_size
    print(f"{path}: {size / 1e6:.1f} MB; unpack it, and run {NAME}/run")
    return 0 if size <= MOST_BYTES else 1


if __name__ == "__main__":
    sys.exit(make_kit(Path(*sys.argv[1:] or ["dist"])))
