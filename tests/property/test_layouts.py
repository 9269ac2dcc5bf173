"""Every layout and every builder finds the same hits as no tree at all, to the last bit, on the hardest meshes.

See `tests/grazing.py` for the meshes and rays. The hits are the device's own: refined ones could hide a difference.
"""

import numpy as np
import pytest
from hypothesis import Phase, given, strategies as st

from clbvh import Mesh, build
from clbvh.rendering.frame import render_frame
from clbvh.rendering.painters import OneRayPainter
from clbvh.rendering.progress import Progress
from clbvh.structs import NO_PRIM, VIEW
from clbvh.trace.launch import Caster
from clbvh.tree_layouts import TREE_LAYOUTS

from ..grazing import MESHES, RAYS, make_mesh, make_rays
from ..kernel.casting import open_caster
from ..profiles import examples
from ..worlds import mesh_on_device

RAYS_PER_KIND = 500
WIDTH, HEIGHT = 72, 40

# Seeds have no simpler ones, so a failing example is not shrunk.
PHASES = (Phase.explicit, Phase.generate)

BUILDS = {
    "default": {},
    "single triangles": {"leaf_size": 1},
    "fast": {"quality": "fast"},
    "high": {"quality": "high"},
    "median": {"builder": "median", "leaf_size": 2},
    "bin": {"builder": "bin"},
    "frontier": {"builder": "frontier"},
}


def make_limits(hits, generator):
    """Limits of which many are the t of a hit, exactly: of the same ray, or of another one."""
    t = np.where(hits["prim_id"] == NO_PRIM, 1, hits["t"])
    t_min = np.where(generator.random(len(t)) < 0.4, t, 0)
    t_max = np.where(generator.random(len(t)) < 0.4, t, np.inf)
    other = generator.random(len(t)) < 0.2
    t_max[other] = generator.permutation(t)[other]
    return t_min, t_max


def ask(cast, rays, limits):
    """What all queries find, by name."""
    found = {"closest_hit, limits": cast("closest_hit", *rays, *limits)}
    for name, bounds in (("", ()), (", limits", limits)):
        found["any_hit" + name] = cast("any_hit", *rays, *bounds)
    # A limit that many of the rays reach.
    for name, most in (("", {}), (", few", {"max_hits": 3})):
        found["count_hits" + name] = cast("count_hits", *rays, *limits, **most)
        found["all_hits" + name], found["offsets" + name] = cast("all_hits", *rays, *limits, **most)
    return found


@pytest.mark.on_both
@examples(short=24, long=500, phases=PHASES)
@given(kind=st.sampled_from(sorted(MESHES)), tree=st.sampled_from(sorted(BUILDS)), seed=st.integers(0, 2**32 - 1))
def test_all_layouts_and_builders_answer_alike(opened, kind, tree, seed):
    mesh, generator = make_mesh(kind, np.random.default_rng(seed)), np.random.default_rng([seed, 1])
    parts = [make_rays(ray_kind, mesh, RAYS_PER_KIND, generator) for ray_kind in RAYS]
    rays = tuple(np.concatenate(part) for part in zip(*parts, strict=True))
    with open_caster(opened, mesh, None) as cast:
        closest = cast("closest_hit", *rays)
        limits = make_limits(closest, np.random.default_rng([seed, 2]))
        expected = ask(cast, rays, limits)
    # A crossing that counts is found in any way of asking.
    hits, counts = expected["closest_hit, limits"], expected["count_hits"]
    np.testing.assert_array_equal(hits["prim_id"] != NO_PRIM, counts > 0)
    np.testing.assert_array_equal(expected["any_hit, limits"], counts > 0)
    first = expected["all_hits"][expected["offsets"][:-1][counts > 0]]
    assert first.tobytes() == hits[counts > 0].tobytes()

    bvh = build(mesh, **BUILDS[tree])
    # Rays of like directions beside each other, so that tiles of them have narrow beams.
    order = np.lexsort((*rays[0].T.round(1), *rays[1].T.round(1)))
    for layout in TREE_LAYOUTS:
        with open_caster(opened, mesh, bvh, layout) as cast:
            assert cast("closest_hit", *rays).tobytes() == closest.tobytes(), layout
            found = ask(cast, rays, limits)
            assert [name for name in found if found[name].tobytes() != expected[name].tobytes()] == [], layout
        with open_caster(opened, mesh, bvh, layout, tile=(4, 1), with_entry_points=True) as cast:
            in_tiles = cast("closest_hit", *(part[order] for part in rays))
            assert in_tiles.tobytes() == closest[order].tobytes(), layout


def test_a_mesh_that_is_flat_along_an_axis_is_hit_in_every_layout(open_tracer):
    corners = np.random.default_rng(7).uniform(-1, 1, (200, 3, 3))
    for axis in range(3):
        flat = corners * (np.arange(3) != axis)
        mesh = Mesh.from_arrays(flat.reshape(-1, 3), np.arange(600).reshape(-1, 3))
        away = 5.0 * np.eye(3)[axis]
        for layout in TREE_LAYOUTS:
            hits = open_tracer(mesh, layout=layout).closest_hit(flat.mean(axis=1) + away, -away)
            assert hits.is_hit.all(), (axis, layout)


def grazing_view(mesh, generator):
    """A camera close above the plane of a triangle, looking along it with a narrow field of view."""
    origins, directions = make_rays(sorted(RAYS)[int(generator.integers(0, len(RAYS)))], mesh, 1, generator)
    forward = directions[0] / np.linalg.norm(directions[0])
    right = np.cross(forward, generator.normal(size=3))
    right /= np.linalg.norm(right)
    view = np.zeros(1, VIEW)
    view["eye"], view["forward"] = origins[0], forward
    half_height = 10.0 ** generator.uniform(-6, 0)
    view["right"], view["up"] = right * half_height * WIDTH / HEIGHT, np.cross(right, forward) * half_height
    view["width"], view["height"] = WIDTH, HEIGHT
    return view


@examples(short=8, long=200, phases=PHASES)
@given(kind=st.sampled_from(sorted(MESHES)), seed=st.integers(0, 2**32 - 1))
def test_pictures_have_the_same_hits(opened, kind, seed):
    generator = np.random.default_rng(seed)
    mesh = make_mesh(kind, generator)
    view = grazing_view(mesh, generator)
    found = []
    for bvh, layout in ((None, "auto"), *((build(mesh), layout) for layout in TREE_LAYOUTS)):
        with mesh_on_device(opened, mesh, bvh, layout) as world:
            hits = render_frame(Caster(opened, world), view, OneRayPainter(opened, world), Progress(1))[1]
        found.append(hits.tobytes())
        assert found[-1] == found[0], layout
