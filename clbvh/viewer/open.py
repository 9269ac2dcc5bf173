"""The public function: a live picture of anything that can be drawn, in a notebook or in the browser."""

from __future__ import annotations

import os
import sys
import threading
import webbrowser
from collections.abc import Callable
from typing import Any, NamedTuple

from ..bvh import Bvh
from ..errors import SceneError
from ..files.open_scene import SceneLike, as_scene
from ..rendering.options import RenderOptions
from ..rendering.renderer import Renderer
from ..support.say_once import say_once
from ..views.view import View
from .serve import import_server, serve
from .session import FIRST_SHADING, Send, Session


class Opened(NamedTuple):
    """A renderer, and the arguments of the sessions that look at it."""

    renderer: Renderer
    settings: dict[str, Any]

    def connect(self, send: Send) -> Session:
        """Return the session of a page."""
        return Session(self.renderer, send, **self.settings)


def view(
    source: SceneLike | Renderer | list[str],
    view: View | None = None,
    options: RenderOptions | None = None,
    **changes: Any,
) -> Any:
    """Look at a scene: orbit, pan, zoom and fly, click for faces and distances, cut, and copy what is seen.

    In a notebook the live picture is what a cell shows whose last value this is; it needs ``clbvh[notebook]``. Anywhere
    else a page opens in the browser, served from this process to this machine alone, until Ctrl-C; it needs
    ``clbvh[view]``. Only pictures travel, never geometry.

    Parameters
    ----------
    source : SceneLike, list of str, or Renderer
        See `clbvh.render`. A renderer is shown as it is, and stays open.
    view : View, optional
        The settings of the picture. With a width or a height it has that size; otherwise it fills the page.
    options : RenderOptions, optional
    **changes
        Settings of `View`, in place of those of the view.

    Returns
    -------
    ViewWidget or None
        In a notebook the widget.

    Raises
    ------
    ConfigError
        The library of the extra is missing.
    SceneError, MeshError, DeviceError
        See `clbvh.Renderer`.

    Notes
    -----
    The picture settles to the one of `clbvh.render`, byte for byte.

    Examples
    --------
    >>> import clbvh
    >>> clbvh.view("bunny")  # doctest: +SKIP
    """
    if not _is_notebook():
        import_server()  # said before a mesh is loaded
    open_renderer = prepare(source, view, options, changes)
    if _is_notebook():
        from .widget import ViewWidget

        return ViewWidget(*open_renderer())
    serve(lambda: open_renderer().connect, _open_browser, threading.Event().wait)
    return None


def prepare(
    source: SceneLike | Renderer | list[str], view: View | None, options: RenderOptions | None, changes: dict[str, Any]
) -> Callable[..., Opened]:
    """Read a source, so that no page opens for a wrong one, and return the function that builds its trees.

    The function takes `on_phase`, see `Renderer`.
    """
    default, given = View(), view or View()
    # Somebody has asked for a size of the picture; otherwise it has that of the page.
    is_sized = {"width", "height"} & changes.keys() or (given.width, given.height) != (default.width, default.height)
    settings: dict[str, Any] = {"is_sized": bool(is_sized)}
    if isinstance(source, Renderer):
        opened = Opened(source, settings | {"view": (view or source.view).changed(**changes)})
        return lambda on_phase=None: opened
    if isinstance(source, str | os.PathLike | list):
        source = settings["sources"] = [os.fspath(each) for each in (source if isinstance(source, list) else [source])]
    own = default
    if not isinstance(source, Bvh):  # whose tree is not built again
        source, own = as_scene(source)
        if not source.snapshot().masks.any():
            raise SceneError("the scene is empty: place a geometry to look at, as in scene.place(scene.add(mesh))")
    settings |= {"own": own, "view": (view or own).changed(**changes)}
    # The first picture is one that needs no tables of surfaces: it is there half a second sooner.
    first = settings["view"].changed(shading=FIRST_SHADING, samples=None)
    return lambda on_phase=None: Opened(Renderer(source, first, options, on_phase=on_phase), settings)


def _open_browser(address: str, port: int) -> None:
    say_once(f"the live picture is at {address}; Ctrl-C ends it", is_on_stderr=True)
    webbrowser.open(address)


def _is_notebook() -> bool:
    """Return whether this runs in a kernel of Jupyter, which has loaded IPython."""
    module = sys.modules.get("IPython")
    return module is not None and hasattr(module.get_ipython(), "kernel")
