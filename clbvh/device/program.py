"""Kernel sources become programs of OpenCL, compiled by the device's driver."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import KernelBuildError
from ..support.say_once import saying_compiling_if_slow
from .context import DeviceContext, OpenclKernel, keep_for_ever
from .info import DeviceInfo
from .sources import expand_shipped, expand_source, find_arguments

# Types of numbers for PyOpenCL, which takes 6 us for an argument of unknown type.
_NUMBER_TYPES: dict[str | None, type[Any] | None] = {
    "int": np.int32, "uint": np.uint32, "float": np.float32, "double": np.float64, None: None,
}  # fmt: skip

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


def compile_kernels(
    shared: DeviceContext, info: DeviceInfo, name: str, defines: Mapping[str, int], folder: Path | None = None
) -> dict[str, OpenclKernel]:
    """Compile ``kernels/NAME.cl``, unless this process has done so for the device, and return its entry points by name.

    Parameters
    ----------
    shared : DeviceContext
    info : DeviceInfo
    name : str
    defines : mapping of str to int
        Macros; the tunables and sizes that the source asks for.
    folder : Path, optional
        Where files are looked for before the shipped `cl`.

    Raises
    ------
    KernelBuildError
        The device's compiler refuses; the message has its log.
    """
    path = f"kernels/{name}.cl"
    source = expand_shipped(path) if folder is None else expand_source(path, folder)
    options = make_options(defines)
    return shared.kernels((source, options), lambda: _compile(shared.context, info, source, options))


def make_options(defines: Mapping[str, int]) -> tuple[str, ...]:
    """Return the compiler's options on every device."""
    return (_OPTIONS, *(f"-D{macro}={value}" for macro, value in sorted(defines.items())))


def _compile(context: Any, info: DeviceInfo, source: str, options: Sequence[str]) -> dict[str, OpenclKernel]:
    import pyopencl as cl

    if info.is_simulator:
        options = (*options, *_SIMULATOR_OPTIONS)
    if info.kind == "gpu":
        options = (*options, GPU_OPTION)
    if info.cl_device.single_fp_config & cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT:
        options = (*options, CORRECT_ROUNDING)
    program = cl.Program(context, source)
    try:
        with warnings.catch_warnings():
            # PoCL says something about every build, good or bad.
            warnings.simplefilter("ignore", cl.CompilerWarning)
            with saying_compiling_if_slow():
                program.build(list(options), devices=[info.cl_device])
    except cl.Error as error:
        # PoCL 3.0 on the CPU may leave a program locked when it fails to build for want of memory; releasing it then
        # waits for ever, with Python's lock held, so that not even Ctrl-C is heard.
        keep_for_ever(program)
        raise KernelBuildError(info.name, " ".join(options), str(error)) from error
    arguments, kernels = find_arguments(source), {}
    for kernel in program.all_kernels():
        name = kernel.function_name
        kernel.set_scalar_arg_dtypes([_NUMBER_TYPES[kind] for kind in arguments[name].values()])
        kernels[name] = OpenclKernel(kernel, arguments[name])
    return kernels
