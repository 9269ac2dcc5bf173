"""The source of an object of spheres: a file, a procedural set, or numbers in the scene file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import SceneError
from ..geometry.loading.spheres_file import SPHERES_SUFFIXES, read_spheres
from ..geometry.shapes.make_spheres import make_spheres
from ..geometry.spheres import Spheres


@dataclass(frozen=True)
class SpheresSource:
    """The source of spheres: exactly one of `path`, `generator` and `centres`.

    Attributes
    ----------
    path : str
        An NPZ or CSV file, see `read_spheres`.
    generator : str
        A procedural set, with `count`, `seed` and its own `options`.
    centres : tuple of (3,) float
    radii : float, or tuple of float
        One for all spheres, or one each. None where the file has radii, or the set.

    Raises
    ------
    SceneError
        Radii are missing, or given twice.
    """

    path: str | None = None
    generator: str | None = None
    count: int = 100_000
    seed: int = 0
    options: dict[str, float] = field(default_factory=dict)
    centres: tuple[tuple[float, ...], ...] | None = None
    radii: float | tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.centres is not None and self.radii is None:
            raise SceneError("centres need radii: one for all of them, or a list with one for each")
        if isinstance(self.radii, tuple) and len(self.radii) != len(self.centres or ()):
            raise SceneError(f"{len(self.radii)} radii do not fit {len(self.centres or ())} centres")

    @property
    def name(self) -> str:
        """The name of the spheres where the scene has no label."""
        return Path(self.path).stem if self.path is not None else self.generator or "spheres"

    def load(self) -> Spheres:
        """Return the spheres; raise `MeshError`, `ConfigError` or `SceneError` if there are none."""
        if self.generator is not None:
            made = make_spheres(self.generator, count=self.count, seed=self.seed, **self.options)
            looks = {"materials": made.materials, "material_ids": made.material_ids}
            return Spheres.from_arrays(made.centres, made.radii, name=self.name, **looks)
        if self.centres is not None:
            return Spheres.from_arrays(np.array(self.centres), np.array(self.radii), name=self.name)
        centres, radii = read_spheres(str(self.path))
        if radii is not None and self.radii is not None:
            raise SceneError(f"{self.path}: the file has its own radii: leave 'radii' out")
        if radii is not None:
            return Spheres.from_arrays(centres, radii, name=self.name)
        if self.radii is None:
            raise SceneError(f"{self.path}: the file has no radii: give 'radii', one for all")
        return Spheres.from_arrays(centres, self.radii, name=self.name)


def is_spheres_file(name: str) -> bool:
    """Return whether a text names a file of spheres, rather than a procedural set."""
    return Path(name).suffix.lower() in SPHERES_SUFFIXES or Path(name).name != name
