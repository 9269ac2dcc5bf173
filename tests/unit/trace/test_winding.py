"""Generalized winding numbers beside the exact sum in float64, and the inside by them."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import clbvh
from clbvh.trace.points.winding import DEFAULT_ERROR

SIZES = [1.0, 0.2, 0.05, DEFAULT_ERROR, 1e-3, 1e-4]


def sum_angles(corners, points):
    """Return the winding numbers of points by the solid angles of triangles, (f, 3, 3), in float64."""
    numbers = np.empty(len(points))
    for begin in range(0, len(points), 64):
        a, b, c = (corners[None, :, corner] - points[begin : begin + 64, None] for corner in range(3))
        to_a, to_b, to_c = (np.linalg.norm(way, axis=-1) for way in (a, b, c))
        above = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
        below = to_a * to_b * to_c
        for one, other, length in ((a, b, to_c), (a, c, to_b), (b, c, to_a)):
            below += np.einsum("pfi,pfi->pf", one, other) * length
        numbers[begin : begin + 64] = np.arctan2(above, below).sum(axis=1) / (2 * np.pi)
    return numbers


def spread(vertices, count, seed=0):
    """Return points in and around a box."""
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    return np.random.default_rng(seed).uniform(1.2 * lower - 0.2 * upper, 1.2 * upper - 0.2 * lower, (count, 3))


def make_soup(seed):
    """Return triangles of all sizes anywhere, the worst for expansions."""
    random = np.random.default_rng(seed)
    corners = random.random((3000, 1, 3)) + 2.0 ** -random.integers(1, 8, (3000, 1, 1)) * random.random((3000, 3, 3))
    return clbvh.Mesh.from_arrays(corners.reshape(-1, 3), np.arange(9000).reshape(-1, 3))


def without(mesh, is_left_out):
    return clbvh.Mesh.from_arrays(mesh.vertices, mesh.faces[~is_left_out])


@pytest.fixture(scope="module")
def shapes():
    """Meshes of many kinds: closed, open, and no surface at all."""
    knot = clbvh.make_shape("knot", triangles=4000)
    torn = without(knot, np.random.default_rng(5).random(knot.face_count) < 0.3)
    names = ("icosphere", 1280), ("palace", 3000), ("terrain", 3000), ("blobs", 3000)
    return [knot, torn, make_soup(1), *(clbvh.make_shape(name, triangles=count, seed=3) for name, count in names)]


def test_errors_are_below_what_is_asked_for(session, shapes):
    for mesh in shapes:
        points = spread(mesh.vertices, 300)
        exact = sum_angles(mesh.vertices[mesh.faces], points)
        with clbvh.Tracer(mesh, device=session.info) as tracer:
            assert np.abs(tracer.winding_number(points, max_error=0) - exact).max() < 5e-5, mesh.name
            for size in SIZES:
                errors = tracer.winding_number(points, max_error=size) - exact
                assert np.abs(errors).max() < size, (mesh.name, size)


def test_a_disc_is_seen_at_its_solid_angle(session):
    segments, heights = 720, np.array([-3.0, -0.5, -0.01, 0.01, 0.2, 1, 10, 1e6, 1e30])
    turns = 2 * np.pi * np.arange(segments) / segments
    rim = np.column_stack((np.cos(turns), np.sin(turns), np.zeros(segments)))
    faces = [[0, 1 + i, 1 + (i + 1) % segments] for i in range(segments)]
    points = np.column_stack((np.full((9, 2), 1e-3), heights))
    with clbvh.Tracer(clbvh.Mesh.from_arrays([[0, 0, 0], *rim], faces), device=session.info) as tracer:
        found = tracer.winding_number(points, max_error=1e-4)
    # Its normal looks up, so what is below is on its inner side.
    assert found == pytest.approx(np.sign(-heights) * (1 - 1 / np.hypot(1, 1 / heights)) / 2, abs=2e-4)


def test_closed_meshes_contain_the_same_points_by_both_rules(session, shapes):
    for mesh in shapes:
        if not mesh.is_watertight or mesh.name == "blobs":  # which overlap
            continue
        points = spread(mesh.vertices, 20_000, 1)
        with clbvh.Tracer(mesh, device=session.info) as tracer:
            by_parity, by_winding = tracer.contains(points), tracer.contains(points, rule="winding")
            assert np.array_equal(by_parity, by_winding), mesh.name
            distances = tracer.signed_distance(points[:2000])
            assert np.array_equal(distances, tracer.signed_distance(points[:2000], rule="winding"))
        inverted = clbvh.Mesh.from_arrays(mesh.vertices, mesh.faces[:, ::-1])
        with clbvh.Tracer(inverted, device=session.info) as tracer:
            assert np.array_equal(by_parity, tracer.contains(points, rule="winding")), mesh.name


def test_holes_and_overlaps_have_an_inside_and_the_warning_says_how(session, shapes):
    knot = shapes[0]
    torn = without(knot, np.random.default_rng(2).random(knot.face_count) < 0.1)
    points = spread(knot.vertices, 20_000, 2)
    with clbvh.Tracer(knot, device=session.info) as tracer:
        meant = tracer.contains(points)
    with clbvh.Tracer(torn, device=session.info) as tracer:
        with pytest.warns(clbvh.OpenMeshWarning, match="rule='winding'"):
            by_parity = tracer.contains(points)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            by_winding = tracer.contains(points, rule="winding")
    assert (by_winding != meant).mean() < 2e-3 < 0.01 < (by_parity != meant).mean()
    cube = clbvh.make_shape("cube", triangles=12)
    two = clbvh.Mesh.from_arrays(
        np.concatenate((cube.vertices, cube.vertices + 0.5)),
        np.concatenate((cube.faces, cube.faces + len(cube.vertices))),
    )
    middle, size = cube.vertices.mean(axis=0), np.ptp(cube.vertices, axis=0)
    asked = np.array([middle + 0.25, middle - 0.4 * size, middle + 0.5 + 0.4 * size, middle + 2 * size])
    with clbvh.Tracer(two, device=session.info) as tracer:
        assert tracer.winding_number(asked).round(2).tolist() == [2, 1, 1, 0]
        assert tracer.contains(asked, rule="winding").tolist() == [True, True, True, False]
        assert not tracer.contains(asked[:1]).any()
        assert (tracer.signed_distance(asked, rule="winding") > 0).tolist() == [True, True, True, False]


def test_moves_are_followed(session):
    ball = clbvh.make_shape("icosphere", triangles=320)
    scene = clbvh.Scene()
    geometry = scene.add(ball)
    mirror = [[-2.0, 0.3, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    here, there = scene.place(geometry, mask=1), scene.place(geometry, mirror, mask=2)
    points = spread(np.array([[-2.0, -2, -2], [8, 2, 2]]), 300)

    def exact(*transforms):
        corners = [np.asarray(each)[:3, :3] @ ball.vertices[ball.faces][..., None] for each in transforms]
        corners = [each[..., 0] + np.asarray(t)[:3, 3] for each, t in zip(corners, transforms, strict=True)]
        signs = [np.sign(np.linalg.det(np.asarray(each)[:3, :3])) for each in transforms]
        return sum(sign * sum_angles(each, points) for sign, each in zip(signs, corners, strict=True))

    with clbvh.Tracer(scene, device=session.info) as tracer:
        assert tracer.winding_number(points) == pytest.approx(exact(np.eye(4), mirror), abs=2 * DEFAULT_ERROR)
        assert tracer.winding_number(points, mask=2) == pytest.approx(exact(mirror), abs=DEFAULT_ERROR)
        assert tracer.winding_number(points, instance=here) == pytest.approx(exact(np.eye(4)), abs=DEFAULT_ERROR)
        assert np.array_equal(tracer.contains(points, rule="winding"), tracer.contains(points))
        signed = tracer.signed_distance(points)
        assert tracer.signed_distance(points, rule="winding") == pytest.approx(signed, abs=1e-12)
        moved = np.eye(4)
        moved[:3, 3] = 3, 0, 1
        tracer.set_transforms(there, moved)
        assert tracer.winding_number(points) == pytest.approx(exact(np.eye(4), moved), abs=2 * DEFAULT_ERROR)
        assert np.array_equal(
            tracer.winding_number(points, instance=[here, here]), tracer.winding_number(points, mask=1)
        )
        tracer.set_masks(there, 0)
        assert tracer.winding_number(points) == pytest.approx(exact(np.eye(4)), abs=DEFAULT_ERROR)
    with clbvh.Tracer(ball, device=session.info) as tracer:
        assert tracer.winding_number([0.0, 0, 3]) == pytest.approx(0, abs=DEFAULT_ERROR)
        tracer.update(ball.vertices + np.array([0, 0, 3]))
        assert tracer.winding_number([0.0, 0, 3]) == pytest.approx(1, abs=DEFAULT_ERROR)


def test_points_and_parts_of_any_number_have_the_same_answers(session, shapes, monkeypatch):
    points = spread(shapes[0].vertices, 5000, 3)
    with clbvh.Tracer(shapes[0], device=session.info) as tracer:
        whole, done = tracer.winding_number(points), []
        monkeypatch.setattr("clbvh.trace.rays.pieces.CHUNK_RAYS", 700)
        monkeypatch.setattr("clbvh.trace.points.pack.CHUNK_RAYS", 700)
        parts = tracer.winding_number(points.reshape(50, 100, 3), progress=lambda *each: done.append(each))
        assert np.array_equal(whole.reshape(50, 100), parts)
        assert tracer.winding_number(points[7]) == whole[7]
        assert tracer.winding_number(np.empty((0, 3))).shape == (0,)
    assert done[-1] == (5000, 5000)
    assert len(done) > 5


def test_what_does_not_fit_is_refused(session, mesh):
    with clbvh.Tracer(mesh, device=session.info) as tracer:
        for error, words, call in [
            (clbvh.ConfigError, "max_error", lambda: tracer.winding_number([0, 0, 1], max_error=-1)),
            (clbvh.ConfigError, "max_error", lambda: tracer.winding_number([0, 0, 1], max_error=np.nan)),
            (clbvh.ConfigError, "rule", lambda: tracer.contains([0, 0, 1], rule="odd")),
            (clbvh.ConfigError, "rule", lambda: tracer.contains([0, 0, 1], rule=np.array(["parity", "winding"]))),
            (clbvh.ConfigError, "rule", lambda: tracer.signed_distance([0, 0, 1], rule=None)),
            (clbvh.QueryError, "finite", lambda: tracer.winding_number([0, 0, np.nan])),
        ]:
            with pytest.raises(error, match=words):
                call()
        assert np.isfinite(tracer.winding_number([0, 0, 0], max_error=10**400))
    with pytest.raises(clbvh.QueryError, match="closed"):
        tracer.winding_number([0, 0, 1])
    with clbvh.Tracer(clbvh.Spheres([[0, 0, 0]], 1.0)) as tracer, pytest.raises(clbvh.QueryError, match="spheres"):
        tracer.winding_number([0, 0, 1])
