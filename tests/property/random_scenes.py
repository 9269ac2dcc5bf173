"""Random scenes on a grid: a few shapes, instances of every kind, and rays that are hard for them."""

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from hypothesis import strategies as st

import clbvh
from clbvh import Mesh, SceneState, Spheres, make_shape

from ..unit.trace.scene_states import ALL, affine, make_state, scene_of, turn

GRID = 4
RAYS = 120

# Instances may be this far away, in units of the grid.
FAR = 1e7

MASKS = (ALL, ALL, ALL, 1, 2, 3, 0)
RAY_MASKS = (ALL, 1, 2, 4)


@dataclass(frozen=True)
class RandomScene:
    """A scene and rays for it, as the oracle and as the tracer take them; and the call that makes it again."""

    call: str
    state: SceneState
    origins: np.ndarray
    directions: np.ndarray
    generator: np.random.Generator

    def __repr__(self) -> str:
        return self.call

    # Hypothesis shows the call, not the arrays.
    def _repr_pretty_(self, printer, is_cycle) -> None:
        printer.text(self.call)

    def contents(self) -> clbvh.Scene:
        """The scene by its public interface."""
        return scene_of(self.state)


def _as_mesh(corners: np.ndarray) -> Mesh:
    return Mesh.from_arrays(corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3))


def _make_soup(generator) -> Mesh:
    corners = generator.integers(-GRID, GRID, (generator.integers(1, 12), 3, 3), endpoint=True).astype(np.float64)
    copied = generator.random(len(corners)) < 0.2
    corners[copied] = corners[0]
    flat = generator.random(len(corners)) < 0.2
    corners[flat, :, generator.integers(0, 3)] = generator.integers(-GRID, GRID)
    return _as_mesh(corners)


def _make_line(generator) -> Mesh:
    """Degenerate triangles only: no ray hits them."""
    return _as_mesh(np.array([[0, 0, 0], [1, 1, 0], [2, 2, 0]]) + generator.integers(-GRID, GRID, (3, 1, 3)))


def _make_cube(generator) -> Mesh:
    box = trimesh.creation.box(2 * generator.integers(1, GRID, 3))
    return Mesh.from_arrays(box.vertices + generator.integers(-GRID, GRID, 3), box.faces)


def _make_ball(generator) -> Mesh:
    ball = make_shape("icosphere", triangles=80)
    return Mesh.from_arrays(ball.vertices * GRID, ball.faces)


def _make_spheres(generator) -> Spheres:
    """Overlapping, nested, touching and equal ones."""
    count = generator.integers(1, 10)
    centres = generator.integers(-GRID, GRID, (count, 3), endpoint=True)
    radii = generator.integers(1, GRID, count, endpoint=True) / generator.choice([1, 4])
    copied = generator.random(count) < 0.2
    centres[copied], radii[copied] = centres[0], radii[0]
    return Spheres(centres, radii)


KINDS = {
    "soup": _make_soup,
    "line": _make_line,
    "cube": _make_cube,
    "ball": _make_ball,
    "spheres": _make_spheres,
    "more spheres": _make_spheres,
}


def _right_turn(generator):
    """An orthogonal matrix of the grid, half of them mirrors."""
    return np.eye(3)[generator.permutation(3)] * generator.choice([-1, 1], 3)


def _any_turn(generator):
    one, other, third = (turn(axis, generator.uniform(0, 2 * np.pi)) for axis in range(3))
    return one @ other @ third


def _shear(generator):
    return np.eye(3) + np.triu(generator.integers(-2, 2, (3, 3), endpoint=True), 1)


LINEAR = {
    "none": lambda generator: np.eye(3),
    "right turn": _right_turn,
    "turn": _any_turn,
    "scale": lambda generator: np.diag(generator.choice([0.25, 0.5, 2, 3, -1], 3)),
    "shear": lambda generator: _right_turn(generator) @ _shear(generator),
    "all": lambda generator: _any_turn(generator) @ np.diag(generator.choice([0.25, 0.5, 2, 3], 3)) @ _shear(generator),
}


