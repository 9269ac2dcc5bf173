"""One page that looks at a scene: events in, pictures out, whatever carries them.

Owns what the page shows: the view, the selection, and the thread that renders. The thread renders the newest view: at a
lower resolution and with few samples while something moves, then with more and more samples, up to those of the view.
The settled picture is that of `Renderer.render`, byte for byte. Knows neither sockets nor notebooks; the messages are
listed in docs/internals/viewer.md.
"""

from __future__ import annotations

import math
import re
import reprlib
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from ..choices import REPORT_SHADINGS, SHADINGS, STANDARD_VIEWS
from ..errors import ClbvhError, ConfigError
from ..files.image_files import encode_picture
from ..rendering.picture import Picture
from ..rendering.renderer import Renderer
from ..support.settings import Vector
from ..views.cameras.arrays import as_vector
from ..views.cameras.camera import Camera
from ..views.view import View
from . import navigate
from .inspect import Picked, describe_hit, encode_mask, place_marks
from .phrase import phrase_command, phrase_python

Send: TypeAlias = Callable[[dict[str, Any], bytes], None]
"""Carries a message to the page: the message, and its binary part, which may be empty."""

# Of the first picture of objects without colours: it needs no tables of surfaces, which take as long as the tree.
FIRST_SHADING = "lambert"

# Seconds of a picture while something moves: 30 pictures a second.
_FRAME_S = 1 / 30

# Seconds of a launch, for which a change may have to wait.
_LAUNCH_S = 0.02

# Seconds of a picture for a saved notebook.
_STILL_PICTURE_S = 0.5

# Seconds without a change after which the picture settles.
_STILL_S = 0.15

# Samples while something moves; two share their work, see cl/film/studio.cl.
_MOVING_SAMPLES = 2

# Of the samples of a settling picture, from one pass to the next, and the fewest of a pass.
_PASS_FACTOR, _FEWEST = 4, 4

# Least share of the resolution while something moves, along each side.
_LEAST_SCALE = 1 / 8

_JPEG = {"quality": 80, "subsampling": 2}

# Of the numbers in events, which are pixels of a page.
_MOST = 1e6

# CSS pixels that a click may move.
_CLICK = 4

# Degrees of a drag over the height of the picture, and of a turntable in a second.
_DRAG_DEGREES, _SPIN_DEGREES = 200.0, 30.0

# Factor of a distance for one CSS pixel of the wheel, and the most of one event.
_WHEEL, _MOST_WHEEL = 1.0015, 240.0

# Shares of the distance: at which a double click comes to stand, and that a second of flying covers.
_FOCUS, _FLIGHT = 0.5, 0.5

# Factor of flying with Shift.
_FASTER = 4

_LEFT, _RIGHT, _MIDDLE = 1, 2, 3

# To the right, upwards and forwards.
_FLYING_KEYS = {
    "w": (0, 0, 1), "s": (0, 0, -1), "a": (-1, 0, 0), "d": (1, 0, 0), "e": (0, 1, 0), "q": (0, -1, 0),
    "ArrowUp": (0, 0, 1), "ArrowDown": (0, 0, -1), "ArrowLeft": (-1, 0, 0), "ArrowRight": (1, 0, 0),
}  # fmt: skip
_SIDE_KEYS = {"f": "front", "r": "right", "b": "back", "l": "left", "t": "top", "u": "bottom", "i": "iso"}
_POSE = "camera", "side", "eye", "look_at", "up", "fov", "projection", "aperture", "focus_distance"


class _StaleError(Exception):
    """The picture that is being rendered is no longer wanted."""


class _Job(NamedTuple):
    """A picture to render.

    Attributes
    ----------
    version : int
        Of the state that it shows.
    view : View
    is_last : bool
        Whether it has all samples in full resolution.
    is_moving : bool
    """

    version: int
    view: View
    is_last: bool
    is_moving: bool


