"""Compiles the kernels into a library for the host: every variant for every level of processor, linked into one file.

Each kernel gets an entry, a plain C function that runs a range of work-groups::

    void LEVEL_KERNEL_MACROS(const uchar *launch, long first_group, long end_group)

`launch` is four ints, the columns and rows of the work-groups and of the work-items of each, and then the kernel's
arguments in slots of 8 bytes. A loop of `cl/host/` gets an entry with its own parameters. Objects are kept by the text
that they were made of, so that a change compiles anew only what it touches.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from ...errors import ConfigError, DeviceError, KernelBuildError
from ...support.folders import find_cache, find_folder
from ...support.host_threads import usable_cores
from ..sources import ENTRY_POINT, LOOP, expand_for_host, expand_shipped, expand_source, find_arguments, find_loops
from .variants import FIXED, Variant, list_loop_files, list_variants, loop_entry, machine

COMPILER_VARIABLE = "CLBVH_CLANG"
OBJECTS_VARIABLE = "CLBVH_OBJECTS"

# The beginning of an object's name.
_NAME = re.compile(r"[0-9a-f]{32}\b")

# How long objects are kept after they were last needed.
_KEPT_S = 30 * 24 * 3600

# The oldest clang that compiles the sources.
_OLDEST_CLANG = 15
_NAMES = ("clang", *(f"clang-{version}" for version in range(29, _OLDEST_CLANG - 1, -1)))

# The levels of each kind of processor, from the lowest up, and what the compiler calls them.
LEVELS = {
    "x86_64": {"v2": "x86-64-v2", "v3": "x86-64-v3", "v4": "x86-64-v4"},
    "aarch64": {"neon": "armv8-a"},
}

# Rounding is ours to choose, and infinities and NaN mean something.
_OPTIONS = (
    "-x", "cl", "-cl-std=CL1.2", "-Xclang", "-cl-ext=+all", "-cl-no-stdinc", "-O3", "-ffp-contract=off",
    "-fno-math-errno", "-fno-asynchronous-unwind-tables", "-fPIC", "-fvisibility=hidden",
)  # fmt: skip
_KERNEL_OPTIONS = (*_OPTIONS, "-w", "-c")
# A pointer to another type is an error: Python checks what loops are given, and nobody what they do with it.
_LOOP_OPTIONS = (*_OPTIONS, "-Wno-everything", "-Werror=incompatible-pointer-types", "-fmax-type-align=1", "-c")
_C_OPTIONS = ("-x", "c", "-O2", "-fPIC", "-fvisibility=hidden", "-c")

_VISIBLE = '__attribute__((visibility("default")))'

_BUILTINS = "host/builtins.cl"
_LOOP_BUILTINS = "host/loops.cl"
_LEVEL = "host/level.c"


class Compiler(NamedTuple):
    """A clang: the commands that compile and that link, and the version as it names itself."""

    compile: tuple[str, ...]
    link: tuple[str, ...]
    version: str


def is_known_machine() -> bool:
    """Return whether kernels can be compiled for this system and its processor."""
    return sys.platform == "linux" and machine() in LEVELS


def find_compiler() -> Compiler | None:
    """Return the clang that `CLBVH_CLANG` names, one on the PATH, or the one in the package ziglang; or None."""
    names = [os.environ[COMPILER_VARIABLE]] if os.environ.get(COMPILER_VARIABLE) else _NAMES
    for name in names:
        path = shutil.which(name)
        version = _ask_version((path,)) if path else ""
        found = re.search(r"clang version (\d+)", version)
        if path and found and int(found[1]) >= _OLDEST_CLANG:
            return Compiler((path,), (path, "-shared", "-nostdlib", "-s"), version)
    spec = find_spec("ziglang")
    if spec is not None and spec.origin is not None and not os.environ.get(COMPILER_VARIABLE):
        zig = str(Path(spec.origin).with_name("zig"))
        return Compiler((zig, "clang"), (zig, "ld.lld", "-shared", "-s"), _ask_version((zig, "clang")))
    return None


def _need_compiler() -> Compiler:
    if (compiler := find_compiler()) is None:
        asked = os.environ.get(COMPILER_VARIABLE)
        found = f"{asked} is none" if asked else "none is on the PATH, nor is there the package ziglang"
        raise DeviceError(
            f"the kernels cannot be compiled without clang {_OLDEST_CLANG} or newer, and {found}: "
            f"`pip install ziglang`, or name a clang by {COMPILER_VARIABLE}"
        )
    return compiler


def _ask_version(command: Sequence[str]) -> str:
    try:
        return subprocess.run([*command, "--version"], capture_output=True, text=True, timeout=60, check=False).stdout
    except (OSError, subprocess.SubprocessError):
        return ""


def find_objects() -> Path:
    """Return the folder of what was compiled before: `CLBVH_OBJECTS`, or one in the user's cache."""
    return Path(os.environ.get(OBJECTS_VARIABLE) or find_cache() / "objects")


