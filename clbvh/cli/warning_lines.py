"""Warnings about the user's files: one line each on stderr, without a line of a program that the user has not made."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from ..errors import ClbvhWarning


@contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Print each warning of clbvh as one line; those of others are shown as always."""
    with warnings.catch_warnings():
        show = warnings.showwarning

        def show_line(message: Warning | str, category: type[Warning], *rest: Any, **named: Any) -> None:
            if issubclass(category, ClbvhWarning):
                print(f"clbvh: warning: {message}", file=sys.stderr)
            else:
                show(message, category, *rest, **named)

        warnings.showwarning = show_line
        warnings.simplefilter("always", ClbvhWarning)
        yield