def make_rays(state: SceneState, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Rays along axes and in all directions, to points of instances and past them, from near, far, and within."""
    chosen = generator.integers(0, len(state.transforms), RAYS)
    local = generator.integers(-2 * GRID, 2 * GRID, (RAYS, 3), endpoint=True) / 2
    for index, instance in enumerate(chosen):
        shape = state.shapes[state.geometry_ids[instance]]
        if generator.random() < 0.5:
            points = shape.vertices if isinstance(shape, Mesh) else shape.centres
            local[index] = points[generator.integers(0, len(points))]
    linear, offset = state.transforms[chosen, :3, :3], state.transforms[chosen, :3, 3]
    targets = np.einsum("nij,nj->ni", linear, local) + offset
    ways = generator.integers(-GRID, GRID, (RAYS, 3), endpoint=True).astype(np.float64)
    along_axis = generator.random(RAYS) < 0.4
    ways[along_axis] = np.eye(3)[generator.integers(0, 3, along_axis.sum())] * generator.choice([-1, 1])
    ways[(ways == 0).all(axis=1)] = [0, 0, 1]
    # In the instance's own directions, or in the world's.
    in_object = generator.random(RAYS) < 0.5
    ways[in_object] = np.einsum("nij,nj->ni", linear, ways)[in_object]
    steps = generator.choice([0, 1, 2, 10, 1000, FAR], RAYS, p=[0.15, 0.2, 0.2, 0.3, 0.1, 0.05])
    return targets - steps[:, None] * ways, ways * generator.choice([1.0, 0.125, 1e3], (RAYS, 1))


def scale_scene(scene: RandomScene, scale: float) -> RandomScene:
    """The scene in another unit: all instances and rays are larger by a factor."""
    transforms = scene.state.transforms.copy()
    transforms[:, :3] *= scale
    return replace(
        scene, call=f"scale_scene({scene.call}, {scale!r})",
        state=scene.state.with_transforms(np.arange(len(transforms)), transforms),
        origins=scene.origins * scale, directions=scene.directions * scale,
    )  # fmt: skip


def make_scene(seed: int, kinds: tuple[str, ...], linear: tuple[str, ...], *, is_far: bool = False) -> RandomScene:
    """A scene of the shapes of some kinds, placed by linear maps of some kinds, some of them twice.

    Without maps, it is the first shape alone in its own place.
    """
    generator = np.random.default_rng(seed)
    shapes = [KINDS[kind](generator) for kind in kinds]
    placed = []
    for kind in linear:
        far = FAR * (is_far and generator.random() < 0.5)
        matrix = LINEAR[kind](generator)
        # On the grid, often in the middle; so that instances overlap, lie within each other, and touch.
        offset = generator.integers(-3 * GRID, 3 * GRID, 3, endpoint=True) * (generator.random(3) < 0.6)
        offset = offset + far * generator.integers(-1, 1, 3, endpoint=True)
        row = int(generator.integers(0, len(shapes))), affine(matrix, offset)
        placed.append((*row, int(generator.choice(MASKS))))
        if generator.random() < 0.25:
            # Again in the same place, with another mask.
            placed.append((*row, int(generator.choice(MASKS))))
    state = make_state(shapes, *placed) if placed else make_state(shapes[:1], (0, affine()))
    call = f"make_scene({seed}, {kinds}, {linear}, is_far={is_far})"
    return RandomScene(call, state, *make_rays(state, generator), generator)


@st.composite
def random_scenes(draw, *, is_in_one_unit=False):
    """Any of these scenes; some are a lone shape, others are in any unit and far from zero."""
    seed, is_lone = draw(st.integers(0, 2**32 - 1)), draw(st.sampled_from([False, False, True]))
    shapes = tuple(draw(st.lists(st.sampled_from(tuple(KINDS)), min_size=1, max_size=3)))
    if is_lone:
        return make_scene(seed, shapes, ())
    linear = tuple(draw(st.lists(st.sampled_from(tuple(LINEAR)), min_size=1, max_size=6)))
    if is_in_one_unit:
        return make_scene(seed, shapes, linear)
    scene = make_scene(seed, shapes, linear, is_far=draw(st.booleans()))
    return scale_scene(scene, draw(st.sampled_from([1.0, 1.0, 2.0**-99, 2.0**99, 1e-30, 1e30])))
