"""Any shapes, placed anywhere: every layout finds the same hits, and they are those of the oracle."""

import numpy as np
import pytest
from hypothesis import given

import clbvh
from clbvh import Mesh, Tracer
from clbvh.builders.build import build_tree
from clbvh.structs import LAYOUT_WIDTHS
from clbvh.trace.check.intersections import Rays
from clbvh.trace.check.reference import Reference
from clbvh.trace.world.trees import BRUTE

from ..all_hits_reference import find_wrong_crossings
from ..profiles import examples, seeds
from ..state_tracer import StateTracer, open_tracer
from ..unit.trace.scene_states import affine, flatten, make_state
from .random_scenes import (
    KINDS,
    LINEAR,
    MESH_KINDS,
    RAY_MASKS,
    RAYS,
    make_scene,
    make_world,
    random_scenes,
    scale_scene,
)

LAYOUTS = (*LAYOUT_WIDTHS, BRUTE)
FEW_RAYS = 16

FIELDS = ("t", "u", "v", "prim_id", "instance_id", "geometry_id", "is_front", "locations")


@pytest.fixture(scope="module")
def opened(_opened_device):
    return _opened_device


def as_bytes(hits):
    return {name: np.asarray(getattr(hits, name)).tobytes() for name in FIELDS}


def ask(scene, opened, layout, limits):
    """The answers to all queries about rays, as the tracer gives them."""
    with open_tracer(scene, opened.info, layout) as tracer:
        rays = scene.origins, scene.directions
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


def compare_layouts(scene, opened, limits, layouts=LAYOUTS):
    """Ask every layout; return the answers, which are the same."""
    answers = {layout: ask(scene, opened, layout, limits) for layout in layouts}
    first, *others = answers
    for layout in others:
        for query, expected in answers[first].items():
            found = answers[layout][query]
            if isinstance(expected, np.ndarray):
                assert found.tobytes() == expected.tobytes(), (query, layout)
                continue
            if hasattr(expected, "offsets"):
                np.testing.assert_array_equal(found.offsets, expected.offsets, f"{query}, {layout}")
            one, other = as_bytes(found), as_bytes(expected)
            assert [name for name in FIELDS if one[name] != other[name]] == [], (query, layout)
    return answers[first]


def make_limits(scene, first):
    """Limits and masks for all rays: many a limit is exactly the t of a hit."""
    generator, count = scene.generator, len(first.t)
    t = np.where(first.is_hit, first.t, 1.0)
    return {
        "t_min": np.where(generator.random(count) < 0.4, t * generator.choice([0.5, 1.0], count), 0.0),
        "t_max": np.where(generator.random(count) < 0.4, t * generator.choice([1.0, 1.5], count), np.inf),
        "mask": generator.choice(RAY_MASKS, count).astype(np.uint32),
    }


def check_against_the_oracle(scene, answers, limits):
    """Compare all answers with the oracle's; return the number of rays whose closest hit is decided."""
    reference = Reference(scene.state)
    decided = 0
    for suffix, given_limits in (("", {}), (", limits", limits)):
        rays = Rays.make(scene.origins, scene.directions, **given_limits)
        known = reference.intersections(rays)
        closest, crossings = answers["closest_hit" + suffix], answers["all_hits" + suffix]
        assert [str(one) for one in reference.find_differences(rays, closest, known)] == []
        assert find_wrong_crossings(reference, rays, crossings, known).tolist() == []
        assert (crossings.counts >= known.sure_counts).all()
        assert (crossings.counts <= np.diff(known.offsets)).all()
        expected = reference.closest_hit(rays, known)
        for name in ("instance_id", "geometry_id", "prim_id"):
            obtained = getattr(closest, name)[expected.is_decided]
            np.testing.assert_array_equal(obtained, getattr(expected, name)[expected.is_decided])
        decided += int(expected.is_decided.sum())

        # The queries agree with each other.
        np.testing.assert_array_equal(closest.is_hit, crossings.counts > 0)
        is_closest = np.ones(len(crossings.t), np.bool_)
        for name in ("t", "u", "v", "instance_id", "prim_id"):
            is_closest &= getattr(crossings, name) == getattr(closest, name)[crossings.ray_id]
        # Twice, where a sphere is entered and left at once.
        found = np.bincount(crossings.ray_id[is_closest], minlength=len(closest.t)) > 0
        np.testing.assert_array_equal(found, closest.is_hit)
    limited = answers["all_hits, limits"].counts
    np.testing.assert_array_equal(answers["count_hits"], limited)
    np.testing.assert_array_equal(answers["any_hit"], limited > 0)
    np.testing.assert_array_equal(answers["count_hits, few"], np.minimum(answers["all_hits"].counts, 2))
    np.testing.assert_array_equal(answers["closest_prim"], answers["closest_hit, limits"].prim_id)
    closest, first = answers["closest_hit"], answers["all_hits, first"]
    for name in ("t", "prim_id", "instance_id"):
        np.testing.assert_array_equal(getattr(first, name), getattr(closest, name)[closest.is_hit])
    return decided


