"""Spheres in memory, checked, and once more in the local coordinates that trees and devices use.

Owns the checks of centres and radii, and `Shape`: a mesh or spheres. Must not know of files or trees.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..device.host.loops import Loops
from ..errors import MeshError
from ..kinds import SPHERES, Kind
from ..support.memory import check_memory
from .appearance.appearance import Appearance, check_fit, make_unchecked
from .appearance.material import Material
from .arrays import as_array, check_numbers, copy_as_float64
from .coincident import NO_COINCIDENCE, Coincidence
from .corners import Boxes, Corners, corners_of_boxes
from .local_frame import LocalFrame, find_bounds, find_frame, shift_and_scale
from .mesh import MAX_FACE_COUNT, Mesh
from .point_spacing import find_point_radius
from .scales import LEAST_SHARE

_MAX_BYTE = 255

# Centre and radius in the user's coordinates and in local ones.
_BYTES_PER_SPHERE = 48

# Boxes of spheres are larger than the spheres by rounding and by the margin of `bound_spheres`. Room for that stays
# between the outermost sphere and the end of local coordinates.
_ROOM = 1.0 + 2.0**-16

# The least local radius. A smaller one would be rounded to zero by devices that have no numbers below the normal ones.
_LEAST_LOCAL_RADIUS = np.finfo(np.float32).tiny

_LOOPS = Loops("geometry/boxes")


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Spheres(LocalFrame):
    """Spheres, each with a centre and a radius: particles, atoms, stars.

    Rays hit their surfaces from outside and from inside. Spheres may overlap, and lie within each other. As in a
    `clbvh.Mesh`, trees and devices work in local coordinates, about 1 in size and around zero; where a sphere is hit is
    computed in float64 from the centres and radii as they are given.

    Parameters
    ----------
    centres : (n, 3) float
        Any floating-point or integer dtype and any unit; they are copied.
    radii : (n,) float, or float
        Above 0, in the same unit. One number is the radius of all spheres.
    name : str, optional
        The name of the spheres in messages and reports.
    colours : (n, 4) or (n, 3) uint8, optional
        sRGB and alpha of each sphere, for pictures.
    materials : sequence of Material, optional
    material_ids : (n,) int, optional
        The material of each sphere. All have the first one if left out.

    Attributes
    ----------
    centres : (n, 3) float64
    radii : (n,) float64
    local_centres : (n, 3) float32, local coordinates
        ``(centres - origin) * scale``.
    local_radii : (n,) float32, local units
        ``radii * scale``, and at least the smallest normal number of float32.
    origin : (3,) float64
        Centre of the box around all spheres.
    scale : float
        A power of two: local units in one unit of the centres. The largest half side of the box around all spheres is
        about 0.5 to 1 local units.
    name : str
    appearance : Appearance, or None
        Colours and materials. No tree depends on it.
    note : str
        What a user should know of them, or nothing: `Picture.notes` has it.

    Raises
    ------
    MeshError
        Wrong shape or dtype, no spheres, too many spheres, a coordinate that is not finite, a radius that is not finite
        or not above 0, colours or material ids of another number of spheres, or a box whose sides float64 cannot scale:
        smaller than 1e-150 or larger than 1e150. The message names the first fault.

    Notes
    -----
    48 bytes per sphere.

    Examples
    --------
    >>> import clbvh
    >>> spheres = clbvh.Spheres([[0, 0, 0], [4, 0, 0]], [1, 0.5])
    >>> spheres
    Spheres('spheres', count=2)
    >>> spheres.origin
    array([1.75, 0.  , 0.  ])
    >>> clbvh.Spheres([[0, 0, 0], [4, 0, 0]], [1, -1])
    Traceback (most recent call last):
    clbvh.errors.MeshError: spheres: sphere 1 has the radius -1, but radii must be finite and above 0
    """

    centres: NDArray[np.float64]
    radii: NDArray[np.float64]
    local_centres: NDArray[np.float32]
    local_radii: NDArray[np.float32]
    origin: NDArray[np.float64]
    scale: float
    name: str
    appearance: Appearance | None
    note: str

    def __init__(
        self,
        centres: ArrayLike,
        radii: ArrayLike,
        *,
        name: str = "spheres",
        colours: ArrayLike | None = None,
        materials: Sequence[Material] = (),
        material_ids: ArrayLike | None = None,
    ) -> None:
        checked_centres = _check_centres(centres, name)
        checked_radii = _check_radii(radii, len(checked_centres), name)
        origin, scale = _find_frame(checked_centres, checked_radii, name)
        local_radii = np.maximum((checked_radii * scale).astype(np.float32), _LEAST_LOCAL_RADIUS)
        appearance: Any = Appearance(None, None, colours, materials, material_ids)  # type: ignore[arg-type]
        check_fit(appearance, len(checked_centres), name, has_corners=False)
        vars(self).update(
            appearance=None if appearance.is_empty else appearance,
            centres=checked_centres,
            radii=checked_radii,
            name=name,
            origin=origin,
            scale=scale,
            local_centres=shift_and_scale(checked_centres, origin, scale),
            local_radii=local_radii,
            note="",
        )

    @classmethod
    def from_points(
        cls, points: Any, radius: ArrayLike | None = None, *, colours: ArrayLike | None = None, name: str = "points"
    ) -> Spheres:
        """Return a sphere around each point of a cloud, so that it can be traced and drawn.

        Parameters
        ----------
        points : (n, 3) float, or a point cloud of trimesh or Open3D
        radius : float, or (n,) float, optional
            By default three quarters of the median distance between a point and its sixth neighbour, so that spheres on
            a surface overlap; `note` says it.
        colours : (n, 3) or (n, 4) uint8, or float from 0 to 1, optional
            sRGB, and alpha. By default those of the object.
        name : str, optional

        Raises
        ------
        MeshError
            See `Spheres`.

        Examples
        --------
        >>> import clbvh
        >>> import numpy as np
        >>> ground = np.stack(np.meshgrid(np.arange(30), np.arange(20), [0]), axis=-1).reshape(-1, 3)
        >>> cloud = clbvh.Spheres.from_points(ground)
        >>> cloud, cloud.radii[:1].round(2)
        (Spheres('points', count=600), array([1.06]))
        """
        for attribute in ("vertices", "points"):
            if hasattr(points, attribute):
                colours = getattr(points, "colors", None) if colours is None else colours
                points = getattr(points, attribute)
                break
        checked = _check_centres(points, name)
        note = ""
        if radius is None:
            radius = find_point_radius(checked)
            note = f"{name}: the points are spheres of the radius {radius:.3g}, by their spacing"
        if colours is not None:
            colours = np.asarray(colours)
            colours = np.rint(colours * _MAX_BYTE).astype(np.uint8) if colours.dtype.kind == "f" else colours
            colours = colours if len(colours) else None
        white = () if colours is None else (Material(base_colour=(1.0, 1.0, 1.0)),)
        spheres = cls(checked, radius, name=name, colours=colours, materials=white)
        vars(spheres)["note"] = note
        return spheres

    @classmethod
    def from_arrays(cls, centres: ArrayLike, radii: ArrayLike, *, name: str = "spheres", **looks: Any) -> Spheres:
        """Return spheres, as the constructor does; named like `Mesh.from_arrays`.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Spheres.from_arrays([[0, 0, 0], [4, 0, 0], [0, 4, 0]], 0.5, name="atoms")
        Spheres('atoms', count=3)
        """
        return cls(centres, radii, name=name, **looks)

    def with_spheres(self, centres: ArrayLike, radii: ArrayLike | None = None) -> Spheres:
        """Return as many spheres that have moved.

        Parameters
        ----------
        centres : (n, 3) float
            The same number as before.
        radii : (n,) float, or float, optional
            The present radii if left out.

        Returns
        -------
        Spheres
            With their own origin and scale, and the present appearance.

        Raises
        ------
        MeshError
            Another number of spheres, or spheres that the constructor refuses.

        Examples
        --------
        >>> import clbvh
        >>> spheres = clbvh.Spheres([[0, 0, 0], [4, 0, 0]], [1, 0.5])
        >>> spheres.with_spheres(spheres.centres + [0, 0, 1]).radii
        array([1. , 0.5])
        """
        array = as_array(centres, f"{self.name}: centres")
        if array.ndim == 2 and len(array) != self.prim_count:
            raise MeshError(f"{self.name}: {len(array):,} spheres cannot replace the present {self.prim_count:,}")
        moved = Spheres(centres, self.radii if radii is None else radii, name=self.name)
        object.__setattr__(moved, "appearance", self.appearance)
        return moved

    @property
    def kind(self) -> Kind:
        """Of its primitives: spheres."""
        return SPHERES

    @property
    def prim_count(self) -> int:
        """Number of primitives: the spheres."""
        return len(self.radii)

    @cached_property
    def spans_scales(self) -> bool:
        """Whether a sphere is so small beside all of them that float64 decides what rays hit; see `Mesh`."""
        return bool(self.radii.min() * self.scale < LEAST_SHARE)

    @property
    def is_watertight(self) -> bool:
        """True: spheres enclose a volume."""
        return True

    @property
    def coincidence(self) -> Coincidence:
        """Of no faces."""
        return NO_COINCIDENCE

    @cached_property
    def local_box(self) -> NDArray[np.float32]:
        """(2, 3) float32: the least and the greatest local coordinates of the spheres, rounded."""
        return np.stack(_bound(self.local_centres, self.local_radii)).astype(np.float32)

    @property
    def balls(self) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """Centres and radii of balls that reach as far as the shape: the spheres."""
        return self.centres, self.radii

    def find_corners(self) -> Corners:
        """Return two opposite corners of the box around each sphere.

        Notes
        -----
        O(n), in this thread: about 20 ms for 1,000,000 spheres, 36 bytes each.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Spheres([[0, 0, 0], [4, 0, 0]], 1).find_corners().points.shape
        (4, 3)
        """
        return corners_of_boxes(bound_spheres(self))

    @cached_property
    def fingerprint(self) -> bytes:
        """32 bytes that identify local centres and radii: the SHA-256 of their number and bytes.

        Nothing else determines a tree: not the name, nor where the spheres are, nor their unit.
        """
        digest = hashlib.sha256(f"{self.prim_count} spheres;".encode())
        digest.update(np.ascontiguousarray(self.local_centres, "<f4").data)
        digest.update(np.ascontiguousarray(self.local_radii, "<f4").data)
        return digest.digest()

    def __repr__(self) -> str:
        return f"Spheres({self.name!r}, count={self.prim_count:,})"


def _check_centres(centres: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return the centres as a finite (n, 3) float64 array of our own."""
    array = as_array(centres, f"{name}: centres")
    if array.ndim != 2 or array.shape[1] != 3:
        raise MeshError(f"{name}: centres must have shape (n, 3), not {array.shape}")
    check_numbers(array, f"{name}: centres")
    if len(array) == 0:
        raise MeshError(f"{name}: there are no spheres")
    if len(array) > MAX_FACE_COUNT:
        raise MeshError(f"{name}: {len(array):,} spheres are too many: the limit is {MAX_FACE_COUNT:,}")
    check_memory(f"{len(array):,} spheres", len(array) * _BYTES_PER_SPHERE, MeshError)
    copied = copy_as_float64(array)
    finite = np.isfinite(copied)
    if not finite.all():
        sphere, axis = np.argwhere(~finite)[0]
        coordinate = f"{'xyz'[axis]} = {array[sphere, axis]}"
        raise MeshError(f"{name}: sphere {sphere} has a centre that is not finite: {coordinate}")
    return copied


