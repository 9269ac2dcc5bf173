"""Any shapes, alone or placed anywhere: every layout finds the same hits, and they are those of the oracle."""

import numpy as np
import pytest
from hypothesis import given

from clbvh import Tracer
from clbvh.trace.check.intersections import Rays
from clbvh.trace.check.reference import Reference
from clbvh.trace.world.trees import BRUTE
from clbvh.tree_layouts import TREE_LAYOUTS

from ..all_hits_reference import find_wrong_crossings
from ..profiles import examples, seeds
from ..state_tracer import open_tracer
from .random_scenes import KINDS, LINEAR, RAY_MASKS, RAYS, make_scene, random_scenes, scale_scene

FIELDS = ("t", "u", "v", "prim_id", "instance_id", "geometry_id", "is_front", "locations", "offsets")


def as_bytes(answer):
    if isinstance(answer, np.ndarray):
        return answer.tobytes()
    return {name: np.asarray(getattr(answer, name)).tobytes() for name in FIELDS if hasattr(answer, name)}


def ask(scene, opened, layout, limits):
    """The answers to all queries about rays, as the tracer gives them."""
    rays = scene.origins, scene.directions
    with open_tracer(scene, opened.info, layout) as tracer:
        return {
            "closest_hit": tracer.closest_hit(*rays),
            "all_hits": tracer.all_hits(*rays),
            "closest_hit, limits": tracer.closest_hit(*rays, **limits),
            "all_hits, limits": tracer.all_hits(*rays, **limits),
            "any_hit": tracer.any_hit(*rays, **limits),
            "count_hits": tracer.count_hits(*rays, **limits),
            "count_hits, few": tracer.count_hits(*rays, max_hits=2),
            "closest_prim": tracer.closest_prim(*rays, **limits),
            "all_hits, first": tracer.all_hits(*rays, max_hits=1),
        }


def make_limits(scene, first):
    """Limits and masks for all rays: many a limit is exactly the t of a hit."""
    generator, count = scene.generator, len(first.t)
    t = np.where(first.is_hit, first.t, 1.0)
    return {
        "t_min": np.where(generator.random(count) < 0.4, t * generator.choice([0.5, 1.0], count), 0.0),
        "t_max": np.where(generator.random(count) < 0.4, t * generator.choice([1.0, 1.5], count), np.inf),
        "mask": generator.choice(RAY_MASKS, count).astype(np.uint32),
    }


def check_against_the_oracle(scene, closest, crossings, limits):
    """Compare hits with the oracle's and with each other; return the number of rays whose closest hit is decided."""
    reference, rays = Reference(scene.state), Rays.make(scene.origins, scene.directions, **limits)
    known = reference.intersections(rays)
    assert [str(one) for one in reference.find_differences(rays, closest, known)] == []
    assert find_wrong_crossings(reference, rays, crossings, known).tolist() == []
    assert (crossings.counts >= known.sure_counts).all()
    assert (crossings.counts <= np.diff(known.offsets)).all()
    expected = reference.closest_hit(rays, known)
    for name in ("instance_id", "geometry_id", "prim_id"):
        obtained = getattr(closest, name)[expected.is_decided]
        np.testing.assert_array_equal(obtained, getattr(expected, name)[expected.is_decided])

    is_closest = np.ones(len(crossings.t), np.bool_)
    for name in ("t", "u", "v", "instance_id", "prim_id"):
        is_closest &= getattr(crossings, name) == getattr(closest, name)[crossings.ray_id]
    # Twice, where a sphere is entered and left at once.
    found = np.bincount(crossings.ray_id[is_closest], minlength=len(closest.t)) > 0
    np.testing.assert_array_equal(found, closest.is_hit)
    np.testing.assert_array_equal(found, crossings.counts > 0)
    return np.count_nonzero(expected.is_decided)


def check(scene, opened):
    """Compare layouts with each other and with the oracle; return the number of decided rays, and the answers."""
    with Tracer(scene.contents(), device=opened.info) as tracer:
        limits = make_limits(scene, tracer.closest_hit(scene.origins, scene.directions))
    answers = ask(scene, opened, BRUTE, limits)
    for layout in TREE_LAYOUTS:
        others = ask(scene, opened, layout, limits)
        assert [name for name in answers if as_bytes(others[name]) != as_bytes(answers[name])] == [], layout
    decided = check_against_the_oracle(scene, answers["closest_hit"], answers["all_hits"], {})
    decided += check_against_the_oracle(scene, answers["closest_hit, limits"], answers["all_hits, limits"], limits)

    # The queries agree with each other.
    counts = answers["all_hits, limits"].counts
    np.testing.assert_array_equal(answers["count_hits"], counts)
    np.testing.assert_array_equal(answers["any_hit"], counts > 0)
    np.testing.assert_array_equal(answers["count_hits, few"], np.minimum(answers["all_hits"].counts, 2))
    np.testing.assert_array_equal(answers["closest_prim"], answers["closest_hit, limits"].prim_id)
    closest, first = answers["closest_hit"], answers["all_hits, first"]
    for name in ("t", "prim_id", "instance_id"):
        np.testing.assert_array_equal(getattr(first, name), getattr(closest, name)[closest.is_hit])
    return decided, answers


@pytest.mark.on_both
@examples(short=40, long=2000)
@given(scene=random_scenes())
def test_layouts_and_the_oracle_agree(opened, scene):
    check(scene, opened)


@pytest.mark.parametrize(("is_far", "scale"), [(False, 1.0), (True, 1e-30), (True, 1e30)])
@pytest.mark.parametrize("seed", seeds(1))
def test_most_rays_are_decided(opened, seed, is_far, scale):
    """So that the test above can fail."""
    scene = scale_scene(make_scene(seed, tuple(KINDS), tuple(LINEAR), is_far=is_far), scale)
    decided, answers = check(scene, opened)
    assert decided > 0.3 * 2 * RAYS
    assert answers["closest_hit"].count > 0.3 * RAYS
    assert len(np.unique(answers["all_hits"].instance_id)) > 2


def test_the_first_of_all_hits_is_the_closest_one_far_away(opened):
    check(scale_scene(make_scene(7, ("line", "cube", "ball"), ("turn", "scale", "turn"), is_far=True), 1e30), opened)
