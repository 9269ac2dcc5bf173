"""The fuzz of geometry: random hard meshes, rays and points, in every layout, against no tree and against the oracle.

A mesh is a target as a file is: its few bytes are the seed that everything follows from.
"""

from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np

from clbvh import Mesh, Scene, build
from clbvh.device.open import open_device
from clbvh.device.session import DeviceSession
from clbvh.trace.check.intersections import Rays
from clbvh.trace.check.reference import Reference
from clbvh.trace.hits.all_hits import find_all_hits
from clbvh.trace.hits.closest import count_hits, find_any_hits, find_closest_hits
from clbvh.trace.launch import Caster
from clbvh.trace.points.batch import SeenPoints
from clbvh.trace.points.queries import find_closest
from clbvh.trace.rays.batch import read_rays
from clbvh.tree_layouts import TREE_LAYOUTS

from ..all_hits_reference import find_wrong_crossings
from ..grazing import MESHES, RAYS, make_mesh, make_rays
from ..kernel.casting import STACK_SIZE
from ..rays import hard_rays, random_rays
from ..soup import make_soup
from ..worlds import mesh_on_device
from .readers import Reader

_SEED_BYTES = 8
_SOUP = "soup"
_RAYS_PER_KIND, _POINTS = 40, 40

# Meshes are scaled by up to these powers of two, 1e-30 to 1e30, and moved by up to this many times their size.
_MOST_EXPONENT = 99
_MOST_OFFSET_EXPONENT = 22

_FEW_HITS = 3

_BUILDS: list[dict[str, Any]] = [
    {}, {"leaf_size": 1}, {"leaf_size": 255}, {"quality": "fast"}, {"quality": "high"}, {"builder": "median"},
    {"builder": "bin", "leaf_size": 2},
]  # fmt: skip


def _make_scene(generator):
    """Return a mesh and rays in its coordinates."""
    kind = str(generator.choice([_SOUP, _SOUP, *sorted(MESHES)]))
    if kind == _SOUP:
        count, seed = int(generator.integers(1, 60)), int(generator.integers(2**32))
        grid, size = int(generator.choice([3, 8, 1000])), int(generator.choice([2, 8]))
        copies, degenerate = generator.choice([0, 0.3], 2)
        mesh = make_soup(count, seed, grid=grid, size=size, copies=copies, degenerate=degenerate)
    else:
        mesh = make_mesh(kind, generator)
    kinds = [hard_rays(mesh, _RAYS_PER_KIND, generator)]
    if not mesh.degenerate_faces.all():
        kinds += [make_rays(name, mesh, _RAYS_PER_KIND, generator) for name in RAYS]
    origins, directions = (np.concatenate(parts).astype(np.float64) for parts in zip(*kinds, strict=True))
    directions[(directions == 0).all(axis=1)] = [0, 0, 1]
    return _move(mesh, origins, directions, generator)


def _move(mesh, origins, directions, generator):
    """Leave all as it is; or scale it by a power of two and move it by whole sizes; or do both by any numbers."""
    how = generator.integers(3)
    if how == 0:
        return mesh, (origins, directions)
    exponent = generator.integers(-_MOST_EXPONENT, _MOST_EXPONENT + 1)
    size = np.exp2(np.ceil(np.log2(np.abs(mesh.vertices).max() or 1.0)))
    offset = generator.integers(-1, 2, 3) * size * np.exp2(generator.integers(0, _MOST_OFFSET_EXPONENT))
    scale = np.exp2(exponent)
    if how == 2:
        scale, offset = scale * generator.uniform(1, 2), offset * generator.uniform(0.5, 1, 3)
    lengths = np.exp2(generator.integers(-_MOST_EXPONENT, _MOST_EXPONENT + 1, (len(origins), 1)))
    # Some rays come from far away.
    far = np.exp2(generator.integers(3, 40, (len(origins), 1))) * (generator.random((len(origins), 1)) < 0.3)
    origins = origins - far * size * directions / np.abs(directions).max(axis=1, keepdims=True)
    moved = Mesh.from_arrays((mesh.vertices + offset) * scale, mesh.faces)
    return moved, ((origins + offset) * scale, directions * lengths)


@contextmanager
def _open(session, bvh, layout):
    """Open a caster for a tree in a layout; without one, for its mesh without a tree."""
    with mesh_on_device(session, bvh.mesh, bvh if layout else None, layout or "auto") as world:
        # One stack size for all trees, so that they share their kernels.
        world.defines["STACK_SIZE"] = max(STACK_SIZE, world.defines["STACK_SIZE"])
        caster = Caster(session, world)
        try:
            yield caster
        finally:
            caster.release()


