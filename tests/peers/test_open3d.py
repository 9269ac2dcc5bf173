"""The same rays in Open3D's RaycastingScene (Embree on the CPU): an engine that shares nothing with this one."""

import warnings

import numpy as np
import pytest

from clbvh import Tracer, build, load_mesh
from clbvh.geometry.shapes.make_shape import make_shape
from clbvh.rendering.cameras.framing import frame_mesh
from clbvh.study.engines import Open3D

from ..mesh_reference import find_differences
from ..rays import as_float32, centred, random_rays

WIDTH, HEIGHT = 800, 450
AGREEMENT = 0.9999
T_TOLERANCE = 1e-5
# A ray of length 1 that starts very near a surface: both engines round coordinates, not t.
T_FLOOR = 2.0**-23
NO_GEOMETRY = 2**32 - 1

SHAPES = ["icosphere", "knot", "terrain", "blobs", "boxes"]
SCANS = ["bun_zipper.ply", "drill_shaft_zip.ply", "dragon_871k.ply"]


@pytest.fixture(scope="module")
def cast_with_open3d():
    """A function from a mesh and rays to t and face numbers, -1 on a miss."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import open3d as open3d
    except ImportError as error:
        pytest.skip(f"peers: Open3D cannot be imported: {error}")

    def cast(mesh, origins, directions):
        engine = Open3D()
        engine.open(mesh.vertices, mesh.faces)
        engine.build()
        answer = engine.scene.cast_rays(engine.pack(origins, directions))
        prim_id = answer["primitive_ids"].numpy().astype(np.int64)
        return answer["t_hit"].numpy(), np.where(prim_id == NO_GEOMETRY, -1, prim_id)

    return cast


def check_agreement(mesh, origins, directions, hits, theirs, t_floor=0.0):
    """Almost all hits are equal; of the others ours are right, so they lie where both engines may differ."""
    their_t, their_prim = theirs
    both = hits.is_hit & (their_prim >= 0)
    neither = ~hits.is_hit & (their_prim < 0)
    close = np.zeros(len(hits), bool)
    close[both] = np.abs(hits.t[both] - their_t[both]) <= T_TOLERANCE * their_t[both] + t_floor
    agree = neither | close
    assert both.mean() > 0.01
    assert agree.mean() >= AGREEMENT
    # Faces differ only where the distance does not: on the edge between two of them.
    assert (hits.prim_id == their_prim).mean() >= AGREEMENT

    others = np.flatnonzero(~agree)
    wrong = find_differences(mesh, origins[others], directions[others], hits.take(others))
    assert [str(difference) for difference in wrong] == []


def primary_rays(mesh):
    camera = frame_mesh(mesh, aspect=WIDTH / HEIGHT)
    origins, directions = camera.rays(WIDTH, HEIGHT)
    return as_float32(origins.reshape(-1, 3)), as_float32(directions.reshape(-1, 3))


def check_mesh(session, mesh, cast_with_open3d):
    with Tracer(build(mesh), device=session.info) as tracer:
        for (origins, directions), t_floor in (
            (primary_rays(mesh), 0.0),
            (random_rays(mesh, WIDTH * HEIGHT, np.random.default_rng(70)), T_FLOOR),
        ):
            hits = tracer.closest_hit(origins, directions)
            theirs = cast_with_open3d(mesh, origins, directions)
            check_agreement(mesh, origins, directions, hits, theirs, t_floor)


@pytest.mark.parametrize("shape", SHAPES)
def test_shapes(session, cast_with_open3d, shape):
    check_mesh(session, centred(make_shape(shape, triangles=20_000)), cast_with_open3d)


@pytest.mark.parametrize("name", SCANS)
def test_scans(session, cast_with_open3d, real_mesh_path, name):
    check_mesh(session, centred(load_mesh(real_mesh_path(name))), cast_with_open3d)
