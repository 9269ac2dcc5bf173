"""Scenes that show nothing, because nothing is placed, or everything is removed: every query answers that it misses."""

import pickle

import numpy as np
import pytest

import clbvh
from clbvh import SceneError
from clbvh.tree_layouts import TREE_LAYOUTS

KNOT = clbvh.make_shape("knot", triangles=1500)


def make_empty(contents):
    scene = clbvh.Scene()
    if contents != "nothing":
        knot, _ = scene.add(KNOT, name="knot"), scene.add(clbvh.Spheres([[0, 0, 0]], 1), name="ball")
    if contents == "removed":
        scene.place_many(knot, np.tile(np.eye(4), (2, 1, 1)), mask=0)
        scene.place("ball", mask=0)
    return scene


def assert_nothing_is_seen(tracer, generator):
    for count in (1, 40, 3000):
        points, ways = generator.uniform(-3, 3, (count, 3)), generator.normal(size=(count, 3))
        for mask in (None, generator.integers(0, 4, count)):
            hits, every = tracer.closest_hit(points, ways, mask=mask), tracer.all_hits(points, ways, mask=mask)
            for ids in (hits.prim_id, hits.instance_id, hits.geometry_id, hits.part_id):
                assert (ids == -1).all()
            assert np.isinf(hits.t).all()
            assert np.isnan(hits.locations).all()
            assert hits[hits.is_hit].locations.shape == hits[hits.is_hit].offset_origins().shape == (0, 3)
            assert (every.locations.shape, every.counts.tolist()) == ((0, 3), [0] * count)
            assert not tracer.any_hit(points, ways, mask=mask).any()
            assert not tracer.count_hits(points, ways, mask=mask).any()
            assert (tracer.closest_prim(points, ways, mask=mask) == -1).all()
            for found in (tracer.closest_point(points, mask=mask), tracer.closest_points(points, 2, mask=mask)):
                assert np.isinf(found.distance).all()
                assert np.isnan(found.point).all()
                assert max(found.prim_id.max(), found.instance_id.max(), found.geometry_id.max()) == -1
            assert not tracer.contains(points, mask=mask).any()
            assert (tracer.signed_distance(points, mask=mask) == -np.inf).all()
            assert (tracer.ambient_occlusion(points, ways, mask=mask) == 1).all()
    assert tracer.closest_hit([0, 0, 1e30], [0, 0, -1]).t == np.inf
    assert tracer.collisions().shape == (0, 2)


@pytest.mark.parametrize("quality", ["default", "fast"])
@pytest.mark.parametrize("layout", TREE_LAYOUTS)
@pytest.mark.parametrize("contents", ["nothing", "geometries", "removed"])
def test_every_query_misses(contents, layout, quality):
    generator = np.random.default_rng(1)
    with clbvh.Tracer(make_empty(contents), layout=layout, quality=quality) as tracer:
        assert_nothing_is_seen(tracer, generator)
        with pickle.loads(pickle.dumps(tracer)) as other:
            assert_nothing_is_seen(other, generator)


@pytest.mark.on_both
def test_every_query_misses_on_every_device(session):
    with clbvh.Tracer(make_empty("geometries"), device=session.info, layout="bvh2") as tracer:
        assert_nothing_is_seen(tracer, np.random.default_rng(1))
    with clbvh.Tracer(make_empty("nothing"), device=session.info) as tracer:
        assert not tracer.any_hit([[0, 0, 5]], [[0, 0, -1]])


def test_geometries_that_nothing_places_can_move():
    scene = make_empty("geometries")
    with clbvh.Tracer(scene) as tracer:
        tracer.set_transforms([], np.empty((0, 4, 4)))
        tracer.set_masks([], 0)
        tracer.set_vertices("knot", 2 * KNOT.vertices)
        tracer.set_spheres("ball", [[0, 0, 1]], 2)
        assert_nothing_is_seen(tracer, np.random.default_rng(1))
        scene.place("knot")
        with pytest.raises(SceneError, match="placed after"):
            tracer.set_masks(0, 1)


@pytest.mark.parametrize("contents", ["nothing", "geometries", "removed"])
@pytest.mark.parametrize("settings", [{"shading": "lambert+shadow"}, {"shading": "path", "samples": 2}])
def test_a_picture_is_the_background_for_which_somebody_has_to_give_a_camera(contents, settings):
    size, options = {"width": 40, "height": 30}, clbvh.RenderOptions(validate=True)
    aside = clbvh.render(KNOT, **size, **settings, camera=clbvh.Camera((0, 0, 500), (0, 0, 600)))
    with clbvh.Renderer(make_empty(contents), options=options, **size, **settings) as renderer:
        camera = clbvh.Camera((0, 0, 5), (0, 0, 0))
        for view in ({"camera": camera}, {"eye": camera.eye, "look_at": camera.look_at}):
            picture = renderer.render(**view)
            assert (picture.rgb == aside.rgb).all()
            assert (picture.report()["hits"], picture.hits.count) == (0, 0)
        assert np.isinf(renderer.images("depth", camera=camera)["depth"]).all()
        for frame in (renderer.render, lambda: renderer.turntable(2), lambda: renderer.render(eye=camera.eye)):
            with pytest.raises(SceneError, match="shows nothing that a camera could frame"):
                frame()
