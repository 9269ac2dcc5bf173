"""`clbvh view`: a live picture of meshes or of a scene, in a page of the browser."""

from __future__ import annotations

import sys
import threading
import webbrowser
from typing import Any

from ..rendering.options import RenderOptions
from . import options
from .progress import Progress
from .signals import calling_on_interrupt

_WITHOUT = ("validate",)


@options.with_options(view=options.list_view_options(), tree=options.list_tree_options(without=_WITHOUT))
def view(
    *sources: options.Sources,
    no_browser: bool = False,
    point_radius: options.PointRadius = None,
    view: options.Given = options.NOTHING,
    tree: options.Given = options.NOTHING,
) -> None:
    """Look at meshes or a scene in the browser: orbit, pan, zoom, fly, cut, measure.

    The page is served to this machine alone, until Ctrl-C. It needs websockets: pip install "clbvh[view]".

    Parameters
    ----------
    no_browser
        Print the address alone.
    """
    from ..viewer.open import prepare
    from ..viewer.serve import import_server, serve

    import_server()  # said before a mesh is loaded
    wanted = options.make_options(RenderOptions, tree)
    open_renderer = prepare(options.find_source(sources, point_radius), None, wanted, options.read_changes(view))

    def tell(address: str, port: int) -> None:
        print(address)
        print(f"Ctrl-C ends it. From another machine: ssh -N -L {port}:127.0.0.1:{port} THIS-HOST", flush=True)
        if not no_browser and not webbrowser.open(address):
            print("clbvh: no browser opens here: open the address in one", file=sys.stderr)

    def open_scene() -> Any:
        with Progress() as progress:
            return open_renderer(progress.enter).connect

    def wait() -> None:
        stopped = threading.Event()
        with calling_on_interrupt(stopped.set):
            stopped.wait()

    serve(open_scene, tell, wait)
