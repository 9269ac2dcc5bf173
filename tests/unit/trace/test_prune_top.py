"""The tree over some instances, against the instances one by one and against a scene of no others."""

from types import SimpleNamespace

import numpy as np
import pytest

import clbvh
from clbvh.builders.build import build_tree
from clbvh.geometry.corners import Boxes
from clbvh.structs import INSTANCE
from clbvh.trace.world.top_tree import prune_top


def top_over(count, leaf_size, seed):
    """A tree over boxes, some of them twice."""
    generator = np.random.default_rng(seed)
    lower = generator.uniform(-1, 1, (count, 3))
    lower[generator.random(count) < 0.3] = lower[0]
    boxes = Boxes.from_arrays(lower, lower + generator.uniform(0, 0.3, (count, 3)), "boxes")
    bvh = build_tree(boxes, "sah", None, clbvh.BuildOptions(leaf_size=leaf_size))
    instances = np.zeros(count, INSTANCE)
    instances["instance_id"], instances["mask"] = bvh.prim_ids, 1 + bvh.prim_ids
    return SimpleNamespace(instances=instances, bvh=bvh)


def walk(nodes, index=0):
    """Return slots, least and greatest corner below a node of `bvh2`, after a check of the boxes of its children."""
    slots, corners = [], []
    for child in range(2):
        box = nodes["aabb_min"][index][child], nodes["aabb_max"][index][child]
        if (box[0] > box[1]).any():
            continue
        first, count = nodes["first"][index][child], nodes["count"][index][child]
        if count > 0:
            slots += range(first, first + count)
        else:
            below, least, most = walk(nodes, first)
            np.testing.assert_array_equal(box, (least, most))
            slots += below
        corners.append(box)
    return slots, np.min([box[0] for box in corners], axis=0), np.max([box[1] for box in corners], axis=0)


@pytest.mark.parametrize("count", [1, 2, 3, 50, 400])
@pytest.mark.parametrize("leaf_size", [1, 4])
@pytest.mark.parametrize("share", [0.01, 0.3, 1.0])
def test_the_tree_holds_the_chosen_instances_in_tight_boxes(count, leaf_size, share):
    top = top_over(count, leaf_size, seed=count)
    generator = np.random.default_rng(9)
    chosen = np.flatnonzero(generator.random(count) < share)
    chosen = generator.permutation(chosen if len(chosen) else [count // 2])
    arrays = prune_top(top, chosen)
    np.testing.assert_array_equal(np.sort(arrays["instances"]["instance_id"]), np.sort(chosen))
    np.testing.assert_array_equal(arrays["instances"]["mask"], arrays["instances"]["instance_id"] + 1)
    slots, least, most = walk(arrays["top_nodes"])
    np.testing.assert_array_equal(np.sort(slots), np.arange(len(chosen)))
    assert len(arrays["top_nodes"]) <= max(1, len(chosen) - 1)
    if share == 1.0:
        np.testing.assert_array_equal(least, top.bvh.nodes["aabb_min"][0])
        np.testing.assert_array_equal(most, top.bvh.nodes["aabb_max"][0])
    if leaf_size == 1:
        corners = top.bvh.shape.corners[chosen].reshape(-1, 3)
        np.testing.assert_array_equal((least, most), (corners.min(axis=0), corners.max(axis=0)))


def test_without_any_instance_nothing_is_seen():
    arrays = prune_top(top_over(20, 1, seed=0), np.array([], np.int64))
    assert arrays["instances"]["mask"].tolist() == [0]
    assert walk(arrays["top_nodes"])[0] == [0]


@pytest.mark.parametrize("chosen", [1, 9, 60])
def test_points_see_the_chosen_instances_alone(chosen):
    generator = np.random.default_rng(chosen)
    ball, spheres = clbvh.make_shape("icosphere", triangles=80), clbvh.Spheres(generator.normal(size=(5, 3)), 0.4)
    places = np.tile(np.eye(4), (120, 1, 1))
    places[:, :3, 3] = generator.uniform(-9, 9, (120, 3))
    ids = np.sort(generator.choice(120, chosen, replace=False))
    scene, only = clbvh.Scene(), clbvh.Scene()
    shapes = [scene.add(ball), scene.add(spheres)]
    others = [only.add(ball), only.add(spheres)]
    for number, place in enumerate(places):
        scene.place(shapes[number % 2], place)
    for number in ids:
        only.place(others[number % 2], places[number])
    points = generator.uniform(-10, 10, (500, 3))
    points[::2] = places[generator.choice(ids, 250), :3, 3] + generator.uniform(-0.5, 0.5, (250, 3))
    with clbvh.Tracer(scene) as tracer, clbvh.Tracer(only) as expected:
        found, other = tracer.closest_point(points, instance=ids), expected.closest_point(points)
        np.testing.assert_allclose(found.distance, other.distance, rtol=1e-12)
        np.testing.assert_array_equal(found.prim_id, other.prim_id)
        np.testing.assert_array_equal(found.instance_id, ids[other.instance_id])
        np.testing.assert_array_equal(tracer.contains(points, instance=ids), expected.contains(points))
        signed = tracer.signed_distance(points, instance=ids)
        np.testing.assert_allclose(signed, expected.signed_distance(points), rtol=1e-12)
        assert (signed > 0).any()
        assert np.isinf(tracer.closest_point(points, instance=[]).distance).all()
