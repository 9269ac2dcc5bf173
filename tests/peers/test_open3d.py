"""The same rays in Open3D's RaycastingScene (Embree on the CPU): an engine that shares nothing with this one."""

import warnings

import numpy as np
import pytest

from clbvh import Scene, Tracer, load_mesh, make_shape
from clbvh.study.engines import Open3D
from clbvh.trace.check.intersections import Rays
from clbvh.trace.check.reference import Reference
from clbvh.views.cameras.framing import frame_mesh

from ..rays import as_float32, centred, random_rays

WIDTH, HEIGHT = 800, 450
AGREEMENT = 0.9999
T_TOLERANCE = 1e-5
# A ray of length 1 that starts very near a surface: both engines round coordinates, not t.
T_FLOOR = 2.0**-23

SHAPES = ["knot", "terrain", "boxes"]
SCANS = ["bun_zipper.ply", "drill_shaft_zip.ply", "dragon_871k.ply"]


def check_agreement(mesh, origins, directions, hits, t_floor):
    """Almost all hits are equal; of the others ours are right, so they lie where both engines may differ."""
    engine = Open3D(mesh.vertices, mesh.faces)
    engine.build()
    answer = engine.scene.cast_rays(engine.pack(origins, directions))
    their_t, their_prim = answer["t_hit"].numpy(), answer["primitive_ids"].numpy().astype(np.int64)
    their_prim[their_prim == 2**32 - 1] = -1
    both = hits.is_hit & (their_prim >= 0)
    agree = ~hits.is_hit & (their_prim < 0)
    agree[both] = np.abs(hits.t[both] - their_t[both]) <= T_TOLERANCE * their_t[both] + t_floor
    assert both.mean() > 0.01
    assert agree.mean() >= AGREEMENT
    # Faces differ only where the distance does not: on the edge between two of them.
    assert (hits.prim_id == their_prim).mean() >= AGREEMENT
    others = np.flatnonzero(~agree)
    rays = Rays.make(origins[others], directions[others])
    wrong = Reference(Scene(mesh).snapshot()).find_differences(rays, hits.take(others))
    assert [str(difference) for difference in wrong] == []


@pytest.mark.parametrize("name", [*SHAPES, *SCANS])
def test_rays_of_a_camera_and_any_others(session, real_mesh_path, name):
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import open3d  # noqa: F401
    except ImportError as error:
        pytest.skip(f"peers: Open3D cannot be imported: {error}")
    mesh = centred(make_shape(name, triangles=20_000) if name in SHAPES else load_mesh(real_mesh_path(name)))
    camera_rays = frame_mesh(mesh, aspect=WIDTH / HEIGHT).rays(WIDTH, HEIGHT)
    seen = [as_float32(each.reshape(-1, 3)) for each in camera_rays]
    others = random_rays(mesh, WIDTH * HEIGHT, np.random.default_rng(70))
    with Tracer(mesh, device=session.info) as tracer:
        for rays, t_floor in ((seen, 0.0), (others, T_FLOOR)):
            check_agreement(mesh, *rays, tracer.closest_hit(*rays), t_floor)