class Session:
    """What one page shows of a renderer; any number of sessions share one.

    Parameters
    ----------
    renderer : Renderer
    send : function
        See `Send`. Called by the thread of the session and by those that call `handle`.
    view : View, optional
        What is seen at first; by default the view of the renderer.
    sources : sequence of str
        The files that are shown, for the command; empty without any.
    own : View, optional
        That of a scene file.
    is_sized : bool
        Whether the picture has the size of the renderer's view; otherwise it has that of the page.
    """

    def __init__(
        self, renderer: Renderer, send: Send, view: View | None = None, *,
        sources: Sequence[str] = (), own: View | None = None, is_sized: bool = False,
    ) -> None:  # fmt: skip
        self._renderer, self._send, self._sources, self._own = renderer, send, sources, own or View()
        self._start = self._view = renderer.view if view is None else view
        camera = self._start.camera
        self._is_sized = is_sized or (camera is not None and camera.lens is not None)
        self._up = (camera or renderer.find_camera(self._start, side="front")).up
        # Guards all that follows, and wakes the thread.
        self._changed = threading.Condition()
        self._version, self._moved_at = 0, 0.0
        self._size: tuple[int, int] | None = None
        self._ratio, self._scale = 1.0, 0.5
        self._sent, self._drawn = 0, 0
        self._picture: Picture | None = None
        self._settled = -1, b""
        self._is_flying = self._is_spinning = self._is_saving = False
        self._keys: dict[str, bool] = {}
        self._drag: dict[str, Any] = {}
        self._marks: list[Picked] = []
        self._selected: Picked | None = None
        self._thread: threading.Thread | None = None

    # Events

    def handle(self, event: Any) -> None:
        """Take one event of the page; a wrong one is answered by a note."""
        try:
            if not isinstance(event, dict):
                raise ConfigError(f"an event must be a JSON object, not {reprlib.repr(event)}")
            handler, needed = _HANDLERS.get(str(event.get("event_type")), (None, ()))
            if handler is not None:
                _check_fields(event, needed)
                handler(self, event)
        except ClbvhError as error:
            self._note(str(error), is_error=True)

    def refresh(self) -> None:
        """Render again what has changed in the renderer."""
        with self._changed:
            self._touch()

    def close(self) -> None:
        """End the thread, and what it is rendering. A page that comes back starts another one."""
        with self._changed:
            thread, self._thread, self._size = self._thread, None, None
            self._keys.clear()
            self._is_spinning = False
            self._touch(moves=False)
        if thread is not None and thread is not threading.current_thread():
            thread.join()

    def _leave(self, event: dict[str, Any]) -> None:
        """Stop for a page that ends; another view of the same widget says its size again, and goes on."""
        self.close()
        self._say({"type": "opened"})

    def _resize(self, event: dict[str, Any]) -> None:
        ratio = event.get("pixel_ratio", 1.0)
        size = max(1, round(event["width"] * ratio)), max(1, round(event["height"] * ratio))
        if self._is_sized:
            size = self._start.width, self._start.height
        View(width=size[0], height=size[1])  # raises for a size that no picture has
        with self._changed:
            self._ratio, is_first = size[0] / event["width"], self._size is None
            self._size = size
            # Also where the size is the same: a notebook may show one widget twice, or again after a reload, and the
            # page before it does not say that it has drawn a picture.
            self._drawn = self._sent
            self._touch()
            if is_first:
                self._thread = threading.Thread(target=self._run, name="clbvh-view", daemon=True)
                self._thread.start()
        self._greet()
        if is_first:
            for note in self._renderer.list_notes(self._start):
                self._note(note)

    def _greet(self) -> None:
        """Tell the page what it shows."""
        mesh, state = self._renderer.mesh, self._renderer.scene.snapshot()
        facts = f"{state.placed_prim_count:,} {'primitives' if mesh is None else 'triangles'}"
        if state.instance_count > 1:
            facts = f"{state.instance_count:,} objects, {facts}"
        width, height = (self._start.width, self._start.height) if self._is_sized else (None, None)
        self._say({
            "type": "scene", "title": (", ".join(self._sources) or "scene") if mesh is None else mesh.name,
            "facts": facts,
            "shadings": list(SHADINGS), "sides": list(STANDARD_VIEWS), "width": width, "height": height,
        })  # fmt: skip
        self._say_state()

    def _say_state(self) -> None:
        view = self._view
        self._say({
            "type": "state", "shading": view.shading, "cut": None if view.cut is None else view.cut.text,
            "wireframe": view.wireframe is not None, "fly": self._is_flying, "turntable": self._is_spinning,
        })  # fmt: skip

    def _press(self, event: dict[str, Any]) -> None:
        point, button = (event["x"], event["y"]), event["button"]
        seen, is_hit = self._find_point(point)
        with self._changed:
            self._drag = {
                "from": point, "at": point, "is_click": button == _LEFT, "seen": seen,
                "pivot": seen if is_hit else self._camera().look_at,
                "pans": button in (_RIGHT, _MIDDLE) or "Shift" in event.get("modifiers", ()),
            }  # fmt: skip
        if self._is_spinning:
            self._spin()

    def _move(self, event: dict[str, Any]) -> None:
        point = event["x"], event["y"]
        with self._changed:
            drag, size = self._drag, self._size
            if not drag or size is None:
                return
            if math.dist(point, drag["from"]) > _CLICK:
                drag["is_click"] = False
            if drag["is_click"]:
                return
            right, down = point[0] - drag["at"][0], point[1] - drag["at"][1]
            drag["at"], camera = point, self._camera()
            pans = drag["pans"] or 2 in event.get("buttons", ())
            degrees = np.multiply((right, down), _DRAG_DEGREES * self._ratio / size[1]).tolist()
            if pans:
                camera = navigate.drag(camera, drag["seen"], np.multiply(point, self._ratio), size)
            elif self._is_flying:
                camera = navigate.turn(camera, (degrees[0] / 2, -degrees[1] / 2), camera.eye, self._up)
            else:
                camera = navigate.turn(camera, (-degrees[0], degrees[1]), drag["pivot"], self._up)
            self._show(camera)

    def _release(self, event: dict[str, Any]) -> None:
        with self._changed:
            drag, self._drag = self._drag, {}
            self._moved_at = 0.0
            self._changed.notify_all()
        if drag.get("is_click"):
            self._click(drag["from"])

    def _click(self, point: tuple[float, float]) -> None:
        """Show what is under the cursor, and the distance to the last click."""
        found = self._pick(point)
        with self._changed:
            self._selected = found
            self._marks = [] if found is None else [*self._marks, found][-2:]
            lines = [] if found is None else list(found.lines)
            if len(self._marks) == 2:
                first, second = (each.location for each in self._marks)
                lines.append(("measured", f"{math.dist(first, second):.7g}"))
        self._say_hit(lines)

    def _clear(self) -> None:
        with self._changed:
            self._selected, self._marks = None, []
        self._say_hit([])

    def _say_hit(self, lines: list[tuple[str, str]]) -> None:
        self._say({"type": "hit", "lines": lines})
        if self._picture is not None:
            self._say_overlay(self._picture)

    def _focus(self, event: dict[str, Any]) -> None:
        point, is_hit = self._find_point((event["x"], event["y"]))
        self._clear()  # a double click is two clicks, too
        if is_hit:
            with self._changed:
                self._show(navigate.focus(self._camera(), point, _FOCUS))

    def _wheel(self, event: dict[str, Any]) -> None:
        point = event["x"], event["y"]
        turned = min(max(event["dy"], -_MOST_WHEEL), _MOST_WHEEL)
        pivot, _ = self._find_point(point)
        with self._changed:
            if turned and self._size is not None:
                pixel = np.multiply(point, self._ratio)
                self._show(navigate.zoom(self._camera(), _WHEEL**turned, pivot, pixel, self._size))

    def _press_key(self, event: dict[str, Any]) -> None:
        key = event["key"]
        key = key.lower() if len(key) == 1 else key
        is_plain = not {"Control", "Meta", "Alt"}.intersection(event.get("modifiers", ()))
        if not is_plain:
            return
        names = list(SHADINGS)
        if key in _FLYING_KEYS and (self._is_flying or key.startswith("Arrow")):
            with self._changed:
                self._keys[key] = "Shift" in event.get("modifiers", ())
                self._touch()
        elif key in _SIDE_KEYS:
            self._set({"name": "side", "value": _SIDE_KEYS[key]})
        elif key in map(str, range(1, len(names) + 1)):
            self._set({"name": "shading", "value": names[int(key) - 1]})
        elif key in ("h", "Home"):
            self._go_home()
        elif key == "g":
            self._set({"name": "fly", "value": not self._is_flying})
        elif key == "m":
            self._set({"name": "wireframe", "value": self._view.wireframe is None})
        elif key == " ":
            self._spin()
        elif key == "Escape":
            self._clear()

    def _release_key(self, event: dict[str, Any]) -> None:
        key = event["key"]
        with self._changed:
            self._keys.pop(key.lower() if len(key) == 1 else key, None)
            self._changed.notify_all()

    def _note_drawn(self, event: dict[str, Any]) -> None:
        with self._changed:
            self._drawn = event["index"]
            self._changed.notify_all()

    def _set(self, event: dict[str, Any]) -> None:
        """Change a setting of the view, by the panel or a key."""
        name, value = event["name"], event.get("value")
        with self._changed:
            if name == "fly":
                self._is_flying = bool(value)
            elif name == "side":
                view = self._home().changed(side=str(value))
                self._renderer.find_camera(view)  # raises for a side from which there is no panorama
                self._view = view
            elif name == "shading":
                # These have one sample alone.
                samples = self._start.samples and (1 if value in REPORT_SHADINGS else self._start.samples)
                self._view = self._view.changed(shading=value, samples=samples)
            elif name == "cut":
                self._view = self._view.changed(cut=value)
            elif name == "wireframe":
                self._view = self._view.changed(wireframe=value and (self._start.wireframe or True))
            else:
                raise ConfigError(f"the viewer sets shading, side, cut, wireframe and fly, not {name!r}")
            self._touch()
        self._say_state()

    def _ask(self, event: dict[str, Any]) -> None:
        what, view = event["what"], self._sized()
        if what == "command":
            self._say({"type": "text", "what": what, "text": phrase_command(self._sources, self._own, view)})
        elif what == "python":
            self._say({"type": "text", "what": what, "text": phrase_python(self._sources, view)})
        elif what == "png":
            with self._changed:
                version, content = self._settled
                self._is_saving = version != self._version
            if not self._is_saving:
                self._say_file(content)
        elif what == "home":
            self._go_home()
        elif what == "turntable":
            self._spin()
        elif what == "clear":
            self._clear()

    def _go_home(self) -> None:
        with self._changed:
            self._view = self._home()
            self._touch()

    def _spin(self) -> None:
        with self._changed:
            self._is_spinning = not self._is_spinning
            self._touch()
        self._say_state()

    # The view

    def _home(self) -> View:
        """Return the view with the camera of the beginning."""
        return replace(self._view, **{name: getattr(self._start, name) for name in _POSE})

    def _sized(self) -> View:
        """Return the view in the size of the page."""
        width, height = self._size or (self._start.width, self._start.height)
        return self._view if self._is_sized else self._view.changed(width=width, height=height)

    def _camera(self) -> Camera:
        """Return the camera that dragging continues from; a view from the top gets the scene's up axis."""
        camera = self._renderer.find_camera(self._sized())
        return camera if camera.up == self._up else navigate.turn(camera, (0.0, 0.0), camera.look_at, self._up)

    def _show(self, camera: Camera) -> None:
        """Look through a camera: as settings of the view, which the command line has, or with its lens."""
        self._view = replace(self._view, side=None, **_settings_of(camera))
        self._touch()

    def _touch(self, *, moves: bool = True) -> None:
        """Note that another picture is to be shown; the lock is held."""
        self._version += 1
        if moves:
            self._moved_at = time.perf_counter()
        self._changed.notify_all()

    def _pick(self, point: tuple[float, float]) -> Picked | None:
        """Return what is seen at a point of the page, in CSS pixels."""
        hit = self._renderer.hits_at(np.multiply(point, self._ratio), self._sized())
        return None if self._picture is None else describe_hit(hit, self._picture.scene.state)

    def _find_point(self, point: tuple[float, float]) -> tuple[Vector, bool]:
        """Return what is seen at a point of the page, and True; or else what would be at the depth of `look_at`."""
        view, pixel = self._sized(), np.multiply(point, self._ratio)
        hit = self._renderer.hits_at(pixel, view)
        if hit.is_hit:
            return as_vector(hit.locations), True
        return navigate.find_opposite(self._renderer.find_camera(view), pixel, (view.width, view.height)), False

    def _advance(self, spent_s: float) -> None:
        """Fly, and turn the table, by the time that has passed; the lock is held."""
        if self._keys:
            camera = self._camera()
            distance = math.dist(camera.eye, camera.look_at) * _FLIGHT * spent_s
            distance *= _FASTER if any(self._keys.values()) else 1
            steps = np.sum([_FLYING_KEYS[key] for key in self._keys], axis=0)
            right, _, forward = camera.axes()
            upward = np.asarray(self._up) / np.linalg.norm(self._up)
            self._show(navigate.move(camera, distance * (steps[0] * right + steps[1] * upward + steps[2] * forward)))
        if self._is_spinning:
            camera = self._camera()
            self._show(navigate.turn(camera, (_SPIN_DEGREES * spent_s, 0.0), camera.look_at, self._up))

    # The thread

    def _run(self) -> None:
        """Render the newest view, until the page is closed."""
        own, shown, passes, before = threading.current_thread(), -1, list[View](), time.perf_counter()
        while True:
            try:
                with self._changed:
                    if self._thread is not own:
                        return
                    spent_s, before = time.perf_counter() - before, time.perf_counter()
                    if self._keys or self._is_spinning:
                        self._advance(min(spent_s, _STILL_S))
                    left_s, is_new = self._moved_at + _STILL_S - before, self._version != shown
                    if is_new:
                        shown, passes = self._version, self._list_passes()
                    if is_new and left_s > 0:
                        job = _Job(shown, self._moving_view(), False, True)
                    elif left_s <= 0 and passes:
                        job = _Job(shown, passes.pop(0), not passes, False)
                    else:
                        self._changed.wait(left_s if left_s > 0 else None)
                        continue
                self._render(job, own)
            except _StaleError:
                pass
            except Exception as error:  # the next change may be rendered again
                if not isinstance(error, ClbvhError):
                    traceback.print_exc()
                with self._changed:
                    passes, self._is_spinning, self._is_saving = [], False, False
                    self._keys.clear()
                self._say_state()
                self._note(str(error) or repr(error), is_error=True)

    def _list_passes(self) -> list[View]:
        """Return the views of a picture that settles, each with more samples than the one before."""
        view, counts = self._sized(), []
        count = view.sample_count
        while count >= _FEWEST:
            counts.append(count)
            count //= _PASS_FACTOR
        return [view.changed(samples=each) for each in counts[:0:-1]] + [view]

    def _moving_view(self) -> View:
        """Return the view as it is rendered while something moves."""
        view, scale = self._sized(), self._scale
        if self._sent == 0 and not any(shape.appearance for shape in self._renderer.scene.snapshot().shapes):
            view = view.changed(shading=FIRST_SHADING, samples=None)
        if view.shading not in REPORT_SHADINGS:
            view = view.changed(samples=min(_MOVING_SAMPLES, view.sample_count))
        if view.camera is not None and view.camera.lens is not None:
            return view  # one aspect ratio, which few lower resolutions have
        return view.changed(width=max(1, round(view.width * scale)), height=max(1, round(view.height * scale)))

    def _render(self, job: _Job, own: threading.Thread) -> None:
        """Render a picture, and send it once the page has drawn the one before."""
        begin = time.perf_counter()

        def check(done: int, total: int) -> None:
            if self._thread is not own or (not job.is_moving and self._version != job.version):
                raise _StaleError

        picture = self._renderer.render(job.view, launch_s=_LAUNCH_S, on_samples=check)
        is_exact = job.is_last or picture.is_transparent
        content = encode_picture(picture.pixels, ".png") if is_exact else encode_picture(picture.rgb, ".jpg", **_JPEG)
        spent_s = time.perf_counter() - begin
        if job.is_moving:
            # Half of the way in each frame, as the times of frames differ.
            ratio = math.sqrt(_FRAME_S / spent_s)
            self._scale = min(max(self._scale * math.sqrt(ratio), _LEAST_SCALE), 1.0)
        with self._changed:
            self._changed.wait_for(lambda: self._drawn >= self._sent or self._thread is not own)
            if self._thread is not own or (not job.is_moving and self._version != job.version):
                raise _StaleError
            self._sent += 1
            self._picture = picture
            index, is_saving = self._sent, self._is_saving and job.is_last
            if job.is_last:
                self._settled, self._is_saving = (job.version, content), False
        height, width = picture.found.shape
        self._say({
            "type": "frame", "index": index, "width": width, "height": height, "settled": job.is_last,
            "format": "png" if is_exact else "jpeg", "samples": picture.samples,
            "of_samples": self._view.sample_count, "frame_ms": round(spent_s * 1e3, 1),
        }, content)  # fmt: skip
        if is_saving:
            self._say_file(content)
        if self._marks:
            self._say_overlay(picture)
        if index == 1:
            # What a click takes is compiled once on a machine: before the first one.
            self._find_point((0.0, 0.0))

    def _say_overlay(self, picture: Picture) -> None:
        """Send what is drawn over a picture: marks, their distance, and the mask of what is selected."""
        points, size = self._marks, self._size
        if size is not None:
            marks = place_marks(points, picture.camera, size, self._ratio)
            self._say({"type": "overlay", **marks}, encode_mask(self._selected, picture))

    def _say_file(self, content: bytes) -> None:
        # Named after the scene and what is seen of it.
        words = (self._renderer.scene.snapshot().names[0], self._view.side, self._view.shading)
        name = re.sub(r"\W+", "-", "-".join(filter(None, words)).lower()).strip("-")
        self._say({"type": "file", "name": f"{name}.png"}, content)

    def render_still(self) -> Picture:
        """Return the picture as it is now, or what half a second makes of it."""
        limit_s = None if self._view.shading in REPORT_SHADINGS else _STILL_PICTURE_S
        return self._picture or self._renderer.render(self._view, time_limit_s=limit_s)

    def _note(self, text: str, *, is_error: bool = False) -> None:
        self._say({"type": "note", "text": text, "is_error": is_error})

    def _say(self, message: dict[str, Any], content: bytes = b"") -> None:
        self._send({**message, "bytes": len(content)}, content)


