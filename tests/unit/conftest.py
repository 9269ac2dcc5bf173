"""A mesh, its tracer and rays that make its life hard, for the tests of queries; modules may have their own."""

import numpy as np
import pytest

from clbvh import Tracer, build
from clbvh.geometry.shapes import make_shape

from ..rays import centred, hard_rays


@pytest.fixture(scope="module")
def mesh():
    return centred(make_shape("knot", triangles=1800))


@pytest.fixture(scope="module")
def tracer(_opened_device, mesh):
    with Tracer(build(mesh), device=_opened_device.info) as opened:
        yield opened


@pytest.fixture(scope="module")
def rays(mesh):
    """3072 of them, in any order."""
    origins, directions = hard_rays(mesh, 3072, np.random.default_rng(30))
    order = np.random.default_rng(31).permutation(len(origins))
    return origins[order], directions[order]
