"""The sky and the sun of points beside formulas, and the horizon."""

from __future__ import annotations

import math

import numpy as np
import pytest

import clbvh
from clbvh.radiation import horizon, sky, sky_view, sun_hours, tregenza_patches

DEPTH = 2.0
WALL_WIDTH = 400.0
# Of points above the ground: float32 rounds coordinates of this wall by 1e-5.
HEIGHT = 1e-3


@pytest.fixture
def yard():
    """A round yard of radius 1 around z, whose walls reach from z = -2 to z = 2."""
    sections = 512
    turns = 2 * np.pi * np.arange(sections) / sections
    rims = [np.column_stack((np.cos(turns), np.sin(turns), np.full(sections, z))) for z in (-DEPTH, DEPTH)]
    here, there = np.arange(sections), (np.arange(sections) + 1) % sections
    faces = np.concatenate(
        (np.column_stack((here, there, there + sections)), np.column_stack((here, there + sections, here + sections)))
    )
    return clbvh.Mesh.from_arrays(np.concatenate(rims), faces)


@pytest.fixture
def wall():
    """A wide wall at y = 1 from z = 0 to z = 1, whose front looks to the south, and the ground before it."""
    half = WALL_WIDTH / 2
    corners = [[-half, 1, 0], [half, 1, 0], [half, 1, 1], [-half, 1, 1], [-half, -half, 0], [half, -half, 0]]
    return clbvh.Mesh.from_arrays(corners, [[0, 1, 2], [0, 2, 3], [4, 5, 1], [4, 1, 0]])


def test_patches_cover_the_sky_once():
    directions, solid_angles = tregenza_patches()
    assert len(directions) == 145
    assert np.linalg.norm(directions, axis=1) == pytest.approx(1)
    assert solid_angles.sum() == pytest.approx(2 * math.pi)
    # The projection of the hemisphere has the area pi.
    assert solid_angles @ directions[:, 2] == pytest.approx(math.pi, rel=6e-3)
    assert (solid_angles[:-1] / solid_angles[:-1].mean()).max() < 1.2


def test_sky_view_is_that_of_formulas(session, yard, wall):
    heights = np.array([0.0, 0.5, 1.0, 2.0])
    points = np.column_stack((np.zeros((4, 2)), heights))
    exact = 1 / (1 + (DEPTH - heights) ** 2)
    with clbvh.Tracer(yard, device=session.info) as tracer:
        assert sky_view(tracer, points) == pytest.approx(exact, abs=5e-3)
        upside_down = sky_view(tracer, -points, up=(0, 0, -1))
        patches, solid_angles = tregenza_patches()
        coarse = sky_view(tracer, points, directions=patches, solid_angles=solid_angles)
    assert upside_down == pytest.approx(exact, abs=5e-3)
    assert coarse == pytest.approx(exact, abs=0.07)
    with clbvh.Tracer(wall, device=session.info) as tracer:
        # Points on the wall see the sky over one side, whose lower half is ground; those above the ground see the wall.
        on_wall = sky_view(tracer, tracer.points_on([0, 1]))
        distances = np.array([0.5, 1.0, 3.0])
        before = np.column_stack((np.zeros(3), 1 - distances, np.full(3, HEIGHT)))
        on_ground = sky_view(tracer, before)
        turned = sky_view(tracer, before, normals=[0, 1, 0])
        closest = tracer.closest_point([[0, 0.5, 0.4], [9, -9, 2]])
        assert sky_view(tracer, closest) == pytest.approx(sky_view(tracer, closest.as_hits()))
        assert horizon(tracer, closest, [0]).shape == (2, 1)
    assert on_wall == pytest.approx(0.5, abs=5e-3)
    elevation = np.arctan((1 - HEIGHT) / distances)
    assert on_ground == pytest.approx((1 + np.cos(elevation)) / 2, abs=5e-3)
    assert turned == pytest.approx((1 - np.sin(elevation)) / 2, abs=5e-3)


def test_sun_hours_count_free_directions_in_front_of_the_surface(session, wall, monkeypatch):
    south, north, high = (0, -1, 0.5), (0, 1, 0.5), (0, 1, 5)
    points = np.array([[0, 0, HEIGHT], [0, 0.9, HEIGHT], [0, -9, HEIGHT]])
    with clbvh.Tracer(wall, device=session.info) as tracer:
        assert sun_hours(tracer, points, [south, north, high], [1, 2, 4]).tolist() == [5, 1, 7]
        assert sun_hours(tracer, points[:1], [south, north, high]).tolist() == [2]
        surface = tracer.points_on([[0], [3]])
        assert sun_hours(tracer, surface, [south, north, high], [1, 2, 4]).tolist() == [[1], [7]]
        cosines = [1 / math.sqrt(1.25), 5 / math.sqrt(26) * 4 + 3 * 0.5 / math.sqrt(1.25)]
        assert sun_hours(tracer, surface, [south, north, high], [1, 2, 4], by_cosine=True).ravel() == pytest.approx(
            cosines
        )
        # A part at a time is the same.
        random = np.random.default_rng(1)
        spread, suns = (
            random.uniform(-3, 0.9, (50, 3)) * [1, 1, 0] + np.array([0, 0, HEIGHT]),
            random.normal(size=(40, 3)),
        )
        whole = sun_hours(tracer, spread, suns, random.random(40))
        done = []
        monkeypatch.setattr(sky, "_RAYS_AT_ONCE", 400)
        parts = sun_hours(tracer, spread, suns, np.random.default_rng(1).random(40), progress=lambda *n: done.append(n))
    assert len(done) == 5
    assert done[-1] == (2000, 2000)
    assert len(parts) == len(whole)


