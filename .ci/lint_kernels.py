#!/usr/bin/env python3
"""Check the OpenCL sources: layout of the text, and that every include exists and is used.

``python .ci/lint_kernels.py [FOLDER ...]`` checks all ``.cl`` files below the folders, by default those of the project,
prints ``file:line: message`` for each finding and exits with 1 if there is one.

The rules:

- lines of at most 120 characters, no trailing space, no tab, exactly one newline at the end of the file;
- an include names a file below one of `INCLUDE_ROOTS`, as the host resolves it (`clbvh/device/program.py`);
- no built-in function whose result OpenCL leaves to the driver and no 64-bit atomic: answers are the same on every
  device; no double, except in a file that enables them, or that only the host runs;
- an include is used: the file uses an identifier that the included file defines, or one that it includes in turn and
  that no other include of the file brings. Macros, functions, structs and typedefs define identifiers; words in
  comments and strings are no uses.

Some includes are there for other reasons, such as those that the host has to expand before a branch. A comment that
begins with ``// keep:`` and says the reason exempts the includes from there to the next blank line. A file of includes
alone is a bundle, and needs no such comment.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]
FOLDERS = ("cl",)

# The folders of what only the host runs.
_HOST = {"host", "on_host"}

# Where the host looks for an include.
INCLUDE_ROOTS = ("cl",)

# The include that the host makes from clbvh/structs.py.
STRUCTS_INCLUDE = "structs.cl"

MAX_LINE = 120

# Functions of OpenCL with an error bound instead of a result, and what not every device has. cl/math/vectors.cl has the
# functions of vectors that are needed, written out.
_UNPORTABLE = re.compile(
    r"\b(?:(?:native|half|fast|atom)_\w+|normalize|length|distance|dot|cross|mix|mad|step|smoothstep|rsqrt|rootn|cbrt"
    r"|hypot|fmod|pow[nr]?|exp(?:2|10|m1)?|log(?:2|10|1p)?|sincos|a?(?:sin|cos|tan)h?(?:pi)?|atan2)\s*\("
)
_DOUBLE = re.compile(r"\b(?:convert_)?double\d*\b")
# The structs enable them for worlds that span scales.
_ENABLES_DOUBLE = {"#pragma OPENCL EXTENSION cl_khr_fp64 : enable", "#if EXACT", "#if !LONE && EXACT"}

_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*(?:// again\b.*)?$')
_ANY_INCLUDE = re.compile(r"^\s*#\s*include\b")
_KEEP = re.compile(r"^\s*// keep: \S")
_WORD = re.compile(r"\b[A-Za-z_]\w*\b")
_COMMENT_OR_STRING = re.compile(r'//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"', re.DOTALL)

_DEFINITIONS = (
    re.compile(r"^\s*#\s*define\s+(\w+)", re.MULTILINE),
    re.compile(r"^\}\s*(\w+)\s*;", re.MULTILINE),  # the end of typedef struct
    re.compile(r"^\s*typedef\b[^{};]*?(\w+)\s*;", re.MULTILINE),
    re.compile(r"^[A-Za-z_][\w \t*]*?(\w+)\s*\([^;{}]*\)\s*\{", re.MULTILINE),  # a function
)


class Source:
    """One file: its lines, the identifiers that it defines and uses, and its includes.

    Attributes
    ----------
    lines : list of str
    includes : list of (int, str, bool)
        Line number, name, and whether a `// keep:` comment exempts it.
    defined, used : set of str
    is_bundle : bool
        Whether the file consists of includes alone.
    """

    def __init__(self, text: str) -> None:
        self.lines = text.split("\n")
        self.includes = list(self._find_includes())
        code = "\n".join(line for line in _blank(text).split("\n") if not _ANY_INCLUDE.match(line))
        self.defined = {name for pattern in _DEFINITIONS for name in pattern.findall(code)}
        self.used = set(_WORD.findall(code))
        self.is_bundle = bool(self.includes) and not code.strip()

    def _find_includes(self) -> Iterator[tuple[int, str, bool]]:
        is_kept = False
        for number, line in enumerate(self.lines, start=1):
            if not line.strip():
                is_kept = False
            elif _KEEP.match(line):
                is_kept = True
            elif match := _INCLUDE.match(line):
                yield number, match[1], is_kept


class Linter:
    """The sources of a project, read once.

    Parameters
    ----------
    project : Path
        The folder that holds `INCLUDE_ROOTS`.
    structs : str
        The text that stands for `STRUCTS_INCLUDE`.
    """

    def __init__(self, project: Path, structs: str) -> None:
        self._roots = [project / root for root in INCLUDE_ROOTS]
        self._structs = Source(structs)
        self._sources: dict[Path, Source] = {}

    def check(self, path: Path) -> list[tuple[int, str]]:
        """Return the findings in one file: line numbers and messages, in order."""
        return sorted(
            [
                *_check_text(path.read_bytes().decode("utf-8")),
                *self._check_includes(self._read(path), has_doubles=not _HOST.isdisjoint(path.parts)),
            ]
        )

    def _check_includes(self, source: Source, *, has_doubles: bool) -> Iterator[tuple[int, str]]:
        has_doubles |= not _ENABLES_DOUBLE.isdisjoint(source.lines)
        for number, line in enumerate(source.lines, start=1):
            if _ANY_INCLUDE.match(line) and not _INCLUDE.match(line):
                yield number, "an include is a line of its own, '#include \"NAME\"': the host expands no other"
            text = _blank(line)
            if found := _UNPORTABLE.search(text) or (None if has_doubles else _DOUBLE.search(text)):
                yield number, f"'{found[0].rstrip(' (')}' differs between devices, or not all have it"
        for number, name, is_kept in source.includes:
            included = self._find(name)
            if included is None:
                yield number, f"'{name}' is in none of {', '.join(INCLUDE_ROOTS)}"
            elif not (is_kept or source.is_bundle or self._is_used(source, name, included)):
                yield number, f"nothing of '{name}' is used; if it is needed, say so: '// keep: REASON'"

    def _is_used(self, source: Source, name: str, included: Source) -> bool:
        if source.used & included.defined:
            return True
        others = [self._find(other) for _, other, _ in source.includes if other != name]
        brought: set[str] = set().union(*(self._all_defined(other) for other in others if other is not None))
        return bool(source.used & (self._all_defined(included) - brought))

    def _all_defined(self, source: Source) -> set[str]:
        """Return the identifiers that a file and all files that it includes define."""
        found, stack, seen = set(), [source], set()
        while stack:
            current = stack.pop()
            if id(current) not in seen:
                seen.add(id(current))
                found |= current.defined
                stack += [file for _, name, _ in current.includes if (file := self._find(name)) is not None]
        return found

    def _find(self, name: str) -> Source | None:
        if name == STRUCTS_INCLUDE:
            return self._structs
        path = next((root / name for root in self._roots if (root / name).is_file()), None)
        return None if path is None else self._read(path)

    def _read(self, path: Path) -> Source:
        if path not in self._sources:
            self._sources[path] = Source(path.read_text(encoding="utf-8"))
        return self._sources[path]


def _blank(text: str) -> str:
    """Return the text without comments and strings."""
    return _COMMENT_OR_STRING.sub(" ", text)


def _check_text(text: str) -> Iterator[tuple[int, str]]:
    lines = text.split("\n")
    for number, line in enumerate(lines, start=1):
        if len(line) > MAX_LINE:
            yield number, f"{len(line)} characters; a line has at most {MAX_LINE}"
        if line != line.rstrip():
            yield number, "trailing space"
        if "\t" in line:
            yield number, "a tab; indentation is four spaces"
    if lines[-1]:
        yield len(lines), "no newline at the end of the file"
    elif len(lines) > 1 and not lines[-2].strip():
        yield len(lines) - 1, "blank line at the end of the file"


def main(folders: list[str]) -> int:
    """Print the findings in all folders, and return the exit code."""
    sys.path.insert(0, str(PROJECT))
    from clbvh.structs import c_declarations

    linter = Linter(PROJECT, c_declarations())
    is_clean = True
    for folder in folders or FOLDERS:
        for path in sorted((PROJECT / folder).rglob("*.cl")):
            for line, message in linter.check(path):
                is_clean = False
                print(f"{path.relative_to(PROJECT)}:{line}: {message}")
    return 0 if is_clean else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
