"""A triangle whose t rounds to zero or more is hit, though its box ends just before the ray begins.

Such a box was left out: its far plane lies at a negative t, which no factor of t moves beyond zero.
"""

import numpy as np
import pytest

from clbvh import Mesh, build
from clbvh.structs import LAYOUT_WIDTHS

from ..kernel.casting import open_caster

# Corners, an origin relative to the middle of the box, beside the first triangle by less than its t is rounded, and a
# direction.
IN_A_PLANE = (
    ([[-3, 2.5, 0], [-1, 0.5, 0], [2, -1.5, 0]], [[-2, -0.5, 0], [-3, -1.5, 0], [-1, 2.5, 0]]),
    [-1.873005747795105, 1.4832037687301636, 2.999629804544972e-16],
    [-0.3157864511013031, 0.5389906764030457, 0.00017183214367832989],
)
LONG_AND_THIN = (
    (
        [[0.0006, 2, 0], [0.0005, -8, 0], [-0.0003, -4, 0.0001]],
        [[0.0001, 1, 0.0001], [-0.0007, 3, 0.0008], [0.0006, 7, -0.0003]],
        [[-0.0008, -2, 0.0001], [0.0003, 8, 0.0004], [-0.0002, -7, -0.0007]],
        [[0.0002, -1, -0.0008], [0.0008, 1, 0.0005], [0.0005, 6, 0.0001]],
    ),
    [0.0005924901342950761, 1.2490108013153076, -6.949555677020908e-14],
    [-0.00039624585770070553, 0.8754945993423462, -0.0002500020491424948],
)


@pytest.mark.parametrize("layout", LAYOUT_WIDTHS)
@pytest.mark.parametrize("case", [IN_A_PLANE, LONG_AND_THIN], ids=["in-a-plane", "long-and-thin"])
def test_it_is_hit(session, case, layout):
    corners, origin, direction = case
    mesh = Mesh.from_arrays(np.reshape(corners, (-1, 3)), np.arange(3 * len(corners)).reshape(-1, 3))
    ray = mesh.origin + np.array([origin]), np.array([direction])
    with open_caster(session, mesh, None) as cast:
        expected = cast("closest_hit", *ray)
    assert expected["prim_id"].tolist() == [0]
    assert 0 <= expected["t"][0] < 1e-6
    with open_caster(session, mesh, build(mesh, leaf_size=1), layout) as cast:
        assert cast("closest_hit", *ray).tolist() == expected.tolist()
