"""Structs that cross to the device: their sizes, their lanes, their C text."""

from __future__ import annotations

import re

import numpy as np
import pytest

from clbvh import structs
from clbvh.structs import DEVICE_STRUCTS, c_declarations

SIZES = {"NODE": 32, "BVH2_NODE": 64, "TRIANGLE": 40, "PACKED_RAY": 32, "HIT": 16}
C_SIZES = {"float": 4, "int": 4, "uint": 4}


def read_declarations():
    """Return {struct: [(type, field, shape)]} as a C compiler would see it."""
    structs = {}
    for body, name in re.findall(r"typedef struct [^{]*\{(.*?)\} (\w+);", c_declarations(), flags=re.DOTALL):
        fields = re.findall(r"^\s*(\w+) (\w+)((?:\[\d+\])*);$", body, flags=re.MULTILINE)
        assert len(fields) == body.count(";")
        structs[name] = [(kind, field, tuple(map(int, re.findall(r"\d+", shape)))) for kind, field, shape in fields]
    return structs


@pytest.mark.parametrize(("name", "size"), SIZES.items())
def test_sizes(name, size):
    assert getattr(structs, name).itemsize == size


@pytest.mark.parametrize("name", DEVICE_STRUCTS)
def test_c_text_declares_every_field_in_order_without_padding(name):
    dtype = DEVICE_STRUCTS[name]
    offset = 0
    fields = read_declarations()[name]
    assert [field for _, field, _ in fields] == list(dtype.names)
    for kind, field, shape in fields:
        assert dtype.fields[field][1] == offset
        assert dtype[field].shape == shape
        assert {"f": "float", "i": "int", "u": "uint"}[dtype[field].base.kind] == kind
        offset += C_SIZES[kind] * int(np.prod(shape, dtype=int))
    assert offset == dtype.itemsize


def test_c_text_aligns_structs_by_what_divides_their_size():
    declared = re.findall(
        r"typedef struct (?:__attribute__\(\(aligned\((\d+)\)\)\) )?\{.*?\} (\w+);", c_declarations(), re.DOTALL
    )
    alignments = {name: int(alignment or C_SIZES["float"]) for alignment, name in declared}
    assert alignments.keys() == DEVICE_STRUCTS.keys()
    assert all(DEVICE_STRUCTS[name].itemsize % alignment == 0 for name, alignment in alignments.items())
    assert (alignments["bvh2_node_t"], alignments["triangle_t"], alignments["sphere_t"]) == (16, 8, 4)


def test_c_text_defines_every_constant_once():
    defined = re.findall(r"^#define (\w+) \((-?\d+)\)$", c_declarations(), flags=re.MULTILINE)
    assert {name: int(value) for name, value in defined} == structs.DEVICE_CONSTANTS
    assert len(defined) == len(structs.DEVICE_CONSTANTS)
    assert len(set(structs.SHADINGS.values())) == len(structs.SHADINGS)
    assert len(set(structs.LAYOUTS.values())) == len(structs.LAYOUTS)


def test_structs_cannot_be_declared_with_a_type_that_c_does_not_have(monkeypatch):
    monkeypatch.setitem(DEVICE_STRUCTS, "wide_t", np.dtype([("x", np.float64)]))
    with pytest.raises(KeyError):
        c_declarations()


def lanes_of(dtype, lane_count):
    """Return one record in which lane i of 4 bytes holds i, whatever its field's type."""
    record = np.zeros(1, dtype)
    record.view(np.int32)[:] = np.arange(lane_count)
    return record[0]


def numbers(field):
    return np.ascontiguousarray(field).view(np.int32).ravel().tolist()


def test_node_lanes_agree_with_the_dtype():
    node = lanes_of(structs.NODE, structs.NODE_LANES)
    assert numbers(node["aabb_min"]) == [0, 1, 2]
    assert node["first"] == structs.NODE_FIRST
    assert numbers(node["aabb_max"]) == [structs.NODE_MAX + axis for axis in range(3)]
    assert node["count"] == structs.NODE_COUNT


def test_bvh2_lanes_agree_with_the_dtype():
    node = lanes_of(structs.BVH2_NODE, structs.BVH2_LANES)
    for child in range(2):
        assert numbers(node["aabb_min"][child]) == [structs.BVH2_MIN + 3 * child + axis for axis in range(3)]
        assert numbers(node["aabb_max"][child]) == [structs.BVH2_MAX + 3 * child + axis for axis in range(3)]
        assert node["first"][child] == structs.BVH2_FIRST + child
        assert node["count"][child] == structs.BVH2_COUNT + child
