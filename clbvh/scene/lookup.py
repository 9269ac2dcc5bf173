"""What a scene holds, and how users name it: by handles, by ids and by names.

Nothing here changes the scene.
"""

from __future__ import annotations

from collections.abc import Iterable
from numbers import Integral

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from .arguments import shorten
from .geometry import Geometry
from .instance import Instance
from .state import SceneState
from .store import SceneStore


class SceneLookup:
    """The geometries and the instances of a scene. `SceneContents` adds them."""

    _store: SceneStore

    @property
    def geometries(self) -> tuple[Geometry, ...]:
        """All geometries; the index is the id."""
        return self._store.handles()[0]

    @property
    def instances(self) -> tuple[Instance, ...]:
        """All instances; the index is the id."""
        return self._store.handles()[1]

    @property
    def is_empty(self) -> bool:
        """Whether nothing is placed, so that no ray hits anything."""
        return not self._store.has_instances

    def find(self, name: str) -> Instance:
        """Return the instance of a name.

        Raises
        ------
        SceneError
            No instance has the name.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene(clbvh.make_shape("icosphere", triangles=320))
        >>> scene.find("icosphere").id
        0
        """
        found = self._store.find_instance(name)
        if found is None:
            raise SceneError(_say_unknown("instance", name, [instance.name for instance in self.instances]))
        return found

    def find_geometry(self, name: str) -> Geometry:
        """Return the geometry of a name.

        Raises
        ------
        SceneError
            No geometry has the name.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene(clbvh.make_shape("icosphere", triangles=320))
        >>> scene.find_geometry("icosphere").id
        0
        """
        found = self._store.find_geometry(name)
        if found is None:
            raise SceneError(_say_unknown("geometry", name, [geometry.name for geometry in self.geometries]))
        return found

    def snapshot(self) -> SceneState:
        """Return what the scene holds now. It is immutable, and the same object until something is added.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene(clbvh.make_shape("icosphere", triangles=320))
        >>> scene.snapshot().geometry_ids
        array([0], dtype=int32)
        """
        return self._store.snapshot()

    def geometry_id(self, geometry: Geometry) -> int:
        """Return the id of a geometry; raise `SceneError` unless it is one of this scene.

        Examples
        --------
        >>> import clbvh
        >>> ball = clbvh.Scene().add(clbvh.make_shape("icosphere", triangles=320))
        >>> clbvh.Scene().geometry_id(ball)
        Traceback (most recent call last):
        clbvh.errors.SceneError: Geometry(0, 'icosphere', ...) belongs to another scene: add its shape to this one
        """
        if not isinstance(geometry, Geometry):
            raise SceneError(f"expected a geometry that Scene.add returned, not {shorten(geometry)}")
        if geometry.owner is not self._store:
            raise SceneError(f"{geometry!r} belongs to another scene: add its shape to this one")
        return geometry.id

    def instance_ids(self, instances: Instance | int | Iterable[Instance | int]) -> NDArray[np.int64]:
        """Return the ids of instances, (n,) int64.

        Parameters
        ----------
        instances : Instance or int, or a sequence of instances or ids
            The tuple `Scene.instances` itself takes no time, nor does an array of ids.

        Raises
        ------
        SceneError
            One is not an instance of this scene.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene(clbvh.make_shape("icosphere", triangles=320))
        >>> scene.instance_ids([scene.find("icosphere")])
        array([0])
        """
        mine = self.instances
        if instances is mine:
            return np.arange(len(mine))
        if isinstance(instances, Instance | int):
            instances = (instances,)
        if isinstance(instances, np.ndarray) and instances.dtype.kind in "iu" and instances.ndim == 1:
            ids = instances.astype(np.int64)
        else:
            try:
                given = list(instances)
            except TypeError:
                raise SceneError(f"expected instances that Scene.place returned, not {shorten(instances)}") from None
            ids = np.array([self._instance_id(instance) for instance in given], np.int64)
        wrong = (ids < 0) | (ids >= len(mine))
        if wrong.any():
            raise SceneError(f"there is no instance {ids[wrong][0]}: the scene has {len(mine):,} (from 0)")
        return ids

    def _instance_id(self, instance: Instance | int) -> int:
        if isinstance(instance, Integral) and not isinstance(instance, bool):
            number = int(instance)
            return number if abs(number) <= np.iinfo(np.int64).max else -1
        if not isinstance(instance, Instance):
            raise SceneError(f"expected an instance that Scene.place returned, not {shorten(instance)}")
        if instance.geometry.owner is not self._store:
            raise SceneError(f"{instance!r} belongs to another scene")
        return instance.id


def _say_unknown(kind: str, name: object, names: list[str]) -> str:
    known = ", ".join(map(shorten, names[:5])) + (", ..." if len(names) > 5 else "")
    return f"the scene has no {kind} {shorten(name)}; " + (f"it has {known}" if names else "it has none")
