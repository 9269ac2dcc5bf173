"""What a terminal shows while a picture is made, and Ctrl-C for a picture that is to be kept."""

from __future__ import annotations

import threading
import time
from contextlib import nullcontext
from typing import TYPE_CHECKING

from .signals import calling_on_interrupt

if TYPE_CHECKING:
    from ..rendering.picture import Picture
    from ..rendering.render import RenderOptions
    from ..rendering.scene import Scene

# No estimate before this many seconds: the first samples say little.
_LEAST_S = 0.5


def render_with_status(
    scene: Scene, options: RenderOptions, *, time_limit_s: float | None = None, keeps: bool = False
) -> Picture:
    """Render, and show the phase, the share of the samples and the time that is left if stderr is a terminal.

    Parameters
    ----------
    scene : Scene
    options : RenderOptions
    time_limit_s : float, optional
        See `Renderer.render`.
    keeps : bool
        Whether Ctrl-C ends the picture early instead of the process.
    """
    from rich.console import Console

    from ..rendering.render import render

    stopped = threading.Event()
    console = Console(stderr=True)
    with console.status("") as status, calling_on_interrupt(stopped.set) if keeps else nullcontext():
        begin = time.perf_counter()

        def show(done: int, total: int) -> None:
            spent = time.perf_counter() - begin
            left = spent * (total - done) / done
            if time_limit_s is not None:
                status.update(f"render: {spent:.0f} of {time_limit_s:.0f} s ...")
            elif spent > _LEAST_S:
                status.update(f"render: {100 * done // total} %, about {left:.0f} s left ...")

        return render(
            scene, options, time_limit_s=time_limit_s, on_samples=show, is_stopped=stopped.is_set,
            on_phase=lambda phase: status.update(f"{phase} ..."),
        )  # fmt: skip
