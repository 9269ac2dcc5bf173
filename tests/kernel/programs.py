"""Functions of `cl/` called on arrays: a test is a few lines of OpenCL, its inputs, and what numpy expects."""

import re
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from clbvh.kinds import TRIANGLE
from clbvh.structs import DEVICE_STRUCTS, PACKED_RAY
from clbvh.tree_layouts import LAYOUTS

NUMBERS = {
    "float": np.dtype("f4"), "int": np.dtype("i4"), "uint": np.dtype("u4"), "uchar": np.dtype("u1"),
    "double": np.dtype("f8"),
}  # fmt: skip
TYPES = NUMBERS | DEVICE_STRUCTS
NARROWER = {"f8": "f4", "i8": "i4", "b1": "i4"}

# The lengths of OpenCL's vectors of numbers.
VECTORS = (2, 3, 4, 8)

KERNEL = """{includes}

kernel void evaluate({arguments}, const int count)
{{
    const int i = get_global_id(0);
    if (i >= count) {{
        return;
    }}
    {loads}
#line 1 "body"
    {body}
    {stores}
}}
"""


@cache
def build_text(session, text, defines):
    """The kernels of a text, compiled once for all tests; `defines` as (name, value), sorted."""
    with TemporaryDirectory() as root:
        # Messages and the driver's cache have the name of the folder, so it is always the same.
        path = Path(root) / "tests" / "kernels" / "text.cl"
        path.parent.mkdir(parents=True)
        path.write_text(text, encoding="utf-8")
        return session.kernels("text", dict(defines), folder=path.parents[1])


def call(session, includes, body, outputs, *, tables=None, layout="brute", defines=None, has_doubles=False, **rows):
    """Run lines of OpenCL, once per row of arrays, and return the outputs as arrays, in their order.

    In the body each input and output is a variable of its row: a number, a vector of 2, 3, 4 or 8 numbers, or else a
    pointer to what the row has; ``i`` is the row. `outputs` are declarations, such as ``"float3 a, hit_t hits[2]"``,
    and begin as zeros. An input of one row belongs to all rows. `tables` are arrays that every row has as a whole.
    `includes` are files of `cl/`, or text with a ``#``. Inputs of float64 become floats, unless `has_doubles`.
    """
    inputs = {name: _as_device_has_it(array, has_doubles=has_doubles) for name, array in rows.items()}
    count = max(map(len, inputs.values()))
    inputs = {name: np.broadcast_to(array, (count, *array.shape[1:])) for name, array in inputs.items()}
    tables = {name: _as_device_has_it(array) for name, array in (tables or {}).items()}
    written = {name: np.zeros((count, *shape), dtype) for name, dtype, shape in _parse(outputs)}
    declared = [_declare(name, array) for name, array in inputs.items()]
    declared += [_declare(name, array, is_output=True) for name, array in written.items()]
    declared += [(_declare(name, array)[0].replace(f"all_{name}", name), "", "") for name, array in tables.items()]
    arguments, loads, stores = zip(*declared, strict=True)
    text = KERNEL.format(
        includes=includes if "#" in includes else "\n".join(f'#include "{name}"' for name in includes.split()),
        arguments=", ".join(arguments),
        loads=" ".join(loads),
        body=body,
        stores=" ".join(stores[len(inputs) :]),
    )
    defines = {"LAYOUT": LAYOUTS[layout].number, "STACK_SIZE": 48} | (defines or {})
    kernel = build_text(session, text, tuple(sorted(defines.items())))["evaluate"]
    buffers = [session.upload(array) for array in (*inputs.values(), *written.values(), *tables.values())]
    try:
        arguments = zip(kernel.argument_names, (*buffers, np.int32(count)), strict=True)
        session.run(kernel, (count,), (64,), **dict(arguments))
        for buffer, array in zip(buffers[len(inputs) :], written.values(), strict=False):
            session.download(buffer, array)
    finally:
        for buffer in buffers:
            session.release(buffer)
    return tuple(written.values()) if len(written) > 1 else next(iter(written.values()))


def _as_device_has_it(array, *, has_doubles=False):
    array = np.asarray(array)
    is_kept = has_doubles and array.dtype == np.float64
    return array if is_kept else array.astype(NARROWER.get(array.dtype.str[1:], array.dtype))


def _parse(outputs):
    """Yield the name, the dtype and the shape of a row of each declaration."""
    for declaration in outputs.split(", "):
        kind, name, size = re.fullmatch(r"(\w+) (\w+)(?:\[(\d+)\])?", declaration).groups()
        length = "" if kind in TYPES else kind[-1]
        shape = tuple(int(text) for text in (size, length) if text)
        yield name, TYPES[kind.removesuffix(length)], shape


def _declare(name, array, *, is_output=False):
    """The argument for an array, and the lines that load its row into a variable and store it."""
    const = "" if is_output else "const "
    kind = next(kind for kind, dtype in TYPES.items() if dtype == array.dtype)
    argument = f"{const}global {kind} *restrict all_{name}"
    shape = array.shape[1:]
    if shape == () and (kind in NUMBERS or is_output):
        return argument, f"{const}{kind} {name} = all_{name}[i];", f"all_{name}[i] = {name};"
    if len(shape) == 1 and shape[0] in VECTORS and kind in NUMBERS:
        places = [f"all_{name}[{shape[0]} * i + {index}]" for index in range(shape[0])]
        load = f"{const}{kind}{shape[0]} {name} = ({kind}{shape[0]})({', '.join(places)});"
        return argument, load, " ".join(f"{place} = {name}.s{index};" for index, place in enumerate(places))
    return argument, f"{const}global {kind} *{name} = all_{name} + {np.prod(shape, dtype=int)} * i;", ""


def make_rays(origins, directions, t_min=0.0, t_max=np.inf):
    """An array of `structs.PACKED_RAY`; all rays may share an origin, a direction or limits."""
    origins, directions = np.broadcast_arrays(np.atleast_2d(origins), np.atleast_2d(directions))
    rays = np.empty(len(origins), PACKED_RAY)
    rays["origin"], rays["direction"] = origins, directions
    rays["t_min"], rays["t_max"] = t_min, t_max
    return rays


def make_triangles(corners, prim_ids=0):
    """An array of `TRIANGLE` with these corners, (n, 3, 3)."""
    triangles = np.empty(len(corners), TRIANGLE)
    for index, name in enumerate("abc"):
        triangles[name] = corners[:, index]
    triangles["prim_id"] = prim_ids
    return triangles
