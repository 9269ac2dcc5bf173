"""The looks of a shape: values at the corners of its faces, and the materials of its faces.

Owns the checks of the arrays, and vectors of length 1. Must not know of files, nor of the shape itself.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import MeshError
from ..arrays import as_array, check_numbers
from .material import Material, copy_with_alpha

_LEAST_SQUARE, _MOST_SQUARE = 1e-200, 1e200

# Unit vectors whose components were rounded to float32, or to six digits, have squares this near to 1.
_UNIT_TOLERANCE = 4e-6


def normalize(vectors: NDArray[np.number]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return vectors of length 1, and which of them have a direction.

    Parameters
    ----------
    vectors : (..., 3) float

    Returns
    -------
    unit : (..., 3) float32
        Those that are zero or not finite become (0, 0, 1). In the order of C.
    has_direction : (...) bool
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        squares = np.einsum("...i,...i->...", vectors, vectors, dtype=np.float64)
        if (np.abs(squares - 1) < _UNIT_TOLERANCE).all():
            return vectors.astype(np.float32, order="C"), np.ones(squares.shape, np.bool_)
        # The squares of the rest may underflow or overflow.
        has_direction = (squares > _LEAST_SQUARE) & (squares < _MOST_SQUARE)
        unit = (vectors / np.sqrt(squares)[..., None]).astype(np.float32, order="C")
        if not has_direction.all():
            odd = np.asarray(vectors[~has_direction], np.float64)
            scaled = odd / np.abs(odd).max(axis=-1, keepdims=True)
            scaled /= np.sqrt(np.einsum("ij,ij->i", scaled, scaled))[:, None]
            is_number = np.isfinite(scaled).all(axis=-1)
            unit[~has_direction] = np.where(is_number[:, None], scaled, (0, 0, 1))
            has_direction[~has_direction] = is_number
    return unit, has_direction


def find_flat_normals(corners: NDArray[np.number]) -> NDArray[np.float32]:
    """Return the unit normals of triangles, (n, 3) float32; (0, 0, 1) for those without an area.

    Parameters
    ----------
    corners : (n, 3, 3) float
        The points at the corners of each triangle.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        points = np.asarray(corners, np.float64)
        u, v = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
        # To a size of about 1: the product of tiny sides could underflow.
        u, v = (side / np.abs(side).max(axis=1, keepdims=True, initial=0) for side in (u, v))
        return normalize(np.nan_to_num(np.cross(u, v)))[0]


