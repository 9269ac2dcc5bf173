"""Hits, closest points, scenes, tracers and pictures show what they hold, and become tables and arrays."""

import io

import matplotlib.figure
import numpy as np
import pytest
from PIL import Image

from clbvh import Mesh, Renderer, Scene, Spheres, Tracer, Transform, make_shape, render

STAIRS = Mesh.from_arrays(
    [[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, -1], [4, 0, -1], [0, 4, -1]], [[0, 1, 2], [3, 4, 5]], name="stairs"
)
DOWN = [0, 0, -1]
INSIDE, OUTSIDE = [1, 2, 5], [9, 9, 5]


@pytest.fixture(scope="module")
def stairs():
    with Tracer(STAIRS) as tracer:
        yield tracer


@pytest.fixture(scope="module")
def placed():
    scene = Scene()
    scene.place_many(scene.add(STAIRS), [np.eye(4), Transform(translate=(0, 0, 2)).matrix])
    with Tracer(scene) as tracer:
        yield tracer


def test_results_show_the_first_of_what_they_found(stairs, placed):
    one, first, second = "t=16.6667, prim_id=0, location=(1, 2, 0)", "location=(1, 2, 0)", "location=(1, 2, -1)"
    near = "distance=2, prim_id=1, instance_id=0, point=(1, 2, -1)"
    for found, text in (
        (stairs.closest_hit(OUTSIDE, DOWN), "Hits(miss)"),
        (placed.closest_hit(INSIDE, DOWN), "Hits(t=3, prim_id=0, instance_id=1, location=(1, 2, 2))"),
        (
            stairs.closest_hit([[OUTSIDE, INSIDE]] * 4, [[[0, 0, -0.3]]]),
            f"Hits(shape=(4, 2), hits=4, t=16.6667..16.6667)\n  [0, 1] {one}\n  [1, 1] {one}\n  [2, 1] {one}",
        ),
        (stairs.closest_hit(np.empty((0, 3)), DOWN), "Hits(shape=(0,), hits=0)"),
        (
            stairs.all_hits([OUTSIDE, INSIDE], DOWN),
            f"AllHits(rays=2, hits=2, t=5..6)\n  ray 1: t=5, prim_id=0, {first}\n  ray 1: t=6, prim_id=1, {second}",
        ),
        (placed.closest_point([1, 2, -3]), f"ClosestPoints({near})"),
        (placed.closest_point([1, 2, 5], mask=0), "ClosestPoints(none)"),
        (
            placed.closest_point([[1, 2, 5], [1, 2, -3]], mask=[0, 1]),
            f"ClosestPoints(shape=(2,), found=1, distance=2..2)\n  [1] {near}",
        ),
    ):
        assert repr(found) == text


def test_flat_hits_are_a_table(stairs, placed):
    names = ["t", "u", "v", "prim_id", "instance_id", "geometry_id", "is_front", "x", "y", "z"]
    for tracer in (stairs, placed):
        hits = tracer.closest_hit([INSIDE, OUTSIDE], DOWN)
        table = hits.to_dict()
        assert list(table) == names
        assert all(np.array_equal(table[name], getattr(hits, name)) for name in names[:7])
        assert np.array_equal(np.stack([table[axis] for axis in "xyz"], axis=1), hits.locations, equal_nan=True)
        every = tracer.all_hits([OUTSIDE, INSIDE], DOWN)
        assert list(every.to_dict()) == ["ray_id", *names]
        assert {len(column) for column in every.to_dict().values()} == {every.count}


def test_a_scene_shows_a_few_of_its_objects():
    scene = Scene()
    assert repr(scene) == "Scene(geometries=0, instances=0)"
    for number in range(10):
        geometry = scene.add(Spheres(np.zeros((1 + number, 3)), 1.0), name=f"dots {number}")
        scene.place_many(geometry, np.tile(np.eye(4), (5 * number, 1, 1)))
    lines = repr(scene).splitlines()
    assert lines[:3] == [
        "Scene(geometries=10, instances=225)",
        "  'dots 0': 1 sphere, not placed",
        "  'dots 1': 2 spheres, placed as 'dots 1', 'dots 1 2', 'dots 1 3' and 2 more",
    ]
    assert (len(lines), lines[-1]) == (10, "  and 2 more")


def test_tracers_and_renderers_show_counts(stairs, placed):
    assert repr(placed).startswith("Tracer('scene', instances=2, primitives=4, device=")
    with Renderer(STAIRS, width=8, height=8) as renderer:
        assert repr(renderer).replace("Renderer", "Tracer") == repr(stairs)


@pytest.mark.parametrize("transparent", [False, True])
def test_a_picture_is_an_array_and_an_image(session, transparent, monkeypatch):
    picture = render(make_shape("icosphere", triangles=80), width=24, height=16, samples=1, transparent=transparent)
    array = np.array(picture)
    assert (array == picture.pixels).all()
    assert array.shape == (16, 24, 4 if transparent else 3)
    array[:] = 0
    assert picture.pixels.any()
    assert np.asarray(picture, np.float32).dtype == np.float32
    assert (np.asarray(picture.to_pil()) == picture.pixels).all()
    figure = matplotlib.figure.Figure()
    figure.add_subplot().imshow(picture)
    figure.savefig(io.BytesIO(), format="png")
    shown = []
    monkeypatch.setattr(Image.Image, "show", lambda image: shown.append(image))
    picture.show()
    assert (np.asarray(shown[0]) == picture.pixels).all()
