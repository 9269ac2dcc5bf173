"""Runs the wheels of dist on emulated processors and systems, and compares their answers with this machine's.

With an emulated Python: the conformance check, and two pictures with the bytes of this machine's. Without one: the
calls of `.ci/record_calls.py`, made again by `.ci/replay.c`. A lane that lacks a wheel or a program is skipped with a
reason; a difference is exit code 1. The packages of Debian: qemu-user-static mmdebstrap musl musl-tools wine64
gcc-mingw-w64-x86-64-win32.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(PROJECT))

from build_wheels import find_wheel  # noqa: E402

from clbvh.device.host.targets import Target, find_target  # noqa: E402
from clbvh.support.folders import find_cache  # noqa: E402

# Outside of the checkout: hatchling follows the links of a system's folders, and leaves out what it has seen there.
FOLDER = find_cache() / "emulated"

# The Python of Debian 12, and the platforms whose wheels run there.
_DEBIAN, _PYTHON = "bookworm", "3.11"
_GLIBCS = range(36, 16, -1)

_PICTURES = {
    "studio": ("--width", "160", "--height", "100"),
    "path": ("--width", "96", "--height", "64", "--shading", "path", "--samples", "4"),
}


class SkipError(Exception):
    """What a lane lacks."""


def run(command: Sequence[object], **environment: object) -> str:
    """Run a command, and return what it prints."""
    words = os.environ | {name: str(value) for name, value in environment.items()}
    done = subprocess.run(
        [*map(str, command)], env=words, cwd=FOLDER, capture_output=True, text=True, errors="replace", check=False
    )
    if done.returncode:
        lines = (done.stdout + done.stderr).strip().splitlines()
        raise RuntimeError(f"{Path(str(command[0])).name}: {lines[-1] if lines else f'exit code {done.returncode}'}")
    return done.stdout


def need(program: str) -> str:
    """Return where a program is."""
    if (path := shutil.which(program)) is None:
        raise SkipError(f"needs {program}")
    return path


def need_wheel(name: str) -> Path:
    """Return a target's wheel."""
    target = find_target(name)
    wheel = find_wheel(target, PROJECT / "dist") if target else None
    if wheel is None:
        raise SkipError(f"needs a wheel: make wheels ONLY={name}")
    return wheel


def unpack(name: str) -> Path:
    """Return the folder of an unpacked wheel."""
    folder = FOLDER / name / "site"
    shutil.rmtree(folder, ignore_errors=True)
    with zipfile.ZipFile(need_wheel(name)) as archive:
        archive.extractall(folder)
    return folder


def check_python(command: Sequence[object], path: str, **environment: object) -> str:
    """Run the conformance check and draw the pictures by a Python, and compare."""
    chosen = environment | {"PYTHONPATH": path, "CLBVH_DEVICE": "host", "CLBVH_CACHE": FOLDER / "cache"}
    report = json.loads(
        run([*command, "-m", "clbvh", "doctor", "--conformance", "--json", "--device", "host"], **chosen)
    )
    count = sum(entry["parts"] for entry in report["compared"])
    if not report["is_equal"]:
        raise RuntimeError(f"{len(report['differences'])} of {count} answers differ")
    size = 0
    for name, words in _PICTURES.items():
        own, other = FOLDER / f"{name}.ppm", FOLDER / f"{name}.emulated.ppm"
        render = "-m", "clbvh", "render", "demo", *words, "-o"
        run([sys.executable, *render, own], PYTHONPATH=PROJECT, CLBVH_DEVICE="host")
        run([*command, *render, other], **chosen)
        if own.read_bytes() != other.read_bytes():
            raise RuntimeError(f"the picture {name} differs")
        size += own.stat().st_size
    level = report["device"]["driver_version"].partition(" ")[2]
    return f"level {level}: {count} of {count} answers and {size} bytes of pictures equal"


