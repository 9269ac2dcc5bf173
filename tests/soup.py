"""Triangle soups for tests: unconnected triangles, seeded, with as many defects as a test asks for."""

import numpy as np

from clbvh import Mesh


def make_soup(count, seed, *, grid=1000, size=20, copies=0.0, degenerate=0.0, scale=1.0):
    """Return a mesh of `count` triangles, with first corners on a grid and edges of at most `size` along each axis.

    A small grid makes equal centroids and coplanar triangles; `copies` and `degenerate` are shares of all triangles.
    """
    random = np.random.default_rng(seed)
    first = random.integers(0, grid, (count, 1, 3), endpoint=True)
    corners = np.concatenate([first, first + random.integers(0, size, (count, 2, 3), endpoint=True)], axis=1)
    bad = random.random(count) < degenerate
    corners[bad, 2] = corners[bad, 1]
    points = bad & (random.random(count) < 0.5)
    corners[points] = corners[points, :1]
    copied = random.random(count) < copies
    corners[copied] = corners[random.integers(0, count, copied.sum())]
    faces = np.arange(3 * count).reshape(-1, 3)
    return Mesh.from_arrays(corners.reshape(-1, 3) * scale, faces, name=f"soup {count}, seed {seed}")