def _check_radii(radii: ArrayLike, count: int, name: str) -> NDArray[np.float64]:
    """Return the radii as a (count,) float64 array of our own, finite and above 0."""
    array = as_array(radii, f"{name}: radii", "(n,)")
    check_numbers(array, f"{name}: radii")
    if array.ndim == 0:
        array = np.full(count, array)
    if array.shape != (count,):
        raise MeshError(f"{name}: radii must be one number or have shape ({count},), not {array.shape}")
    copied = copy_as_float64(array)
    right = (copied > 0) & (copied < np.inf)
    if not right.all():
        sphere = int(np.argmin(right))
        raise MeshError(f"{name}: sphere {sphere} has the radius {array[sphere]}, but radii must be finite and above 0")
    return copied


def _bound(centres: NDArray[Any], radii: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the least and the greatest coordinates of spheres."""
    return find_bounds(centres - radii[:, None])[0], find_bounds(centres + radii[:, None])[1]


def _find_frame(
    centres: NDArray[np.float64], radii: NDArray[np.float64], name: str
) -> tuple[NDArray[np.float64], float]:
    """Return the origin and the scale of local coordinates."""
    with np.errstate(over="ignore"):  # refused by find_frame
        lower, upper = _bound(centres, radii)
        half = max(float(np.max(upper / 2 - lower / 2)), float(radii.max()))
        # Far from zero, float64 may round the sides of the box away.
        return find_frame(lower, upper, name, subject="the group of spheres is", least_half=half * _ROOM)


def bound_spheres(spheres: Spheres) -> NDArray[np.float32]:
    """Return the boxes of spheres, (n, 2, 3) float32, in local coordinates.

    Each contains the local sphere and a margin of 2^-18 of its radius; no coordinate is beyond -1 or 1.
    """
    corners = np.empty((spheres.prim_count, 2, 3), np.float32)
    _LOOPS.bound_spheres(spheres.local_centres, spheres.local_radii, corners)
    return corners


Shape: TypeAlias = Mesh | Spheres
"""The shape of a geometry: a mesh, or spheres. Both have `kind`, `prim_count`, `origin`, `scale` and `fingerprint`."""

Bounded: TypeAlias = Shape | Boxes
"""A shape that a tree can be over. All have `prim_count`, `origin`, `scale`, `name`, `local_box` and `find_corners`."""


def join_numbers(shape: Shape, prefix: str = "") -> NDArray[Any] | None:
    """Return the numbers of each primitive in a row, see `Kind.arrays`; None of a mesh."""
    arrays = [getattr(shape, prefix + name) for name in shape.kind.arrays]
    return np.column_stack(arrays) if arrays else None


_Shape = TypeVar("_Shape", Mesh, Spheres)


def with_material(shape: _Shape, material: Material) -> _Shape:
    """Return a shape all of whose primitives have one material.

    Parameters
    ----------
    shape : Mesh or Spheres
        Its normals and texture coordinates are kept; its colours and materials are not.
    material : Material

    Returns
    -------
    Mesh or Spheres
        Shares all arrays with the given one.

    Examples
    --------
    >>> import clbvh
    >>> from clbvh.geometry.spheres import with_material
    >>> ball = clbvh.make_shape("icosphere", triangles=320)
    >>> with_material(ball, clbvh.Material(metallic=1.0)).appearance
    Appearance(materials=1)
    """
    looks = shape.appearance
    normals, uvs = (None, None) if looks is None else (looks.normals, looks.uvs)
    # Neither by a constructor, which would copy the arrays and check them again.
    dressed = copy.copy(shape)
    appearance = make_unchecked(normals=normals, uvs=uvs, colours=None, materials=(material,), material_ids=None)
    object.__setattr__(dressed, "appearance", appearance)
    return dressed
