"""Kernel sources: files, found and expanded, and the arguments of their entry points.

Includes are expanded here, not by a compiler, for two reasons: the expanded text is all that a compiled program depends
on, so it is a safe cache key; and `#line` markers make every compiler message name our file and line.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from ..errors import InternalError
from ..structs import c_declarations
from ..support.folders import find_folder

# The include that stands for the text made from `clbvh/structs.py`.
STRUCTS_INCLUDE = "structs.cl"

# An entry point in the expanded text: its name, and its arguments.
ENTRY_POINT = re.compile(r"^kernel void (\w+)\(([^)]*)\)", re.MULTILINE)

# A loop that only the host runs: its result, its name, and its parameters.
LOOP = re.compile(r"^loop (\w+) (\w+)\(([^)]*)\)", re.MULTILINE)

# Arguments that several kernels share: a macro and its text.
_SHARED_ARGUMENTS = re.compile(r"^#define (\w+_ARGUMENTS) ((?:.*\\\n)*.*)", re.MULTILINE)

# An argument that is a number.
_NUMBER = re.compile(r"(?:const )?(int|uint|float|double) (\w+)")

# A file is expanded once, but for one that is included "again", with other macros.
_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*(// again\b.*)?$')


def expand_source(name: str, folder: Path | None = None) -> str:
    """Return the text of a kernel file with its includes expanded, each file once but for those included "again".

    Parameters
    ----------
    name : str
        Path below the `cl` folder, such as ``kernels/render.cl``. Includes are named the same way.
    folder : Path, optional
        Where files are looked for before the shipped `cl`.

    Raises
    ------
    InternalError
        A file is missing.
    """
    roots = [find_folder("cl")] if folder is None else [folder, find_folder("cl")]
    return "\n".join(_expand(name, roots, set())) + "\n"


@cache
def expand_shipped(name: str) -> str:
    """Return the text of a shipped kernel file; files are read once in a process, as modules are."""
    return expand_source(name)


@cache
def expand_for_host(name: str) -> str:
    """Return the same as the host has it: a file below ``cl/on_host`` takes the place of the one of its name."""
    return expand_source(name, find_folder("cl") / "on_host")


def _expand(name: str, roots: list[Path], seen: set[str]) -> Iterator[str]:
    """Yield the lines of a file, unless it was seen before."""
    if name in seen:
        return
    seen.add(name)
    label, text = _read(name, roots)
    yield f'#line 1 "{label}"'
    for number, line in enumerate(text.splitlines(), start=1):
        if match := _INCLUDE.match(line):
            yield from _expand(match[1], roots, seen - {match[1]} if match[2] else seen)
            yield f'#line {number + 1} "{label}"'
        else:
            yield line


def _read(name: str, roots: list[Path]) -> tuple[str, str]:
    """Return what compiler messages call a file, and its text."""
    if name == STRUCTS_INCLUDE:
        return f"cl/{name}", c_declarations()
    for root in roots:
        if (root / name).is_file():
            return f"{root.name}/{name}", (root / name).read_text(encoding="utf-8")
    raise InternalError(f"the kernel source '{name}' is missing in {' and '.join(map(str, roots))}")


def find_arguments(source: str) -> dict[str, dict[str, str | None]]:
    """Return the arguments of each entry point of an expanded source, with the C types of those that are numbers.

    From the text and not from a driver: one that loads a compiled program from a cache may have forgotten them.
    """
    shared = dict(_SHARED_ARGUMENTS.findall(source))
    found = {}
    for name, arguments in ENTRY_POINT.findall(source):
        while macro := next((each for each in shared if re.search(rf"\b{each}\b", arguments)), None):
            arguments = re.sub(rf"\b{macro}\b", shared[macro].replace("\\", ""), arguments)
        declarations = [declaration.strip() for declaration in arguments.split(",")]
        numbers = {declaration: _NUMBER.fullmatch(declaration) for declaration in declarations}
        found[name] = {
            declaration.split()[-1].lstrip("*"): number and number[1] for declaration, number in numbers.items()
        }
    return found


def find_loops(source: str) -> dict[str, tuple[str, str]]:
    """Return the loops of a source, see host/loops.py: the result's type and the parameters by the loop's name."""
    return {name: (result, parameters) for result, name, parameters in LOOP.findall(source)}
