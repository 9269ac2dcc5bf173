"""Memory that is taken again and again."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh.builders.workers import workspace
from clbvh.builders.workers.workspace import Workspace


@pytest.fixture
def space():
    with Workspace() as opened:
        yield opened


def take(space, **shapes):
    """Return arrays of these shapes by name, and their handles by name."""
    taken = {name: space.take(name, shape, np.float32) for name, shape in shapes.items()}
    return {name: array for name, (_, array) in taken.items()}, {name: handle for name, (handle, _) in taken.items()}


def test_who_attaches_sees_the_same_memory(space):
    arrays, handles = take(space, a=(3, 4))
    handles["a"].attach()[...] = 7
    assert arrays["a"].shape == (3, 4)
    assert (arrays["a"] == 7).all()


def test_smaller_arrays_use_the_same_memory_and_larger_ones_get_more(space):
    _, first = take(space, a=(100,), b=(1,))
    _, second = take(space, a=(2, 25), b=(1,))
    assert {name: handle.serial for name, handle in first.items()} == {
        name: handle.serial for name, handle in second.items()
    }
    arrays, third = take(space, a=(101,), b=(1,))
    assert third["a"].serial != first["a"].serial
    assert third["b"].serial == first["b"].serial
    arrays["a"][:] = 1
    assert (third["a"].attach() == 1).all()


def test_another_type_may_lie_in_the_same_memory(space):
    _, array = space.take("a", (10,), np.float32)
    array[:] = 1
    _, again = space.take("a", (2, 2), np.int64)
    assert again.dtype == np.int64
    assert again.ravel().tolist() == np.ones(8, np.float32).view(np.int64).tolist()


def test_an_array_outlives_the_workspace():
    with Workspace() as space:
        arrays, handles = take(space, a=(1000,))
        arrays["a"][:] = 5
    assert (arrays["a"] == 5).all()
    with pytest.raises(FileNotFoundError):
        handles["a"].attach()


def test_it_tells_when_it_holds_too_much(space, monkeypatch):
    monkeypatch.setattr(workspace, "_KEPT_BYTES", 4000)
    take(space, a=(900,))
    assert not space.is_too_large
    take(space, b=(101,))
    assert space.is_too_large
    space.close()
    assert not space.is_too_large
