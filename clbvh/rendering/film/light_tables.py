"""The light that paths draw, as the device takes it: primitives that emit, by their power; see cl/film/lights.cl."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError
from ...geometry import Mesh
from ...geometry.appearance.material import OPAQUE, Material
from ...geometry.spheres import Shape, Spheres
from ...structs import LIGHT, LIGHT_CHOICE

# Weights of linear red, green and blue in the luminance (ITU-R BT.709).
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

# Spheres that a map stretches by more than this share are no lights that paths draw, as their area is not a sphere's.
_MOST_STRETCH = 1e-4

_MOST_LIGHTS = 2**24


@dataclass(frozen=True, eq=False)
class LightTables:
    """The tables, by the names of the kernels' arguments.

    Attributes
    ----------
    arrays : dict of str to array
    power : float
        Sum of luminance times area, in local units.
    count : int
        Emitting primitives.
    """

    arrays: dict[str, NDArray[Any]]
    power: float
    count: int

    def describe(self, view: NDArray[np.void]) -> None:
        """Fill what the view, (1,) `structs.VIEW`, says of the lights."""
        view["light_count"], view["light_power"] = self.count, self.power


def local_maps(transforms: NDArray[np.float64], origin: NDArray[np.float64], scale: float) -> NDArray[np.float64]:
    """Return (n, 4, 4) float64: (n, 4, 4) transforms, followed by the map to local coordinates."""
    maps = np.array(transforms, np.float64)
    maps[:, :3, 3] -= origin
    maps[:, :3] *= scale
    return maps


def emits_light(shape: Shape) -> NDArray[np.bool_]:
    """Return (m,) bool: whether each material of a shape emits light that paths may draw.

    That light is the same everywhere on the surface, and the surface is all there: the points of a light are drawn
    without regard to textures and alpha.
    """
    materials = () if shape.appearance is None else shape.appearance.materials
    return np.array([is_drawable_light(each) for each in materials], bool)


def is_drawable_light(material: Material) -> bool:
    """Return whether the light of a material depends neither on textures nor on alpha."""
    texture = material.base_colour_texture
    is_whole = material.alpha >= 1.0 and (texture is None or texture.is_opaque)
    return any(material.emission) and material.emission_texture is None and is_whole


def _has_whole_colours(shape: Shape) -> bool:
    colours = None if shape.appearance is None else shape.appearance.colours
    return colours is None or bool((colours[..., 3] == OPAQUE).all())


def is_similar(linear: NDArray[np.float64]) -> bool:
    """Return whether a (3, 3) map keeps the shape of spheres."""
    stretches = np.linalg.svd(linear, compute_uv=False)
    return bool(stretches[0] - stretches[2] <= _MOST_STRETCH * stretches[0])


def find_lights(
    shapes: Sequence[Shape], geometry_ids: NDArray[np.integer], to_local: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return (n,) bool: the instances whose emitting primitives are in the tables; see `make_light_tables`."""
    emits = np.array([emits_light(shape).any() and _has_whole_colours(shape) for shape in shapes], bool)
    emits = emits[np.asarray(geometry_ids)]
    for number in np.flatnonzero(emits):
        is_mesh = isinstance(shapes[geometry_ids[number]], Mesh)
        emits[number] = is_mesh or is_similar(to_local[number, :3, :3])
    return emits


