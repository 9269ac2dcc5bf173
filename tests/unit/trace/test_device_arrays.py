"""Rays in arrays on a device, and hits that stay there: the host's to the last bit, whoever packs and refines."""

import dataclasses
import logging
from contextlib import nullcontext

import numpy as np
import pyopencl as cl
import pyopencl.array
import pytest

from clbvh import ConfigError, DeviceHits, Mesh, MeshError, QueryError, Scene, Spheres, Tracer, make_shape
from clbvh.structs import PACKED_RAY, RAY_LOW
from clbvh.trace.put_rays import cut_batch, put_rays
from clbvh.trace.rays import pieces
from clbvh.trace.rays.batch import read_device_rays, read_rays
from clbvh.trace.rays.pack import pack_rays

from ...concurrency.threads import run_in_threads
from ...packing import device_packs

pytestmark = pytest.mark.on_opencl

# A CPU packs rays and refines hits as the host; with the first, its kernels do, as those of a GPU.
WAYS = pytest.mark.parametrize("way", [device_packs, nullcontext], ids=["kernels", "host"])

RAYS = 6000


def as_bytes(hits):
    """The arrays of `DeviceHits`, or those of `Hits` in their types."""
    values = [np.asarray(each.get() if hasattr(each, "get") else each) for each in map(hits.__getattribute__, NAMES)]
    return {name: (each.shape, each.view(np.int8 if each.dtype == bool else each.dtype).tobytes())
            for name, each in zip(NAMES, values, strict=True)}  # fmt: skip


NAMES = DeviceHits._fields


def put(tracer, *arrays):
    return [cl.array.to_device(tracer.queue, np.array(array)) for array in arrays]


def extreme_rays(mesh, seed):
    """Rays at vertices, into faces, and in the planes of faces, from up to 1e12 away, of any length; with limits."""
    generator = np.random.default_rng(seed)
    corners = mesh.vertices[mesh.faces[generator.integers(0, mesh.face_count, RAYS)]]
    size, kind = np.ptp(mesh.vertices, axis=0).max(), generator.integers(0, 4, (RAYS, 1))
    inside = np.einsum("nij,ni->nj", corners, generator.dirichlet(np.ones(3), RAYS))
    target = np.where(kind == 0, corners[:, 0], inside)
    edges = (corners[:, 1:] - corners[:, :1]) * generator.normal(size=(RAYS, 2, 1))
    axes = np.eye(3)[generator.integers(0, 3, RAYS)] * size
    way = np.where(kind == 2, edges.sum(axis=1), np.where(kind == 3, axes, generator.normal(size=(RAYS, 3)) * size))
    way = np.where(way.any(axis=1, keepdims=True), way, 1.0)  # of a degenerate face
    way /= np.abs(way).max(axis=1, keepdims=True)
    distance = size * 10.0 ** generator.choice([-1, 0, 1, 3, 6, 12], RAYS)
    length = 10.0 ** generator.choice([0, 0, -312, -300, 5, 300], RAYS)
    with np.errstate(over="ignore"):
        t = distance / np.maximum(length, 1e-307)
    limits = {"t_min": np.where(generator.random(RAYS) < 0.5, 0, 0.99 * t), "t_max": generator.choice([1, np.inf]) * t}
    return (target - way * distance[:, None], way * length[:, None]), limits


