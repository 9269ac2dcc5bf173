"""The store of a scene: its geometries and instances in the order of adding, behind one lock.

Owns ids, names and the growing arrays. Its callers have checked shapes and matrices. Several scenes share a store when
they differ only in the settings of their pictures.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry.appearance.material import Material
from ..geometry.spheres import Shape
from .handles import ALL_BITS, Colour, Geometry, Instance, colour_of_row, shorten
from .state import SceneState

# The top tree counts instances as a mesh counts faces.
MAX_INSTANCE_COUNT = 2**30

_FIRST_CAPACITY = 8


class FirstObject(Protocol):
    """An object that a scene has from its beginning, and that is loaded when it is needed."""

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(4, 4) float64: its transform."""

    def load(self) -> tuple[Shape, str]:
        """Return its shape and its name."""


class SceneStore:
    """Geometries and instances.

    Parameters
    ----------
    first : FirstObject, optional
        Geometry 0 and instance 0. Loaded by the first call that needs it, which raises what `load` raises.
    """

    def __init__(self, first: FirstObject | None = None) -> None:
        self.first = first
        self._is_pending = first is not None
        self._geometry_names = UniqueNames("a geometry")
        self._instance_names = UniqueNames("an instance")
        self._geometries: list[Geometry] = []
        self._instances: list[Instance] = []
        self._transforms = np.empty((_FIRST_CAPACITY, 4, 4))
        self._masks = np.empty(_FIRST_CAPACITY, np.uint32)
        self._colours = np.empty((_FIRST_CAPACITY, 3))
        self._geometry_ids = np.empty(_FIRST_CAPACITY, np.int32)
        self._material_ids = np.empty(_FIRST_CAPACITY, np.int32)
        # Equal materials are one.
        self._material_numbers: dict[Material, int] = {}
        self._start()

    def _start(self) -> None:
        # Re-entrant: several parts are added as one step.
        self.lock = threading.RLock()
        self._snapshot: SceneState | None = None
        self._tuples: tuple[tuple[Geometry, ...], tuple[Instance, ...]] | None = None

    @classmethod
    def from_state(cls, state: SceneState, first: FirstObject | None = None) -> SceneStore:
        """Return a store of the content of a state; `first` says what geometry 0 and instance 0 are made from."""
        store = cls()
        store.first = first
        for shape, name in zip(state.shapes, state.names, strict=True):
            store.add(shape, name, name)
        store._transforms = state.transforms.copy()
        store._masks, store._geometry_ids = state.masks.copy(), state.geometry_ids.copy()
        store._colours = state.colours.copy()
        store._material_ids = state.material_ids.copy()
        store._material_numbers = {material: number for number, material in enumerate(state.materials)}
        for number, name in enumerate(state.instance_names):
            geometry = store._geometries[state.geometry_ids[number]]
            mask, colour = int(state.masks[number]), colour_of_row(state.colours[number])
            material = state.material_of(number)
            unique = store._instance_names.add(name)
            store._instances.append(Instance(number, unique, geometry, mask, colour, material))
        store._snapshot = store._tuples = None
        return store

    @property
    def is_as_made(self) -> bool:
        """Whether the store holds its first object, if it has one, and nothing else."""
        with self.lock:
            count = int(self.first is not None and not self._is_pending)
            return len(self._geometries) == len(self._instances) == count

    @property
    def has_instances(self) -> bool:
        """Whether anything is placed; nothing is loaded for the answer."""
        return self._is_pending or bool(self._instances)

    def handles(self) -> tuple[tuple[Geometry, ...], tuple[Instance, ...]]:
        """Return the geometries and the instances; the same tuples until something is added."""
        with self.lock:
            self._load_first()
            if self._tuples is None:
                self._tuples = tuple(self._geometries), tuple(self._instances)
            return self._tuples

    def snapshot(self) -> SceneState:
        """Return the present state; the same one until something is added."""
        with self.lock:
            geometries, instances = self.handles()
            if self._snapshot is None:
                count = len(instances)
                # Rows are written once, before they are counted, so a state can share them.
                self._snapshot = SceneState(
                    shapes=tuple(geometry.shape for geometry in geometries),
                    names=tuple(geometry.name for geometry in geometries),
                    geometry_ids=self._geometry_ids[:count],
                    transforms=self._transforms[:count],
                    masks=self._masks[:count],
                    instance_names=tuple(instance.name for instance in instances),
                    colours=self._colours[:count],
                    materials=tuple(self._material_numbers),
                    material_ids=self._material_ids[:count],
                )
            return self._snapshot

    def transform(self, instance_id: int) -> NDArray[np.float64]:
        """Return a copy of the transform of an instance."""
        return self._transforms[instance_id].copy()

    def find_geometry(self, name: str) -> Geometry | None:
        """Return the geometry of a name."""
        with self.lock:
            self._load_first()
            index = self._geometry_names.find(name)
            return None if index is None else self._geometries[index]

    def find_instance(self, name: str) -> Instance | None:
        """Return the instance of a name."""
        with self.lock:
            self._load_first()
            index = self._instance_names.find(name)
            return None if index is None else self._instances[index]

    def add(self, shape: Shape, name: str | None, wish: str) -> Geometry:
        """Add a geometry; `wish` is its name if the user has chosen none, with a number where it is taken."""
        with self.lock:
            self._load_first()
            if name is not None:
                self._geometry_names.check(name)
            return self._add(shape, name, wish)

    def place(
        self,
        geometry: Geometry,
        transforms: NDArray[np.float64],
        names: Sequence[str] | None,
        wish: str,
        mask: int,
        colour: Colour | None = None,
        material: Material | None = None,
    ) -> tuple[Instance, ...]:
        """Place a geometry by each of (n, 4, 4) transforms."""
        with self.lock:
            self._load_first()
            if names is not None:
                for name in names:
                    self._instance_names.check(name)
                if len(set(names)) < len(names):
                    raise SceneError("two of the names are the same, but the names of instances are unique")
            return self._place(geometry, transforms, names, wish, mask, colour, material)

    def copy(self) -> SceneStore:
        """Return a store of the same content, with handles of its own."""
        with self.lock:
            copied = SceneStore(self.first)
            copied._is_pending = self._is_pending
            copied._geometry_names, copied._instance_names = self._geometry_names.copy(), self._instance_names.copy()
            copied._geometries = [replace(geometry, owner=copied) for geometry in self._geometries]
            copied._instances = [
                replace(instance, geometry=copied._geometries[instance.geometry.id]) for instance in self._instances
            ]
            copied._material_numbers = self._material_numbers.copy()
            count = len(self._instances)
            for array in _ARRAYS:
                setattr(copied, array, getattr(self, array)[:count].copy())
            return copied

    def _load_first(self) -> None:
        if not self._is_pending:
            return
        assert self.first is not None
        (shape, name), matrix = self.first.load(), self.first.matrix
        self._is_pending = False
        geometry = self._add(shape, None, name)
        self._place(geometry, matrix[None], None, geometry.name, ALL_BITS)

    def _add(self, shape: Shape, name: str | None, wish: str) -> Geometry:
        names = self._geometry_names
        unique = names.add_numbered(wish) if name is None else names.add(name)
        geometry = Geometry(len(self._geometries), unique, shape, self)
        self._geometries.append(geometry)
        self._snapshot = self._tuples = None
        return geometry

    def _place(
        self,
        geometry: Geometry,
        transforms: NDArray[np.float64],
        names: Sequence[str] | None,
        wish: str,
        mask: int,
        colour: Colour | None = None,
        material: Material | None = None,
    ) -> tuple[Instance, ...]:
        begin, end = len(self._instances), len(self._instances) + len(transforms)
        if end > MAX_INSTANCE_COUNT:
            raise SceneError(f"{end:,} instances are too many: the limit is {MAX_INSTANCE_COUNT:,}")
        for array in _ARRAYS:
            setattr(self, array, _grow(getattr(self, array), begin, end))
        self._transforms[begin:end] = transforms
        self._masks[begin:end] = mask
        self._colours[begin:end] = np.nan if colour is None else colour
        self._geometry_ids[begin:end] = geometry.id
        numbers = self._material_numbers
        self._material_ids[begin:end] = -1 if material is None else numbers.setdefault(material, len(numbers))
        unique: Iterable[str]
        if names is None:
            unique = (self._instance_names.add_numbered(wish) for _ in range(begin, end))
        else:
            unique = map(self._instance_names.add, names)
        placed = tuple(
            Instance(index, name, geometry, mask, colour, material) for index, name in enumerate(unique, begin)
        )
        self._instances += placed
        self._snapshot = self._tuples = None
        return placed

    def __getstate__(self) -> dict[str, Any]:
        with self.lock:
            state = vars(self).copy()
            for array in _ARRAYS:
                state[array] = state[array][: len(self._instances)].copy()
            state["_geometries"], state["_instances"] = self._geometries.copy(), self._instances.copy()
            state["_material_numbers"] = self._material_numbers.copy()
            for name in ("lock", "_snapshot", "_tuples"):
                del state[name]
            return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._start()


