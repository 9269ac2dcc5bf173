"""Meshes whose parts are far smaller than the whole: in float32 of the whole, parts were lost, or taken for others."""

from dataclasses import replace

import numpy as np
import pyopencl as cl
import pyopencl.array
import pytest
import trimesh

from clbvh import Camera, Mesh, Scene, Spheres, Tracer, make_shape, render

from ..packing import device_packs

RATIOS = [2.0**4, 2.0**13, 1e5, 2e7, 2e8, 2.0**40]
LAYOUTS = ["bvh2", "bvh8", "bvh8c"]
SEED = 45


def ball(centre=(0.0, 0.0, 0.0)):
    """A ball of radius 1 about a centre."""
    mesh = make_shape("icosphere", triangles=320)
    vertices = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    return vertices + centre, mesh.faces


def slope(half):
    """Two triangles below the ball, in a plane that no axis lies in."""
    x, y = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]).T
    return np.column_stack((x, y, 0.3 * x + 0.1 * y - 1.25)), np.array([[0, 1, 2], [0, 2, 3]])


def join(*parts):
    vertices, faces, count = [], [], 0
    for own_vertices, own_faces in parts:
        vertices.append(own_vertices)
        faces.append(own_faces + count)
        count += len(own_vertices)
    return np.concatenate(vertices), np.concatenate(faces)


def rays_at(centre, radius, count, generator):
    """Rays at a ball of this radius, and beside it, from a distance of four of them."""
    directions = generator.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return centre + radius * (generator.uniform(-1.1, 1.1, (count, 3)) - 4 * directions), directions


def meet(vertices, faces, origins, directions):
    """(closest face, its t, number of hits) of each ray, all pairs in numbers of 64 digits (Moeller and Trumbore)."""
    corners = vertices.astype(np.longdouble)[faces]
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    origins, directions = (each.astype(np.longdouble)[:, None] for each in (origins, directions))
    way, across = origins - corners[:, 0], np.cross(directions, ac)
    volume, beside = (across * ab).sum(-1), np.cross(way, ab)
    u, v = (way * across).sum(-1) / volume, (directions * beside).sum(-1) / volume
    t = (ac * beside).sum(-1) / volume
    t[~((u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0))] = np.inf
    face = np.where(np.isfinite(t.min(axis=1)), t.argmin(axis=1), -1)
    return face, t.min(axis=1).astype(np.float64), np.isfinite(t).sum(axis=1)


def distances(vertices, faces, points):
    """The distance of each point from triangles, from their planes or else their edges, in numbers of 64 digits."""
    corners = vertices.astype(np.longdouble)[faces] - points[:, None, None]
    least = np.full(len(points), np.inf)
    normal = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    normal /= np.sqrt((normal**2).sum(-1, keepdims=True))
    is_over = np.ones(normal.shape[:2], bool)
    for begin, end in ((0, 1), (1, 2), (2, 0)):
        a, way = corners[..., begin, :], corners[..., end, :] - corners[..., begin, :]
        is_over &= (np.cross(a, corners[..., end, :]) * normal).sum(-1) >= 0
        share = np.clip(-(a * way).sum(-1) / (way**2).sum(-1), 0, 1)
        to_edge = np.sqrt(((a + share[..., None] * way) ** 2).sum(-1))
        least = np.minimum(least, to_edge.min(axis=1))
    to_plane = np.where(is_over, np.abs((corners[..., 0, :] * normal).sum(-1)), np.inf)
    return np.minimum(least, to_plane.min(axis=1)).astype(np.float64)