def hard_world(kind, seed):
    """A mesh far from zero, some faces of which have no area; and a scene with small, turned and mirrored instances."""
    generator = np.random.default_rng(seed)
    shape = make_shape("knot", triangles=600)
    vertices = shape.vertices * 10.0 ** generator.choice([-100, 0, 100])
    vertices[::7] = vertices[3]
    mesh = Mesh.from_arrays(vertices + generator.choice([0, 1e3, 1e9]) * np.abs(vertices).max(), shape.faces)
    scene = Scene(mesh)
    other = scene.add(Mesh.from_arrays(vertices[shape.faces[:40].reshape(-1)], np.arange(120).reshape(-1, 3)))
    for number in range(6):
        matrix = np.eye(4)
        matrix[:3, :3] = generator.normal(size=(3, 3)) * 10.0 ** generator.choice([-3, 0])
        matrix[:3, 3] = mesh.origin + generator.normal(size=3) / mesh.scale
        scene.place(other, matrix, mask=1 + number % 3)
    return mesh, mesh if kind == "mesh" else scene


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ["mesh", "scene"])
def test_kernels_pack_and_refine_to_the_bits_of_the_host(kind, seed, monkeypatch):
    monkeypatch.setattr(pieces, "CHUNK_RAYS", 4096)
    mesh, source = hard_world(kind, seed)
    rays, limits = extreme_rays(mesh, seed)
    options = limits | {"mask": np.arange(RAYS) % 8}
    with Tracer(source) as tracer, device_packs():
        hits = tracer.closest_hit(*rays, **options)
        assert RAYS / 4 < hits.count < RAYS
        assert as_bytes(tracer.closest_hit(*rays, **options, out="device")) == as_bytes(hits)
        there = put(tracer, *rays)
        assert as_bytes(tracer.closest_hit(*there, **options)) == as_bytes(hits)
        assert (tracer.any_hit(*there, **options) == hits.is_hit).all()

        # The primitive says little of how a ray was packed.
        device = tracer._caster
        batch, arrays = read_rays(*rays, *limits.values()), read_device_rays(*there, *limits.values())
        with device.open_call() as call:
            for piece in cut_batch(call, arrays):
                packed, low = np.empty(piece.item_count, PACKED_RAY), np.zeros(piece.item_count, RAY_LOW)
                pack_rays(batch, device.world.box, packed, first_ray=piece.begin, lows=low)
                found, found_low, described = packed.copy(), low.copy(), put_rays(call, arrays, piece).arguments
                call.session.download(described["rays"], found)
                assert found.tobytes() == packed.tobytes()
                if kind == "scene":
                    call.session.download(described["lows"], found_low)
                    for name in ("origin", "direction", "mask"):
                        assert found_low[name].tobytes() == low[name].tobytes(), name


@WAYS
def test_arrays_of_any_shape_and_number_are_read_where_they_are(open_tracer, source, rays, way):
    tracer = open_tracer(source)
    origins, directions = (np.round(array[:480] * 8) for array in rays)
    directions[(directions == 0).all(axis=1)] = 1
    both = put(tracer, np.concatenate((origins, directions), axis=1)[::-1])[0]
    fortran = [cl.array.to_device(tracer.queue, np.asfortranarray(array)) for array in (origins, directions)]
    grids = put(tracer, origins.reshape(20, 24, 3), directions.reshape(20, 24, 3))
    cases = [
        (put(tracer, origins, directions), (origins, directions)),
        (put(tracer, origins.astype("f4"), directions), (origins, directions)),
        (put(tracer, origins.astype("i4"), directions.astype("f4")), (origins, directions)),
        ((both[::-1, :3], both[::-1, 3:]), (origins, directions)),
        (fortran, (origins, directions)),
        ([origins, fortran[1]], (origins, directions)),
        ([array[3:17, ::5] for array in grids], [array.get()[3:17, ::5] for array in grids]),
        (put(tracer, origins[0], directions), (origins[0], directions)),
        (put(tracer, origins[:7, None], directions[:9]), (origins[:7, None], directions[:9])),
        (put(tracer, origins[1], directions[1]), (origins[1], directions[1])),
        (put(tracer, origins[:0], directions[:0]), (origins[:0], directions[:0])),
    ]
    with way():
        for number, (given, same) in enumerate(cases):
            hits = tracer.closest_hit(*same)
            for out in ("host", "device"):
                assert as_bytes(tracer.closest_hit(*given, out=out)) == as_bytes(hits), (number, out)
            for query in ("any_hit", "closest_prim", "count_hits"):
                assert (getattr(tracer, query)(*given) == getattr(tracer, query)(*same)).all(), (number, query)
        limits = put(tracer, np.full(480, 0.5), np.arange(480) % 3)
        found = tracer.closest_hit(*fortran, t_max=limits[0], mask=limits[1], out="device")
        assert as_bytes(found) == as_bytes(tracer.closest_hit(origins, directions, t_max=0.5, mask=np.arange(480) % 3))
        assert tracer.all_hits(*fortran).t.tobytes() == tracer.all_hits(origins, directions).t.tobytes()
        points = both[:, 3:], directions[::-1]
        assert len({tracer.closest_point(each).point.tobytes() for each in points}) == 1


