"""Triangles that overlap in one plane are hit alike in every layout, at any angle.

The error of a triangle's t is relative to the coordinates of its corners, and boxes were culled with a slack relative
to t: the box of a triangle with a smaller t was left out once a farther one was hit.
"""

import numpy as np
import pytest

from clbvh import Mesh, build
from clbvh.structs import LAYOUT_WIDTHS

from ..kernel.casting import open_caster

# Corners in a plane, an origin close to it, relative to the middle of the box, a direction, and the triangle hit.
FROM_ABOVE = (
    [[-2, 0.5, 0], [3, 0.5, 0], [-2, -2.5, 0]],
    [[-3, -2.5, 0], [0, 2.5, 0], [-1, -2.5, 0]],
    [[-2, -0.5, 0], [-3, -1.5, 0], [-1, 2.5, 0]],
)
CASES = {
    "from above": (
        FROM_ABOVE,
        [-1.8737452030181885, -2.2530648708343506, -0.00021493468375410885],
        [-0.5690650343894958, -0.3129706382751465, 0.22009311616420746],
        1,
    ),
    "nearly in the plane": (
        (
            [[1, 0, -3], [3, 0, 1], [-2, 0, 1]],
            [[2, 0, -2], [-3, 0, -1], [2, 0, 2]],
            [[0, 0, 1], [2, 0, -1], [-2, 0, -1]],
        ),
        [-0.417790025472641, 4.734772469927595e-12, -0.1629110872745514],
        [-0.5504674911499023, -1.8144250546470175e-08, 0.010253475047647953],
        1,
    ),
}


@pytest.mark.parametrize("layout", LAYOUT_WIDTHS)
@pytest.mark.parametrize("case", CASES)
def test_a_tree_changes_nothing(session, case, layout):
    corners, origin, direction, prim_id = CASES[case]
    mesh = Mesh.from_arrays(np.reshape(corners, (-1, 3)), np.arange(3 * len(corners)).reshape(-1, 3))
    ray = mesh.origin + np.array([origin]), np.array([direction])
    with open_caster(session, mesh, None) as cast:
        expected = cast("closest_hit", *ray)
    assert expected["prim_id"].tolist() == [prim_id]
    with open_caster(session, mesh, build(mesh, leaf_size=1), layout) as cast:
        assert cast("closest_hit", *ray).tolist() == expected.tolist()
