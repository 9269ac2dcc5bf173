"""A page without a browser: keeps what a session sends, and says at once that each picture is drawn."""

from __future__ import annotations

import io
import threading
from typing import Any

import numpy as np
from PIL import Image

from clbvh.viewer.session import Session

# Seconds for what a session is waited for; PoCL may have to compile.
PATIENCE_S = 60


class Page:
    """What one session shows."""

    def __init__(self, renderer, width: int = 96, height: int = 64, ratio: float = 1.0, **settings: Any) -> None:
        self.messages: list[tuple[dict, bytes]] = []
        self.draws = True
        self._arrived = threading.Condition()
        self.session = Session(renderer, self._take, **settings)
        self.do("resize", width=width, height=height, pixel_ratio=ratio)

    def __enter__(self) -> Page:
        return self

    def __exit__(self, *error: object) -> None:
        self.session.close()

    def _take(self, message: dict, content: bytes = b"") -> None:
        assert message["bytes"] == len(content)
        with self._arrived:
            self.messages.append((message, content))
            self._arrived.notify_all()
        if message["type"] == "frame" and self.draws:
            self.do("frame_feedback", index=message["index"])

    def do(self, event_type: str, **values: Any) -> None:
        """Let an event happen."""
        self.session.handle({"event_type": event_type, **values})

    def drag(self, begin: tuple, end: tuple, button: int = 1) -> None:
        """Press a button, move, and release it."""
        for kind, (x, y) in (("pointer_down", begin), ("pointer_move", end), ("pointer_up", end)):
            self.do(kind, x=x, y=y, button=button, buttons=[button], modifiers=[])

    def click(self, x: float, y: float) -> dict[str, str]:
        """Click, and return what the panel shows."""
        self.drag((x, y), (x, y))
        return dict(self.last("hit")[0]["lines"])

    def last(self, kind: str, **values: Any) -> tuple[dict, bytes]:
        """Return the last message of a kind with these values, which may still have to arrive."""

        def find() -> tuple[dict, bytes] | None:
            fitting = (each for each in reversed(self.messages) if {"type": kind, **values}.items() <= each[0].items())
            return next(fitting, None)

        with self._arrived:
            assert self._arrived.wait_for(find, PATIENCE_S), f"no {kind} {values}: {[m for m, _ in self.messages]}"
            return find()  # type: ignore[return-value]

    def settle(self) -> np.ndarray:
        """Return the picture that has settled since the last call."""
        message, content = self.last("frame", settled=True)
        with self._arrived:
            self.messages = [each for each in self.messages if each[0]["type"] != "frame"]
        assert message["format"] == "png"
        return np.asarray(Image.open(io.BytesIO(content)))

    def text(self, what: str) -> str:
        """Return what is copied."""
        self.do("ask", what=what)
        return self.last("text", what=what)[0]["text"]