def check_rays(tracer, number_of, expected, origins, directions, size=1.0):
    """Every query finds the triangles that exact numbers find; float64 has its roundings of triangles of a size."""
    face, t, counts = expected
    hits, everything = tracer.closest_hit(origins, directions), tracer.all_hits(origins, directions)
    assert number_of(hits).tolist() == face.tolist()
    np.testing.assert_allclose(hits.t, t, rtol=1e-12, atol=2.0**-46 * size)
    assert tracer.count_hits(origins, directions).tolist() == counts.tolist() == everything.counts.tolist()
    assert tracer.any_hit(origins, directions).tolist() == (counts > 0).tolist()
    first = everything.offsets[:-1][counts > 0]
    assert number_of(everything)[first].tolist() == face[counts > 0].tolist()


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("ratio", RATIOS, ids="{:.0e}".format)
def test_a_ball_was_lost_on_a_ground(session, ratio, layout):
    vertices, faces = join(ball(), slope(ratio))
    rays = rays_at(np.zeros(3), 1.0, 400, np.random.default_rng(SEED))
    expected = meet(vertices, faces, *rays)
    assert (expected[0] >= 320).any()
    assert (expected[0] < 320).sum() > 50
    mesh = Mesh.from_arrays(vertices, faces)
    assert mesh.spans_scales == (ratio > 2.0**13)
    with Tracer(mesh, layout=layout, device=session.info) as tracer:
        check_rays(tracer, lambda hits: hits.prim_id, expected, *rays, size=ratio)
        points = rays[0][:40] / 3
        distance = np.minimum(*(distances(*part, points) for part in (ball(), slope(ratio))))
        # Of the whole: as float64 resolves it, or float32 where that is enough for the parts.
        tolerance = (2.0**-50 if mesh.spans_scales else 2.0**-20) * ratio
        np.testing.assert_allclose(tracer.closest_point(points).distance, distance, rtol=1e-7, atol=tolerance)


@pytest.mark.parametrize("ratio", [2e7, 2.0**40], ids="{:.0e}".format)
def test_a_placed_ball_was_lost_on_a_placed_ground(session, ratio):
    """As instances the ground's t was off by more than the ball is large, whatever the ball's own."""
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3], [1, 2, 3])
    scene = Scene()
    for part in (ball(), slope(ratio)):
        scene.place(scene.add(Mesh.from_arrays(*part)), turn)
    vertices, faces = join(ball(), slope(ratio))
    placed = vertices @ turn[:3, :3].T + turn[:3, 3]
    rays = rays_at(turn[:3, 3], 1.0, 400, np.random.default_rng(SEED))
    expected = meet(placed, faces, *rays)
    with Tracer(scene, device=session.info) as tracer:
        check_rays(tracer, lambda hits: hits.prim_id + 320 * (hits.instance_id == 1), expected, *rays, size=ratio)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_row_of_cubes_was_lost(session, layout):
    cube = trimesh.creation.box()
    places = 1e5 * np.arange(20)
    mesh = Mesh.from_arrays(*join(*((cube.vertices + np.array([x, 0, 0]), cube.faces) for x in places)))
    generator = np.random.default_rng(SEED)
    beside = generator.uniform(-0.48, 0.48, (2000, 3)) + generator.choice(places, 2000)[:, None] * [1, 0, 0]
    x, y, z = np.eye(3)
    with Tracer(mesh, layout=layout, device=session.info) as tracer:
        assert tracer.any_hit(beside + 3 * z, -z).all()
        assert not tracer.any_hit(beside + y + 3 * z, -z).any()
        assert tracer.contains(beside).all()
        assert not tracer.contains(beside + x).any()


