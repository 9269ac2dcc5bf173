"""Loops of the host take the arrays that they declare, and refuse all others before they run."""

import numpy as np
import pytest

from clbvh.device.host.loops import Loops
from clbvh.device.host.variants import list_loop_files
from clbvh.device.sources import find_loops
from clbvh.errors import InternalError
from clbvh.support.folders import find_folder

FACES = Loops("geometry/faces")


def arguments(**changed):
    arrays = {
        "vertices": np.array([[0, 0, 0], [4, 0, 0], [0, 2, 0], [9, 9, 9]], np.float64),
        "faces": np.array([[0, 1, 2]], np.int32),
        "sizes": np.full(4, -1.0),
    }
    return list((arrays | changed).values())


def test_lengths_are_those_of_the_arrays():
    given = arguments()
    assert FACES.find_sizes(*given) is None
    assert given[2].tolist() == [4, 4, 4, -1]


def test_arrays_may_begin_at_any_byte():
    given = arguments()
    for number, array in enumerate(given):
        memory = np.zeros(array.nbytes + 1, np.uint8)
        given[number] = memory[1:].view(array.dtype).reshape(array.shape)
        given[number][:] = array
    FACES.find_sizes(*given)
    assert given[2].tolist() == [4, 4, 4, -1]


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("vertices", np.zeros((4, 3), np.float32)),
        ("vertices", np.zeros((4, 6))[:, ::2]),
        ("vertices", np.zeros((3, 3))),
        ("vertices", None),
        ("vertices", [[0.0, 0.0, 0.0]] * 4),
        ("faces", np.zeros((1, 3), np.int64)),
        ("sizes", np.zeros(5)),
        ("sizes", np.frombuffer(bytes(32), np.float64)),
    ],
)
def test_other_arrays_are_refused(name, array):
    with pytest.raises(InternalError, match="the loop 'find_sizes' does not take its"):
        FACES.find_sizes(*arguments(**{name: array}))


def test_missing_arguments_and_unknown_loops_are_refused():
    with pytest.raises(TypeError, match=r"find_sizes\(\) missing 1 required positional argument: 'sizes'"):
        FACES.find_sizes(*arguments()[:2])
    with pytest.raises(AttributeError, match=r"cl/host/geometry/faces.cl has no loop 'find_size'"):
        FACES.find_size()


def test_all_declarations_can_be_read():
    names = list_loop_files()
    assert "geometry/faces" in names
    for name in names:
        loops = find_loops((find_folder("cl") / "host" / f"{name}.cl").read_text())
        assert loops, name
        for loop in loops:
            assert callable(getattr(Loops(name), loop))