def _ask(caster, rays, points, limits):
    """Return the answers to all queries."""
    free = read_rays(*rays, 0.0, np.inf)
    limited = read_rays(*rays, *limits)
    return {
        "closest_hit": find_closest_hits(caster, free, None),
        "closest_hit, limits": find_closest_hits(caster, limited, None),
        "any_hit": find_any_hits(caster, limited, None),
        "count_hits": count_hits(caster, limited, None, None),
        "all_hits": find_all_hits(caster, free, None, None),
        "all_hits, few": find_all_hits(caster, limited, _FEW_HITS, None),
        "closest_point": find_closest(caster, SeenPoints.read(points)),
    }


def _bytes(answer):
    """Return an answer's arrays as bytes."""
    if isinstance(answer, np.ndarray):
        return [answer.tobytes()]
    fields = answer if isinstance(answer, tuple) else [value for key, value in vars(answer).items() if key != "mesh"]
    return [value.tobytes() for value in fields if isinstance(value, np.ndarray)]


def _are_exact(mesh, rays):
    """Say of each ray whether the device sees exactly what the oracle sees: nothing was rounded to float32."""
    if (mesh.to_local(mesh.vertices) != mesh.local_vertices).any():
        return np.zeros(len(rays[0]), np.bool_)
    local = mesh.to_local(rays[0])
    longest = np.abs(rays[1]).max(axis=1, keepdims=True)
    directions = np.ldexp(rays[1], -np.frexp(longest)[1])
    near = np.abs(local).max(axis=1) <= 8 * np.abs(mesh.local_vertices).max()
    with np.errstate(over="ignore", under="ignore"):
        same = (local.astype(np.float32) == local) & (directions.astype(np.float32) == directions)
    return near & same.all(axis=1)


def check_geometry(session: DeviceSession, seed: int) -> int:
    """Cast rays and points at the mesh of a seed; return how many rays the oracle judged."""
    generator = np.random.default_rng(seed)
    mesh, rays = _make_scene(generator)
    points = np.concatenate((rays[0][:_POINTS], random_rays(mesh, _POINTS, generator)[0]))
    options = _BUILDS[generator.integers(len(_BUILDS))]
    bvh = build(mesh, **options)

    with _open(session, bvh, None) as caster:
        free = read_rays(*rays, 0.0, np.inf)
        first = find_closest_hits(caster, free, None)
        # Many limits are exactly the t of a hit.
        t = np.where(first.is_hit, first.t, 1.0)
        limits = np.where(generator.random(len(t)) < 0.4, t, 0.0), np.where(generator.random(len(t)) < 0.4, t, np.inf)
        expected = _ask(caster, rays, points, limits)
    for layout in TREE_LAYOUTS:
        with _open(session, bvh, layout) as caster:
            found = _ask(caster, rays, points, limits)
        different = [name for name, answer in expected.items() if _bytes(found[name]) != _bytes(answer)]
        assert not different, f"{layout} with {options} differs from no tree in {different}"

    # The queries agree with each other.
    closest, limited, crossings = expected["closest_hit"], expected["closest_hit, limits"], expected["all_hits"]
    assert (limited.is_hit == (expected["count_hits"] > 0)).all()
    assert (limited.is_hit == expected["any_hit"]).all()
    assert (closest.is_hit == (crossings.counts > 0)).all()
    begins = crossings.offsets[:-1][closest.is_hit]
    assert (crossings.prim_id[begins] == closest.prim_id[closest.is_hit]).all()

    # And the oracle with them.
    judged, reference = np.flatnonzero(_are_exact(mesh, rays)), Reference(Scene(mesh).snapshot())
    differences = reference.find_differences(Rays.make(rays[0][judged], rays[1][judged]), closest.take(judged))
    assert not differences, str(differences[0])
    wrong = np.intersect1d(find_wrong_crossings(reference, Rays.make(*rays), crossings), judged)
    assert not len(wrong), f"the crossings of ray {wrong[0]} are not all that there are"
    return len(judged)


@cache
def _open_device():
    return open_device()


def _read(content, folder):
    check_geometry(_open_device(), int.from_bytes(content, "little"))
    return True


# The first ones compile what the others use, before their time counts.
_FIRST = [seed.to_bytes(_SEED_BYTES, "little") for seed in range(8)]
GEOMETRY = Reader(_FIRST, lambda generator: generator.randbytes(_SEED_BYTES), _read)
