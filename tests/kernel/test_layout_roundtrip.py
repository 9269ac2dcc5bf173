"""Every struct crosses to the device and back: a different value in every field, read and written field by field.

The kernels are made from `structs.DEVICE_STRUCTS`, so a new struct is covered by itself.
"""

from functools import partial
from itertools import product

import numpy as np
import pytest

from clbvh.structs import DEVICE_CONSTANTS, DEVICE_STRUCTS, NO_PRIM

ROWS = 3


def c_elements(dtype):
    """The C expression of every scalar of a struct, and whether it is a float."""
    for name in dtype.names:
        for index in product(*map(range, dtype[name].shape)):
            yield name + "".join(f"[{i}]" for i in index), dtype[name].base == np.float32


def kernel_text(name, dtype):
    """A kernel that takes a struct apart into lanes, and puts another one together from them."""
    elements = list(c_elements(dtype))
    reads = [
        f"lanes[{len(elements)} * i + {lane}] = {'as_int' if is_float else ''}(given[i].{element});"
        for lane, (element, is_float) in enumerate(elements)
    ]
    writes = [
        f"made[i].{element} = {'as_float' if is_float else ''}(lanes[{len(elements)} * i + {lane}]);"
        for lane, (element, is_float) in enumerate(elements)
    ]
    return (
        f"kernel void cross_{name}(const global {name} *given, global int *lanes, global {name} *made,\n"
        "    global int *sizes, const int count)\n"
        "{\n"
        "    const int i = get_global_id(0);\n"
        "    if (i >= count) return;\n"
        f"    sizes[i] = sizeof({name});\n"
        f"    {' '.join(reads)}\n"
        f"    {' '.join(writes)}\n"
        "}\n"
    )


def constants_text():
    """A kernel that writes the value of each constant."""
    stores = " ".join(f"values[{index}] = {name};" for index, name in enumerate(DEVICE_CONSTANTS))
    signature = "kernel void constants(const global int *unused, global int *values, const int count)"
    return f"{signature}\n{{ if (get_global_id(0) < count) {{ {stores} }} }}\n"


@pytest.fixture(scope="module")
def cross(run_shell, tmp_path_factory):
    """A function that runs one of the kernels; all of them are one program."""
    folder = tmp_path_factory.mktemp("structs")
    (folder / "kernels").mkdir()
    kernels = [kernel_text(name, dtype) for name, dtype in DEVICE_STRUCTS.items()]
    text = "\n".join(['#include "structs.cl"', *kernels, constants_text()])
    (folder / "kernels" / "crossings.cl").write_text(text, encoding="utf-8")
    return partial(run_shell, bundle="crossings", defines={}, folder=folder)


def fill(dtype):
    """Rows of a struct in which no two scalars are equal."""
    rows = np.zeros(ROWS, dtype)
    value = 1
    for row, name in product(range(ROWS), dtype.names):
        size = rows[name][row].size
        # Halves, so that a float that is converted to an integer on the way does not survive.
        values = np.arange(value, value + size) + (0.5 if dtype[name].base == np.float32 else 0)
        rows[name][row] = values.reshape(dtype[name].shape)
        value += size
    return rows


@pytest.mark.parametrize("name", DEVICE_STRUCTS)
def test_every_field_is_where_the_device_looks_for_it(cross, name):
    dtype = DEVICE_STRUCTS[name]
    lane_count = len(list(c_elements(dtype)))
    rows = fill(dtype)

    lanes, made, sizes = cross(f"cross_{name}", [rows], [(np.int32, (lane_count,)), dtype, np.int32])

    expected = np.concatenate([rows[field].reshape(ROWS, -1).view(np.int32) for field in dtype.names], axis=1)
    assert len(np.unique(expected)) == expected.size
    assert (sizes == dtype.itemsize).all()
    np.testing.assert_array_equal(lanes, expected)
    assert made.tobytes() == rows.tobytes()


def test_constants_reach_the_device(cross):
    (values,) = cross("constants", [np.zeros(1, np.int32)], [(np.int32, (len(DEVICE_CONSTANTS),))])
    assert dict(zip(DEVICE_CONSTANTS, values[0].tolist(), strict=True)) == DEVICE_CONSTANTS
    assert DEVICE_CONSTANTS["NO_PRIM"] == NO_PRIM == -1