@pytest.mark.parametrize("quality", ["default", "fast"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_balls_far_apart_were_degenerate(session, layout, quality):
    centres = np.array([[0, 0, 0], [1e8, 0, 0], [2e8, 0, 1e8]])
    vertices, faces = join(*map(ball, centres))
    mesh, generator = Mesh.from_arrays(vertices, faces), np.random.default_rng(SEED)
    assert mesh.degenerate_count == 0
    assert mesh.is_watertight
    with Tracer(mesh, layout=layout, quality=quality, device=session.info) as tracer:
        for centre in centres:
            rays = rays_at(centre, 1.0, 200, generator)
            check_rays(tracer, lambda hits: hits.prim_id, meet(vertices, faces, *rays), *rays, size=2e8)
            inside = centre + generator.uniform(-0.5, 0.5, (50, 3))
            assert tracer.contains(inside).all()
            outward = centre + 3 * vertices[:20]  # the vertices of the first ball are their own directions
            np.testing.assert_allclose(tracer.closest_point(outward).distance, 2, rtol=1e-7)
            np.testing.assert_allclose(tracer.signed_distance(outward), -2, rtol=1e-7)
            assert (tracer.signed_distance(inside) > 0).all()


def test_spheres_far_apart_were_lost(session):
    """Their hits by the formula."""
    centres, radii = np.array([[0, 0, 0], [1e8, 0, 0], [2e8, 0, 1e8]]), np.array([1, 1, 1e-3])
    scene, generator = Scene(), np.random.default_rng(SEED)
    scene.place(scene.add(Spheres(centres, radii)))
    with Tracer(scene, device=session.info) as tracer:
        for sphere, (centre, radius) in enumerate(zip(centres, radii, strict=True)):
            origins, directions = rays_at(centre, radius, 300, generator)
            way = (origins - centre).astype(np.longdouble)
            middle = -(way * directions).sum(axis=1)
            rest = radius**2 - (way**2).sum(axis=1) + middle**2
            hits = tracer.closest_hit(origins, directions)
            assert hits.prim_id.tolist() == np.where(rest >= 0, sphere, -1).tolist()
            expected = middle - np.sqrt(np.maximum(rest, 0))
            np.testing.assert_allclose(hits.t[rest >= 0], expected[rest >= 0].astype(float), rtol=1e-6)


def make_spike(depth):
    """A tetrahedron whose triangles halve again and again towards a corner at zero: closed, convex, 2^-depth to 1."""
    edges = np.array([[1.0, 0.25, 0.125], [0.25, 1.0, 0.375], [0.125, 0.25, 1.0]])
    rings = [edges * 2.0**-step for step in range(depth + 1)]
    faces = [[0, 1, 2]]
    for step in range(depth):
        for side in range(3):
            a, b = 3 * step + side, 3 * step + (side + 1) % 3
            faces += [[b, a, b + 3], [a, a + 3, b + 3]]
    tip, last = 3 * depth + 3, 3 * depth
    faces += [[last + (side + 1) % 3, last + side, tip] for side in range(3)]
    return np.concatenate([*rings, np.zeros((1, 3))]), np.array(faces)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_no_ray_leaves_a_closed_mesh_of_all_sizes(session, layout):
    """Also through shared edges and vertices, of triangles of different sizes: each ray crosses it once."""
    vertices, faces = make_spike(38)
    mesh, generator = Mesh.from_arrays(vertices, faces), np.random.default_rng(SEED)
    assert mesh.is_watertight
    with Tracer(mesh, layout=layout, device=session.info) as tracer:
        for step in range(0, 38, 4):
            inside = 2.0**-step * np.array([0.25, 0.28125, 0.3125])
            corners = np.unique(faces[3 * step : 3 * step + 24])
            middles = vertices[faces[:, [0, 1, 2, 0]]].reshape(-1, 4, 3)
            middles = (middles[:, :-1] + middles[:, 1:]).reshape(-1, 3) / 2
            targets = np.concatenate((vertices, middles, inside + generator.normal(size=(200, 3)), vertices[corners]))
            assert (tracer.count_hits(inside, targets - inside) == 1).all()
            assert tracer.contains(inside)


def test_a_vertex_of_no_face_made_the_mesh_small(session):
    vertices, faces = ball()
    strayed = Mesh.from_arrays(np.concatenate((vertices, [[1e6, 0, 0]])), faces)
    mesh = Mesh.from_arrays(vertices, faces)
    assert strayed.origin.tolist() == mesh.origin.tolist()
    assert strayed.scale == mesh.scale
    assert not strayed.spans_scales
    assert strayed.local_vertices[:-1].tobytes() == mesh.local_vertices.tobytes()
    moved = strayed.with_vertices(strayed.vertices + 1)
    assert moved.scale == mesh.scale


def test_start_points_were_as_far_away_as_the_whole_is_large(session):
    """80 units above a ball of radius 1."""
    vertices, faces = join(ball(), slope(2e7))
    generator = np.random.default_rng(SEED)
    with Tracer(Mesh.from_arrays(vertices, faces), device=session.info) as tracer:
        hits = tracer.closest_hit(*rays_at(np.zeros(3), 1.0, 4000, generator))
        hits = hits[hits.is_hit]
        starts, normals = hits.offset_origins(), hits.normals(facing=True)
        leaps = np.linalg.norm(starts - hits.locations, axis=1)
        assert leaps[hits.prim_id < 320].max() < 1e-9
        assert leaps.max() < 1e-3
        away = generator.normal(size=starts.shape)
        away *= np.where((away * normals).sum(axis=1, keepdims=True) < 0, -1, 1)
        again = tracer.all_hits(starts, away)
        assert not (again.prim_id == hits.prim_id[again.ray_id]).any()
        below = hits[hits.prim_id >= 320]
        assert tracer.any_hit(below.offset_origins(), -below.locations).all()


@pytest.mark.on_opencl
def test_a_device_without_doubles_says_so_and_keeps_the_distances_of_float32(session, monkeypatch, caplog):
    monkeypatch.setenv("_CLBVH_SAID", "")
    mesh, generator = Mesh.from_arrays(*join(ball(), slope(2e7))), np.random.default_rng(SEED)
    with caplog.at_level("WARNING", "clbvh"), Tracer(mesh, device=replace(session.info, has_fp64=False)) as tracer:
        hits = tracer.closest_hit(*rays_at(np.zeros(3), 1.0, 400, generator))
        hits = hits[hits.is_hit]
        assert "no double precision" in caplog.text
        assert np.linalg.norm(hits.offset_origins() - hits.locations, axis=1).min() > 1
        above = tracer.all_hits(hits.offset_origins(), hits.normals(facing=True))
        assert not (above.prim_id == hits.prim_id[above.ray_id]).any()


@pytest.mark.on_opencl
@pytest.mark.parametrize("layout", LAYOUTS)
def test_rays_in_arrays_on_the_device_are_decided_alike(session, layout):
    rays = rays_at(np.zeros(3), 1.0, 300, np.random.default_rng(SEED))
    with Tracer(Mesh.from_arrays(*join(ball(), slope(2e7))), layout=layout, device=session.info) as tracer:
        expected = tracer.closest_hit(*rays)
        there = [cl.array.to_device(tracer.queue, each) for each in rays]
        with device_packs():
            assert tracer.closest_hit(*there, out="device").prim_id.get().tolist() == expected.prim_id.tolist()
            assert tracer.count_hits(*there).tolist() == tracer.count_hits(*rays).tolist()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_ambient_occlusion_was_that_of_the_whole(session, layout):
    """Of points around a ball, which hides the share of the hemisphere that it does without a ground."""
    points, away = 1.1 * np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0.0]]), [-0.3, -0.1, 1]  # at right angles to the slope
    with (
        Tracer(Mesh.from_arrays(*join(ball(), slope(2e7))), layout=layout, device=session.info) as tracer,
        Tracer(Mesh.from_arrays(*ball()), layout=layout, device=session.info) as alone,
    ):
        expected = alone.ambient_occlusion(points, away, rays=256)
        assert expected[1] < 0.5
        np.testing.assert_allclose(tracer.ambient_occlusion(points, away, rays=256), expected, atol=0.02)


@pytest.mark.parametrize("kind", ["mesh", "spheres"])
def test_pictures_of_a_far_ball_had_no_normals(session, kind):
    """Of one of two that are far apart, as if it were alone; float32 does not tell its corners apart."""
    centres = np.array([[0.0, 0, 0], [1e8, 0, 0]])
    if kind == "mesh":
        both, alone = Mesh.from_arrays(*join(*map(ball, centres))), Mesh.from_arrays(*ball())
    else:
        both, alone = Spheres(centres, [1, 1]), Spheres(centres[:1], [1])
    pictures = []
    for source, centre in ((both, centres[0]), (both, centres[1]), (alone, centres[0])):
        camera = Camera(eye=centre + np.array([0, -4, 1]), look_at=centre)
        pictures.append(render(source, camera=camera, shading="normal", width=48, height=48).pixels.astype(int))
    for picture in pictures[:2]:
        assert np.abs(picture - pictures[2]).mean() < 2
