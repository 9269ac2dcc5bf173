"""Where a scene's mesh comes from; it is loaded when it is needed."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from ..errors import SceneError
from ..geometry import Mesh, load_mesh
from ..geometry.appearance.material import Material
from ..geometry.dressed import with_material
from ..geometry.fetch import find_known_mesh
from ..geometry.shapes.make_shape import make_shape


@dataclass(frozen=True)
class MeshSource:
    """The source of a scene's mesh: exactly one of `path`, `name`, `shape` and `mesh`.

    Attributes
    ----------
    path : str
        A mesh file.
    name : str
        A known mesh, such as ``bunny``.
    shape : str
        A procedural shape, with `triangles`, `seed` and the shape's own `options`.
    mesh : Mesh
        A mesh in memory.
    material : Material, optional
        Of the whole mesh, instead of its own materials and colours.

    Raises
    ------
    SceneError
        None of the four is given, or several.

    Examples
    --------
    >>> import clbvh
    >>> clbvh.MeshSource(shape="icosphere", triangles=1000).load()
    Mesh('icosphere', vertices=492, faces=980)
    >>> clbvh.MeshSource(path="part.ply", name="bunny")
    Traceback (most recent call last):
    clbvh.errors.SceneError: the mesh needs exactly one of path, name and shape, or a Mesh
    """

    path: str | None = None
    name: str | None = None
    shape: str | None = None
    triangles: int = 100_000
    seed: int = 0
    options: dict[str, float] = field(default_factory=dict)
    mesh: Mesh | None = None
    material: Material | None = None

    def __post_init__(self) -> None:
        if sum(value is not None for value in (self.path, self.name, self.shape, self.mesh)) != 1:
            raise SceneError("the mesh needs exactly one of path, name and shape, or a Mesh")

    def load(self) -> Mesh:
        """Return the mesh; raise `MeshError` or `ConfigError` if there is none.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.MeshSource(shape="icosphere", triangles=1000).load().face_count
        980
        """
        mesh = self._load_bare()
        return mesh if self.material is None else with_material(mesh, self.material)

    def _load_bare(self) -> Mesh:
        if self.mesh is not None:
            return self.mesh
        if self.shape is not None:
            return make_shape(self.shape, triangles=self.triangles, seed=self.seed, **self.options)
        return load_mesh(self.file())

    def file(self) -> Path:
        """Return the file that `load` reads.

        Examples
        --------
        >>> import clbvh
        >>> print(clbvh.MeshSource(path="part.ply").file())
        part.ply
        """
        return find_known_mesh(self.name) if self.name is not None else Path(str(self.path))

    def estimate_face_count(self) -> int:
        """Return the approximate number of triangles without reading them; 0 if the file is missing.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.MeshSource(shape="icosphere", triangles=1000).estimate_face_count()
        1000
        """
        if self.mesh is not None:
            return self.mesh.face_count
        if self.shape is not None:
            return self.triangles
        file = self.file()
        return file.stat().st_size // _BYTES_PER_FACE if file.is_file() else 0


# Binary PLY files take about 19 bytes per triangle, ASCII ones about 43.
_BYTES_PER_FACE = 30
