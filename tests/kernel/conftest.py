"""Shell kernels: each `kernels/NAME.cl` here calls one function of `cl/` once per work-item."""

import numpy as np
import pytest

from clbvh.structs import LAYOUTS

from . import packed_rays
from .programs import HERE, find_kernel

WORK_GROUP_SIZE = 64

# The bundle of the shells for single numbers, boxes and triangles, and what it is built with.
SHELLS = "shells"
SHELL_DEFINES = {"LAYOUT": LAYOUTS["brute"]}


@pytest.fixture(scope="session")
def run_shell(_opened_device):
    """A function that runs a shell over arrays and returns arrays.

    ``run_shell(name, inputs, outputs)``: the kernel takes the inputs, the outputs and the number of rows, in that
    order. `outputs` are dtypes, or pairs of a dtype and a shape per row; the rows are those of the first input.
    `bundle`, `defines` and `folder` say which program has the shell, see `programs.find_kernel`.
    """
    session = _opened_device

    def run(name, inputs, outputs, bundle=SHELLS, defines=None, folder=HERE):
        kernel = find_kernel(session, bundle, name, SHELL_DEFINES if defines is None else defines, folder)
        count = len(inputs[0])
        results = []
        for output in outputs:
            dtype, shape = output if isinstance(output, tuple) else (output, ())
            results.append(np.zeros((count, *shape), dtype))
        given = [session.upload(array) for array in inputs]
        written = [session.upload(array) for array in results]
        try:
            arguments = zip(kernel.argument_names, (*given, *written, np.int32(count)), strict=True)
            session.run(kernel, (count,), (WORK_GROUP_SIZE,), **dict(arguments))
            for buffer, array in zip(written, results, strict=True):
                session.download(buffer, array)
        finally:
            for buffer in given + written:
                session.release(buffer)
        return results

    return run


@pytest.fixture(scope="session")
def run_lane_shell(run_shell):
    """As `run_shell`, with a wide layout before the name, for the shells that work in lanes; see `lane_shells.cl`."""

    def run(layout, name, inputs, outputs, *, portable=False):
        defines = {"LAYOUT": LAYOUTS[layout], "STACK_SIZE": 16} | ({"PORTABLE": 1} if portable else {})
        return run_shell(name, inputs, outputs, "lane_shells", defines)

    return run


@pytest.fixture(scope="session")
def make_rays():
    """A function from origins, directions and limits to an array of `structs.PACKED_RAY`."""
    return packed_rays.make_rays
