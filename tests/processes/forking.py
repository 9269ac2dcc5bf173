"""A process that has used everything, and children that it forks: a script, since a test must not fork pytest.

Prints one JSON object: how each child ended, by name.
"""

import gc
import json
import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback

import numpy as np
import trimesh

import clbvh
from clbvh.integrations.trimesh import RayMeshIntersector
from clbvh.support.host_threads import HostThreads
from clbvh.trace.rays import pieces

# A child that takes longer hangs; compiling for the first time is slow.
PATIENCE_S = 100.0

# Exit code of a child whose query was refused.
REFUSED = 77

# More hits than one thread refines.
MANY = 100_000


class Parent:
    """What a process has before it forks."""

    def __init__(self):
        self.mesh = clbvh.make_shape("knot", triangles=1800)
        self.bvh = clbvh.build(self.mesh)
        # More than the host casts itself.
        self.rays = np.random.default_rng(0).normal(size=(2, 70_000, 3))
        self.box = RayMeshIntersector(trimesh.creation.box())
        self.objects = clbvh.Scene()
        self.object = self.objects.add(self.mesh)
        self.places = np.stack([np.eye(4), clbvh.Transform(translate=(3, 0, 0)).matrix])
        self.objects.place_many(self.object, self.places)
        self.scene = clbvh.Scene(clbvh.make_shape("icosphere", triangles=80))

    def use(self):
        self.tracer = clbvh.Tracer(self.bvh)
        self.closed = clbvh.Tracer(self.bvh)
        self.moving = clbvh.Tracer(self.objects)
        self.move()
        self.deform()
        self.renderer = clbvh.Renderer(self.scene, width=8, height=8)
        self.picture = self.renderer.render()
        self.hits = self.tracer.closest_hit(*np.random.default_rng(0).normal(size=(2, MANY, 3)))
        self.hits.locations.sum()
        self.box.intersects_any([[0, 0, 5]], [[0, 0, -1]])
        self.threads = HostThreads(3)
        self.threads.run(abs, [(1,), (2,), (3,)])
        self.pool = clbvh.SubtreePool(2)
        self.pool.wait_ready()

    def forget(self):
        del self.tracer, self.closed, self.moving, self.renderer, self.picture, self.box, self.hits
        gc.collect()

    def close(self):
        with self.tracer, self.moving, self.renderer:
            self.box.close()
            self.pool.close()
            self.threads.close()

    def query(self):
        return self.tracer.closest_hit(*self.rays).count

    def move(self):
        self.moving.set_transforms(self.objects.instances, self.places)
        return self.moving.closest_hit(*self.rays).count

    def deform(self):
        self.moving.set_vertices(self.object, self.mesh.vertices)

    def open_and_query(self):
        with clbvh.Tracer(self.bvh) as tracer:
            return tracer.closest_hit(*self.rays).count

    def work_on_the_host(self):
        bvh = clbvh.build(clbvh.make_shape("knot", triangles=30_000), quality="high")
        locations = self.hits.locations
        tripled = self.threads.run(lambda number: 3 * number, [(1,), (2,), (3,)])
        return [bvh.mesh.face_count, bool(np.isfinite(locations).any()), tripled]

    def fork_in_a_query(self):
        """Fork between two pieces of a query and go on in both; return the counts in the parent and in the child."""
        whole, child = pieces.CHUNK_RAYS, []
        pieces.CHUNK_RAYS = len(self.rays[0]) // 2

        def fork(done, of):
            if not child:
                child.append(os.fork())

        try:
            count = self.tracer.closest_hit(*self.rays, progress=fork).count
        except clbvh.errors.DeviceError:
            os._exit(REFUSED)
        if child[0] == 0:
            os._exit(0)
        pieces.CHUNK_RAYS = whole
        return [count, wait_for(child[0])]


def run_child(work, *, leave=os._exit):
    """Fork, call `work` in the child, and return what came of it."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            outcome = json.dumps(work())
        except clbvh.errors.ClbvhError as error:
            outcome = f"{type(error).__name__}: {error}"
        except BaseException:
            outcome = traceback.format_exc()
        os.write(writer, outcome.encode())
        os.close(writer)
        leave(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as pipe:
        code = wait_for(child)
        outcome = pipe.read().decode()
    return outcome if code == 0 else f"exit code {code}, {outcome}"


def wait_for(child):
    """Return the exit code of a child, after killing it if it takes too long."""
    deadline = time.monotonic() + PATIENCE_S
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > deadline:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.01)


def main():
    """Run each child."""
    parent = Parent()
    children = {"before the first use": run_child(parent.open_and_query)}
    parent.use()
    parent.closed.close()
    works = {
        "query": parent.query,
        "query of few rays": lambda: parent.tracer.any_hit(*parent.rays[:, :10]).tolist(),
        "query of a closed tracer": lambda: parent.closed.any_hit(*parent.rays).sum(),
        "points": lambda: parent.tracer.contains(parent.rays[0]),
        "update": lambda: parent.tracer.update(parent.mesh.vertices),
        "set_transforms": parent.move,
        "set_vertices": parent.deform,
        "own tracer": parent.open_and_query,
        "times": lambda: parent.tracer.timings_ms,
        "devices": lambda: [str(device) for device in clbvh.list_devices()],
        "render": lambda: clbvh.render(parent.scene, width=8, height=8).hits.count,
        "renderer": lambda: parent.renderer.render().hits.count,
        "picture of before": lambda: [parent.picture.hits.count, len(parent.picture._repr_png_()) > 0],
        "trimesh": lambda: parent.box.intersects_any([[0, 0, 5]], [[0, 0, -1]]).tolist(),
        "pool": lambda: clbvh.build(parent.mesh, pool=parent.pool, task_threshold=100).node_count,
        "close": parent.close,
        "forget": parent.forget,
        "host": parent.work_on_the_host,
    }
    for name, work in works.items():
        children[name] = run_child(work)
    children["sys.exit"] = run_child(parent.query, leave=sys.exit)
    children["forget, then sys.exit"] = run_child(parent.forget, leave=sys.exit)
    children["in a query"] = parent.fork_in_a_query()
    # As PyTorch's DataLoader does it.
    process = multiprocessing.get_context("fork").Process(target=parent.forget)
    process.start()
    process.join(PATIENCE_S)
    children["multiprocessing"] = process.exitcode
    process.kill()

    # While other threads are in the middle of queries.
    is_over = threading.Event()

    def trace():
        while not is_over.is_set():
            parent.query()

    threads = [threading.Thread(target=trace) for _ in range(3)]
    for thread in threads:
        thread.start()
    children["busy"] = sorted({run_child(parent.query) for _ in range(8)})
    children["busy, close"] = sorted({run_child(parent.close) for _ in range(8)})
    is_over.set()
    for thread in threads:
        thread.join()

    children["parent of a scene"] = [parent.move(), parent.move()]
    children["parent"] = [parent.query(), clbvh.build(parent.mesh, pool=parent.pool, task_threshold=100).node_count]
    parent.close()
    print(json.dumps(children))


if __name__ == "__main__":
    main()
