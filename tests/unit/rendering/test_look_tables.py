"""Tables of what surfaces look like: kernels number their rows in 32 bits."""

import numpy as np
import pytest

from clbvh import Appearance, Mesh, SceneError
from clbvh.rendering import look_tables
from clbvh.rendering.look_tables import Looks, make_look_tables

CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize(
    ("values", "table", "count"),
    [
        ({"uvs": CORNERS[FACES]}, "corner_uvs", 12),
        ({"colours": np.full((2, 3, 4), 255, np.uint8)}, "corner_colours", 6),
        ({"normals": np.broadcast_to([0.0, 0, 1], (2, 3, 3))}, "corner_normals", 6),
    ],
)
def test_more_rows_than_kernels_can_number_are_refused(monkeypatch, values, table, count):
    square = Mesh.from_arrays(np.c_[CORNERS, np.zeros(4)], FACES, appearance=Appearance(**values))
    looks = Looks([square], np.zeros(1, int), np.full((1, 3), np.nan))
    monkeypatch.setattr(look_tables, "_MOST_ROWS", count)
    assert len(make_look_tables(looks, np.zeros(1, bool), 0.0)[table]) == count
    monkeypatch.setattr(look_tables, "_MOST_ROWS", count - 1)
    with pytest.raises(SceneError, match=f"'{table}' .* has {count} numbers, and the device counts up to {count - 1}:"):
        make_look_tables(looks, np.zeros(1, bool), 0.0)
