"""A mesh, its tracer and hard rays, for the tests of queries; modules may have their own."""

import numpy as np
import pytest

from clbvh import Tracer, build
from clbvh.geometry.shapes.make_shape import make_shape

from ..rays import centred, hard_rays


@pytest.fixture(scope="session")
def mesh():
    return centred(make_shape("knot", triangles=1800))


@pytest.fixture(scope="session")
def tracer(_opened_device, mesh):
    with Tracer(build(mesh), device=_opened_device.info) as opened:
        yield opened


@pytest.fixture(scope="session")
def rays(mesh):
    """3072 hard rays in a random order."""
    origins, directions = hard_rays(mesh, 3072, np.random.default_rng(30))
    order = np.random.default_rng(31).permutation(len(origins))
    return origins[order], directions[order]
