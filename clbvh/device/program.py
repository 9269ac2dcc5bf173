"""Kernel sources become programs: find, expand, build.

Includes are expanded here, not by the OpenCL compiler, for two reasons: the expanded text is all that a compiled
program depends on, so it is a safe cache key; and `#line` markers make every compiler message name our file and
line.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InternalError, KernelBuildError
from ..structs import c_declarations
from ..support.folders import find_folder
from ..support.say_once import saying_compiling_if_slow
from .context import Kernel, check_process, keep_for_ever
from .session import DeviceSession

# The include that stands for the text made from `clbvh/structs.py`.
STRUCTS_INCLUDE = "structs.cl"

# An entry point in the expanded text: its name, and its arguments.
_ENTRY_POINT = re.compile(r"^kernel void (\w+)\(([^)]*)\)", re.MULTILINE)

# Arguments that several kernels share: a macro and its text.
_SHARED_ARGUMENTS = re.compile(r"^#define (\w+_ARGUMENTS) ((?:.*\\\n)*.*)", re.MULTILINE)

# An argument that is a number, and the types of these.
_NUMBER = re.compile(r"(?:^|,)\s*(?:const )?(int|uint|float|double) (\w+)\s*(?=,|$)")
_NUMBER_TYPES: dict[str, type[Any]] = {"int": np.int32, "uint": np.uint32, "float": np.float32, "double": np.float64}

_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')

# Relaxed mathematics would let the compiler assume that there is no infinity: slab tests rely on it.
_OPTIONS = "-cl-std=CL1.2"

# OpenCL allows errors of 2.5 units in the last place in quotients and 3 in square roots, which GPUs use; with this they
# have the bits of every other device. The drivers for CPUs round correctly with and without it.
CORRECT_ROUNDING = "-cl-fp32-correctly-rounded-divide-sqrt"

# Kernels of wide layouts spare the registers of a GPU, see cl/triangles/block.cl.
GPU_OPTION = "-DIS_GPU=1"

# Oclgrind 21.10 has no instruction for popcount, which its compiler (clang 14) makes of other expressions, and takes
# the negation of a true lane in a mask for true. Neither occurs without the optimizer; and then every access that is
# checked is one of the source.
_SIMULATOR_OPTIONS = ("-DPORTABLE=1", "-cl-opt-disable")


def expand_source(name: str, folder: Path | None = None) -> str:
    """Return the text of a kernel file with its includes expanded, each file once.

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
def _expand_shipped(name: str) -> str:
    """Return the text of a shipped kernel file; files are read once in a process, as modules are."""
    return expand_source(name)


def _expand(name: str, roots: list[Path], seen: set[str]) -> Iterator[str]:
    """Yield the lines of a file, unless it was seen before."""
    if name in seen:
        return
    seen.add(name)
    label, text = _read(name, roots)
    yield f'#line 1 "{label}"'
    for number, line in enumerate(text.splitlines(), start=1):
        if match := _INCLUDE.match(line):
            yield from _expand(match[1], roots, seen)
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


def build_kernel(
    session: DeviceSession, name: str, defines: Mapping[str, int] | None = None, *, folder: Path | None = None
) -> Kernel:
    """Compile ``kernels/NAME.cl`` and return its entry point of the same name; see `build_kernels`."""
    return build_kernels(session, name, defines, folder=folder)[name]


def build_kernels(
    session: DeviceSession, name: str, defines: Mapping[str, int] | None = None, *, folder: Path | None = None
) -> dict[str, Kernel]:
    """Compile ``kernels/NAME.cl``, unless this process has done so for the device, and return its entry points by name.

    Parameters
    ----------
    session : DeviceSession
    name : str
    defines : mapping of str to int, optional
        Macros; the tunables and sizes that the source asks for.
    folder : Path, optional
        Where files are looked for before the shipped `cl`.

    Raises
    ------
    KernelBuildError
        The device's compiler refuses; the message has its log.
    """
    check_process()
    path = f"kernels/{name}.cl"
    source = _expand_shipped(path) if folder is None else expand_source(path, folder)
    options = make_options(defines or {})
    return session.shared.kernels((source, options), lambda: _compile(session, source, options))


def make_options(defines: Mapping[str, int]) -> tuple[str, ...]:
    """Return the compiler's options on every device."""
    return (_OPTIONS, *(f"-D{macro}={value}" for macro, value in sorted(defines.items())))


def _compile(session: DeviceSession, source: str, options: Sequence[str]) -> dict[str, Kernel]:
    import pyopencl as cl

    if session.info.is_simulator:
        options = (*options, *_SIMULATOR_OPTIONS)
    if session.info.kind == "gpu":
        options = (*options, GPU_OPTION)
    if session.info.cl_device.single_fp_config & cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT:
        options = (*options, CORRECT_ROUNDING)
    program = cl.Program(session.context, source)
    try:
        with warnings.catch_warnings():
            # PoCL says something about every build, good or bad.
            warnings.simplefilter("ignore", cl.CompilerWarning)
            with saying_compiling_if_slow():
                program.build(list(options), devices=[session.info.cl_device])
    except cl.Error as error:
        # PoCL 3.0 on the CPU may leave a program locked when it fails to build for want of memory; releasing it then
        # waits for ever, with Python's lock held, so that not even Ctrl-C is heard.
        keep_for_ever(program)
        raise KernelBuildError(session.info.name, " ".join(options), str(error)) from error
    arguments, kernels = find_arguments(source), {}
    for kernel in program.all_kernels():
        name = kernel.function_name
        # PyOpenCL takes 6 us for a number of which it knows no type.
        kernel.set_scalar_arg_dtypes(list(arguments[name].values()))
        kernels[name] = Kernel(kernel, arguments[name])
    return kernels


def find_arguments(source: str) -> dict[str, dict[str, type[Any] | None]]:
    """Return the arguments of each entry point of an expanded source, with the numpy types of those that are numbers.

    From the text and not from the driver: a driver that loads a compiled program from a cache may have forgotten them.
    """
    shared = dict(_SHARED_ARGUMENTS.findall(source))
    found = {}
    for name, arguments in _ENTRY_POINT.findall(source):
        while macro := next((each for each in shared if re.search(rf"\b{each}\b", arguments)), None):
            arguments = re.sub(rf"\b{macro}\b", shared[macro].replace("\\", ""), arguments)
        text = " ".join(arguments.split())
        numbers = {argument: _NUMBER_TYPES[kind] for kind, argument in _NUMBER.findall(text)}
        found[name] = {argument: numbers.get(argument) for argument in re.findall(r"(\w+)\s*(?:,|$)", text)}
    return found