def build_library(
    target: Path, objects: Path, levels: Iterable[str], *, jobs: int | None = None,
    variants: Iterable[Variant] = (), macros: Mapping[str, int] | None = None,
) -> None:  # fmt: skip
    """Compile all kernels and loops for this machine's kind of processor, and link them.

    Parameters
    ----------
    target : Path
        The library; replaced at once when it is complete.
    objects : Path
        Folder of what was compiled before.
    levels : iterable of str
        Names in `LEVELS`.
    jobs : int, optional
        Compilers at a time; by default the number of usable processors.
    variants : iterable of Variant
        By default all.
    macros : mapping of str to int, optional
        Macros besides those of each variant.

    Raises
    ------
    DeviceError
        There is no compiler.
    KernelBuildError
        It refuses.
    """
    compiler = _need_compiler()
    names = LEVELS[machine()]
    levels = sorted(levels)
    chosen = list(variants) or list_variants()
    units = [_variant_unit(variant, level, names[level], macros or {}) for level in levels for variant in chosen]
    units += [_loops_unit(name, level) for level in levels for name in list_loop_files()]
    _link(compiler, target, objects, [*units, _level_unit(tuple(levels))], jobs)


def build_program(objects: Path, source: str, macros: Mapping[str, int], level: str) -> Path:
    """Compile kernels that do not ship with clbvh; return a library of their own, with entries LEVEL_KERNEL.

    Parameters
    ----------
    objects : Path
        Folder of what was compiled before, and of the library.
    source : str
        Source text, with its includes expanded.
    macros : mapping of str to int
        All macros of the source.
    level : str
        A name in `LEVELS`.

    Raises
    ------
    DeviceError
        There is no compiler.
    KernelBuildError
        It refuses.
    """
    compiler = _need_compiler()
    entries = {kernel: f"{level}_{kernel}" for kernel in find_arguments(source)}
    unit = _unit(source, entries, LEVELS[machine()][level], macros)
    target = objects / f"{_digest(compiler, unit)}.so"
    if not target.exists():
        _link(compiler, target, objects, [unit], 1)
    return target


def build_loops(objects: Path, name: str, level: str) -> Path:
    """Compile one file of loops; return a library of its own, with the entries of the whole one.

    Parameters and errors are those of `build_program`; the name is that of the file.
    """
    compiler = _need_compiler()
    unit = _loops_unit(name, level)
    target = objects / f"{_digest(compiler, unit)}.so"
    if not target.exists():
        _link(compiler, target, objects, [unit], 1)
    return target


def _link(compiler: Compiler, target: Path, objects: Path, units: Sequence[_Unit], jobs: int | None) -> None:
    """Compile the units, several at a time, and link them."""
    objects.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(jobs or usable_cores()) as pool:
        made = list(pool.map(lambda unit: _compile(compiler, unit, objects), units))
    target.parent.mkdir(parents=True, exist_ok=True)
    own = f"{os.getpid()}-{threading.get_ident()}"
    linked, listing = target.with_suffix(f".{own}.tmp"), objects / f"{target.name}.{own}.rsp"
    listing.write_text("\n".join(f'"{path}"' for path in made))
    try:
        _run([*compiler.link, "-o", str(linked), f"@{listing}"])
        linked.replace(target)
    finally:
        listing.unlink()
        linked.unlink(missing_ok=True)
    _forget_old(objects)


