"""The tables of times of a renderer and of its pictures, in milliseconds: the same phases in the same order."""

from __future__ import annotations

from collections.abc import Mapping

from ..builders.tree_maker import MadeTree
from ..device.timing import EventTimes
from ..support.stopwatch import Stopwatch, add_total

# Runs alongside other phases.
_OVERLAPPING = ("pool_start",)


def list_setup_ms(watch: Stopwatch, made: MadeTree | None, upload_ms: float) -> dict[str, float]:
    """Return the timings of a `Renderer`; see `Picture.timings`.

    Parameters
    ----------
    watch : Stopwatch
        With the laps load, open and layout.
    made : MadeTree or None
        The tree, if the renderer has made one.
    upload_ms : float
        Time of the uploads, which are part of the lap layout.
    """
    code_ms, total_ms, laps_ms = watch.code_ms, watch.total_ms, watch.laps_ms
    phases_ms = {
        "load": laps_ms["load"],
        **(dict.fromkeys(("pool_start", "cache", "build"), 0.0) if made is None else made.timings_ms),
        "open": laps_ms["open"],
        # The tree is uploaded as it is arranged; the upload has a row of its own.
        "layout": max(laps_ms["layout"] - upload_ms, 0.0),
        **code_ms,
        "upload": upload_ms,
        "kernel": 0.0,
        "download": 0.0,
    }
    return add_total(phases_ms, total_ms, overlapping=_OVERLAPPING)


def list_picture_ms(setup_ms: Mapping[str, float], times: EventTimes, watch: Stopwatch) -> dict[str, float]:
    """Return the timings of a `Picture`: its own phases; those of the set-up take no time."""
    own_ms, total_ms = {**times.sums_ms(), **watch.code_ms}, watch.total_ms
    phases_ms = {phase: own_ms.get(phase, 0.0) for phase in setup_ms if phase not in ("other", "total")}
    return add_total(phases_ms, total_ms, overlapping=_OVERLAPPING)
