"""Structs that cross to the device: their sizes, their lanes, their C text."""

import re

import numpy as np
import pytest

from clbvh import structs
from clbvh.structs import DEVICE_STRUCTS, c_declarations

SIZES = {"NODE": 32, "BVH2_NODE": 64, "TRIANGLE": 40, "PACKED_RAY": 32, "HIT": 16}


def test_c_text_declares_every_field_in_order_without_padding():
    assert {name: getattr(structs, name).itemsize for name in SIZES} == SIZES
    declared = re.findall(
        r"typedef struct (?:__attribute__\(\(aligned\((\d+)\)\)\) )?\{(.*?)\} (\w+);", c_declarations(), re.DOTALL
    )
    assert [name for _, _, name in declared] == list(DEVICE_STRUCTS)
    for alignment, body, name in declared:
        fields, dtype, offset = (
            re.findall(r"^\s*(\w+) (\w+)((?:\[\d+\])*);$", body, re.MULTILINE),
            DEVICE_STRUCTS[name],
            0,
        )
        assert [field for _, field, _ in fields] == list(dtype.names)
        assert len(fields) == body.count(";")
        for kind, field, shape in fields:
            assert dtype.fields[field][1] == offset
            assert dtype[field].shape == tuple(map(int, re.findall(r"\d+", shape)))
            assert {"f": "float", "i": "int", "u": "uint"}[dtype[field].base.kind] == kind
            offset += 4 * int(np.prod(dtype[field].shape, dtype=int))
        assert offset == dtype.itemsize
        assert dtype.itemsize % int(alignment or 4) == 0
    alignments = {name: alignment for alignment, _, name in declared}
    assert [alignments[name] for name in ("bvh2_node_t", "triangle_t", "sphere_t")] == ["16", "8", ""]


def test_c_text_defines_every_constant_once():
    defined = re.findall(r"^#define (\w+) \((-?\d+)\)$", c_declarations(), flags=re.MULTILINE)
    assert {name: int(value) for name, value in defined} == structs.DEVICE_CONSTANTS
    assert len(defined) == len(structs.DEVICE_CONSTANTS)
    for numbers in (structs.SHADINGS, structs.LAYOUTS):
        assert len(set(numbers.values())) == len(numbers)


def test_structs_cannot_be_declared_with_a_type_that_c_does_not_have(monkeypatch):
    monkeypatch.setitem(DEVICE_STRUCTS, "wide_t", np.dtype([("x", np.float64)]))
    with pytest.raises(KeyError):
        c_declarations()


def test_lanes_agree_with_the_dtypes():
    """Lane i of 4 bytes holds i, whatever its field's type."""
    node, node2 = np.zeros((), structs.NODE), np.zeros((), structs.BVH2_NODE)
    for record in (node, node2):
        record.reshape(1).view(np.int32)[:] = np.arange(record.itemsize // 4)
    assert node["aabb_min"].view(np.int32).tolist() == [0, 1, 2]
    assert node["aabb_max"].view(np.int32).tolist() == [structs.NODE_MAX + axis for axis in range(3)]
    assert (node["first"], node["count"]) == (structs.NODE_FIRST, structs.NODE_COUNT)
    for child in range(2):
        for field, first in (("aabb_min", structs.BVH2_MIN), ("aabb_max", structs.BVH2_MAX)):
            assert node2[field][child].view(np.int32).tolist() == [first + 3 * child + axis for axis in range(3)]
        assert node2["first"][child] == structs.BVH2_FIRST + child
        assert node2["count"][child] == structs.BVH2_COUNT + child