class _Unit(NamedTuple):
    """The input of one compilation: the options, the text, and the ending of its file."""

    options: tuple[str, ...]
    text: str
    ending: str


def _variant_unit(variant: Variant, level: str, processor: str, macros: Mapping[str, int]) -> _Unit:
    source = expand_for_host(f"kernels/{variant.name}.cl")
    entries = {kernel: f"{level}_{variant.entry(kernel)}" for kernel in find_arguments(source)}
    return _unit(source, entries, processor, FIXED | dict(variant.macros) | dict(macros))


def _unit(source: str, entries: Mapping[str, str], processor: str, macros: Mapping[str, int]) -> _Unit:
    """Return what compiles the kernels of a source, with their entries by the kernels' names."""
    arguments = find_arguments(source)
    texts = (_entry_text(kernel, arguments[kernel], entry) for kernel, entry in entries.items())
    kernels = ENTRY_POINT.sub(r"kernel void \1(const work_item_t work_item, \2)", source)
    text = expand_shipped(_BUILTINS) + kernels + "".join(texts)
    defines = (f"-D{macro}={value}" for macro, value in macros.items())
    return _Unit((*_KERNEL_OPTIONS, *_target_options(processor), *defines), text, ".cl")


# The length of an array, which a declaration gives for host/loops.py, and which OpenCL C does not allow.
_LENGTH = re.compile(r"(?<=\w)\[[^\]]*[a-z][^\]]*\]")
_PARAMETER_NAME = re.compile(r"(\w+)(?:\[[^\]]*\])*\s*(?:,|$)")


def _loops_unit(name: str, level: str) -> _Unit:
    """Return what compiles the loops of a file for a level, with their entries."""
    source = LOOP.sub(lambda declaration: _LENGTH.sub("[]", declaration[0]), expand_shipped(f"host/{name}.cl"))
    texts = []
    for loop, (result, parameters) in find_loops(source).items():
        entry, passed = f"{level}_{loop_entry(name, loop)}", ", ".join(_PARAMETER_NAME.findall(parameters))
        call = f"{'' if result == 'void' else 'return '}{loop}({passed});"
        texts.append(f"extern {_VISIBLE} {result} {entry}({parameters}) {{ {call} }}\n")
    options = *_LOOP_OPTIONS, *_target_options(LEVELS[machine()][level])
    return _Unit(options, expand_shipped(_BUILTINS) + expand_shipped(_LOOP_BUILTINS) + source + "".join(texts), ".cl")


def _level_unit(levels: tuple[str, ...]) -> _Unit:
    facts = f'{_VISIBLE} const char clbvh_facts[] = "{find_digest()} {" ".join(levels)}";\n'
    text = (find_folder("cl") / _LEVEL).read_text(encoding="utf-8")
    return _Unit((*_C_OPTIONS, *_target_options("")), text + facts, ".c")


def _target_options(processor: str) -> tuple[str, ...]:
    return (f"--target={machine()}-linux-gnu", *((f"-march={processor}",) if processor else ()))


# The slots are behind the four numbers of the launch.
_ENTRY = (
    f"extern {_VISIBLE} "
    + """void {entry}(
    const uchar *launch, const long first_group, const long end_group)
{{
    const int *shape = (const int *)launch;
    const ulong *slots = (const ulong *)(shape + 4);
    work_item_t item;
    item.group_count[0] = shape[0];
    item.group_count[1] = shape[1];
    item.global_size[0] = shape[0] * shape[2];
    item.global_size[1] = shape[1] * shape[3];
    for (long group = first_group; group < end_group; group++) {{
        item.group_id[0] = group % shape[0];
        item.group_id[1] = group / shape[0];
        for (int row = 0; row < shape[3]; row++) {{
            item.global_id[1] = item.group_id[1] * shape[3] + row;
            for (int column = 0; column < shape[2]; column++) {{
                item.global_id[0] = item.group_id[0] * shape[2] + column;
                {kernel}(item, {arguments});
            }}
        }}
    }}
}}
"""
)