def check_aarch64() -> str:
    """Check with the Python of an aarch64 Debian, and packages from PyPI."""
    wheel, emulator = need_wheel("linux-aarch64"), need("qemu-aarch64-static")
    root, site = FOLDER / "debian-arm64", FOLDER / "linux-aarch64" / "site"
    if not root.exists():
        options = "--variant=extract", "--architectures=arm64", "--include=python3,libpython3-stdlib,libstdc++6"
        run([need("mmdebstrap"), *options, _DEBIAN, root])
    platforms = [*(f"manylinux_2_{minor}_aarch64" for minor in _GLIBCS), "manylinux2014_aarch64"]
    options = [
        "--only-binary=:all:",
        "--python-version",
        _PYTHON,
        "--implementation",
        "cp",
        "--upgrade",
        "--target",
        site,
    ]
    options += [word for tag in platforms for word in ("--platform", tag)]
    run([sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *options, wheel])
    run([sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *options, "--no-deps",
         "--force-reinstall", wheel])  # fmt: skip
    return check_python([emulator, "-L", root, root / "usr/bin/python3"], str(site))


def check_old_x86() -> str:
    """Check with a processor without AVX, this Python and its packages."""
    return check_python([need("qemu-x86_64-static"), "-cpu", "Nehalem", sys.executable], str(unpack("linux-x86_64")))


def check_musl() -> str:
    """Replay with musl and the library of the same wheel, at each level of this processor."""
    library = unpack("linux-x86_64") / "clbvh" / "compiled" / "host-x86_64.so"
    program = FOLDER / "replay-musl"
    run([need("musl-gcc"), "-O1", "-o", program, PROJECT / ".ci" / "replay.c"])
    return replay([need("/lib/ld-musl-x86_64.so.1"), program], library, find_target("linux-x86_64"))


def check_windows() -> str:
    """Replay with Wine, at each level of this processor."""
    library = unpack("windows-x86_64") / "clbvh" / "compiled" / "host-x86_64.dll"
    program, wine = FOLDER / "replay.exe", shutil.which("wine64") or need("/usr/lib/wine/wine64")
    # Not by zig, which compiles the start files of a program for Windows first: minutes of two cores.
    run([need("x86_64-w64-mingw32-gcc"), "-O1", "-w", "-o", program, PROJECT / ".ci" / "replay.c"])
    return replay([wine, program], library, find_target("windows-x86_64"), WINEPREFIX=FOLDER / "wine", WINEDEBUG="-all")


def replay(command: Sequence[object], library: Path, target: Target | None, **environment: object) -> str:
    """Make the calls again at each level of a library that this processor has."""
    calls = FOLDER / "calls.bin"
    run([sys.executable, PROJECT / ".ci" / "record_calls.py", calls], PYTHONPATH=PROJECT, CLBVH_DEVICE="host")
    lines, processor = [], 0
    for level in target.levels if target else ():
        if lines and int(level[1:]) > processor:
            break
        said = run([*command, library, level, calls], **environment).splitlines()
        processor = int(said[0].partition(";")[0].rpartition(" ")[2])
        lines.append(f"{level}: {said[-1]}")
    return "; ".join(lines)


LANES: dict[str, Callable[[], str]] = {
    "aarch64": check_aarch64,
    "nehalem": check_old_x86,
    "musl": check_musl,
    "windows": check_windows,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the lanes, print a table, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("lanes", nargs="*", help=f"any of {', '.join(LANES)}; all without it")
    options = parser.parse_args(arguments)
    if unknown := sorted({*options.lanes} - {*LANES}):
        parser.error(f"'{unknown[0]}' is no lane: there are {', '.join(LANES)}")
    FOLDER.mkdir(parents=True, exist_ok=True)
    is_good, ran = True, 0
    print("| lane | answers | s |\n|---|---|---|")
    for name in options.lanes or LANES:
        started = time.perf_counter()
        try:
            answer = LANES[name]()
            ran += 1
        except SkipError as reason:
            answer = f"skipped: {reason}"
        except RuntimeError as error:
            answer, is_good = f"FAILED: {error}", False
        print(f"| {name} | {answer} | {time.perf_counter() - started:.0f} |", flush=True)
    # Nothing compared is no success.
    return 0 if is_good and ran else 1


if __name__ == "__main__":
    sys.exit(main())
