"""The page of the viewer, served to this machine's own browsers: its files, and one websocket for each page.

Every request needs the token of the address, and a host name of this machine: neither other users nor pages of other
sites can look in.
"""

from __future__ import annotations

import json
import secrets
import threading
from collections.abc import Callable
from contextlib import suppress
from http import HTTPStatus
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import parse_qs, urlsplit

from ..errors import ConfigError
from ..support.context_manager import ContextManager

_PAGE = Path(__file__).parent / "page"
_FILES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/view.js": ("view.js", "text/javascript; charset=utf-8"),
    "/view.css": ("view.css", "text/css; charset=utf-8"),
}
_SOCKET = "/socket"

_HOST = "127.0.0.1"
_HOST_NAMES = {_HOST, "localhost", "[::1]"}

# What the page may load and do: nothing from elsewhere.
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src blob: data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)

# Bytes of an event of the page.
_MOST_BYTES = 1 << 16


class Connected(Protocol):
    """What a page talks to."""

    def handle(self, event: Any) -> None:
        """Take an event, or anything else that a page sends; None for what is no JSON."""

    def close(self) -> None:
        """End everything that the page has begun."""


def serve(
    open_scene: Callable[[], Callable[[Any], Connected]],
    on_address: Callable[[str, int], object],
    wait: Callable[[], object],
) -> None:
    """Serve the page of a scene, which is opened while the browser starts.

    Parameters
    ----------
    open_scene : function
        Returns the function for `PageServer.show`.
    on_address : function
        Gets the address of the page, and its port.
    wait : function
        Returns when the page is to end, as it does by Ctrl-C.
    """
    with PageServer() as server:
        on_address(server.address, server.port)
        try:
            server.show(open_scene())
            wait()
        except KeyboardInterrupt:
            return


def import_server() -> Callable[..., Any]:
    """Return the function of websockets that serves; raise `ConfigError` if the extra ``view`` is missing."""
    try:
        from websockets.sync.server import serve
    except ImportError as error:
        raise ConfigError(f"the viewer needs websockets: run 'pip install \"clbvh[view]\"' ({error})") from error
    return serve


class PageServer(ContextManager):
    """Serves the page from threads of its own, until it is closed.

    Attributes
    ----------
    address : str
        To open in a browser; it holds the token.
    port : int
        Chosen by the system.

    Raises
    ------
    ConfigError
        The library of the extra ``view`` is missing.
    """

    def __init__(self) -> None:
        serve = import_server()
        self._token = secrets.token_urlsafe(16)
        self._ready = threading.Event()
        self._connect: Callable[[Any], Connected] | None = None
        self._server = serve(self._talk, _HOST, 0, process_request=self._answer, max_size=_MOST_BYTES, compression=None)
        self.port = self._server.socket.getsockname()[1]
        self.address = f"http://{_HOST}:{self.port}/?token={self._token}"
        self._thread = threading.Thread(target=self._server.serve_forever, name="clbvh-page", daemon=True)
        self._thread.start()

    def show(self, connect: Callable[[Any], Connected]) -> None:
        """Begin to show something; pages that were opened before wait for it.

        Parameters
        ----------
        connect : function
            Gets the function that sends a message and its bytes to the page, and returns what takes the page's events.
        """
        self._connect = connect
        self._ready.set()

    def close(self) -> None:
        """Close all connections, which ends what their pages have begun."""
        self._ready.set()
        self._server.shutdown(reason="The program has ended.")
        self._thread.join()

    def _answer(self, page: Any, request: Any) -> Any:
        """Answer a request for a file, or let a websocket be opened."""
        from websockets.datastructures import Headers
        from websockets.http11 import Response

        try:
            address, origin = urlsplit(request.path), request.headers.get("Origin")
            names = [request.headers.get("Host", "")] + ([] if origin is None else [urlsplit(origin).netloc])
        except (LookupError, ValueError):  # a header twice, brackets that hold no address
            return page.respond(HTTPStatus.BAD_REQUEST, "The request's address, Host or Origin is malformed.\n")
        is_own = all(name.rpartition(":")[0] in _HOST_NAMES or name in _HOST_NAMES for name in names)
        token = parse_qs(address.query).get("token", [""])[0]
        needs_token = address.path in ("/", _SOCKET)
        if not is_own or (needs_token and not secrets.compare_digest(token.encode(), self._token.encode())):
            return page.respond(HTTPStatus.FORBIDDEN, "Open the whole address that clbvh view has printed.\n")
        if address.path == _SOCKET:
            return None
        if address.path not in _FILES:
            return page.respond(HTTPStatus.NOT_FOUND, "There is no such page.\n")
        name, kind = _FILES[address.path]
        content = (_PAGE / name).read_bytes()
        headers = Headers({
            "Content-Type": kind, "Content-Length": str(len(content)), "Content-Security-Policy": _POLICY,
            "Cache-Control": "no-store", "Referrer-Policy": "no-referrer", "X-Content-Type-Options": "nosniff",
            "Connection": "close",
        })  # fmt: skip
        return Response(HTTPStatus.OK.value, HTTPStatus.OK.phrase, headers, content)

    def _talk(self, page: Any) -> None:
        """Carry messages between one page and what it looks at, in a thread of its own."""
        from websockets.exceptions import ConnectionClosed

        sending = threading.Lock()

        def send(message: dict[str, Any], content: bytes = b"") -> None:
            with sending, suppress(ConnectionClosed):  # the session is closed by the loop below
                page.send(json.dumps(message))
                if content:
                    page.send(content)

        session = None
        try:
            if not self._ready.is_set():
                send({"type": "note", "text": "Opening ...", "is_error": False, "bytes": 0})
            self._ready.wait()
            if self._connect is None:
                return
            session = self._connect(send)
            for text in page:
                session.handle(_read(text))
        except ConnectionClosed:
            pass
        finally:
            if session is not None:
                session.close()


def _read(text: str | bytes) -> Any:
    """Return the value of a JSON text; None where it is none, or nested too deeply."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None
