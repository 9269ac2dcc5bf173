"""The part of a view that depends on what is seen: up, the camera that shows the whole, the ground, and notes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .cameras.bounds import SceneBounds
from .cameras.camera import Camera
from .cameras.framing import frame_scene, measure_side
from .cameras.projection import Panorama
from .guesses import Framed, Up, frame_without_outliers, guess_up
from .kernel_view import Ground, find_ground, shows_ground, sky_direction
from .view import View

_Found = TypeVar("_Found")


class ViewFinder:
    """Finds what views leave open, for one scene. The last answers are kept: each reads all vertices.

    All but `complete` and `notes` take views that `complete` has returned.

    Parameters
    ----------
    whole : SceneBounds
        Where everything is.
    """

    def __init__(self, whole: SceneBounds) -> None:
        self._whole = whole
        self._last: dict[str, tuple[Any, Any]] = {}

    def _keep(self, name: str, key: Any, find: Callable[[], _Found]) -> _Found:
        """Return what is found for a key; the last one of each name is kept."""
        known = self._last.get(name)
        if known is None or known[0] != key:
            known = self._last[name] = key, find()
        return known[1]

    @cached_property
    def _without_outliers(self) -> Framed:
        return frame_without_outliers(self._whole)

    def bounds(self, view: View) -> SceneBounds:
        """Return what a camera that shows the whole has to show."""
        return self._without_outliers.bounds if view.frame == "auto" else self._whole

    def complete(self, view: View) -> View:
        """Return the view with a direction that is up, and a cut in the scene's coordinates."""
        up = self._find_up(view).vector
        cut = view.cut
        if cut is not None:
            cut = cut.resolved(*self._box)
        return view if (up, cut) == (view.up, view.cut) else replace(view, up=up, cut=cut)

    @cached_property
    def _box(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The lower and the upper corner of everything, (3,) float64, in the scene's coordinates."""
        lower, upper = self._whole.origin + self._whole.local_box / np.float64(self._whole.scale)
        return lower, upper

    def _find_up(self, view: View) -> Up:
        if not isinstance(view.up, str):
            return Up(view.up, None)
        if view.camera is not None and view.camera.lens is None:
            return Up(view.camera.up, None)
        bounds = self.bounds(view)
        return self._keep("up", (view.frame, view.eye, view.look_at), lambda: guess_up(bounds, view.eye, view.look_at))

    def camera(self, view: View) -> Camera:
        """Return the camera of a view: the one that it has, or the one that its settings choose."""
        if view.camera is not None:
            return view.camera
        lens = view.fov, view.projection, view.aperture, view.focus_distance
        key = view.width / view.height, view.eye, view.look_at, view.up, view.side, view.frame, *lens
        return self._keep("camera", key, lambda: self._choose_camera(view))

    def _choose_camera(self, view: View) -> Camera:
        camera = frame_scene(
            self.bounds(view),
            aspect=view.width / view.height,
            up=view.up,  # type: ignore[arg-type]  # complete
            fov=view.fov,
            eye=view.eye,
            look_at=view.look_at,
            projection=view.projection,
            side=view.side,
        )
        if view.aperture == 0 and view.focus_distance is None:
            return camera
        return replace(camera, aperture=view.aperture, focus_distance=view.focus_distance)

    def turn(self, view: View, count: int) -> list[Camera]:
        """Return the cameras of a full turn, which all see the whole from the same distance."""
        first = frame_scene(
            self.bounds(view),
            turns=True,
            aspect=view.width / view.height,
            up=view.up,  # type: ignore[arg-type]  # complete
            fov=view.fov,
            projection=view.projection,
        )
        if view.aperture:
            first = replace(first, aperture=view.aperture, focus_distance=view.focus_distance)
        return [first.orbit(360.0 * number / count) for number in range(count)]

    def measure(self, view: View, side: str) -> tuple[float, float]:
        """Return the width and the height of the whole, seen without perspective from a side."""
        return measure_side(self.bounds(view), side, view.up)  # type: ignore[arg-type]  # complete

    def ground(self, view: View, camera: Camera) -> Ground | None:
        """Return the ground of a picture that shows one."""
        if not shows_ground(view):
            return None
        up = sky_direction(view, camera)
        return self._keep("ground", (view.frame, *up.tolist()), lambda: find_ground(self.bounds(view), up))

    def notes(self, view: View) -> tuple[str, ...]:
        """Return what the user of a view should know: the guessed `up`, outliers, a cut beside everything."""
        notes: list[str | None] = []
        if view.camera is None:
            notes.append(self._find_up(view).note)
            is_framed = view.look_at is None and not isinstance(view.projection, Panorama)
            if is_framed and view.frame == "auto" and (left_out := self._without_outliers.note) is not None:
                notes.append(f"{left_out}; --frame all shows everything")
        if view.cut is not None:
            notes.append(view.cut.resolved(*self._box).describe_miss(*self._box))
        return tuple(note for note in notes if note is not None)