def test_nothing_but_small_numbers_crosses_the_bus(mesh, rays, traffic):
    with Tracer(mesh) as tracer, device_packs():
        vertices = put(tracer, mesh.vertices.astype("f4"))[0]
        tracer.update(vertices)
        there = put(tracer, *rays)
        expected = as_bytes(tracer.closest_hit(*rays))
        assert as_bytes(tracer.closest_hit(*rays, out="device")) == expected
        tracer.update(vertices * np.float32(2))
        tracer.update(vertices)
        traffic.clear()
        found = tracer.closest_hit(*there, out="device")
        assert max(traffic) < 200, traffic
        assert "vertices" not in vars(tracer.mesh)
    assert as_bytes(found) == expected  # after the tracer is closed


def test_the_vertices_are_put_there_once_and_counted(world, rays):
    with Tracer(world) as tracer, device_packs():
        assert as_bytes(tracer.closest_hit(*rays, out="device")) == as_bytes(tracer.closest_hit(*rays))  # has spheres
    scene = Scene()
    ball = scene.add(make_shape("icosphere", triangles=5120))
    scene.place(ball)
    scene.place(ball, np.diag([2, 2, 2, 1]))
    with Tracer(scene) as tracer, device_packs():
        before, shape = tracer.memory_bytes, tracer._caster.world.state.shapes[0]
        tracer.closest_hit(*rays, out="device")
        vertices = tracer._caster.world.refine_buffers._kept["vertices"][1]
        assert tracer.memory_bytes - before >= shape.vertices.nbytes + shape.faces.nbytes
        tracer.set_transforms(0, np.diag([0.5, 3, 1, 1]))
        assert as_bytes(tracer.closest_hit(*rays, out="device")) == as_bytes(tracer.closest_hit(*rays))
        assert tracer._caster.world.refine_buffers._kept["vertices"][1] is vertices


@WAYS
def test_a_query_waits_for_the_queue_and_a_kernel_behind_it_sees_the_hits(open_tracer, mesh, way):
    tracer, count = open_tracer(mesh), 20_000
    program = cl.Program(tracer.context, """
    kernel void aim(global float *directions, const int steps) {
        float x = 0;
        for (int step = 0; step < steps; step++) { x = x * 0.5f + 1; }
        directions[get_global_id(0)] = get_global_id(0) % 3 == 2 ? -1 : x * 1e-9f;
    }
    kernel void note(global const double *t, global int *is_hit) {
        is_hit[get_global_id(0)] = isfinite(t[get_global_id(0)]);
    }
    """).build()  # fmt: skip
    origins = mesh.origin + [[0.7, 0.01, 5]] + np.random.default_rng(0).normal(size=(count, 3)) * 0.3
    other = cl.CommandQueue(tracer.context)
    directions = cl.array.zeros(other, (count, 3), np.float32)
    directions.finish()
    is_hit = cl.array.empty(tracer.queue, count, np.int32)
    program.aim(tracer.queue, (3 * count,), None, directions.data, np.int32(200))
    with way():
        hits = tracer.closest_hit(put(tracer, origins)[0], directions, out="device")
    program.note(tracer.queue, (count,), None, hits.t.data, is_hit.data)
    expected = tracer.closest_hit(origins, directions.get())
    assert 0 < expected.count < count
    assert (is_hit.get() == expected.is_hit).all()


