"""Shell kernels: each `kernels/NAME.cl` here calls one function of `cl/` once per work-item."""

from pathlib import Path

import numpy as np
import pytest

from clbvh.device.program import build_kernel

HERE = Path(__file__).parent
GROUP_SIZE = 64


@pytest.fixture(scope="session")
def run_shell(_opened_device):
    """A function that runs a shell over arrays and returns arrays.

    ``run_shell(name, inputs, outputs)``: the kernel takes the inputs, the outputs and the number of rows, in that
    order. `outputs` are dtypes, or pairs of a dtype and a shape per row; the rows are those of the first input.
    """
    kernels = {}
    session = _opened_device

    def run(name, inputs, outputs, defines=None, folder=HERE):
        key = (name, folder, tuple(sorted((defines or {}).items())))
        if key not in kernels:
            kernels[key] = build_kernel(session, name, defines, folder=folder)
        count = len(inputs[0])
        results = []
        for output in outputs:
            dtype, shape = output if isinstance(output, tuple) else (output, ())
            results.append(np.zeros((count, *shape), dtype))
        given = [session.upload(array) for array in inputs]
        written = [session.upload(array) for array in results]
        try:
            session.run(kernels[key], (count,), (GROUP_SIZE,), *given, *written, np.int32(count))
            for buffer, array in zip(written, results, strict=True):
                session.download(buffer, array)
        finally:
            for buffer in given + written:
                session.release(buffer)
        return results

    return run


@pytest.fixture(scope="session")
def make_rays():
    """A function from origins, directions and limits to an array of `layout.RAY`."""
    from clbvh.layout import RAY

    def make(origins, directions, t_min=0.0, t_max=np.inf):
        origins, directions = np.broadcast_arrays(np.atleast_2d(origins), np.atleast_2d(directions))
        rays = np.empty(len(origins), RAY)
        rays["origin"], rays["direction"] = origins, directions
        rays["t_min"], rays["t_max"] = t_min, t_max
        return rays

    return make
