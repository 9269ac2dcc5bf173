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
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from ...errors import ConfigError, DeviceError, KernelBuildError
from ...support.folders import find_cache, find_folder
from ...support.host_threads import usable_cores
from ..sources import ENTRY_POINT, LOOP, expand_for_host, expand_shipped, expand_source, find_arguments, find_loops
from .targets import Target, find_machine, find_target
from .variants import FIXED, WITHOUT_LEVEL, Variant, list_loop_files, list_variants, loop_entry

COMPILER_VARIABLE = "CLBVH_CLANG"
OBJECTS_VARIABLE = "CLBVH_OBJECTS"

# The beginning of an object's name.
_NAME = re.compile(r"[0-9a-f]{32}\b")

# How long objects are kept after they were last needed.
_KEPT_S = 30 * 24 * 3600

# The oldest clang that compiles the sources.
_OLDEST_CLANG = 15
_NAMES = ("clang", *(f"clang-{version}" for version in range(29, _OLDEST_CLANG - 1, -1)))

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


def find_own_target() -> Target | None:
    """Return the target of an installation from source, which is this machine; None where there is none.

    On other systems than Linux nobody has tried to compile: the library for them is in a wheel.
    """
    return find_target() if sys.platform == "linux" else None


def find_compiler() -> Compiler | None:
    """Return the clang that `CLBVH_CLANG` names, one on the PATH, or the one in the package ziglang; or None."""
    names = [os.environ[COMPILER_VARIABLE]] if os.environ.get(COMPILER_VARIABLE) else _NAMES
    for name in names:
        path = shutil.which(name)
        version = _ask_version((path,)) if path else ""
        found = re.search(r"clang version (\d+)", version)
        if path and found and int(found[1]) >= _OLDEST_CLANG:
            return Compiler((path,), (path, "-shared", "-nostdlib", "-s"), version)
    zig = None if os.environ.get(COMPILER_VARIABLE) else _find_zig()
    return zig and Compiler((zig, "clang"), (zig, "ld.lld", "-shared", "-s"), _ask_version((zig, "clang")))


def find_cross_compiler(target: Target) -> Compiler | None:
    """Return the clang of the package ziglang, which has every system's C library to link with; or None."""
    zig = _find_zig()
    link = "cc", "-shared", "-s", "-target", target.zig, *target.links
    return zig and Compiler((zig, "clang"), (zig, *link), _ask_version((zig, "clang")))


def _find_zig() -> Any:
    spec = find_spec("ziglang")
    return spec and spec.origin and str(Path(spec.origin).with_name("zig"))


def _need_compiler(target: Target | None = None) -> Compiler:
    if target is not None:
        if (compiler := find_cross_compiler(target)) is None:
            raise DeviceError(f"kernels for {target.name} are compiled by the package ziglang: `pip install ziglang`")
        return compiler
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
    path: Path, objects: Path, levels: Iterable[str] = (), *, target: Target | None = None, jobs: int | None = None,
    variants: Iterable[Variant] = (), macros: Mapping[str, int] | None = None,
) -> None:  # fmt: skip
    """Compile all kernels and loops, and link them.

    Parameters
    ----------
    path : Path
        The library; replaced at once when it is complete.
    objects : Path
        Folder of what was compiled before.
    levels : iterable of str
        Of the target; by default all.
    target : Target, optional
        A library for all machines of this target; by default for this one, by any compiler.
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
    compiler, target = _need_compiler(target), target or _need_own_target()
    levels = sorted(levels) or list(target.levels)
    chosen = list(variants) or list_variants()
    units = {
        (level, variant): _variant_unit(variant, level, target, macros or {})
        for level in levels
        for variant in chosen
        if level == levels[0] or variant.name not in WITHOUT_LEVEL.get(level, ())
    }
    loops = [_loops_unit(name, level, target) for level in levels for name in list_loop_files()]
    # Similar code side by side compresses better: wheels are 15 % smaller.
    order = sorted(range(len(units)), key=[*units].__getitem__)
    _link(compiler, path, objects, [*units.values(), *loops, _level_unit(levels, target)], jobs, order)


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
        Of this machine's target.

    Raises
    ------
    DeviceError
        There is no compiler.
    KernelBuildError
        It refuses.
    """
    compiler = _need_compiler()
    entries = {kernel: f"{level}_{kernel}" for kernel in find_arguments(source)}
    unit = _unit(source, entries, _target_options(_need_own_target(), level), macros)
    path = objects / f"{_digest(compiler, unit)}.so"
    if not path.exists():
        _link(compiler, path, objects, [unit], 1)
    return path


def build_loops(objects: Path, name: str, level: str) -> Path:
    """Compile one file of loops; return a library of its own, with the entries of the whole one.

    Parameters and errors are those of `build_program`; the name is that of the file.
    """
    compiler = _need_compiler()
    unit = _loops_unit(name, level, _need_own_target())
    path = objects / f"{_digest(compiler, unit)}.so"
    if not path.exists():
        _link(compiler, path, objects, [unit], 1)
    return path


