"""Cleanups are run once, the latest first, whatever they raise."""

from __future__ import annotations

import pytest

from clbvh.support import unfinished


@pytest.fixture(autouse=True)
def list_of_its_own(monkeypatch):
    import threading

    monkeypatch.setattr(unfinished, "_cleanups", {})
    monkeypatch.setattr(unfinished, "_lock", threading.Lock())


def test_the_latest_comes_first_and_an_error_stops_none():
    done = []
    unfinished.add(lambda: done.append("first"))
    unfinished.add(lambda: 1 / 0)
    unfinished.add(lambda: done.append("last"))
    unfinished.clean_up()
    assert done == ["last", "first"]


def test_what_is_finished_is_not_cleaned_up():
    done = []
    with unfinished.listed(lambda: done.append("block")):
        pass
    ticket = unfinished.add(lambda: done.append("ticket"))
    unfinished.discard(ticket)
    unfinished.discard(ticket)
    unfinished.clean_up()
    assert done == []


def test_nothing_begins_after_the_cleanup():
    unfinished.clean_up()
    assert not unfinished._lock.acquire(blocking=False)
