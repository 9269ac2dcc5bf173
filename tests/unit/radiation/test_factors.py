"""View factors beside formulas of Howell's catalog, and what holds for all of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

import clbvh
from clbvh.radiation import factors, view_factors

RAYS = 1 << 16

# Deviations of independent rays that an error may have.
DEVIATIONS = 4


def join(*shapes):
    """Return a mesh of several (vertices, faces), and the number of the shape of each face."""
    firsts = np.cumsum([0, *(len(vertices) for vertices, _ in shapes)])
    faces = [np.asarray(faces) + first for (_, faces), first in zip(shapes, firsts, strict=False)]
    vertices = np.concatenate([np.asarray(vertices, np.float64) for vertices, _ in shapes])
    return clbvh.Mesh.from_arrays(vertices, np.concatenate(faces)), np.repeat(np.arange(len(faces)), [*map(len, faces)])


def rectangle(corner, side, other):
    """Return a rectangle; its normal is along the cross product of its sides."""
    corner, side, other = (np.asarray(each, np.float64) for each in (corner, side, other))
    return np.array([corner, corner + side, corner + side + other, corner + other]), [[0, 1, 2], [0, 2, 3]]


def disc(height, direction, segments=512):
    """Return a disc of radius 1 around z, whose normal is up or down."""
    turns = direction * 2 * np.pi * np.arange(segments) / segments
    rim = np.column_stack((np.cos(turns), np.sin(turns), np.full(segments, height)))
    faces = [[0, 1 + i, 1 + (i + 1) % segments] for i in range(segments)]
    return np.concatenate(([[0, 0, height]], rim)), faces


PARALLEL = [rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0)), rectangle((0, 0, 1), (0, 1, 0), (1, 0, 0))]
PERPENDICULAR = [rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0)), rectangle((0, 0, 0), (0, 1, 0), (0, 0, 1))]
# A plate in front of a wall of a box of 2 x 2 x 1: test `analytical_with_obstruction` of MOOSE's heat conduction.
BEHIND_A_PLATE = [
    rectangle((0, 0, 1), (0, 2, 0), (2, 0, 0)),
    rectangle((0, 0, 0), (2, 0, 0), (0, 2, 0)),
    rectangle((0.55, 0.55, 0.75), (0.9, 0, 0), (0, 0.9, 0)),
]


@pytest.mark.parametrize(
    ("shapes", "exact"),
    [
        (PARALLEL, 0.1998248957),
        (PERPENDICULAR, 0.2000437761),
        ([disc(0, 1), disc(1, -1)], (3 - math.sqrt(5)) / 2),
        (BEHIND_A_PLATE, 0.282833),
    ],
    ids=["parallel squares", "perpendicular squares", "coaxial discs", "behind a plate"],
)
def test_factors_are_those_of_formulas(session, shapes, exact):
    mesh, groups = join(*shapes)
    with clbvh.Tracer(mesh, device=session.info) as tracer:
        found = view_factors(tracer, RAYS, groups)
    between = found.to_dense()[:2, :2]
    limit = DEVIATIONS * math.sqrt(exact * (1 - exact) / RAYS)
    assert np.abs([between[0, 1] - exact, between[1, 0] - exact]).max() < limit
    assert between[0, 0] == between[1, 1] == 0
    assert np.allclose(found.to_dense().sum(axis=1) + found.sky, 1, atol=1e-15)
    assert (found.ungrouped == 0).all()


@pytest.mark.parametrize(
    ("shapes", "exact"),
    [(PARALLEL, 0.1998248957), (PERPENDICULAR, 0.2000437761), (BEHIND_A_PLATE, 0.282833)],
    ids=["parallel squares", "perpendicular squares", "behind a plate"],
)
def test_errors_are_less_than_half_of_those_of_independent_rays(session, shapes, exact):
    mesh, groups = join(*shapes)
    with clbvh.Tracer(mesh, device=session.info) as tracer:
        found = [view_factors(tracer, 1 << 14, groups, seed=seed).to_dense() for seed in range(12)]
    errors = np.array([[each[0, 1], each[1, 0]] for each in found]) - exact
    assert np.sqrt((errors**2).mean()) < 0.5 * math.sqrt(exact * (1 - exact) / (1 << 14))


def test_a_sphere_sees_itself_by_area_and_nothing_else(session):
    inside = clbvh.make_shape("icosphere", triangles=320)
    inside = clbvh.Mesh.from_arrays(inside.vertices, inside.faces[:, ::-1])
    with clbvh.Tracer(inside, device=session.info) as tracer:
        found = view_factors(tracer, RAYS >> 4)
    assert (found.sky == 0).all()
    exact = found.area / found.area.sum()
    errors = found.to_dense() - exact
    # A polyhedron is no sphere: neighbours see less of each other, the others more.
    assert np.abs(errors).max() < 2 * exact.max()
    assert np.abs(errors.mean(axis=0)).max() < 0.05 * exact.min()
    # Each factor is that of some 13 rays.
    assert found.reciprocity_error < 1.5 / math.sqrt(found.rays * exact.mean())
    assert (found.area[found.source] * found.factor <= found.area[found.target]).all()


def test_groups_are_means_of_faces_by_area_and_obstruction_takes_away(session):
    mesh, groups = join(*BEHIND_A_PLATE)
    with clbvh.Tracer(mesh, device=session.info) as tracer:
        single = view_factors(tracer, RAYS)
        grouped = view_factors(tracer, RAYS, groups)
        unnamed = view_factors(tracer, RAYS, np.where(groups == 2, -1, groups))
    is_of = np.equal.outer(np.arange(3), groups)
    expected = (is_of * single.area) @ single.to_dense() @ is_of.T / (is_of @ single.area)[:, None]
    assert np.abs(grouped.to_dense() - expected).max() < 0.01
    assert grouped.area == pytest.approx(is_of @ single.area)
    # Rays that end at the plate belong to no group.
    assert np.array_equal(unnamed.to_dense(), grouped.to_dense()[:2, :2])
    assert unnamed.ungrouped == pytest.approx(grouped.to_dense()[:2, 2])
    free, own = join(*BEHIND_A_PLATE[:2])
    with clbvh.Tracer(free, device=session.info) as tracer:
        assert view_factors(tracer, RAYS, own).to_dense()[0, 1] > grouped.to_dense()[0, 1] + 0.1


def test_sides_and_closed_boxes(session):
    box = clbvh.make_shape("cube", triangles=12)
    with clbvh.Tracer(box, device=session.info) as tracer:
        front, back, both = (view_factors(tracer, 4096, sides=sides) for sides in factors.SIDES)
    assert (front.sky == 1).all()
    assert len(front.factor) == 0
    assert (back.sky == 0).all()
    assert back.to_dense().sum(axis=1) == pytest.approx(1)
    assert both.sky == pytest.approx(0.5, abs=DEVIATIONS * 0.5 / 64)
    assert both.area == pytest.approx(2 * back.area)
    assert np.abs(2 * both.to_dense() - back.to_dense()).max() < 0.05
    assert back.reciprocity_error < 0.1


def test_instances_and_batches_are_as_one_mesh(session, monkeypatch):
    mesh, _ = join(*PARALLEL)
    square = clbvh.Mesh.from_arrays(*PARALLEL[0])
    scene = clbvh.Scene()
    geometry = scene.add(square)
    scene.place(geometry)
    over = np.diag([1.0, -1, -1, 1])
    over[:3, 3] = 0, 1, 1
    scene.place(geometry, over)
    with clbvh.Tracer(mesh, device=session.info) as tracer:
        whole = view_factors(tracer, 1024, seed=3)
        monkeypatch.setattr(factors, "_RAYS_AT_ONCE", 1024)
        done = []
        parts = view_factors(tracer, 1024, seed=3, progress=lambda *each: done.append(each))
    assert done == [(1024 * number, 4096) for number in (1, 2, 3, 4)]
    for name in ("source", "target", "factor", "sky"):
        assert np.array_equal(getattr(whole, name), getattr(parts, name))
    with clbvh.Tracer(scene, device=session.info) as tracer:
        placed = view_factors(tracer, 1024, [0, 0, 1, 1])
    assert placed.to_dense()[[0, 1], [1, 0]] == pytest.approx(0.1998, abs=DEVIATIONS * 0.4 / 32)


def test_mirrors_take_the_side_along_and_masks_take_instances_away(session):
    cube = clbvh.make_shape("cube", triangles=12)
    scene = clbvh.Scene()
    geometry = scene.add(cube)
    scene.place(geometry, np.diag([-1.0, 1, 1, 1]))
    other = scene.place(geometry, [[1, 0.3, 0, 2], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    with clbvh.Tracer(scene, device=session.info) as tracer:
        tracer.set_masks(other, 0)
        front, back = (view_factors(tracer, 64, sides=sides) for sides in ("front", "back"))
    assert (front.sky[:12] == 1).all()
    assert (back.sky[:12] == 0).all()
    assert np.isnan(front.sky[12:]).all()
    assert front.area[12:].sum() == 0


def test_small_sources_behind_large_ones_keep_their_digits(session):
    ground = rectangle((-1e8, -1e8, -1), (2e8, 0, 0), (0, 2e8, 0))
    mesh, groups = join(ground, *PARALLEL)
    faces = factors._Faces.of_tracer(clbvh.Tracer(mesh, device=session.info), "front")
    single, grouped = (factors._Sources.make(faces, labels) for labels in (None, groups.astype(np.int32)))
    assert single.sums.tolist() == [1.0] * 6
    assert grouped.sums == pytest.approx([0.5, 1] * 3, abs=1e-12)


def test_faces_without_area_and_walls_of_two_faces(session):
    (vertices, faces), _ = PARALLEL
    mesh, _ = join((vertices, [*faces, [0, 1, 1]]), (vertices, np.array(faces)[:, ::-1]))
    with clbvh.Tracer(mesh, device=session.info) as tracer:
        found = view_factors(tracer, 256)
    # Back to back, neither face sees the other.
    assert (found.sky[[0, 1, 3, 4]] == 1).all()
    assert np.isnan(found.sky[2])
    assert found.area[2] == 0


def test_what_does_not_fit_is_refused(session):
    mesh, groups = join(*PARALLEL)
    with clbvh.Tracer(mesh, device=session.info) as tracer:
        for error, words, options in [
            (clbvh.ConfigError, "rays", {"rays": 0}),
            (clbvh.ConfigError, "rays", {"rays": (1 << 20) + 1}),
            (clbvh.ConfigError, "sides", {"sides": "left"}),
            (clbvh.ConfigError, "seed", {"seed": -1}),
            (clbvh.QueryError, "groups", {"groups": groups[:-1]}),
            (clbvh.QueryError, "groups", {"groups": groups + 0.5}),
            (clbvh.QueryError, "groups", {"groups": groups + 3}),
            (clbvh.QueryError, "groups", {"groups": [[0], [1, 2]]}),
            (clbvh.ConfigError, "sides", {"sides": np.array(["front", "back"])}),
        ]:
            with pytest.raises(error, match=words):
                view_factors(tracer, **options)
    with pytest.raises(clbvh.QueryError, match="not Mesh"):
        view_factors(mesh)
    with clbvh.Tracer(clbvh.Spheres([[0, 0, 0]], 1.0)) as tracer, pytest.raises(clbvh.QueryError, match="spheres"):
        view_factors(tracer)