def check(scene, opened, layouts=LAYOUTS):
    with Tracer(scene.contents(), device=opened.info) as tracer:
        first = tracer.closest_hit(scene.origins, scene.directions)
    limits = make_limits(scene, first)
    answers = compare_layouts(scene, opened, limits, layouts)
    return check_against_the_oracle(scene, answers, limits), answers


@examples(short=30, long=2000)
@given(scene=random_scenes())
def test_layouts_and_the_oracle_agree(opened, scene):
    check(scene, opened)


@pytest.mark.parametrize("seed", seeds(40))
def test_many_worlds_in_one_layout_after_the_other(opened, seed):
    check(make_world(seed, FEW_RAYS), opened, LAYOUTS[seed % len(LAYOUTS) :][:1])


@pytest.mark.parametrize("scale", [1.0, 1e-30, 1e30])
@pytest.mark.parametrize("is_far", [False, True], ids=["near", "far"])
@pytest.mark.parametrize("seed", seeds(2))
def test_most_rays_are_decided(opened, seed, is_far, scale):
    """So that the test above can fail."""
    scene = scale_scene(make_scene(seed, tuple(KINDS), tuple(LINEAR), is_far=is_far), scale)
    decided, answers = check(scene, opened)
    assert len(scene.origins) > 0.7 * RAYS
    assert decided > 0.3 * 2 * RAYS
    assert answers["closest_hit"].count > 0.3 * RAYS
    assert len(np.unique(answers["all_hits"].instance_id)) > 2


@pytest.mark.parametrize("seed", seeds(3))
def test_a_power_of_two_changes_no_bit_but_those_of_exponents(opened, seed):
    scene = make_scene(seed, tuple(KINDS), tuple(LINEAR))
    with Tracer(scene.contents(), device=opened.info) as tracer:
        expected = tracer.all_hits(scene.origins, scene.directions)
    for exponent in (-99, 99):
        scaled = scale_scene(scene, 2.0**exponent)
        with Tracer(scaled.contents(), device=opened.info) as tracer:
            hits = tracer.all_hits(scaled.origins, scaled.directions)
        for name in ("t", "u", "v", "prim_id", "instance_id", "offsets"):
            np.testing.assert_array_equal(getattr(hits, name), getattr(expected, name), f"{name}, 2^{exponent}")


def surface_errors(scene, hits):
    """How far locations are from the exact primitives, and the size of each instance's coordinates."""
    errors, sizes = np.empty(len(hits.t)), np.empty(len(hits.t))
    for index, (instance, prim, location) in enumerate(
        zip(hits.instance_id, hits.prim_id, hits.locations, strict=True)
    ):
        shape = scene.state.shapes[scene.state.geometry_ids[instance]]
        transform = scene.state.transforms[instance]
        linear = transform[:3, :3]
        if isinstance(shape, Mesh):
            corners = shape.vertices[shape.faces[prim]] @ linear.T + transform[:3, 3]
            normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
            errors[index] = abs((location - corners[0]) @ normal) / np.linalg.norm(normal)
        else:
            local = np.linalg.solve(linear, location - transform[:3, 3]) - shape.centres[prim]
            errors[index] = abs(np.linalg.norm(local) - shape.radii[prim]) * np.linalg.norm(linear, 2)
        sizes[index] = np.abs(transform[:3, 3]).max() + 10 * np.linalg.norm(linear, 2)
    return errors, sizes


@pytest.mark.parametrize("seed", seeds(4))
@pytest.mark.parametrize("is_far", [False, True], ids=["near", "far"])
def test_locations_are_on_the_exact_surfaces_and_on_the_rays(opened, seed, is_far):
    scene = make_scene(seed, tuple(KINDS), tuple(LINEAR), is_far=is_far)
    with Tracer(scene.contents(), device=opened.info) as tracer:
        hits = tracer.all_hits(scene.origins, scene.directions)
    errors, sizes = surface_errors(scene, hits)
    assert (errors <= 2.0**-46 * sizes).all(), (errors / sizes).max()
    # Most rays pass no edge, and meet the surface exactly.
    ways = hits.locations - scene.origins[hits.ray_id]
    directions = scene.directions[hits.ray_id]
    along = np.linalg.norm(ways, axis=1)
    beside = np.linalg.norm(ways - hits.t[:, None] * directions, axis=1)
    is_near = along < 1000
    assert np.mean(beside[is_near] <= 2.0**-40 * (along + sizes)[is_near]) > 0.8