@dataclass(frozen=True, eq=False)
class Appearance:
    """Normals, texture coordinates and colours at the corners of a mesh's faces, and their materials.

    The values belong to the three corners of each face, not to vertices: along a sharp edge or the seam of a texture a
    vertex has several. ``values[mesh.faces]`` makes them of values at vertices.

    Parameters
    ----------
    normals : (F, 3, 3) float, optional
        Of any length above 0: they are normalised. None: a picture computes smooth ones, see
        `clbvh.smooth_normals_by_angle`.
    uvs : (F, 3, 2) float, optional
        Texture coordinates; (0, 0) is the lower left corner of a texture.
    colours : (F, 3, 4) uint8, optional
        sRGB and alpha; (F, 3, 3) is opaque. They multiply the base colours of materials.
    materials : sequence of Material
    material_ids : (F,) int, optional
        The material of each face. None: all faces have the first material, if there is one.

    For `clbvh.Spheres` the colours are (n, 4), one for each sphere, and `material_ids` are those of the spheres.

    Attributes
    ----------
    normals : (F, 3, 3) float32, or None
    uvs : (F, 3, 2) float32, or None
    colours : (F, 3, 4) uint8, or None
    materials : tuple of Material
    material_ids : (F,) int32, or None

    Raises
    ------
    MeshError
        Wrong shapes or dtypes, a different number of faces, a normal without a direction, a coordinate that is not
        finite, or a material id without a material.

    Examples
    --------
    >>> import clbvh
    >>> red = clbvh.Appearance(materials=[clbvh.Material("red", base_colour=(0.8, 0.1, 0.1))])
    >>> mesh = clbvh.Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], appearance=red)
    >>> mesh.appearance
    Appearance(materials=1)
    """

    normals: NDArray[np.float32] | None = None
    uvs: NDArray[np.float32] | None = None
    colours: NDArray[np.uint8] | None = None
    materials: tuple[Material, ...] = ()
    material_ids: NDArray[np.int32] | None = None

    def __post_init__(self) -> None:
        for name, check in _CHECKS.items():
            if (values := getattr(self, name)) is not None:
                object.__setattr__(self, name, check(values))
        object.__setattr__(self, "materials", _check_materials(self.materials))
        counts = {name: len(getattr(self, name)) for name in _CHECKS if getattr(self, name) is not None}
        if len(set(counts.values())) > 1:
            listed = ", ".join(f"{name} of {count:,}" for name, count in counts.items())
            raise MeshError(f"an appearance belongs to one number of faces, but has {listed}")
        ids = self.material_ids
        if ids is not None and len(ids) and not 0 <= int(ids.min()) <= int(ids.max()) < len(self.materials):
            face = int(np.argmax((ids < 0) | (ids >= len(self.materials))))
            raise MeshError(f"face {face} has the material {ids[face]}, but there are {len(self.materials)} materials")

    @property
    def prim_count(self) -> int | None:
        """Number of faces or spheres that the arrays belong to; None without arrays, which suits any."""
        return next((len(values) for name in _CHECKS if (values := getattr(self, name)) is not None), None)

    @property
    def is_empty(self) -> bool:
        """Whether it says nothing."""
        return self.prim_count is None and not self.materials

    def without_normals(self) -> Appearance:
        """Return the same appearance without its normals.

        Examples
        --------
        >>> import clbvh
        >>> flat = clbvh.Appearance(normals=[[[0, 0, 1]] * 3], materials=[clbvh.Material()])
        >>> flat.without_normals()
        Appearance(materials=1)
        """
        return self if self.normals is None else self._replace(normals=None)

    def select(self, faces: NDArray[Any]) -> Appearance:
        """Return the appearance of some faces, or of all in another order; the materials stay.

        Parameters
        ----------
        faces : (n,) int or bool
            An index into the first axis of the arrays.

        Examples
        --------
        >>> import clbvh
        >>> import numpy as np
        >>> looks = clbvh.Appearance(uvs=np.zeros((5, 3, 2)))
        >>> looks.select(np.array([4, 0]))
        Appearance(uvs=2, materials=0)
        """
        chosen = {name: values[faces] for name in _CHECKS if (values := getattr(self, name)) is not None}
        return self._replace(**chosen)

    def transformed(self, matrix: ArrayLike) -> Appearance:
        """Return the appearance of a mesh whose vertices are moved by a matrix and whose faces are not turned round.

        Normals stay on the side of the faces on which they were, also where the matrix mirrors.

        Parameters
        ----------
        matrix : (3, 3) or (4, 4) float
            Of an affine transform.

        Examples
        --------
        >>> import clbvh
        >>> slope = clbvh.Appearance(normals=[[[0, 0.8, 0.6]] * 3])
        >>> slope.transformed(clbvh.Transform(scale=(1, 1, 2)).matrix).normals[0, 0].round(3)
        array([0.   , 0.936, 0.351], dtype=float32)
        """
        if self.normals is None:
            return self
        return self._replace(normals=turn_normals(self.normals, np.asarray(matrix, np.float64)))

    def _replace(self, **values: Any) -> Appearance:
        return make_unchecked(**(vars(self) | values))

    def __repr__(self) -> str:
        counts = [f"{name}={len(getattr(self, name)):,}" for name in _CHECKS if getattr(self, name) is not None]
        return f"Appearance({', '.join([*counts, f'materials={len(self.materials)}'])})"


def make_unchecked(**values: Any) -> Appearance:
    """Return an appearance of arrays that are as documented: of their shapes and dtypes, unit, finite and in range.

    For readers, which have seen to that on the way; the checks would take as long as reading.
    """
    appearance = object.__new__(Appearance)
    for each in dataclasses.fields(Appearance):
        object.__setattr__(appearance, each.name, values.pop(each.name, each.default))
    if values:
        raise TypeError(f"an appearance has no {', '.join(values)}")
    return appearance


def turn_corners(appearance: Appearance) -> Appearance:
    """Return the looks of triangles whose corners are listed backwards, so that their normals are on the other side."""
    values = vars(appearance) | {
        name: np.ascontiguousarray(array[:, ::-1])
        for name in ("normals", "uvs", "colours")
        if (array := getattr(appearance, name)) is not None
    }
    if appearance.normals is not None:
        values["normals"] = -values["normals"]
    return make_unchecked(**values)


