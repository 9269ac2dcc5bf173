"""The tracers of all meshes: one per mesh and options, shared by its engines, and the bound of what they hold.

The device's memory belongs to the mesh: it goes back when the mesh is collected. A mesh of trimesh and its engines
refer to each other, so that is when Python's garbage collector runs, which counts objects and not their bytes: hence
the bound.
"""

from __future__ import annotations

import gc
import threading
from typing import Any, ClassVar, TypeAlias
from weakref import WeakSet, WeakValueDictionary, ref

from ...geometry.as_mesh import MeshLike, as_mesh
from .following_tracer import EngineOptions
from .mesh_tracer import MeshTracer
from .scene_tracer import SceneTracer

AnyTracer: TypeAlias = MeshTracer | SceneTracer

# After this many trees have gone to a device, meshes that nobody uses are collected: a collection takes about 50 ms
# with trimesh and what it imports loaded, so it adds less than 1 ms to each tree.
_TREES_PER_COLLECTION = 64

# Trees take this share of a device's memory at most, as far as those in use allow; then the ones that have not been
# used for longest leave it, until half of that is free.
_MEMORY_SHARE = 0.25


class _Tracers:
    """Of this process. A callback of the garbage collector takes no lock: it may run while its thread holds one."""

    lock = threading.RLock()
    shared: ClassVar[WeakValueDictionary[tuple[int, EngineOptions], MeshTracer]] = WeakValueDictionary()
    # Those that live as long as a mesh, by its identity. A reference that dies is removed before the identity is free.
    kept: ClassVar[dict[int, tuple[ref[Any], set[MeshTracer]]]] = {}
    open: ClassVar[WeakSet[AnyTracer]] = WeakSet()
    opened_count = 0


def read_mesh(thing: Any) -> Any:
    """Return a `trimesh.Trimesh` as it is, and make a new one with the same faces of any other `MeshLike`.

    Raises
    ------
    MeshError
        The argument is not a mesh.
    """
    import trimesh

    if isinstance(thing, trimesh.Trimesh):
        return thing
    as_given: MeshLike = thing
    mesh = as_mesh(as_given)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def find_tracer(mesh: Any, options: EngineOptions, *, keep: bool) -> MeshTracer:
    """Return the tracer of a mesh with these options, which all engines share.

    Parameters
    ----------
    mesh : trimesh.Trimesh
    options : EngineOptions
    keep : bool
        Whether it lives as long as the mesh, and not only as long as somebody refers to it.
    """
    with _Tracers.lock:
        key = (id(mesh), options)
        tracer = _Tracers.shared.get(key)
        if tracer is None:
            tracer = _Tracers.shared[key] = MeshTracer(options, make_room)
        if keep:
            entry = _Tracers.kept.get(id(mesh))
            if entry is None:
                entry = _Tracers.kept[id(mesh)] = (ref(mesh, _Forget(id(mesh))), set())
            entry[1].add(tracer)
        return tracer


def forget_kept() -> None:
    """Drop the references to tracers that live as long as their meshes; tracers that are still in use stay."""
    _Tracers.kept.clear()


def open_tracers() -> list[AnyTracer]:
    """Return the tracers that hold memory of a device."""
    with _Tracers.lock:
        return [tracer for tracer in _Tracers.open if tracer.open_tracer is not None]


class _Forget:
    """Called when a mesh is collected."""

    def __init__(self, mesh_id: int) -> None:
        self._mesh_id = mesh_id

    def __call__(self, mesh: ref[Any]) -> None:
        _Tracers.kept.pop(self._mesh_id, None)


def make_room(newest: AnyTracer) -> None:
    """Collect unused meshes from time to time, and remove trees from a device that has too many."""
    tracer = newest.open_tracer
    if tracer is None:
        return
    device, limit = tracer.device, tracer.device.memory_bytes * _MEMORY_SHARE
    with _Tracers.lock:
        _Tracers.open.add(newest)
        _Tracers.opened_count += 1
        is_time = _Tracers.opened_count >= _TREES_PER_COLLECTION
        others = _others_on(device, newest)
        is_full = tracer.memory_bytes + sum(others.values()) > limit
        if is_time or is_full:
            _Tracers.opened_count = 0
    del others
    if not (is_time or is_full):
        return
    gc.collect()
    others = _others_on(device, newest)
    held = tracer.memory_bytes + sum(others.values())
    if held <= limit:
        return
    for other, size in sorted(others.items(), key=lambda item: item[0].last_use):
        if other.give_way():
            held -= size
        if held <= limit / 2:
            return


def _others_on(device: Any, newest: AnyTracer) -> dict[AnyTracer, int]:
    """Return the bytes that each other tracer holds on a device."""
    pairs = [(other, other.open_tracer) for other in open_tracers() if other is not newest]
    return {other: held.memory_bytes for other, held in pairs if held is not None and held.device == device}
