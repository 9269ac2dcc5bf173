"""A process with the engine for trimesh installed, and a child of it: a script, since a test must not fork pytest.

Prints what the child found, as JSON.
"""

from __future__ import annotations

import json
import multiprocessing
import pickle
import sys
from typing import Any

import trimesh

from clbvh import DeviceError
from clbvh.integrations.trimesh import RayMeshIntersector, install

PATIENCE_S = 200.0


def ask(mesh: trimesh.Trimesh) -> list[Any]:
    """Which engine a mesh has, whose it is, and whether it finds the middle inside; or the error."""
    engine = mesh.ray
    home = type(engine).__module__.partition(".")[0]
    if home != "clbvh":
        return [type(engine).__name__, home]
    try:
        return [type(engine).__name__, home, bool(mesh.contains([[0, 0, 0]])[0])]
    except DeviceError as error:
        return ["DeviceError", str(error)]


def ask_new(pickled: bytes, by_hand: bytes, queue: Any) -> None:
    """In a process that has imported everything anew."""
    answers = {"as loaded": ask(pickle.loads(pickled)), "by hand": ask(pickle.loads(by_hand))}
    install()
    answers["installed"] = ask(pickle.loads(pickled))
    queue.put(answers)


def ask_forked(mesh: trimesh.Trimesh, queue: Any) -> None:
    queue.put(ask(mesh))


def main() -> None:
    name = sys.argv[1]
    install()
    mesh = trimesh.creation.box()
    if name != "fork before":
        assert ask(mesh)[2]
    context = multiprocessing.get_context(name.split()[0])
    queue = context.Queue()
    if name.startswith("fork "):
        child = context.Process(target=ask_forked, args=(mesh, queue))
    else:
        by_hand = mesh.copy()
        by_hand.ray = RayMeshIntersector(by_hand)
        child = context.Process(target=ask_new, args=(pickle.dumps(mesh), pickle.dumps(by_hand), queue))
    child.start()
    answers = queue.get(timeout=PATIENCE_S)
    child.join(PATIENCE_S)
    # The parent goes on as before.
    assert child.exitcode == 0
    assert ask(mesh)[2]
    print(json.dumps(answers))


if __name__ == "__main__":
    main()