def turn_normals(normals: NDArray[np.float32], matrix: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return (..., 3) normals of a surface that a matrix moves, on the same sides of its faces.

    Normals are cross products, which go by the cofactors of a matrix: those of a singular one exist as well.
    """
    largest = np.abs(matrix[:3, :3]).max()
    if not 0 < largest < np.inf:
        return normals
    cofactors = find_cofactors(matrix[:3, :3] / largest)
    # Which of those that a singular matrix has flattened point where does not matter: their faces are no surface.
    return normalize(normals @ cofactors.T.astype(np.float32))[0]


def find_cofactors(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cofactors of matrices, (..., 3, 3)."""
    rows = [np.cross(linear[..., (row + 1) % 3, :], linear[..., (row + 2) % 3, :]) for row in range(3)]
    return np.stack(rows, axis=-2)


def check_fit(appearance: Appearance | None, prim_count: int, name: str, *, has_corners: bool) -> None:
    """Raise `MeshError` unless an appearance fits a shape with `prim_count` primitives.

    Parameters
    ----------
    appearance : Appearance or None
    prim_count : int
    name : str
        Of the shape, for messages.
    has_corners : bool
        True for triangles, False for spheres.
    """
    if appearance is None:
        return
    if not isinstance(appearance, Appearance):
        raise MeshError(f"{name}: the appearance must be a clbvh.Appearance, not a {type(appearance).__name__}")
    if appearance.prim_count not in (None, prim_count):
        kind = "faces" if has_corners else "spheres"
        raise MeshError(f"{name}: the appearance is one of {appearance.prim_count:,} {kind}, not of {prim_count:,}")
    if not has_corners and (appearance.normals is not None or appearance.uvs is not None):
        raise MeshError(f"{name}: spheres have no corners, and so no normals and texture coordinates there")
    if appearance.colours is not None and (appearance.colours.ndim == 3) != has_corners:
        shape = "(F, 3, 4)" if has_corners else "(n, 4)"
        raise MeshError(f"{name}: the colours must have shape {shape}, not {appearance.colours.shape}")


def _check_normals(values: ArrayLike) -> NDArray[np.float32]:
    array = _check_corners(values, "normals", 3)
    unit, has_direction = normalize(array)
    if not has_direction.all():
        face, corner = np.argwhere(~has_direction)[0]
        raise MeshError(f"the normal at corner {corner} of face {face} has no direction: {array[face, corner]}")
    return unit


def _check_uvs(values: ArrayLike) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):  # refused below
        array = np.array(_check_corners(values, "uvs", 2), np.float32, order="C")
    if not np.isfinite(array).all():
        face, corner = np.argwhere(~np.isfinite(array).all(axis=2))[0]
        raise MeshError(f"the texture coordinates at corner {corner} of face {face} are not finite")
    return array


def _check_corners(values: ArrayLike, name: str, width: int) -> NDArray[Any]:
    array = as_array(values, name, f"(F, 3, {width})")
    check_numbers(array, name)
    if array.ndim != 3 or array.shape[1:] != (3, width):
        raise MeshError(f"{name} must have shape (F, 3, {width}), not {array.shape}")
    return array


def _check_colours(values: ArrayLike) -> NDArray[np.uint8]:
    array = as_array(values, "colours", "(F, 3, 4)")
    if array.dtype != np.uint8:
        raise MeshError(f"colours must be uint8, from 0 to 255, not {array.dtype}")
    if array.ndim not in (2, 3) or array.shape[-1] not in (3, 4) or (array.ndim == 3 and array.shape[1] != 3):
        raise MeshError(f"colours must have shape (F, 3, 4), or (n, 4) for spheres, not {array.shape}")
    return copy_with_alpha(array)


def _check_ids(values: ArrayLike) -> NDArray[np.int32]:
    array = as_array(values, "material_ids", "(F,)")
    if array.ndim != 1 or not np.issubdtype(array.dtype, np.integer):
        raise MeshError(f"material_ids must be integers of shape (F,), not {array.dtype} of shape {array.shape}")
    limits = np.iinfo(np.int32)
    if len(array) and not limits.min <= int(array.min()) <= int(array.max()) <= limits.max:
        raise MeshError("material_ids must fit 32 bits")
    return np.array(array, np.int32)


def _check_materials(values: Any) -> tuple[Material, ...]:
    try:
        materials = tuple(values)
    except TypeError:
        materials = (None,)
    for material in materials:
        if not isinstance(material, Material):
            raise MeshError(f"materials must be a sequence of clbvh.Material, not {values!r}")
    return materials


_CHECKS = {"normals": _check_normals, "uvs": _check_uvs, "colours": _check_colours, "material_ids": _check_ids}
