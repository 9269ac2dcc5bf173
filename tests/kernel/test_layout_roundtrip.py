"""Every struct crosses to the device and back: a different value in every field, read and written field by field.

The kernels are made from `layout.DEVICE_STRUCTS`, so a new struct is covered by itself.
"""

from itertools import product

import numpy as np
import pytest

from clbvh.layout import DEVICE_CONSTANTS, DEVICE_STRUCTS, NO_PRIM

ROWS = 3


def c_elements(dtype):
    """The C expression of every scalar of a struct, and whether it is a float."""
    for name in dtype.names:
        for index in product(*map(range, dtype[name].shape)):
            yield name + "".join(f"[{i}]" for i in index), dtype[name].base == np.float32


def write_kernel(folder, name, dtype):
    """A kernel that takes a struct apart into lanes, and one that puts it together; return their name."""
    elements = list(c_elements(dtype))
    kernel = f"cross_{name}"
    reads = [
        f"lanes[{len(elements)} * i + {lane}] = {'as_int' if is_float else ''}(given[i].{element});"
        for lane, (element, is_float) in enumerate(elements)
    ]
    writes = [
        f"made[i].{element} = {'as_float' if is_float else ''}(lanes[{len(elements)} * i + {lane}]);"
        for lane, (element, is_float) in enumerate(elements)
    ]
    (folder / "kernels").mkdir(exist_ok=True)
    (folder / "kernels" / f"{kernel}.cl").write_text(
        '#include "layout.cl"\n'
        f"kernel void {kernel}(const global {name} *given, global int *lanes, global {name} *made,\n"
        "    global int *sizes, const int count)\n"
        "{\n"
        "    const int i = get_global_id(0);\n"
        "    if (i >= count) return;\n"
        f"    sizes[i] = sizeof({name});\n"
        f"    {' '.join(reads)}\n"
        f"    {' '.join(writes)}\n"
        "}\n"
    )
    return kernel, len(elements)


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
def test_every_field_is_where_the_device_looks_for_it(run_shell, tmp_path, name):
    dtype = DEVICE_STRUCTS[name]
    kernel, lane_count = write_kernel(tmp_path, name, dtype)
    rows = fill(dtype)

    lanes, made, sizes = run_shell(kernel, [rows], [(np.int32, (lane_count,)), dtype, np.int32], folder=tmp_path)

    expected = np.concatenate([rows[field].reshape(ROWS, -1).view(np.int32) for field in dtype.names], axis=1)
    assert len(np.unique(expected)) == expected.size
    assert (sizes == dtype.itemsize).all()
    np.testing.assert_array_equal(lanes, expected)
    assert made.tobytes() == rows.tobytes()


def test_constants_reach_the_device(run_shell, tmp_path):
    (tmp_path / "kernels").mkdir()
    stores = " ".join(
        f"values[{len(DEVICE_CONSTANTS)} * i + {place}] = {name};" for place, name in enumerate(DEVICE_CONSTANTS)
    )
    (tmp_path / "kernels" / "constants.cl").write_text(
        '#include "layout.cl"\n'
        "kernel void constants(const global int *unused, global int *values, const int count)\n"
        f"{{ const int i = get_global_id(0); if (i >= count) return; {stores} }}\n"
    )
    (values,) = run_shell("constants", [np.zeros(1, np.int32)], [(np.int32, (len(DEVICE_CONSTANTS),))], folder=tmp_path)
    assert dict(zip(DEVICE_CONSTANTS, values[0].tolist(), strict=True)) == DEVICE_CONSTANTS
    assert DEVICE_CONSTANTS["NO_PRIM"] == NO_PRIM == -1
