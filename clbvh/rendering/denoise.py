"""Pictures without noise, by Intel's Open Image Denoise; see `View.denoise`."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError

# Of each pixel, for the base colours that guide the filter: edges and textures are smooth.
GUIDE_SAMPLES = 4


def import_denoiser() -> ModuleType:
    """Return the library, or raise a `ConfigError` that says how to install it."""
    try:
        import pyoidn
    except (ImportError, OSError) as error:  # its own libraries are loaded on import
        raise ConfigError(f"denoise needs pyoidn: run 'pip install pyoidn' ({error})") from error
    return pyoidn


def denoise_film(film: NDArray[np.float32], base_colours: NDArray[np.float32], normals: NDArray[np.floating]) -> None:
    """Take the noise out of a film, in place.

    The filter keeps what the base colours and the normals of the surfaces show: edges and textures.

    Parameters
    ----------
    film : (height, width, 4) float32
        Means of samples; the covered share stays as it is.
    base_colours : (height, width, 4) float32
        The film of the same view in the shading ``albedo``.
    normals : (height, width, 3) float
        Shading normals at the centres of the pixels, NaN on a miss.
    """
    film[..., :3] = import_denoiser().denoise(
        _contiguous(film[..., :3]),
        albedo=_contiguous(base_colours[..., :3].clip(0.0, 1.0)),
        normal=_contiguous(np.nan_to_num(normals)),
        hdr=True,
    )


def _contiguous(values: NDArray[Any]) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, np.float32)
