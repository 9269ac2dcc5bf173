"""Distance and collision of parts: ``python bench/clearance.py``, or ``... fcl`` for python-fcl on the same poses.

Two knots of 100,000 triangles in 21 poses, and 7 links among 30 knots of 20,000 in 40: medians of processor time, and
the sum of all distances, which is the same for both engines.
"""

import sys
import time
from statistics import median

import numpy as np

import clbvh

FAR = (0.3, 0.7, 0.9, 1.0, 1.1, 1.5, 3.0)  # of two knots, in sizes of one
JOINTS = "zyyzyyz"
START, WAY = np.array([0, 20, 40, 10, 30, 20, 0]), np.array([120, 30, 20, 60, 10, 10, 60])  # degrees


class Clbvh:
    """Pairs of one part of `ones` and one of `others`."""

    def __init__(self, ones, others):
        scene = clbvh.Scene()
        self.ones, self.others = (
            [scene.place(scene.add(mesh), pose) for mesh, pose in each] for each in (ones, others)
        )
        self.tracer = clbvh.Tracer(scene)
        self.is_colliding()

    def move(self, poses):
        self.tracer.set_transforms(self.ones, poses)

    def distance(self):
        return self.tracer.closest_pair(self.ones, self.others).distance

    def is_colliding(self):
        return self.tracer.is_colliding(self.ones, self.others)


class Fcl:
    """The same by the managers of fcl."""

    def __init__(self, ones, others):
        import fcl

        self.fcl = fcl
        parts = [[self.load(*part) for part in each] for each in (ones, others)]
        self.ones, self.managers = parts[0], [fcl.DynamicAABBTreeCollisionManager() for _ in range(2)]
        for manager, objects in zip(self.managers, parts, strict=True):
            manager.registerObjects(objects)
            manager.setup()

    def load(self, mesh, pose):
        model = self.fcl.BVHModel()
        model.beginModel(len(mesh.vertices), len(mesh.faces))
        model.addSubModel(mesh.vertices, mesh.faces)
        model.endModel()
        return self.fcl.CollisionObject(model, self.fcl.Transform(pose[:3, :3], pose[:3, 3]))

    def move(self, poses):
        for each, pose in zip(self.ones, poses, strict=True):
            each.setTransform(self.fcl.Transform(pose[:3, :3], pose[:3, 3]))
        self.managers[0].update()

    def distance(self):
        data = self.fcl.DistanceData(request=self.fcl.DistanceRequest(enable_nearest_points=True))
        self.managers[0].distance(self.managers[1], data, self.fcl.defaultDistanceCallback)
        return max(data.result.min_distance, 0.0)

    def is_colliding(self):
        data = self.fcl.CollisionData()
        self.managers[0].collide(self.managers[1], data, self.fcl.defaultCollisionCallback)
        return data.result.is_collision


def pose(**values):
    return clbvh.Transform(**values).matrix


def list_arm_poses(degrees):
    poses, joint = [], np.eye(4)
    for axis, angle in zip(JOINTS, degrees, strict=True):
        poses.append(joint @ pose(rotate=tuple(angle * (axis == each) for each in "xyz")))
        joint = poses[-1] @ pose(translate=(0, 0, 0.22))
    return poses


def measure(name, engine, moves):
    """Print the medians of the first calls in all poses."""
    spent, distances = {"distance": [], "is_colliding": []}, []
    for poses in moves:
        engine.move(poses)
        for call, times in spent.items():
            begin = time.process_time()
            answer = getattr(engine, call)()
            times.append(1e3 * (time.process_time() - begin))
            distances += [answer] if call == "distance" else []
    shown = ", ".join(f"{call} {median(times):.3g} ms" for call, times in spent.items())
    print(f"{name}: {shown}; sum of distances {sum(distances):.9g}")


def main():
    make, random = Fcl if "fcl" in sys.argv[1:] else Clbvh, np.random.default_rng(0)
    knot, small = (clbvh.make_shape("knot", triangles=count) for count in (100_000, 20_000))
    size = np.ptp(knot.vertices, axis=0).max()
    turns = random.uniform(0, 360, (3, 3))
    moves = [[pose(rotate=turn, translate=(far * size, 0.1 * size, 0.05 * size))] for far in FAR for turn in turns]
    engine = make([(knot, np.eye(4))], [(knot, np.eye(4))])
    engine.distance()  # compiles
    measure("two knots", engine, moves)
    link = clbvh.Transform(scale=(0.05, 0.05, 0.15), translate=(0, 0, 0.11))
    link, small = link.apply(clbvh.make_shape("icosphere", triangles=2000)), clbvh.Transform(scale=0.04).apply(small)
    places = zip(random.uniform(0, 360, (30, 3)), random.normal(size=(30, 3)) * 0.8 + [0, 0, 0.5], strict=True)
    others = [(small, pose(rotate=turn, translate=place)) for turn, place in places]
    arm = make([(link, np.eye(4))] * len(JOINTS), others)
    measure("arm", arm, [list_arm_poses(START + share * WAY) for share in np.linspace(0, 1, 40)])


if __name__ == "__main__":
    main()