def make_light_tables(
    shapes: Sequence[Shape], geometry_ids: NDArray[np.integer], to_local: NDArray[np.float64]
) -> LightTables:
    """Return the tables of a scene.

    Parameters
    ----------
    shapes : sequence of Mesh or Spheres
    geometry_ids : (n,) int
        The shape of each instance.
    to_local : (n, 4, 4) float64
        From each instance's coordinates to the local ones of pictures.

    Raises
    ------
    SceneError
        More primitives emit light than the tables hold.
    """
    rows, areas = [], []
    for number in np.flatnonzero(find_lights(shapes, geometry_ids, to_local)):
        shape = shapes[geometry_ids[number]]
        lights, area = _list_lights(shape, emits_light(shape), to_local[number])
        rows.append(lights)
        areas.append(area)
    lights = np.concatenate(rows) if rows else np.zeros(0, LIGHT)
    if len(lights) > _MOST_LIGHTS:
        raise SceneError(f"{len(lights):,} primitives emit light, and there is room for {_MOST_LIGHTS:,}")
    powers = (np.concatenate(areas) if areas else np.zeros(0)) * (lights["emission"].astype(np.float64) @ LUMINANCE)
    power = float(powers.sum())
    # A table without rows still needs a buffer.
    arrays = {
        "lights": lights if len(lights) else np.zeros(1, LIGHT),
        "light_choices": make_alias_table(powers if power > 0 else np.ones(1)),
    }
    return LightTables(arrays, power, len(lights) if power > 0 else 0)


def _list_lights(
    shape: Mesh | Spheres, emitting: NDArray[np.bool_], place: NDArray[np.float64]
) -> tuple[NDArray[np.void], NDArray[np.float64]]:
    """Return the emitting primitives of an instance, and their areas in local units."""
    appearance = shape.appearance
    assert appearance is not None
    ids = np.zeros(shape.prim_count, np.int64) if appearance.material_ids is None else appearance.material_ids
    chosen = np.flatnonzero(emitting[ids])
    emissions = np.array([material.emission for material in appearance.materials])[ids[chosen]]
    lights = np.zeros(len(chosen), LIGHT)
    lights["emission"] = emissions
    linear, shift = place[:3, :3], place[:3, 3]
    if isinstance(shape, Mesh):
        corners = shape.vertices[shape.faces[chosen]] @ linear.T + shift
        ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        lights["a"], lights["ab"], lights["ac"] = corners[:, 0], ab, ac
        return lights, np.linalg.norm(np.cross(ab, ac), axis=1) / 2
    radii = shape.radii[chosen] * np.cbrt(abs(np.linalg.det(linear)))
    lights["a"], lights["radius"] = shape.centres[chosen] @ linear.T + shift, radii
    return lights, 4 * np.pi * radii**2


# Weights are whole numbers whose mean is this one: sums of 2^24 of them are exact in 64 bits.
_MEAN = 2**32


def make_alias_table(weights: NDArray[np.float64]) -> NDArray[np.void]:
    """Return the table, (n,) `structs.LIGHT_CHOICE`.

    The probability of each thing is exact but for its rounding to a multiple of 2^-32 / n, and for the sum of all these
    roundings, which the largest one takes.

    The table is that of Vose's algorithm ("A linear algorithm for generating random numbers with a given distribution",
    1991), by prefix sums instead of lists: the things below the mean take what they lack from those above it, in order,
    and one that has given too much takes that from the next one.

    Parameters
    ----------
    weights : (n,) float64, 0 or more
        At least one of them above 0.
    """
    count = len(weights)
    # Divided first: the sum of the largest float64 numbers is none.
    shares = weights / weights.max()
    whole = np.rint(shares * (_MEAN * count / shares.sum())).astype(np.int64)
    whole[np.argmax(whole)] += _MEAN * count - int(whole.sum())

    below = np.flatnonzero(whole < _MEAN)
    above = np.flatnonzero(whole >= _MEAN)
    # What things lack that come before each one, and what has been given up to each one.
    lacks = np.concatenate([[0], np.cumsum(_MEAN - whole[below])])
    gifts = np.cumsum(whole[above] - _MEAN)

    keeps, aliases = whole.copy(), np.arange(count)
    aliases[below] = above[np.searchsorted(gifts, lacks[:-1], side="right")]
    # After its last gift, a thing may have less than the mean: what it lacks is taken from the next one.
    taken = lacks[np.searchsorted(lacks[:-1], gifts, side="left")]
    keeps[above] = _MEAN + gifts - taken
    aliases[above[:-1]] = above[1:]

    table = np.zeros(count, LIGHT_CHOICE)
    is_whole = keeps >= _MEAN
    table["threshold"] = np.where(is_whole, 0, keeps)
    table["alias"] = np.where(is_whole, np.arange(count), aliases)
    return table
