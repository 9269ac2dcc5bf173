"""Imports by a thread of their own: from an empty stack, once, and with the error of the statement that follows."""

from __future__ import annotations

import importlib
import sys
import threading

import pytest

from clbvh.support.fresh_stack import import_on_fresh_stack

MODULE = """
import sys, threading
thread, depth, frame = threading.current_thread().name, 0, sys._getframe()
while frame := frame.f_back:
    depth += 1
"""


@pytest.fixture
def write_module(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))

    def write(name, text):
        (tmp_path / f"{name}.py").write_text(text)
        importlib.invalidate_caches()
        monkeypatch.delitem(sys.modules, name, raising=False)
        return name

    return write


def call_at_depth(depth, name):
    if depth:
        return call_at_depth(depth - 1, name)
    import_on_fresh_stack(name)
    return sys.modules[name].depth


def test_the_depth_is_that_of_the_import_alone(write_module):
    depths = {call_at_depth(depth, write_module(f"clbvh_deep_{depth}", MODULE)) for depth in (0, 10, 200)}
    assert len(depths) == 1
    assert max(depths) < 30


def test_a_module_is_imported_once(write_module):
    name = write_module("clbvh_once", MODULE)
    import_on_fresh_stack(name)
    module = sys.modules[name]
    module.depth = "kept"
    import_on_fresh_stack(name)
    assert sys.modules[name] is module
    assert module.depth == "kept"


def test_errors_are_left_to_the_import_statement(write_module, capfd):
    name = write_module("clbvh_broken", "raise OSError('no library')")
    import_on_fresh_stack(name)
    assert name not in sys.modules
    with pytest.raises(OSError, match="no library"):
        importlib.import_module(name)
    import_on_fresh_stack("clbvh_no_such_module")
    assert capfd.readouterr() == ("", "")


def test_without_a_thread_the_statement_imports(write_module, monkeypatch):
    def refuse(thread):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    name = write_module("clbvh_later", MODULE)
    import_on_fresh_stack(name)
    assert name not in sys.modules
