"""Managers of collisions: ``python bench/collisions.py``, ``... fcl`` for trimesh's by python-fcl, ``... both``.

Wall time, medians: 1,000 balls of 1,280 triangles in a room, and 30 identical rings of 40,000; depths of two balls of
10,242 vertices. ``both`` compares the answers of the two on 400 pairs of solids and rings at random poses.
"""

import sys
import time
from statistics import median

import numpy as np
import trimesh

from clbvh.integrations.trimesh import CollisionManager

ENGINES = {"clbvh": CollisionManager, "fcl": trimesh.collision.CollisionManager}
move = trimesh.transformations.translation_matrix


def clock(name, task, count=20):
    """Print the median wall time of a task."""
    times = []
    for _ in range(count):
        begin = time.perf_counter()
        task()
        times.append(time.perf_counter() - begin)
    print(f"{name:45} {median(times) * 1e3:10.2f} ms")


def measure(engine):
    """Print the times of one engine."""
    random = np.random.default_rng(0)
    balls = [trimesh.creation.icosphere(3, radius=random.random()) for _ in range(1000)]
    manager = engine()

    def add(meshes, places):
        for number, (mesh, place) in enumerate(zip(meshes, places, strict=True)):
            manager.add_object(number, mesh, move(place))

    def go():
        manager.set_transform(5, move(random.uniform(0, 100, 3)))
        manager.in_collision_internal(return_names=True)

    def ask():
        ball = trimesh.creation.icosphere(2, radius=random.random())
        manager.in_collision_single(ball, move(random.uniform(0, 100, 3)), return_names=True)

    clock("add 1,000 balls", lambda: add(balls, random.uniform(0, 100, (1000, 3))), 1)
    clock("a ball moves, in_collision_internal", go)
    clock("in_collision_single, a new ball", ask)
    clock("min_distance_internal of the balls", manager.min_distance_internal)
    ring = trimesh.creation.torus(1.0, 0.3, major_sections=200, minor_sections=100)
    manager = engine()
    clock("add 30 rings", lambda: add([ring] * 30, random.uniform(0, 8, (30, 3))), 1)
    clock("in_collision_internal of the rings", lambda: manager.in_collision_internal(return_names=True))
    manager = engine()
    add([ring] * 4, [(3 * step, 0.6 * step, 0) for step in range(4)])
    clock("min_distance_internal of four rings apart", manager.min_distance_internal)
    manager, ball = engine(), trimesh.creation.icosphere(5)
    manager.add_object("ball", ball)
    clock("min_distance_single of a ball in a ball", lambda: manager.min_distance_single(ball, move((0.3, 0.2, 0.1))))
    if engine is CollisionManager:
        clock("the same, concentric", lambda: manager.min_distance_single(ball), 1)


def compare():
    """Print how often the answers of both engines differ, and by how much."""
    random = np.random.default_rng(1)
    make = trimesh.creation
    forms = [make.box(), make.icosphere(1), make.cone(0.5, 1), make.cylinder(0.4, 2), make.torus(1, 0.3)]
    different, differences = 0, []
    for _ in range(400):
        pair = [forms[number] for number in random.integers(0, len(forms), 2)]
        poses = [trimesh.transformations.random_rotation_matrix(random.random(3)) for _ in pair]
        for pose in poses:
            pose[:3, 3] = random.uniform(-1, 1, 3)
        collides, distances = [], []
        for engine in ENGINES.values():
            manager = engine()
            manager.add_object("one", pair[0], poses[0])
            collides.append(manager.in_collision_single(pair[1], poses[1]))
            distances.append(manager.min_distance_single(pair[1], poses[1]))
        different += collides[0] != collides[1]
        # fcl's depths of surfaces are those of one pair of triangles.
        if not collides[0] or all(mesh.is_convex for mesh in pair):
            differences.append(abs(distances[0] - distances[1]))
    print(
        f"400 pairs: {different} collide for one of them; {len(differences)} distances differ by {max(differences):.1e}"
    )


if __name__ == "__main__":
    chosen = sys.argv[1] if len(sys.argv) > 1 else "clbvh"
    compare() if chosen == "both" else measure(ENGINES[chosen])
