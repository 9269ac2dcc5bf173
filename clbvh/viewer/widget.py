"""The live picture in a notebook: the module of the page, by anywidget.

Follows https://anywidget.dev for the module, and jupyter_rfb for the names of events.
"""

from __future__ import annotations

from base64 import b64encode
from pathlib import Path
from typing import Any

from ..errors import ConfigError
from ..files.image_files import encode_picture
from ..rendering.renderer import Renderer
from .session import Session

try:
    import anywidget
    import traitlets
except ImportError as error:
    raise ConfigError(f"a live picture needs anywidget: run 'pip install \"clbvh[notebook]\"' ({error})") from error

_PAGE = Path(__file__).parent / "page"


class ViewWidget(anywidget.AnyWidget):
    """A live picture; the last value of a cell.

    Parameters
    ----------
    renderer : Renderer
    settings : dict
        Of the `Session`.

    Attributes
    ----------
    renderer : Renderer
    css_height : str
        Of the picture in the page, such as ``"480px"``.
    """

    _esm = _PAGE / "view.js"
    _css = _PAGE / "view.css"
    css_height = traitlets.Unicode("480px").tag(sync=True)

    def __init__(self, renderer: Renderer, settings: dict[str, Any]) -> None:
        super().__init__()
        self.renderer = renderer
        self._session = Session(renderer, self._carry, **settings)
        self.on_msg(lambda _, event, __: self._session.handle(event))

    def _carry(self, message: dict[str, Any], content: bytes = b"") -> None:
        self.send(message, [content] if content else None)

    def _repr_mimebundle_(self, **named: Any) -> Any:
        """Return what a cell shows: the live picture, and a still one for where no program runs."""
        bundle = super()._repr_mimebundle_(**named)
        if bundle is None:
            return None
        data, more = bundle if isinstance(bundle, tuple) else (bundle, {})
        still = self._session.render_still()
        return {**data, "image/png": b64encode(encode_picture(still.pixels, ".png")).decode()}, more

    def refresh(self) -> None:
        """Show the scene as it is now, after `Renderer.set_transforms`."""
        self._session.refresh()

    def close(self) -> None:
        """End the live picture; the renderer stays open."""
        self._session.close()
        super().close()
