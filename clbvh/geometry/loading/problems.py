"""What is wrong with the looks of a file: one warning for all of it, and the triangles are read nevertheless."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ...errors import AppearanceWarning

_MAX_SHOWN = 3  # problems in a warning
_MAX_DETAIL_LENGTH = 200  # characters of an error's message
_PACKAGE = Path(__file__).parents[2]


class Problems:
    """Sentences about attributes that cannot be used."""

    def __init__(self) -> None:
        self._sentences: dict[str, None] = {}

    def add(self, sentence: str) -> None:
        """Remember a sentence; equal ones count as one."""
        self._sentences[sentence] = None

    @contextmanager
    def drop(self, subject: str) -> Iterator[None]:
        """Turn any error of the statements into a sentence: what they would have set is dropped.

        Files may hold anything, and decoders raise anything.
        """
        try:
            yield
        except Exception as error:
            detail = " ".join(str(error).split())[:_MAX_DETAIL_LENGTH] or type(error).__name__
            self.add(f"{subject} cannot be used: {detail}")

    def warn(self, source: str) -> None:
        """Issue one `AppearanceWarning` about a file, if there is a sentence."""
        if not self._sentences:
            return
        sentences = list(self._sentences)
        rest = f"; and {len(sentences) - _MAX_SHOWN} more" if len(sentences) > _MAX_SHOWN else ""
        text = f"{source}: {'; '.join(sentences[:_MAX_SHOWN])}{rest}"
        warnings.warn(text, AppearanceWarning, stacklevel=_count_own_frames())


def _count_own_frames() -> int:
    """Return the stack level of the first caller outside of clbvh, as `warn` counts from the method above."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_code.co_filename.startswith(f"{_PACKAGE}{os.sep}"):
        frame, level = frame.f_back, level + 1
    return level