def _link(
    compiler: Compiler, path: Path, objects: Path, units: Sequence[_Unit], jobs: int | None, order: Sequence[int] = ()
) -> None:
    """Compile the units, several at a time in their order, and link them: the first ones in another order."""
    objects.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(jobs or usable_cores()) as pool:
        made = list(pool.map(lambda unit: _compile(compiler, unit, objects), units))
    made = [made[number] for number in order] + made[len(order) :]
    path.parent.mkdir(parents=True, exist_ok=True)
    # In a folder of its own, under its own name: some libraries have it inside, and some linkers write more files.
    with TemporaryDirectory(dir=path.parent) as folder:
        linked, listing = Path(folder) / path.name, Path(folder) / "objects.rsp"
        # The linker for macOS takes objects in the order of their paths.
        ordered = [Path(folder) / f"{number:05}.o" for number in range(len(made))]
        for link, each in zip(ordered, made, strict=True):
            link.symlink_to(each.resolve())
        listing.write_text("\n".join(f'"{each.as_posix()}"' for each in ordered))
        _run([*compiler.link, "-o", str(linked), f"@{listing}"])
        linked.replace(path)
    _forget_old(objects)


class _Unit(NamedTuple):
    """The input of one compilation: the options, the text, and the ending of its file."""

    options: tuple[str, ...]
    text: str
    ending: str


def _variant_unit(variant: Variant, level: str, target: Target, macros: Mapping[str, int]) -> _Unit:
    source = expand_for_host(f"kernels/{variant.name}.cl")
    entries = {kernel: f"{level}_{variant.entry(kernel)}" for kernel in find_arguments(source)}
    return _unit(source, entries, _target_options(target, level), FIXED | dict(variant.macros) | dict(macros))


def _unit(source: str, entries: Mapping[str, str], options: tuple[str, ...], macros: Mapping[str, int]) -> _Unit:
    """Return what compiles the kernels of a source, with their entries by the kernels' names."""
    arguments = find_arguments(source)
    texts = (_entry_text(kernel, arguments[kernel], entry) for kernel, entry in entries.items())
    kernels = ENTRY_POINT.sub(r"kernel void \1(const work_item_t work_item, \2)", source)
    text = expand_shipped(_BUILTINS) + kernels + "".join(texts)
    defines = (f"-D{macro}={value}" for macro, value in macros.items())
    return _Unit((*_KERNEL_OPTIONS, *options, *defines), text, ".cl")


# The length of an array, which a declaration gives for host/loops.py, and which OpenCL C does not allow.
_LENGTH = re.compile(r"(?<=\w)\[[^\]]*[a-z][^\]]*\]")
_PARAMETER_NAME = re.compile(r"(\w+)(?:\[[^\]]*\])*\s*(?:,|$)")


def _loops_unit(name: str, level: str, target: Target) -> _Unit:
    """Return what compiles the loops of a file for a level, with their entries."""
    source = LOOP.sub(lambda declaration: _LENGTH.sub("[]", declaration[0]), expand_shipped(f"host/{name}.cl"))
    texts = []
    for loop, (result, parameters) in find_loops(source).items():
        entry, passed = f"{level}_{loop_entry(name, loop)}", ", ".join(_PARAMETER_NAME.findall(parameters))
        call = f"{'' if result == 'void' else 'return '}{loop}({passed});"
        texts.append(f"extern {_VISIBLE} {result} {entry}({parameters}) {{ {call} }}\n")
    options = *_LOOP_OPTIONS, *_target_options(target, level)
    return _Unit(options, expand_shipped(_BUILTINS) + expand_shipped(_LOOP_BUILTINS) + source + "".join(texts), ".cl")


def _level_unit(levels: Sequence[str], target: Target) -> _Unit:
    facts = f'{_VISIBLE} const char clbvh_facts[] = "{find_digest()} {" ".join(levels)}";\n'
    text = (find_folder("cl") / _LEVEL).read_text(encoding="utf-8")
    return _Unit((*_C_OPTIONS, *_target_options(target)), text + facts, ".c")


def _target_options(target: Target, level: str | None = None) -> tuple[str, ...]:
    processor = (f"-march={target.levels[level]}",) if level else ()
    return (f"--target={target.triple}", *processor, *target.options)


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
    for path in (
        *sorted(folder.rglob("*.c*")),
        own / "compile.py",
        own / "library.py",
        own / "targets.py",
        own.parent / "sources.py",
    ):
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
    target = _need_own_target()
    if target.machine != "x86_64":
        return next(iter(target.levels))
    command = [*_need_compiler().compile, "-march=native", "-x", "c", "-dM", "-E", os.devnull]
    macros = _run(command)
    return next(level for level, needed in _MACROS.items() if all(f"{macro} " in macros for macro in needed))


def check_levels(levels: Sequence[str]) -> None:
    """Raise `ConfigError` unless all are levels of this machine's target."""
    target = _need_own_target()
    if unknown := [level for level in levels if level not in target.levels]:
        raise ConfigError(f"{target.name} has no level {unknown[0]}, but {', '.join(target.levels)}")


def _need_own_target() -> Target:
    if (target := find_own_target()) is None:
        raise DeviceError(f"the kernels are not compiled on {sys.platform} for processors of the kind {find_machine()}")
    return target