@examples(short=15, long=500)
@given(scene=random_scenes(kinds=tuple(MESH_KINDS), may_be_far=False))
def test_meshes_are_hit_as_in_the_flattened_mesh(opened, scene):
    vertices, faces, ids = flatten(scene.state)
    flat = Mesh.from_arrays(vertices, faces)
    rays = Rays.make(scene.origins, scene.directions)
    visible = scene.state.masks != 0
    with Tracer(scene.contents(), device=opened.info) as tracer:
        hits = tracer.closest_hit(scene.origins, scene.directions)
    if not visible.all():
        keep = visible[ids[:, 0]]
        if not keep.any():
            assert not hits.is_hit.any()
            return
        flat, ids = Mesh.from_arrays(vertices, faces[keep]), ids[keep]
    with Tracer(flat, device=opened.info) as tracer:
        flat_hits = tracer.closest_hit(scene.origins, scene.directions)
    one = Reference(scene.state).closest_hit(rays)
    other = Reference(make_state([flat], (0, affine()))).closest_hit(rays)
    both = one.is_decided & other.is_decided
    named = np.where(flat_hits.is_hit[:, None], ids[flat_hits.prim_id], -1)[both]
    np.testing.assert_array_equal(np.column_stack((hits.instance_id, hits.prim_id))[both], named)
    both &= hits.is_hit & flat_hits.is_hit
    reach = np.linalg.norm(scene.origins, axis=1) / np.linalg.norm(scene.directions, axis=1)
    assert (np.abs(hits.t[both] - flat_hits.t[both]) <= 1e-4 * (reach + flat_hits.t)[both]).all()


@pytest.mark.parametrize("is_placed", [False, True], ids=["mesh", "instance"])
def test_a_hit_on_a_triangle_seen_edge_on_is_where_the_ray_is(opened, is_placed):
    """Rays in the plane of a square: float32 may see them hit it, but then near its edges."""
    square = Mesh.from_arrays([[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]], [[0, 1, 2], [0, 2, 3]])
    generator = np.random.default_rng(0)
    beside = []
    for _ in range(40):
        transform = affine(LINEAR["turn"](generator), generator.integers(-9, 9, 3))
        origins = np.column_stack((generator.integers(-20, 20, (50, 2)), np.zeros(50)))
        directions = np.column_stack((generator.integers(1, 4, (50, 2)), np.zeros(50)))
        origins = origins @ transform[:3, :3].T + transform[:3, 3]
        directions = directions @ transform[:3, :3].T
        source = clbvh.Scene()
        if is_placed:
            source.place(source.add(square), transform)
        else:
            source = Mesh.from_arrays(square.vertices @ transform[:3, :3].T + transform[:3, 3], square.faces)
        with Tracer(source, device=opened.info) as tracer:
            hits = tracer.closest_hit(origins, directions)
        beside.append(np.linalg.norm(hits.locations - (origins + hits.t[:, None] * directions), axis=1)[hits.is_hit])
    assert (np.concatenate(beside) < 1e-3).all()


def test_the_first_of_all_hits_is_the_closest_one_far_away(opened):
    scene = scale_scene(make_scene(7, ("line", "cube", "ball"), ("turn", "scale", "turn"), is_far=True), 1e30)
    with Tracer(scene.contents(), device=opened.info) as tracer:
        closest = tracer.closest_hit(scene.origins, scene.directions)
        first = tracer.all_hits(scene.origins, scene.directions, max_hits=1)
    np.testing.assert_array_equal(first.prim_id, closest.prim_id[closest.is_hit])


def test_workers_build_the_same_trees_and_so_the_same_hits(opened, pools):
    generator = np.random.default_rng(1)
    dust = clbvh.Spheres(generator.uniform(-2, 2, (30_000, 3)), generator.uniform(0.001, 0.01, 30_000))
    state = make_state(
        [clbvh.make_shape("knot", triangles=30_000), dust],
        (0, affine()), (1, affine((1, 2, 1), (3, 0, 0))), (0, affine((-1, 1, 1), (0, 6, 0))),
    )  # fmt: skip
    origins = generator.normal(size=(2000, 3)) * 20
    directions = generator.uniform(-3, 6, (2000, 3)) - origins
    options = clbvh.BuildOptions(task_threshold=5000)
    trees, answers = {}, {}
    for workers, pool in ((0, None), *list(pools.items())[:2]):
        trees[workers] = [build_tree(shape, "sah", pool, options) for shape in state.shapes]
        with StateTracer(state, opened.info, trees[workers]) as tracer:
            answers[workers] = as_bytes(tracer.all_hits(origins, directions))
    for workers in (1, 2):
        for built, alone in zip(trees[workers], trees[0], strict=True):
            assert built.nodes.tobytes() == alone.nodes.tobytes()
            assert built.prim_ids.tobytes() == alone.prim_ids.tobytes()
        assert answers[workers] == answers[0]
    assert len(answers[0]["prim_id"]) > 4 * 1000
