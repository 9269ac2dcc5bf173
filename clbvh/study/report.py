"""The figures of the report, from one data file with their sources."""

from __future__ import annotations

import tomllib
from functools import cache, reduce
from operator import getitem
from pathlib import Path
from typing import Any

from ..errors import InternalError

TITLE = "Parallel BVH Construction and Traversal for Accelerated Ray Tracing"


@cache
def _read() -> dict[str, Any]:
    return tomllib.loads(Path(__file__).with_name("report.toml").read_text("utf-8"))


def published(path: str) -> Any:
    """Return a figure or a table of the report by its path, such as ``"scaling.build_ms"``.

    Raises
    ------
    InternalError
        The report has no such figure.
    """
    try:
        return reduce(getitem, path.split("."), _read())
    except (KeyError, TypeError):
        raise InternalError(f"report.toml has no '{path}'") from None


def curve(path: str) -> dict[int, float]:
    """Return a table of the report whose keys are numbers."""
    return {int(key): float(value) for key, value in published(path).items()}


def source_of(experiment: str) -> str:
    """Return where in the report the figures of an experiment stand."""
    return str(published(experiment)["source"])
