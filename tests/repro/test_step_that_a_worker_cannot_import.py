"""A step that the worker could not import killed it, and the reason went to its standard error instead of to us."""

from __future__ import annotations

import sys
import types

import pytest

from clbvh import SubtreePool
from clbvh.builders.processes.pool import open_executor
from clbvh.errors import PoolError


@pytest.fixture
def step_known_only_here(monkeypatch):
    module = types.ModuleType("module_of_the_coordinator")
    exec("def step(arrays): return 1", module.__dict__)
    monkeypatch.setitem(sys.modules, module.__name__, module)
    return module.step


def return_a_function(arrays):
    return lambda: None


def test_the_error_holds_the_workers_traceback(step_known_only_here):
    with (
        SubtreePool(workers=1) as pool,
        pytest.raises(PoolError, match="No module named 'module_of_the_coordinator'"),
        open_executor(pool) as executor,
    ):
        executor.map(step_known_only_here, [()])


def test_a_result_that_cannot_be_sent_is_an_error_too():
    with (
        SubtreePool(workers=1) as pool,
        pytest.raises(PoolError, match=r"(?s)worker 0 failed.*pickle"),
        open_executor(pool) as executor,
    ):
        executor.map(return_a_function, [()])
