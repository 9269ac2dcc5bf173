"""A process that has used everything, and children that it forks: a script, since a test must not fork pytest.

It uses the device of the environment. Prints one JSON object: how each child ended, by name, and on the host under
"expected" what the parent got for the same work.
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

# Exit code of a child that got other hits than its parent.
DIFFERS = 78

# More hits than one thread refines.
MANY = 200_000

# Forks while other threads are in queries, and how long such a child may take.
BUSY_FORKS, BUSY_THREADS, BUSY_PATIENCE_S = 200, 4, 10.0


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
        self.many = np.random.default_rng(0).normal(size=(2, MANY, 3))
        self.hits = self.tracer.closest_hit(*self.many)
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

    def differs(self, count):
        """Return whether the first rays of many have other hits than before."""
        hits = self.tracer.closest_hit(*self.many[:, :count])
        return hits.t.tobytes() != self.hits.t[:count].tobytes() or (hits.prim_id != self.hits.prim_id[:count]).any()

    def cast_at_once(self):
        """Cast one ray and many, in this process and in a child at the same time; return the child's exit code."""
        child = os.fork()
        is_wrong = any(self.differs(count) for count in 3 * (1, MANY))
        if child == 0:
            os._exit(DIFFERS * is_wrong)
        return [bool(is_wrong), wait_for(child)]

    def build_fast(self):
        bvh = clbvh.build(clbvh.make_shape("knot", triangles=30_000), quality="fast")
        return [bvh.node_count, int(bvh.prim_ids.sum())]

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
        whole, child, whole_count = pieces.CHUNK_RAYS, [], self.query()
        pieces.CHUNK_RAYS = len(self.rays[0]) // 2

        def fork(done, of):
            if not child:
                child.append(os.fork())

        try:
            count = self.tracer.closest_hit(*self.rays, progress=fork).count
        except clbvh.errors.DeviceError:
            os._exit(REFUSED)
        if child[0] == 0:
            os._exit(DIFFERS * (count != whole_count))
        pieces.CHUNK_RAYS = whole
        return [count, wait_for(child[0])]

    def fork_in_a_task(self):
        """Fork while helpers are at tasks; return the results in the parent, and the child's exit code."""
        child, helped = [], []

        def fork_or_wait(number):
            is_own = threading.current_thread() is threading.main_thread()
            helped.extend([] if is_own else [number])
            while not (helped if is_own else child):
                time.sleep(0.01)
            if not child:
                child.append(os.fork())
            return number

        try:
            results = self.threads.run(fork_or_wait, [(1,), (2,), (3,)])
        except clbvh.errors.PoolError:
            os._exit(REFUSED)
        if child[0] == 0:
            os._exit(0)
        return [results, wait_for(child[0])]


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


def wait_for(child, patience_s=PATIENCE_S):
    """Return the exit code of a child, after killing it if it takes too long."""
    deadline = time.monotonic() + patience_s
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > deadline:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.01)


def describe_choice(spec):
    """Return what a child gets that asks for a device."""
    os.environ.pop("CLBVH_DEVICE", None)
    try:
        return clbvh.choose_device(spec).platform
    except clbvh.errors.DeviceError as error:
        return str(error)


def fork_busy(parent):
    """Fork while other threads are in queries, and return the exit codes of the children."""
    codes, counts = set(), (1, *[1000] * 8, MANY)
    for number in range(BUSY_FORKS):
        child = os.fork()
        if child == 0:
            os._exit(DIFFERS * parent.differs(counts[number % len(counts)]))
        codes.add(wait_for(child, BUSY_PATIENCE_S))
    return sorted(codes)


def query_pool(parent):
    """Return whether workers that were forked by a pool find other hits."""
    global shared
    shared = parent
    with multiprocessing.get_context("fork").Pool(2) as pool:
        return [bool(each) for each in pool.map(differs_in_worker, (1, 10, 1000, MANY))]


def differs_in_worker(count):
    return shared.differs(count)


def main():
    """Run each child."""
    parent = Parent()
    children = {"before the first use": run_child(parent.open_and_query)}
    parent.use()
    parent.closed.close()
    is_host = parent.tracer.device.platform == "host"
    works = {
        "query": parent.query,
        "query of few rays": lambda: parent.tracer.any_hit(*parent.rays[:, :10]).tolist(),
        "query of a closed tracer": lambda: parent.closed.any_hit(*parent.rays).sum(),
        "points": lambda: int(parent.tracer.contains(parent.rays[0]).sum()),
        "update": lambda: parent.tracer.update(parent.mesh.vertices),
        "set_transforms": parent.move,
        "set_vertices": parent.deform,
        "own tracer": parent.open_and_query,
        "times": lambda: parent.tracer.timings_ms,
        "devices": lambda: [device.platform for device in clbvh.list_devices()],
        "choices": lambda: [describe_choice(spec) for spec in (None, "host", "CPU", 0, "pocl", "gpu")],
        "fast build": parent.build_fast,
        "render": lambda: clbvh.render(parent.scene, width=8, height=8).hits.count,
        "renderer": lambda: parent.renderer.render().hits.count,
        "picture of before": lambda: [parent.picture.hits.count, len(parent.picture._repr_png_()) > 0],
        "trimesh": lambda: parent.box.intersects_any([[0, 0, 5]], [[0, 0, -1]]).tolist(),
        "pool": lambda: clbvh.build(parent.mesh, pool=parent.pool, task_threshold=100).node_count,
        "close": parent.close,
        "forget": parent.forget,
        "host": parent.work_on_the_host,
    }
    if not is_host:
        vertices = parent.tracer._caster.session.make_array(parent.mesh.vertices.shape, float, parent.mesh.vertices)
        works["array"] = lambda: clbvh.Mesh.from_arrays(vertices, parent.mesh.faces).face_count
        works["array of rays"] = lambda: parent.tracer.closest_hit(vertices, [0, 0, 1]).count
    for name, work in works.items():
        children[name] = run_child(work)
    if is_host:
        same = set(works) - {"query of a closed tracer", "devices", "choices", "pool", "close", "forget", "times"}
        children["expected"] = {name: json.dumps(works[name]()) for name in sorted(same)}
        children["at once"] = parent.cast_at_once()
        children["multiprocessing pool"] = query_pool(parent)
        children["in a task"] = parent.fork_in_a_task()
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

    threads = [threading.Thread(target=trace) for _ in range(BUSY_THREADS)]
    for thread in threads:
        thread.start()
    children["busy"] = sorted({run_child(parent.query) for _ in range(8)})
    children["busy, close"] = sorted({run_child(parent.close) for _ in range(8)})
    if is_host:
        children["busy forks"] = fork_busy(parent)
    is_over.set()
    for thread in threads:
        thread.join()

    children["parent of a scene"] = [parent.move(), parent.move()]
    children["parent"] = [parent.query(), clbvh.build(parent.mesh, pool=parent.pool, task_threshold=100).node_count]
    parent.close()
    print(json.dumps(children))


if __name__ == "__main__":
    main()