# The events, and the fields that each needs.
_HANDLERS: dict[str, tuple[Callable[[Session, dict[str, Any]], None], tuple[str, ...]]] = {
    "resize": (Session._resize, ("width", "height")),
    "pointer_down": (Session._press, ("x", "y", "button")),
    "pointer_move": (Session._move, ("x", "y")),
    "pointer_up": (Session._release, ()),
    "double_click": (Session._focus, ("x", "y")),
    "wheel": (Session._wheel, ("x", "y", "dy")),
    "key_down": (Session._press_key, ("key",)),
    "key_up": (Session._release_key, ("key",)),
    "frame_feedback": (Session._note_drawn, ("index",)),
    "set": (Session._set, ("name",)),
    "ask": (Session._ask, ("what",)),
    "close": (Session._leave, ()),
}


def _is_number(value: Any, least: float = -_MOST) -> bool:
    return isinstance(value, int | float) and least <= value <= _MOST


def _is_list(value: Any, kind: type) -> bool:
    return isinstance(value, list | tuple) and all(isinstance(each, kind) for each in value)


# Names of fields, a test of their values, and its words.
_FIELDS: tuple[tuple[tuple[str, ...], Callable[[Any], bool], str], ...] = (
    (("x", "y", "dy"), _is_number, f"from {-_MOST:g} to {_MOST:g}"),
    (("width", "height", "pixel_ratio"), lambda size: _is_number(size, 1 / _MOST), f"from {1 / _MOST:g} to {_MOST:g}"),
    (("button", "index"), lambda number: isinstance(number, int), "an integer"),
    (("buttons",), lambda numbers: _is_list(numbers, int), "a list of integers"),
    (("modifiers",), lambda texts: _is_list(texts, str), "a list of texts"),
    (("key", "name", "what"), lambda text: isinstance(text, str), "a text"),
    (("value",), lambda value: isinstance(value, str | bool | None), "a text, true, false or null"),
)  # fmt: skip


def _check_fields(event: dict[str, Any], needed: tuple[str, ...]) -> None:
    """Raise `ConfigError` unless an event has the fields that it needs, and all known ones have values of theirs."""
    for names, is_valid, words in _FIELDS:
        for name in names:
            if (name in needed or name in event) and not is_valid(event.get(name)):
                given = reprlib.repr(event[name]) if name in event else "left out"
                raise ConfigError(f"{name} of the event {event['event_type']!r} must be {words}, not {given}")


def _settings_of(camera: Camera) -> dict[str, Any]:
    """Return the settings of a view that choose a camera."""
    if camera.lens is not None:
        return {"camera": camera}
    return {
        "camera": None, "eye": camera.eye, "look_at": camera.look_at, "up": camera.up, "fov": camera.fov,
        "projection": camera.projection, "aperture": camera.aperture, "focus_distance": camera.focus_distance,
    }  # fmt: skip
