"""The check of a picture against a slow reference that shares no code with the device."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import ConfigError, ValidationError
from ..trace.oracle.reference import find_differences
from .picture import Picture

# Most ray-triangle tests of a validation: about a second.
_MOST_TESTS = 50_000_000


def check_pixels(picture: Picture) -> Picture:
    """Compare a sample of the pixels with the reference; return the picture with the number of compared pixels.

    Raises
    ------
    ValidationError
        A pixel differs; the message names the first one.
    ConfigError
        The picture shows several objects.
    """
    if picture.mesh is None:
        raise ConfigError("pictures of several objects cannot be validated yet: leave the check out")
    height, width = picture.found.shape
    pixel_count = min(width * height, max(1, _MOST_TESTS // picture.mesh.face_count))
    # Spread evenly over the picture, the same ones each time; all of them if there are few.
    pixels = np.linspace(0, width * height - 1, pixel_count).astype(np.int64)
    origins, directions = picture.camera.rays(width, height)
    differences = find_differences(
        picture.mesh, origins.reshape(-1, 3)[pixels], directions.reshape(-1, 3)[pixels], picture.hits.take(pixels)
    )
    if differences:
        first = differences[0]
        row, column = divmod(int(pixels[first.ray]), width)
        raise ValidationError(
            f"{len(differences)} of {pixel_count} pixels differ from the reference; the first one is at column "
            f"{column}, row {row}: {first}"
        )
    return replace(picture, validated_pixels=pixel_count)