def test_the_horizon_is_that_of_a_wall(session, wall):
    azimuths = np.array([-85.0, -45, 0, 30, 60, 90, 180, 270])
    points = np.array([[0, 0, HEIGHT], [0, -2, HEIGHT], [5, 0.5, 0.25]])
    with clbvh.Tracer(wall, device=session.info) as tracer:
        found = horizon(tracer, points, azimuths, tolerance=1e-4)
        coarse = horizon(tracer, points, azimuths, step=10, tolerance=1e-4)
        turned = horizon(tracer, points[:1], [0.0], north=(1, 1, 0.3))
        fine = horizon(tracer, points, azimuths, step=0.25, tolerance=1e-4)
    ahead = np.cos(np.radians(azimuths))
    exact = np.degrees(np.arctan2((1 - points[:, 2:]) * ahead, 1 - points[:, 1:2]))
    assert found == pytest.approx(np.where(ahead > 1e-9, exact, 0), abs=1e-3)
    assert coarse == pytest.approx(found, abs=1e-3)
    assert fine == pytest.approx(found, abs=1e-3)
    assert turned == pytest.approx(np.degrees(np.arctan((1 - HEIGHT) * math.sqrt(0.5))), abs=0.01)


def test_a_roof_hides_what_is_above(session):
    roof = clbvh.Mesh.from_arrays([[-1, 1, 1], [1, 1, 1], [1, 2, 1], [-1, 2, 1]], [[0, 1, 2], [0, 2, 3]])
    with clbvh.Tracer(roof, device=session.info) as tracer:
        assert horizon(tracer, [0, 0, 0], [0.0]) == pytest.approx(45, abs=0.01)
        assert horizon(tracer, [0, 1.5, 0], [0.0, 180.0]) == pytest.approx(90)
        assert sun_hours(tracer, [0.0, 0, 0], [[0, 1, 0.2], [0, 1, 0.9]]) == 1


def test_what_does_not_fit_is_refused(session, wall):
    with clbvh.Tracer(wall, device=session.info) as tracer:
        for error, words, call in [
            (clbvh.QueryError, "length above 0", lambda: sun_hours(tracer, [0, 0, 1], [[0, 0, 0]])),
            (clbvh.QueryError, "weights", lambda: sun_hours(tracer, [0, 0, 1], [[0, 0, 1]], [1, 2])),
            (clbvh.QueryError, "weights", lambda: sun_hours(tracer, [0, 0, 1], [[0, 0, 1]], [np.nan])),
            (clbvh.QueryError, "directions must be", lambda: sun_hours(tracer, [0, 0, 1], [0, 0, 1])),
            (clbvh.QueryError, "needs normals", lambda: sun_hours(tracer, [0, 0, 1], [[0, 0, 1]], by_cosine=True)),
            (clbvh.QueryError, "do not fit", lambda: sky_view(tracer, [[0, 0, 1]] * 2, [[0, 0, 1]] * 3)),
            (clbvh.QueryError, "of a sky", lambda: sky_view(tracer, [0, 0, 1], directions=[[0, 0, -1]])),
            (clbvh.QueryError, "along up", lambda: horizon(tracer, [0, 0, 1], [0], north=(0, 0, 2))),
            (clbvh.QueryError, "finite", lambda: horizon(tracer, [0, 0, 1], [np.inf])),
            (clbvh.QueryError, "numbers", lambda: horizon(tracer, [0, 0, 1], ["north"])),
            (clbvh.QueryError, "up must be", lambda: horizon(tracer, [0, 0, 1], [0], up=np.eye(3))),
            (clbvh.QueryError, "weights", lambda: sun_hours(tracer, [0, 0, 1], [[0, 0, 1]], [1j])),
            (clbvh.QueryError, "misses", lambda: sky_view(tracer, tracer.closest_hit([[0, 0, 9]], [0, 0, 1]))),
            (clbvh.ConfigError, "step", lambda: horizon(tracer, [0, 0, 1], [0], step=0)),
            (clbvh.ConfigError, "step", lambda: horizon(tracer, [0, 0, 1], [0], step="1")),
            (clbvh.ConfigError, "tolerance", lambda: horizon(tracer, [0, 0, 1], [0], tolerance=5e-324)),
            (clbvh.ConfigError, "tolerance", lambda: horizon(tracer, [0, 0, 1], [0], tolerance=2)),
        ]:
            with pytest.raises(error, match=words):
                call()
