"""A hundred million rays from inside closed meshes: none gets out, and each leaves once more than it enters."""

from __future__ import annotations

import time

import numpy as np
import pytest

import clbvh
from tests.closed_meshes import BUNNY, MAKERS, NAMES, open_closed_mesh, scan_path

RAYS = 10**8
BATCH = 10**6


@pytest.mark.parametrize("name", NAMES)
def test_no_ray_leaks(name):
    if name == "bunny" and not scan_path(BUNNY).is_file():
        pytest.skip(f"CLBVH_MESHES names no folder with {BUNNY}")
    mesh, inside = open_closed_mesh(name, larger=16)
    batches = RAYS // len(NAMES) // BATCH + 1
    leaks = even = cast = 0
    begin = time.perf_counter()
    with clbvh.Tracer(clbvh.build(mesh)) as tracer:
        for batch in range(batches):
            make_rays = MAKERS[batch % len(MAKERS)]
            rays = make_rays(mesh, inside, BATCH, np.random.default_rng([53, batch]))
            leaks += np.count_nonzero(tracer.closest_prim(*rays) < 0)
            even += np.count_nonzero(tracer.count_hits(*rays) % 2 == 0)
            cast += BATCH
        print(
            f"\n{mesh}, {tracer.layout}: {cast:,} rays, {leaks} leaks, {even} even counts, "
            f"{time.perf_counter() - begin:.0f} s"
        )
    assert leaks == even == 0