@WAYS
def test_bad_rays_are_named_as_on_the_host(open_tracer, source, way):
    tracer = open_tracer(source)
    for change in ({(0, 7, 1): np.nan}, {(1, 5): 0}, {(0, 900, 0): np.inf, (1, 950): 0}):
        rays = np.ones((2, 1000, 3))
        for index, value in change.items():
            rays[index] = value
        messages = []
        for given, out in ((rays, "host"), (put(tracer, *rays), "host"), (put(tracer, *rays), "device")):
            with way(), pytest.raises(QueryError) as caught:
                tracer.closest_hit(*given, out=out)
            messages.append(str(caught.value))
        assert len(set(messages)) == 1, messages
    with way():
        for shapes in (((5, 3), (4, 3)), ((5, 2), (5, 3))):
            with pytest.raises(QueryError, match="shape"):
                tracer.any_hit(*put(tracer, *map(np.ones, shapes)))
        with pytest.raises(ConfigError, match="'host' or 'device', not 'gpu'"):
            tracer.closest_hit([0, 0, 5], [0, 0, 1], out="gpu")
        with Tracer(make_shape("icosphere", triangles=80)) as closed:
            there = put(closed, np.ones((5, 3)))[0]
        with pytest.raises(QueryError, match="closed"):
            closed.closest_hit(there, [0, 0, 1], out="device")


@pytest.mark.parametrize("case", ["no doubles", "other context", "spheres"])
def test_the_way_over_the_host_is_said_once(case, mesh, rays, session, monkeypatch, caplog):
    monkeypatch.setenv("_CLBVH_SAID", "")
    scene = Scene(mesh)
    if case == "spheres":
        scene.place(scene.add(Spheres([[0, 0, 1]], 0.2)))
    with Tracer(scene) as tracer, device_packs(), caplog.at_level(logging.WARNING, "clbvh"):
        queue = cl.CommandQueue(cl.Context([session.info.cl_device])) if case == "other context" else tracer.queue
        if case == "no doubles":
            own = tracer._caster.session
            monkeypatch.setattr(own, "info", dataclasses.replace(own.info, has_fp64=False))
        there = [cl.array.to_device(queue, array) for array in rays]
        for _ in range(2):
            assert as_bytes(tracer.closest_hit(*there, out="device")) == as_bytes(tracer.closest_hit(*rays))
        assert caplog.text.count("way of the host") == 1


def test_threads_share_the_arrays_on_the_device(mesh, rays):
    with Tracer(mesh) as tracer, device_packs():
        there, expected = put(tracer, *rays), as_bytes(tracer.closest_hit(*rays))

        def ask():
            return [as_bytes(tracer.closest_hit(*there, out="device")) for _ in range(5)]

        assert all(found == expected for each in run_in_threads(*[ask] * 4) for found in each)


def test_a_part_of_a_device_casts_rays_in_its_arrays(mesh, rays):
    try:
        devices = cl.get_platforms()[0].get_devices()[0].create_sub_devices([cl.device_partition_property.EQUALLY, 1])
    except cl.Error as error:
        pytest.skip(f"the CPU has no parts: {error}")
    with Tracer(mesh, device=devices[0]) as tracer, device_packs():
        assert tracer.queue.context == tracer.context
        assert as_bytes(tracer.closest_hit(*put(tracer, *rays), out="device")) == as_bytes(tracer.closest_hit(*rays))
        assert "kernel" in tracer.timings_ms


class Tensor:
    """An array of another library, which has nothing but DLPack."""

    def __init__(self, array, kind=1):
        self._array, self._kind = array, kind

    def __dlpack__(self, **options):
        return self._array.__dlpack__(**options)

    def __dlpack_device__(self):
        return self._kind, 0


def test_dlpack_arrays_are_read_in_the_hosts_memory_alone(open_tracer, mesh, rays):
    tracer = open_tracer(mesh)
    tensors = [Tensor(array) for array in rays]
    assert as_bytes(tracer.closest_hit(*tensors)) == as_bytes(tracer.closest_hit(*rays))
    assert (tracer.contains(tensors[0]) == tracer.contains(rays[0])).all()
    copied = Mesh.from_arrays(Tensor(mesh.vertices), Tensor(mesh.faces))
    assert copied.vertices.tobytes() == mesh.vertices.tobytes()
    assert copied.faces.tobytes() == mesh.faces.tobytes()
    with pytest.raises(QueryError, match=r"directions must be .* Tensor .* type 2.*copy it to the host"):
        tracer.any_hit(tensors[0], Tensor(rays[1], kind=2))
    with pytest.raises(MeshError, match=r"vertices must be .* type 10"):
        Mesh.from_arrays(Tensor(mesh.vertices, kind=10), mesh.faces)
