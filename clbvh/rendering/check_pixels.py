"""The check of a picture against a slow reference that shares no code with the device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..errors import ValidationError
from ..trace.check.intersections import Rays
from ..trace.check.reference import Difference, Reference
from ..trace.hits.hits import Hits
from ..views.cut import Cut
from .picture import Picture

# Most tests of a primitive against a ray in a validation: about a second.
_MOST_TESTS = 50_000_000

# The instances that a ray of a picture comes near: those that it does not are left out by their size alone.
_INSTANCES_PER_RAY = 32


def check_pixels(picture: Picture) -> Picture:
    """Compare a sample of the pixels with the reference; return the picture with the number of compared pixels.

    Raises
    ------
    ValidationError
        A pixel differs; the message names the first one.
    """
    height, width = picture.found.shape
    state = picture.scene.state
    prim_counts = np.array([shape.prim_count for shape in state.shapes], np.int64)[state.geometry_ids]
    # Of one ray, about, and one test of each instance's bounding sphere.
    test_count = int(np.sort(prim_counts)[-_INSTANCES_PER_RAY:].sum()) + len(prim_counts)
    pixel_count = min(width * height, max(1, _MOST_TESTS // max(1, test_count)))
    # Spread evenly over the picture, the same ones each time; all of them if there are few.
    pixels = np.linspace(0, width * height - 1, pixel_count).astype(np.int64)
    # Outside the circle of a fisheye, pixels have rays that nobody casts.
    pixels = pixels[picture.camera.sees(width, height).reshape(-1)[pixels]]
    differences = _find_differences(picture, pixels) if len(pixels) else ()
    if differences:
        first = differences[0]
        row, column = divmod(int(pixels[first.ray]), width)
        raise ValidationError(
            f"{len(differences)} of {len(pixels)} pixels differ from the reference; the first one is at column "
            f"{column}, row {row}: {first}"
        )
    return replace(picture, validated_pixels=len(pixels))


def _find_differences(picture: Picture, pixels: NDArray[np.int64]) -> Sequence[Difference]:
    height, width = picture.found.shape
    origins, directions = (rays.reshape(-1, 3)[pixels] for rays in picture.camera.rays(width, height))
    hits = picture.hits.take(pixels)
    # Pictures show all instances but those that no ray sees.
    reference = Reference(picture.scene.state)
    if picture.cut is not None:
        return _find_differences_beside(picture.cut, reference, origins, directions, hits)
    return reference.find_differences(Rays.make(origins, directions), hits)


def _find_differences_beside(
    cut: Cut, reference: Reference, origins: NDArray[np.float64], directions: NDArray[np.float64], hits: Hits
) -> Sequence[Difference]:
    """Compare the hits before a cut, and, of the rays that have none there, those behind it."""
    begin, end = cut.ranges(origins, directions)
    is_cut = begin <= end
    before = np.where(is_cut, begin, np.inf)
    behind = np.maximum(end, 0.0)
    is_before = hits.is_hit & (hits.t <= before)

    differences: list[Difference] = []
    for chosen, t_min, t_max in (
        (is_before, np.zeros_like(before), before),
        (~is_before & is_cut, behind, np.full_like(behind, np.inf)),
    ):
        rays = np.flatnonzero(chosen & (t_min <= t_max) & np.isfinite(t_min))
        asked = Rays.make(origins[rays], directions[rays], t_min[rays], t_max[rays])
        found = reference.find_differences(asked, hits.take(rays))
        differences += [replace(each, ray=int(rays[each.ray])) for each in found]

    rays = np.flatnonzero(~is_before & (before >= 0))
    asked = Rays.make(origins[rays], directions[rays], 0.0, before[rays])
    least, _ = reference.count_range(asked)
    nearest = reference.closest_hit(asked)
    for number in np.flatnonzero(least > 0).tolist():
        ray = int(rays[number])
        expected = float(nearest.t[number]), int(nearest.instance_id[number]), int(nearest.prim_id[number])
        obtained = float(hits.t[ray]), int(hits.instance_id[ray]), int(hits.prim_id[ray])
        differences.append(Difference(ray, "a primitive before the cut is surely hit", obtained, expected))
    return differences
