"""Scenes that move: after any moves the hits are those of a new tracer over the moved scene, bit for bit."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, strategies as st

from clbvh import Mesh, Tracer
from clbvh.tree_layouts import TREE_LAYOUTS

from ..profiles import examples, seeds
from ..unit.trace.scene_states import affine, scene_of
from .random_scenes import GRID, KINDS, LINEAR, MASKS, RAY_MASKS, RAYS, make_rays, make_scene, random_scenes

FIELDS = ("t", "u", "v", "prim_id", "instance_id", "geometry_id", "is_front", "locations")
NEAR = ("distance", "point", "prim_id", "instance_id", "geometry_id")

MOVES = (
    "some transforms", "all transforms", "the same transforms", "masks", "bend", "shake", "shift", "the same vertices"
)  # fmt: skip


def draw_transforms(count, generator):
    """Transforms of every kind; a geometry of the scene's size, whatever its unit, is moved within the grid's."""
    kinds = generator.choice(list(LINEAR), count)
    return np.array(
        [affine(LINEAR[kind](generator), generator.integers(-2 * GRID, 2 * GRID, 3, endpoint=True)) for kind in kinds]
    ).reshape(-1, 4, 4)


def move_points(points, kind, generator):
    """Points that were moved: `bend` keeps most of a tree's quality, `shake` does not."""
    if kind == "bend":
        return points + 0.25 * np.sin(points[:, [1, 2, 0]])
    if kind == "shake":
        return points + generator.integers(-GRID, GRID, points.shape, endpoint=True)
    return points + generator.integers(-GRID, GRID, 3) if kind == "shift" else points.copy()


def apply(move, tracer, contents, state, generator):
    """Make a move in the tracer; return the state of the scene after it."""
    if "transforms" in move:
        count = len(state.transforms)
        chosen = np.arange(count) if move != "some transforms" else generator.permutation(count)[: 1 + count // 2]
        transforms = (
            state.transforms[chosen] if move == "the same transforms" else draw_transforms(len(chosen), generator)
        )
        tracer.set_transforms(chosen, transforms)
        return state.with_transforms(chosen, transforms)
    if move == "masks":
        masks = generator.choice(MASKS, len(state.masks))
        tracer.set_masks(np.arange(len(masks)), masks)
        return replace(state, masks=masks.astype(np.uint32))
    geometry = int(generator.integers(0, len(state.shapes)))
    shape = state.shapes[geometry]
    if isinstance(shape, Mesh):
        moved = shape.with_vertices(move_points(shape.vertices, move, generator))
        tracer.set_vertices(contents.geometries[geometry], moved.vertices)
    else:
        moved = shape.with_spheres(move_points(shape.centres, move, generator), shape.radii)
        tracer.set_vertices(contents.geometries[geometry], moved.centres)
    return state.with_shape(geometry, moved)


def ask(tracer, rays, masks):
    """All answers, as bytes by name."""
    closest, crossings = tracer.closest_hit(*rays, mask=masks), tracer.all_hits(*rays)
    answers = {"any": tracer.any_hit(*rays, mask=masks), "count": tracer.count_hits(*rays)}
    for answer, fields in ((closest, FIELDS), (crossings, (*FIELDS, "offsets")), (tracer.closest_point(rays[0]), NEAR)):
        answers |= {f"{type(answer).__name__} {name}": np.asarray(getattr(answer, name)) for name in fields}
    return {name: answer.tobytes() for name, answer in answers.items()}


def check(scene, moves, opened, layout):
    """Move a scene, and compare it with a new tracer after each move; return the number of hits, and of changes."""
    generator, contents, state = scene.generator, scene.contents(), scene.state
    masks = generator.choice(RAY_MASKS, 2 * RAYS).astype(np.uint32)
    hits, known = [], (scene.origins, scene.directions)
    with Tracer(contents, device=opened.info, layout=layout) as tracer:
        hits.append(tracer.closest_hit(*known))
        for move in moves:
            state = apply(move, tracer, contents, state, generator)
            # Rays to where the scene was, and to where it is.
            rays = [np.concatenate(pair) for pair in zip(known, make_rays(state, generator), strict=True)]
            found = ask(tracer, rays, masks)
            with Tracer(scene_of(state), device=opened.info, layout=layout) as other:
                expected = ask(other, rays, masks)
            assert [name for name in found if found[name] != expected[name]] == [], move
            hits.append(tracer.closest_hit(*known))
    changes = sum(one.t.tobytes() != other.t.tobytes() for one, other in pairwise(hits))
    return sum(one.count for one in hits), changes


@pytest.mark.on_both
@examples(short=20, long=500)
@given(
    scene=random_scenes(is_in_one_unit=True),
    moves=st.lists(st.sampled_from(MOVES), min_size=1, max_size=4),
    layout=st.sampled_from(tuple(TREE_LAYOUTS)),
)
def test_a_moved_tracer_finds_what_a_new_one_finds(opened, scene, moves, layout):
    check(scene, moves, opened, layout)


def test_moves_change_hits_also_of_one_mesh_in_its_place(opened):
    """So that the test above can fail; one mesh begins without instances."""
    hits, changes = check(make_scene(0, tuple(KINDS), tuple(LINEAR)), MOVES, opened, "bvh2")
    assert hits > 100
    assert changes >= 2
    for seed in seeds(2):
        scene = make_scene(seed, ("ball",), ())
        assert scene.state.lone_shape is not None
        assert check(scene, ("bend", "shake", "all transforms", "bend", "shift"), opened, "auto")[1] >= 3
