"""The part of a view that depends on what is seen: up, the camera that shows the whole, the ground, and notes.

Where its user says nothing, a picture guesses which way is up, and which small parts are too far away to frame.
`View.up` and `View.frame` overrule the guesses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from pathlib import PurePath
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError
from ..geometry import Mesh, Shape, Spheres
from ..kinds import TRIANGLES
from ..support.settings import Vector
from .cameras.bounds import SceneBounds
from .cameras.camera import Camera
from .cameras.framing import frame_scene, measure_side
from .cameras.projection import Panorama
from .ground import Ground, find_ground, shows_ground, sky_direction
from .view import View

_Found = TypeVar("_Found")


class ViewFinder:
    """Finds what views leave open, for one scene. The last answers are kept: each reads all vertices.

    All but `complete` and `notes` take views that `complete` has returned.

    Parameters
    ----------
    whole : SceneBounds
        Where everything is.
    """

    def __init__(self, whole: SceneBounds) -> None:
        self._whole = whole
        self._last: dict[str, tuple[Any, Any]] = {}
        self._completed: tuple[View, View] | None = None

    def _keep(self, name: str, key: Any, find: Callable[[], _Found]) -> _Found:
        """Return what is found for a key; the last one of each name is kept."""
        known = self._last.get(name)
        if known is None or known[0] != key:
            known = self._last[name] = key, find()
        return known[1]

    @cached_property
    def _without_outliers(self) -> Framed:
        return frame_without_outliers(self._whole)

    def bounds(self, view: View) -> SceneBounds:
        """Return what a camera that shows the whole has to show."""
        return self._without_outliers.bounds if view.frame == "auto" else self._whole

    def complete(self, view: View) -> View:
        """Return the view with a direction that is up, and a cut in the scene's coordinates."""
        known = self._completed
        if known is None or known[0] is not view:
            up, cut = self._find_up(view).vector, view.cut and view.cut.resolved(*self._box)
            complete = view if (up, cut) == (view.up, view.cut) else replace(view, up=up, cut=cut)
            known = self._completed = view, complete
        return known[1]

    @cached_property
    def _box(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The lower and the upper corner of everything, (3,) float64, in the scene's coordinates."""
        lower, upper = self._whole.origin + self._whole.local_box / np.float64(self._whole.scale)
        return lower, upper

    def _find_up(self, view: View) -> Up:
        if not isinstance(view.up, str):
            return Up(view.up, None)
        if view.camera is not None and view.camera.lens is None:
            return Up(view.camera.up, None)
        key = view.frame, view.eye, view.look_at
        return self._keep("up", key, lambda: guess_up(self.bounds(view), view.eye, view.look_at))

    def camera(self, view: View) -> Camera:
        """Return the camera of a view: the one that it has, or the one that its settings choose."""
        if view.camera is not None:
            return view.camera
        lens = view.fov, view.projection, view.aperture, view.focus_distance
        key = view.width / view.height, view.eye, view.look_at, view.up, view.side, view.frame, *lens
        chosen = {"eye": view.eye, "look_at": view.look_at, "side": view.side}
        return self._keep("camera", key, lambda: self._choose_camera(view, **chosen))

    def _choose_camera(self, view: View, **chosen: Any) -> Camera:
        if self._whole.is_empty and None in (view.eye, view.look_at):
            raise SceneError(
                "the scene shows nothing that a camera could frame: place a geometry, as in "
                "scene.place(scene.add(mesh)), or give `eye` and `look_at`, or a camera"
            )
        camera = frame_scene(
            self.bounds(view),
            aspect=view.width / view.height,
            up=view.up,  # type: ignore[arg-type]  # complete
            fov=view.fov,
            projection=view.projection,
            **chosen,
        )
        if view.aperture == 0 and view.focus_distance is None:
            return camera
        return replace(camera, aperture=view.aperture, focus_distance=view.focus_distance)

    def turn(self, view: View, count: int) -> list[Camera]:
        """Return the cameras of a full turn, which all see the whole from the same distance."""
        first = self._choose_camera(view, turns=True)
        return [first.orbit(360.0 * number / count) for number in range(count)]

    def measure(self, view: View, side: str) -> tuple[float, float]:
        """Return the width and the height of the whole, seen without perspective from a side."""
        return measure_side(self.bounds(view), side, view.up)  # type: ignore[arg-type]  # complete

    def ground(self, view: View, camera: Camera) -> Ground | None:
        """Return the ground of a picture that shows one."""
        if not shows_ground(view):
            return None
        up = sky_direction(view, camera)
        return self._keep("ground", (view.frame, *up.tolist()), lambda: find_ground(self.bounds(view), up))

    def notes(self, view: View) -> tuple[str, ...]:
        """Return what the user of a view should know: the guessed `up`, outliers, a cut beside everything."""
        notes: list[str | None] = []
        if view.camera is None:
            notes.append(self._find_up(view).note)
            is_framed = view.look_at is None and not isinstance(view.projection, Panorama)
            if is_framed and view.frame == "auto" and (left_out := self._without_outliers.note) is not None:
                notes.append(f"{left_out}; --frame all shows everything")
        if view.cut is not None:
            notes.append(view.cut.resolved(*self._box).describe_miss(*self._box))
        return tuple(note for note in notes if note is not None)


Y_UP: Vector = (0.0, 1.0, 0.0)
Z_UP: Vector = (0.0, 0.0, 1.0)
_Y, _Z = 1, 2
_UPS, _NAMES = {_Y: Y_UP, _Z: Z_UP}, "xyz"

_Array = NDArray[np.float64]

# Axes that are up by the rule of a format, and formats that mostly have z up: STL comes from CAD, for printers.
_RULED_SUFFIXES = {".gltf": _Y, ".glb": _Y, ".3mf": _Z, ".step": _Z, ".stp": _Z}
_Z_SUFFIXES = (".stl", ".off")

# Instances and points that a guess of up looks at, spread evenly; the result is the same for 1,000 to 100,000 points of
# the bunny and the dragon of Stanford.
_INSTANCES, _POINTS = 1000, 60_000

# Share of the points at either end of an axis that may be outliers.
_ENDS = 0.001

# A mesh stands on the points in this share of its height above its lowest one. They span at least a share of it both
# ways, and a multiple of that on the other axis. Nothing stands on less than a share of its own height: a rifle on its
# butt has 0.02, a man on his feet 0.06.
_CONTACT, _LEAST_BASE, _MARGIN, _LEAST_WIDTH = 0.02, 0.2, 2.0, 0.04

# A mesh is flat like a landscape if its height is below this share of its sides; one that is this many times as high as
# wide, and would fall over, is not upright by the habit of its format.
_FLAT, _TOPPLING = 0.2, 2.0

# Outliers are at most this share of all, by number and by the surface of their boxes, and the empty space around the
# others is this many diagonals of the box around them: in a picture with an outlier, they would have less than a third
# of its width. Masts and aerials, the outermost stars of a galaxy and the planets of a sun are none.
_MOST_SHARE, LEAST_GAP = 0.01, 2.0

# Primitives of the first look, which finds out whether there may be outliers, and their share at either end of an axis
# that may be some: three times as many as there can be, so that chance hides none.
_SAMPLE, _SAMPLE_ENDS = 2000, 0.03


class Up(NamedTuple):
    """The direction that is up, and a note for the user; None where nothing was guessed."""

    vector: Vector
    note: str | None


class Framed(NamedTuple):
    """What a picture of the whole frames, and a note of what it leaves out; None if that is nothing."""

    bounds: SceneBounds
    note: str | None


def guess_up(bounds: SceneBounds, eye: Vector | None = None, look_at: Vector | None = None) -> Up:
    """Return the direction that is probably up: y or z, by the shape, or by the habit of the format; y without reason.

    Parameters
    ----------
    bounds : SceneBounds
        Names of meshes may end in the suffix of their file.
    eye, look_at : (3,) float, optional
        Of the camera; one that looks along the guess has the other axis.

    Examples
    --------
    >>> import clbvh
    >>> from clbvh.views.cameras.bounds import SceneBounds
    >>> from clbvh.views.view_finder import guess_up
    >>> guess_up(SceneBounds.of_mesh(clbvh.make_shape("terrain", triangles=2000))).note
    'y is up: the mesh is flat along y, like a landscape; --up 0,0,1 turns it'
    """
    meshes = [shape for shape in bounds.shapes if isinstance(shape, Mesh)]
    suffixes = {PurePath(mesh.name).suffix.lower() for mesh in meshes}
    suffix = suffixes.pop() if len(suffixes) == 1 else ""
    axis, reason = _choose_axis(_sample_points(bounds), suffix, can_stand=bool(meshes))
    other = _Y + _Z - axis
    if eye is not None:
        target = bounds.origin if look_at is None else np.asarray(look_at, np.float64)
        if not np.cross(target - np.asarray(eye, np.float64), _UPS[axis]).any():
            return Up(_UPS[other], None)
    turned = ",".join(f"{part:g}" for part in _UPS[other])
    return Up(_UPS[axis], reason and f"{_NAMES[axis]} is up: {reason}; --up {turned} turns it")


def frame_without_outliers(bounds: SceneBounds) -> Framed:
    """Return a scene without a few small parts far away, which would make everything else small.

    Of a single instance, primitives are left out; of several instances, whole ones.

    Examples
    --------
    >>> import clbvh
    >>> import numpy as np
    >>> from clbvh.views.cameras.bounds import SceneBounds
    >>> from clbvh.views.view_finder import frame_without_outliers
    >>> ball = clbvh.make_shape("icosphere", triangles=320)
    >>> corners = np.concatenate((ball.vertices, [[90, 0, 0], [90, 0.1, 0], [90, 0, 0.1]]))
    >>> faces = np.concatenate((ball.faces, [[162, 163, 164]]))
    >>> frame_without_outliers(SceneBounds.of_mesh(clbvh.Mesh.from_arrays(corners, faces))).note
    '1 of 321 triangles (0.3 %) is far away from the others and is left out of the frame'
    """
    placed = [bounds.shapes[geometry_id] for geometry_id in bounds.geometry_ids.tolist()]
    if len(placed) == 1:
        far = _find_far_prims(placed[0])
        if far is None:
            return Framed(bounds, None)
        counts = np.ones(len(far), np.int64)
        kept = SceneBounds((_without(placed[0], far),), np.zeros(1, np.int64), bounds.transforms)
    else:
        counts = np.array([shape.prim_count for shape in placed])
        far = find_outliers(*bounds.instance_boxes(), counts)
        if not far.any():
            return Framed(bounds, None)
        kept = SceneBounds(bounds.shapes, bounds.geometry_ids[~far], bounds.transforms[~far])
    count, total = int(counts[far].sum()), int(counts.sum())
    share, verb = 100 * count / total, "is" if count == 1 else "are"
    shown = f"{share:.1f}" if share >= 0.1 else f"{share:.2g}"
    name = "triangles" if all(shape.kind is TRIANGLES for shape in bounds.shapes) else "primitives"
    note = f"{count:,} of {total:,} {name} ({shown} %) {verb} far away from the others and {verb} left out of the frame"
    return Framed(kept, note if count else None)


def find_outliers(lower: NDArray[np.floating], upper: NDArray[np.floating], counts: ArrayLike) -> NDArray[np.bool_]:
    """Return which things are outliers, (n,) bool: few, small, and far away from all others.

    A box grows from the middle of the things over all that is near it until nothing is. What is left are outliers if
    they are few. O(n log n). The result does not depend on the order of the things.

    Parameters
    ----------
    lower, upper : (n, 3) float
        Corners of the boxes around the things.
    counts : (n,) int
        How many primitives each thing is.
    """
    begins, ends, counts = np.asarray(lower, np.float64), np.asarray(upper, np.float64), np.asarray(counts, np.float64)
    # Along each axis, both ends are at things that are no outliers.
    middles = begins / 2 + ends / 2
    box_lower, box_upper = _find_end(middles, counts), -_find_end(-middles, counts)
    rest = np.arange(len(begins))
    # A dozen steps are usual, and the box triples in every two: what a step adds was out of reach of the box before.
    while True:
        reach = LEAST_GAP * np.linalg.norm(box_upper - box_lower)
        gaps = np.maximum(np.maximum(begins[rest] - box_upper, box_lower - ends[rest]), 0.0)
        is_near = np.linalg.norm(gaps, axis=1) <= reach
        if not is_near.any():
            break
        near, rest = rest[is_near], rest[~is_near]
        box_lower = np.minimum(box_lower, begins[near].min(axis=0))
        box_upper = np.maximum(box_upper, ends[near].max(axis=0))
    x, y, z = ((ends - begins) / max(float((box_upper - box_lower).max()), np.finfo(float).tiny)).T
    is_few = all(each[rest].sum() <= _MOST_SHARE * each.sum() for each in (counts, x * y + y * z + z * x))
    return np.isin(np.arange(len(begins)), rest) & (is_few and bool((box_upper > box_lower).any()))


def _find_end(points: _Array, counts: _Array) -> _Array:
    """Return (3,) float64: along each axis the first point with more than the share of outliers up to it."""
    order = np.argsort(points, axis=0, kind="stable")
    so_far = np.cumsum(counts[order], axis=0)
    row = np.argmax(so_far > _MOST_SHARE * so_far[-1], axis=0)
    return points[order[row, range(3)], range(3)]


def _find_far_prims(shape: Shape) -> NDArray[np.bool_] | None:
    """Return which primitives are outliers; None if neither they nor unused vertices are far away."""
    whole = np.linalg.norm(np.ptp(shape.local_box.astype(np.float64), axis=0))
    lower, upper = _bound_prims(shape, slice(None, None, -(-shape.prim_count // _SAMPLE)))
    begin, end = np.quantile(np.concatenate((lower, upper)), [_SAMPLE_ENDS, 1 - _SAMPLE_ENDS], axis=0)
    if not whole >= LEAST_GAP * np.linalg.norm(end - begin) > 0:
        return None
    lower, upper = _bound_prims(shape, slice(None))
    is_far = find_outliers(lower, upper, np.ones(len(lower)))
    rest = upper[~is_far].max(axis=0) - lower[~is_far].min(axis=0)
    return is_far if is_far.any() or whole >= LEAST_GAP * np.linalg.norm(rest) else None


def _bound_prims(shape: Shape, chosen: slice) -> tuple[_Array, _Array]:
    """Return the lower and the upper corners of boxes around primitives, (n, 3), in local units."""
    points, ids = shape.find_corners()
    corners = points[ids[chosen]].astype(np.float64)
    return corners.min(axis=1), corners.max(axis=1)


def _without(shape: Shape, is_far: NDArray[np.bool_]) -> Shape:
    """Return a shape without some primitives, and without vertices that no other face uses."""
    if not isinstance(shape, Mesh):
        return Spheres(shape.centres[~is_far], shape.radii[~is_far], name=shape.name)
    vertices, faces = np.unique(shape.faces[~is_far], return_inverse=True)
    return Mesh.from_arrays(shape.vertices[vertices], faces.reshape(-1, 3), name=shape.name)


def _sample_points(bounds: SceneBounds) -> _Array:
    """Return corners of triangles and centres of spheres, (n, 3), spread evenly over a scene, in local units."""
    chosen = range(0, len(bounds.geometry_ids), -(-len(bounds.geometry_ids) // _INSTANCES))
    points = []
    for instance in chosen:
        shape = bounds.shapes[bounds.geometry_ids[instance]]
        step = slice(None, None, -(-shape.prim_count * len(chosen) // _POINTS))
        points.append(bounds.points(instance, shape.faces[step].ravel() if isinstance(shape, Mesh) else step))
    return np.concatenate(points)


def _choose_axis(points: _Array, suffix: str, can_stand: bool) -> tuple[int, str | None]:
    """Return the axis that is up, and the reason; None for the rule of a format, and for y for lack of a reason.

    Spheres cannot stand: the lowest ones of a cloud are where chance has put them.
    """
    if (ruled := _RULED_SUFFIXES.get(suffix)) is not None:
        return ruled, None if ruled == _Y else f"{suffix[1:].upper()} files have it so"
    lower, upper = np.quantile(points, [_ENDS, 1 - _ENDS], axis=0)
    sides = upper - lower
    for axis in (_Z, _Y):
        if 0 < sides[axis] < _FLAT * np.delete(sides, axis).min():
            return axis, f"the mesh is flat along {_NAMES[axis]}, like a landscape"
    bases = {axis: _measure_base(points, lower, sides, axis) if can_stand else 0.0 for axis in (_Y, _Z)}
    for axis, other in ((_Y, _Z), (_Z, _Y)):
        if bases[axis] >= max(_LEAST_BASE, _MARGIN * bases[other]):
            return axis, f"the mesh stands on a wide base along {_NAMES[axis]}, but not along {_NAMES[other]}"
    if suffix not in _Z_SUFFIXES:
        return _Y, None
    if bases[_Z] == 0 and sides[_Z] > _TOPPLING * sides[:2].max():
        return _Y, "the mesh is long along z, and would not stand on its end"
    return _Z, f"most {suffix[1:].upper()} files have it so, and nothing in its shape says otherwise"


def _measure_base(points: _Array, lower: _Array, sides: _Array, axis: int) -> float:
    """Return the share of the sides that the lowest points span, both ways; 0 if the mesh would fall over."""
    if not (sides > 0).all():
        return 0.0
    low = points[points[:, axis] <= lower[axis] + _CONTACT * sides[axis]]
    across = [other for other in range(3) if other != axis]
    begin, end = np.quantile(low[:, across], [_CONTACT, 1 - _CONTACT], axis=0)
    centre = points[:, across].mean(axis=0)
    is_standing = (end - begin >= _LEAST_WIDTH * sides[axis]) & (begin < centre) & (centre < end)
    return float(np.min((end - begin) / sides[across])) if is_standing.all() else 0.0
