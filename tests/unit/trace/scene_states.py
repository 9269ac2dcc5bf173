"""Scenes as a tracer sees them, for tests: shapes, and where they are placed."""

import numpy as np

from clbvh import Scene, SceneState

ALL = 0xFFFFFFFF


def make_state(shapes, *placed):
    """The state of a scene; each instance is (geometry, transform) or (geometry, transform, mask)."""
    rows = [(row[0], np.asarray(row[1], np.float64), row[2] if len(row) > 2 else ALL) for row in placed]
    return SceneState(
        tuple(shapes), tuple(f"geometry {index}" for index in range(len(shapes))),
        np.array([row[0] for row in rows], np.int32), np.array([row[1] for row in rows]).reshape(-1, 4, 4),
        np.array([row[2] for row in rows], np.uint32), tuple(f"instance {index}" for index in range(len(rows))),
        np.full((len(rows), 3), np.nan), (), np.full(len(rows), -1, np.int32),
    )  # fmt: skip


def scene_of(state):
    """The same scene by the public interface."""
    scene = Scene()
    geometries = [scene.add(shape) for shape in state.shapes]
    for geometry, transform, mask in zip(state.geometry_ids, state.transforms, state.masks, strict=True):
        scene.place(geometries[geometry], transform, mask=int(mask))
    return scene


def affine(linear=(1, 1, 1), offset=(0, 0, 0)):
    """A (4, 4) transform; `linear` is a (3, 3) matrix, or its diagonal."""
    matrix = np.eye(4)
    given = np.asarray(linear, np.float64)
    matrix[:3, :3] = np.diag(given) if given.ndim == 1 else given
    matrix[:3, 3] = offset
    return matrix


def turn(axis, angle):
    """The (3, 3) rotation about a coordinate axis."""
    cosine, sine = np.cos(angle), np.sin(angle)
    one, other = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[one, one] = matrix[other, other] = cosine
    matrix[one, other], matrix[other, one] = -sine, sine
    return matrix


def random_linear(generator, stretch=3.0):
    """Any (3, 3) matrix of full rank: rotation, scale, shear and half the time a mirror."""
    turns = [turn(axis, angle) for axis, angle in enumerate(generator.uniform(0, 2 * np.pi, 3))]
    scale = np.diag(stretch ** generator.uniform(-1, 1, 3) * generator.choice([-1.0, 1.0], 3))
    shear = np.eye(3) + np.triu(generator.uniform(-1, 1, (3, 3)), 1)
    return turns[0] @ turns[1] @ scale @ shear @ turns[2]