def _entry_text(kernel: str, arguments: dict[str, str | None], entry: str) -> str:
    slots = (f"*(const {kind or 'ulong'} *)(slots + {number})" for number, kind in enumerate(arguments.values()))
    passed = (slot if kind else f"(void *){slot}" for slot, kind in zip(slots, arguments.values(), strict=True))
    return _ENTRY.format(entry=entry, kernel=kernel, arguments=", ".join(passed))


def _compile(compiler: Compiler, unit: _Unit, folder: Path) -> Path:
    """Return the object of a text, which is compiled unless it is there."""
    digest = _digest(compiler, unit)
    target = folder / f"{digest}.o"
    if target.exists():
        with suppress(OSError):  # see `_forget_old`
            os.utime(target)
    else:
        own = f"{digest}.{os.getpid()}-{threading.get_ident()}"
        source, made = folder / f"{own}{unit.ending}", folder / f"{own}.o"
        source.write_text(unit.text, encoding="utf-8")
        try:
            _run([*compiler.compile, *unit.options, str(source), "-o", str(made)])
            made.replace(target)
        finally:
            source.unlink()
    return target


def _forget_old(folder: Path) -> None:
    """Remove what no library has needed for a month."""
    for path in [*folder.glob("*.o"), *folder.glob("*.so")]:
        with suppress(OSError):  # another process has been quicker, or the file is another user's
            if _NAME.match(path.name) and time.time() - path.stat().st_mtime > _KEPT_S:
                path.unlink()


def _digest(compiler: Compiler, unit: _Unit) -> str:
    return hashlib.sha256("\0".join((compiler.version, *unit.options, unit.text)).encode()).hexdigest()[:32]


def _run(command: list[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise KernelBuildError("host", " ".join(command), done.stderr)
    return done.stdout


def find_digest() -> str:
    """Return a digest of everything that the library depends on."""
    folder, own = find_folder("cl"), Path(__file__).parent
    digest = hashlib.sha256(expand_source("structs.cl").encode() + repr(list_variants()).encode())
    for path in (*sorted(folder.rglob("*.c*")), own / "compile.py", own / "library.py", own.parent / "sources.py"):
        digest.update(f"{path.name}\0".encode() + path.read_bytes())
    return digest.hexdigest()[:32]


# What the compiler defines for a processor of each level of x86-64, from the highest down.
_V3 = ("__AVX2__", "__FMA__", "__BMI__", "__BMI2__", "__F16C__", "__LZCNT__", "__MOVBE__")
_V4 = (*_V3, "__AVX512VL__", "__AVX512DQ__", "__AVX512BW__", "__AVX512CD__")
_MACROS = {"v4": _V4, "v3": _V3, "v2": ()}


def find_level() -> str:
    """Return the highest level that this machine's processor has, by the compiler's knowledge of it.

    Raises
    ------
    DeviceError
        There is no compiler, or the kernels are not for processors of this kind.
    """
    if not is_known_machine():
        raise DeviceError(f"the kernels are not compiled for processors of the kind {machine()}")
    if machine() != "x86_64":
        return next(iter(LEVELS[machine()]))
    command = [*_need_compiler().compile, "-march=native", "-x", "c", "-dM", "-E", os.devnull]
    macros = _run(command)
    return next(level for level, needed in _MACROS.items() if all(f"{macro} " in macros for macro in needed))


def check_levels(levels: Sequence[str]) -> None:
    """Raise `ConfigError` unless all are levels of this machine's kind of processor."""
    known = LEVELS.get(machine(), {})
    if unknown := [level for level in levels if level not in known]:
        raise ConfigError(f"{machine()} has no level {unknown[0]}, but {', '.join(known) or 'none'}")
