"""The server of the page, without a browser: what it refuses, and that it goes on."""

from __future__ import annotations

import logging
import queue
import socket

import pytest

from clbvh.viewer.serve import PageServer

websockets = pytest.importorskip("websockets.sync.client", reason="view: websockets is not installed")


class Listener:
    """What one page talks to; keeps its events."""

    def __init__(self):
        self.events = queue.Queue()

    def handle(self, event):
        self.events.put(event)

    def close(self):
        pass


@pytest.fixture
def listener():
    return Listener()


@pytest.fixture
def server(listener):
    with PageServer() as server:
        server.show(lambda send: listener)
        yield server


def test_a_text_that_is_no_event_does_not_end_the_connection(server, listener, caplog):
    address = server.address.replace("http", "ws").replace("/?", "/socket?")
    texts = dict.fromkeys(("", "{", b"\xff", "1" * 5000, "[" * 60_000)) | {"[1]": [1], '{"a": 1e308}': {"a": 1e308}}
    with websockets.connect(address) as page:
        for text, expected in texts.items():
            page.send(text)
            assert listener.events.get(timeout=20) == expected
    assert [each for each in caplog.records if each.levelno >= logging.WARNING] == []


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        ("/view.js", "Host: localhost\r\n", 200),
        ("/view.js", "Host: [\r\n", 403),
        ("/view.js", "Host: localhost\r\nHost: localhost\r\n", 400),
        ("/view.js", "Host: localhost\r\nOrigin: http://[\r\n", 400),
        ("/view.js", "Host: localhost\r\nOrigin: null\r\nOrigin: null\r\n", 400),
        ("//[", "Host: localhost\r\n", 400),
    ],
)
def test_a_malformed_request_gets_an_answer(server, caplog, path, headers, status):
    with socket.create_connection(("127.0.0.1", server.port), timeout=20) as connection:
        connection.sendall(f"GET {path} HTTP/1.1\r\n{headers}\r\n".encode())
        assert connection.recv(12) == f"HTTP/1.1 {status}".encode()
    assert [each for each in caplog.records if each.levelno >= logging.WARNING] == []
