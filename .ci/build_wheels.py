"""Builds the wheels of all targets and the source distribution on this machine, and looks into each wheel.

`build_wheels.py linux-aarch64` builds one target; `--only-check` looks into what is there. Exit code 1 if a wheel's
library calls what a bare process lacks, needs a newer system than its tags say, has other entries than the
others, or is of other sources than those here, or if a wheel is too large. The check needs the package lief.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(PROJECT))

from clbvh.device.host.compile import find_digest  # noqa: E402
from clbvh.device.host.targets import TARGETS, Target  # noqa: E402
from clbvh.device.host.variants import WITHOUT_LEVEL  # noqa: E402

MOST_BYTES = 12_000_000

# What a library may call: memory, the heap, and the sum of a product where the processor has no instruction for it.
_FUNCTIONS = {"malloc", "free", "memcpy", "memmove", "memset", "fma", "fmaf"}
# And what macOS's loader binds, and clang makes of fills there.
_OF_MACOS = {"dyld_stub_binder", "bzero", "__bzero", "memset_pattern16"}
_LIBRARIES = {
    "linux": {"libc.so.6", "libm.so.6"},
    "darwin": {"/usr/lib/libSystem.B.dylib"},
    "win32": {"ucrtbase.dll"},
}
_NEWEST_GLIBC = (2, 17)


def build(target: Target | None, folder: Path) -> None:
    """Build a target's wheel, or the source distribution, without an environment of its own."""
    environment = dict(os.environ)
    if target is not None:
        environment["CLBVH_HOST_TARGET"] = target.name
    started = time.perf_counter()
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel" if target else "sdist", "-d", str(folder)]
    subprocess.run(command, cwd=PROJECT, env=environment, check=True)
    print(f"{target.name if target else 'sdist'}: {time.perf_counter() - started:.0f} s", flush=True)


def find_wheel(target: Target, folder: Path) -> Path | None:
    """Return the newest wheel of a target."""
    found = sorted(folder.glob(f"*-py3-none-{target.tag}.whl"), key=lambda path: path.stat().st_mtime)
    return found[-1] if found else None


def check_wheel(wheel: Path, target: Target) -> tuple[list[str], set[str]]:
    """Return what is wrong with a wheel, and the entries of its library, without their levels."""
    import lief

    problems = [f"{wheel.stat().st_size} bytes"] if wheel.stat().st_size > MOST_BYTES else []
    with zipfile.ZipFile(wheel) as archive, tempfile.TemporaryDirectory() as folder:
        libraries = [name for name in archive.namelist() if name.startswith("clbvh/compiled/")]
        if libraries != [f"clbvh/compiled/{target.library_name}"]:
            return [*problems, f"its libraries are {libraries}"], set()
        path = archive.extract(libraries[0], folder)
        library: Any = lief.parse(path)
        facts = f"{find_digest()} {' '.join(target.levels)}\0".encode()
        if facts not in Path(path).read_bytes():
            problems.append("its library is of other sources or has other levels")

    exports, imports, needed = read_symbols(library, target)
    if unknown := imports - _FUNCTIONS:
        problems.append(f"its library calls {', '.join(sorted(unknown))}")
    if unknown := needed - _LIBRARIES[target.system]:
        problems.append(f"its library needs {', '.join(sorted(unknown))}")
    if target.system == "linux":
        versions = {
            str(each.name) for need in library.symbols_version_requirement for each in need.get_auxiliary_symbols()
        }
        new = {name for name in versions if tuple(map(int, name.removeprefix("GLIBC_").split("."))) > _NEWEST_GLIBC}
        problems += [f"its library needs {', '.join(sorted(new))}"] if new else []
    if target.system == "darwin" and (oldest := library.build_version.minos[:2]) != [11, 0]:
        problems.append(f"its library needs macOS {oldest}")
    entries = {
        level: {name.removeprefix(f"{level}_") for name in exports if name.startswith(f"{level}_")}
        for level in target.levels
    }
    first = next(iter(entries.values()))
    for level, names in entries.items():
        left_out = WITHOUT_LEVEL.get(level, ())
        if names - first or not all(name.startswith(left_out) for name in first - names):
            problems.append(f"its level {level} has other entries than the lowest one")
    others = exports - {f"{level}_{name}" for level in target.levels for name in first} - {"clbvh_facts", "clbvh_level"}
    problems += [f"its library exports {', '.join(sorted(others))}"] if others else []
    return problems, first


def read_symbols(library: Any, target: Target) -> tuple[set[str], set[str], set[str]]:
    """Return the names that a library exports and imports, and the libraries that it needs."""
    if target.system == "win32":
        exports = {each.name for each in library.get_export().entries}
        imports = {each.name for each in library.imports for each in each.entries}
        return exports, imports, {each.name for each in library.imports}
    exports = {str(each.name) for each in library.exported_symbols}
    imports = {str(each.name) for each in library.imported_symbols} - {""}
    if target.system == "linux":
        return exports, imports, set(library.libraries)
    strip = {name.removeprefix("_") for name in imports} - _OF_MACOS
    exports = {name.removeprefix("_") for name in exports} - {"_mh_dylib_header", "__dso_handle"}
    return exports, strip, {each.name for each in library.libraries if each.command.name == "LOAD_DYLIB"}


def check(targets: Sequence[Target], folder: Path) -> bool:
    """Look into the wheels, and print a table."""
    print("\n| target | wheel, MB | entries | |\n|---|---|---|---|")
    is_good, first = True, None
    for target in targets:
        wheel = find_wheel(target, folder)
        problems, entries = check_wheel(wheel, target) if wheel else (["there is no wheel"], set())
        first = first or entries
        if entries and entries != first:
            problems.append(f"entries of others: {len(entries ^ first)}")
        is_good &= not problems
        size = f"{wheel.stat().st_size / 1e6:.1f}" if wheel else ""
        print(f"| {target.name} | {size} | {len(entries)} | {'; '.join(problems) or 'good'} |", flush=True)
    return is_good


def main(arguments: Sequence[str] | None = None) -> int:
    """Build, check, and return the exit code."""
    names = [target.name for target in TARGETS]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", help=f"any of {', '.join(names)}; all, and the sdist, without it")
    parser.add_argument("--folder", type=Path, default=PROJECT / "dist")
    parser.add_argument("--check", action="store_true", help="look into the wheels, too")
    parser.add_argument("--only-check", action="store_true", help="build none")
    options = parser.parse_args(arguments)
    if unknown := sorted({*options.targets} - {*names}):
        parser.error(f"'{unknown[0]}' is no target: there are {', '.join(names)}")
    targets = [target for target in TARGETS if target.name in (options.targets or names)]
    if not options.only_check:
        for target in [*targets, *([] if options.targets else [None])]:
            build(target, options.folder)
    return 0 if not (options.check or options.only_check) or check(targets, options.folder) else 1


if __name__ == "__main__":
    sys.exit(main())
