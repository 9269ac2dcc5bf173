"""The last step of reading looks: arrays and materials become an `Appearance`, or nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from numpy.typing import NDArray

from ..appearance.appearance import Appearance, make_unchecked
from ..appearance.material import Material

# The colours of a file that has no materials are not tinted.
_WHITE = Material(base_colour=(1.0, 1.0, 1.0))


def finish_looks(arrays: Mapping[str, NDArray], materials: Sequence[Material]) -> Appearance | None:
    """Return an appearance of checked arrays, None if there is nothing to say.

    Colours without a material are those of a white one. A material that differs in nothing from the one that every
    surface has is none.
    """
    if not materials and "colours" in arrays:
        materials = [_WHITE]
    if not arrays and all(material == Material() for material in materials):
        return None
    return make_unchecked(**arrays, materials=tuple(materials))