# One row per instance, and room for more.
_ARRAYS = ("_transforms", "_masks", "_colours", "_geometry_ids", "_material_ids")


def _grow(rows: NDArray[Any], count: int, needed: int) -> NDArray[Any]:
    """Return an array with room for `needed` rows and the first `count` of the given one, or that one itself."""
    if needed <= len(rows):
        return rows
    grown = np.empty((max(needed, 2 * len(rows)), *rows.shape[1:]), rows.dtype)
    grown[:count] = rows[:count]
    return grown


class UniqueNames:
    """The names of all things of one kind, and their ids, which count up from 0.

    Parameters
    ----------
    kind : str
        For messages, with its article: ``"a geometry"``.
    """

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._ids: dict[str, int] = {}
        self._next_number: dict[str, int] = {}

    def __len__(self) -> int:
        return len(self._ids)

    def __iter__(self) -> Iterator[str]:
        return iter(self._ids)

    def find(self, name: object) -> int | None:
        """Return the id of a name."""
        return self._ids.get(name) if isinstance(name, str) else None

    def check(self, name: object) -> None:
        """Raise `SceneError` unless a name is a text that nothing else has."""
        if not _is_name(name):
            raise SceneError(f"the name of {self._kind} must be a text that is not empty, not {shorten(name)}")
        if name in self._ids:
            raise SceneError(f"the scene has {self._kind} with the name {shorten(name)} already: choose another one")

    def add(self, name: str) -> str:
        """Add a name that `check` has accepted."""
        self._ids[name] = len(self._ids)
        return name

    def add_numbered(self, wish: str) -> str:
        """Add a name and return it: the wish itself, or with the first free number from 2 behind it.

        The wish comes from a file or a mesh, so it may be anything.
        """
        name = wish = _clean(str(wish)).strip() or self._kind.split()[-1]
        number = self._next_number.get(wish, 2)
        while name in self._ids:
            name = f"{wish} {number}"
            number += 1
        self._next_number[wish] = number
        return self.add(name)

    def copy(self) -> UniqueNames:
        """Return names that grow apart from these."""
        names = UniqueNames(self._kind)
        names._ids, names._next_number = self._ids.copy(), self._next_number.copy()
        return names


def _is_name(value: object) -> bool:
    """Return whether a value is a text that is not empty and can be written into a file."""
    return isinstance(value, str) and bool(value.strip()) and value == _clean(value)


def _clean(text: str) -> str:
    """Return a text without halves of characters, which JSON allows and UTF-8 does not."""
    return text.encode("utf-8", "replace").decode()


def name_of_file(path: str) -> str:
    """Return the name of what a file holds: the file's without its suffix."""
    return Path(path).stem or path
