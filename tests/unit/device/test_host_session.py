"""The host as a device: what a kernel cannot be given is refused before it runs, and buffers are the host's memory."""

from contextlib import nullcontext

import numpy as np
import pytest

from clbvh import DeviceMemoryError, InternalError, Tracer
from clbvh.device.host import compile, library
from clbvh.device.open import open_device
from clbvh.kinds import ALL_KINDS
from clbvh.tree_layouts import LAYOUTS, WIDE_LAYOUTS

from ...packing import device_packs

SOURCE = (
    "kernel void scale_rows(global float *x, const float factor, const int count)\n{\n"
    + """
    const int i = get_global_id(0) + get_global_id(1) * get_global_size(0);
    if (i < count) {
        x[i] *= factor;
    }
}
"""
)

# Of rays that the host casts together, see cl/on_host/world/rays.cl.
BATCH_SOURCE = """
#include "on_host/world/rays.cl"

kernel void measure_batch(global int *rests)
{
    rests[0] = __alignof__(batch_t) % sizeof(lanes_t);
    rests[1] = (size_t)&((batch_t *)0)->entry_point % sizeof(lanes_t);
    rests[2] = sizeof(node_t) % sizeof(lanes_t);
}
"""

COUNT = 10_001


@pytest.fixture
def host():
    with open_device("host") as opened:
        yield opened


@pytest.fixture
def scale_rows(host, tmp_path):
    """The kernel of the source above."""
    (tmp_path / "kernels").mkdir()
    (tmp_path / "kernels" / "scale_rows.cl").write_text(SOURCE)
    return host.kernel("scale_rows", folder=tmp_path)


@pytest.mark.parametrize(
    ("size", "group"), [((COUNT,), (64,)), ((COUNT,), (1,)), ((101, 100), (8, 8)), ((COUNT, 1), (32, 1))]
)
def test_every_item_runs_once(host, scale_rows, size, group):
    values = np.arange(COUNT, dtype=np.float32)
    buffer, found = host.upload(values), np.empty_like(values)
    host.run(scale_rows, size, group, x=buffer, factor=np.float32(3), count=np.int32(COUNT))
    host.download(buffer, found)
    np.testing.assert_array_equal(found, 3 * values)
    assert host.times.sums_ms()["kernel"] > 0


@pytest.mark.parametrize("layout", WIDE_LAYOUTS)
@pytest.mark.parametrize("macros", [{"LONE": 1}, {"LONE": 1, "EXACT": 1}, {"LONE": 0, "KINDS": ALL_KINDS}], ids=str)
def test_an_entry_point_among_the_variables_of_a_kernel_has_the_alignment_of_vectors(host, tmp_path, layout, macros):
    (tmp_path / "kernels").mkdir()
    (tmp_path / "kernels" / "measure_batch.cl").write_text(BATCH_SOURCE)
    macros = {"LAYOUT": LAYOUTS[layout].number, "STACK_SIZE": 32, "TOP_STACK_SIZE": 32} | macros
    rests = np.full(3, -1, np.int32)
    host.run(host.kernels("measure_batch", macros, folder=tmp_path)["measure_batch"], (1,), (1,), rests=rests)
    assert rests.tolist() == [0, 0, 0]


def test_the_first_arguments_of_a_kernel_may_be_given_once_for_many_launches(host, scale_rows):
    values = np.arange(COUNT, dtype=np.float32)
    buffer, found = host.upload(values), np.empty_like(values)
    kernel = scale_rows.with_first({"x": buffer})
    host.run(kernel, (COUNT,), (64,), factor=np.float32(2), count=np.int32(COUNT))
    host.run_groups(kernel.entry, kernel.bind_numbers((COUNT, 1, 1, 1), (3.0, COUNT)), COUNT, 1, kernel.hold())
    host.download(buffer, found)
    np.testing.assert_array_equal(found, 6 * values)
    for wrong in ((3.0,), (3.0, COUNT, COUNT), (3.0, 1.5)):
        with pytest.raises(InternalError, match="does not take an argument"):
            kernel.bind_numbers((COUNT, 1, 1, 1), wrong)
    with pytest.raises(InternalError, match="takes x: missing or unknown are factor, x"):
        scale_rows.with_first({"factor": 1.0})


def test_what_a_kernel_cannot_be_given_is_refused(host, scale_rows):
    buffer, released = host.allocate(64), host.allocate(64)
    host.release(released)
    good = {"x": buffer, "factor": np.float32(1), "count": np.int32(16)}
    for wrong, words in (
        ({"row": 1}, "takes x, factor, count: missing or unknown are row"),
        ({"x": released}, "given back"),
        ({"x": np.zeros((4, 4), np.float32).T[::2]}, "not contiguous"),
        ({"count": 1.5}, "does not take an argument"),
        ({"factor": buffer}, "does not take an argument"),
        ({"x": np.int32(5)}, "no buffer"),
        ({"x": 5}, "no buffer"),
    ):
        with pytest.raises(InternalError, match=words):
            host.run(scale_rows, (16,), (16,), **good | wrong)
    with pytest.raises(InternalError, match="missing or unknown are count"):
        host.run(scale_rows, (16,), (16,), x=buffer, factor=np.float32(1))
    with pytest.raises(InternalError, match=r"has no entry v?\w+_closest_hit_.*: see host/variants\.py"):
        host.kernel("closest_hit", {"NONE": 1})


def test_buffers_are_aligned_memory_of_the_host(host):
    buffer = host.upload(np.arange(100))
    assert buffer.address % 64 == 0
    with host.mapped(buffer, 10, np.dtype(np.int64), write=True, first=5) as part:
        part[:] = -1
    with host.mapped(buffer, 100, np.dtype(np.int64), write=False) as whole:
        assert whole.sum() == 4950 - sum(range(5, 15)) - 10
    assert host.buffer_count == 1
    with pytest.raises(DeviceMemoryError, match=r"need.* about .* MB of memory, but .* are free: try a smaller job"):
        host.allocate(2**50)
    host.close()
    assert host.is_closed
    assert host.buffer_count == 0
    assert buffer.array is None


@pytest.mark.parametrize("way", [device_packs, nullcontext], ids=["kernels", "host"])
def test_hits_that_stay_on_the_device_are_arrays_of_numpy(world, way):
    origins = np.random.default_rng(5).normal(size=(40, 50, 3)) * 4
    with Tracer(world, device="host") as tracer:
        assert tracer.context is tracer.queue is None
        expected = tracer.closest_hit(origins, -origins)
        with way():
            hits = tracer.closest_hit(origins, -origins, out="device")
    for name in ("t", "u", "v", "prim_id", "instance_id", "geometry_id"):
        found = getattr(hits, name)
        assert isinstance(found, np.ndarray)
        np.testing.assert_array_equal(found, getattr(expected, name), name)
    np.testing.assert_array_equal(hits.is_front, expected.is_front)


def test_a_library_of_other_sources_is_replaced_before_it_is_loaded(tmp_path, monkeypatch):
    good = library.library_path().read_bytes()
    path, digest = tmp_path / "host.so", compile.find_digest().encode()
    path.write_bytes(good.replace(digest, b"0" * len(digest)))
    monkeypatch.setattr(library, "library_path", lambda: path)

    def build(target, *_):
        (tmp_path / "new.so").write_bytes(good)
        (tmp_path / "new.so").replace(target)

    monkeypatch.setattr(compile, "build_library", build)
    assert library.open_library().digest.encode() == digest
