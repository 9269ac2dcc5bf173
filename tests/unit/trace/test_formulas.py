"""Answers known by theorem: closed meshes let no ray out."""

import numpy as np
import pytest

from ...closed_meshes import BUNNY, MAKERS, NAMES, open_closed_mesh, scan_path
from ...profiles import seeds


@pytest.fixture(scope="module", params=NAMES)
def closed(request, open_tracer):
    """A closed mesh, a tracer of it, and a function that makes points inside."""
    if request.param == "bunny" and not scan_path(BUNNY).is_file():
        pytest.skip(f"CLBVH_MESHES names no folder with {BUNNY}")
    mesh, inside = open_closed_mesh(request.param)
    return mesh, open_tracer(mesh), inside


@pytest.mark.parametrize("seed", seeds(2))
@pytest.mark.parametrize("make_rays", MAKERS, ids=lambda f: f.__name__)
def test_no_ray_escapes_from_a_closed_mesh(closed, make_rays, seed):
    mesh, tracer, inside = closed
    origins, directions = make_rays(mesh, inside, 1 << 16, np.random.default_rng([50, seed]))
    hits = tracer.closest_hit(origins, directions)
    assert np.flatnonzero(~hits.is_hit).tolist() == []
    assert tracer.any_hit(origins, directions).all()
    # From inside, a ray goes out once more than it goes in.
    assert np.flatnonzero(tracer.count_hits(origins, directions) % 2 == 0).tolist() == []
    assert len(np.unique(hits.prim_id)) > 0.5 * min(mesh.face_count, 4000)
