"""Points inside a closed mesh, and their distance to its surface: the volume by random points.

python examples/inside_test.py [MESH] [--points 100000]
"""

from __future__ import annotations

import argparse

import numpy as np

import clbvh


def estimate_volume(tracer: clbvh.Tracer, mesh: clbvh.Mesh, count: int, seed: int = 0) -> tuple[float, float]:
    """Return an estimate of the mesh's volume by random points, and its standard error."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    points = np.random.default_rng(seed).uniform(low, high, (count, 3))
    share = tracer.contains(points).mean()
    box = float(np.prod(high - low))
    return box * share, box * float(np.sqrt(share * (1 - share) / count))


def volume(mesh: clbvh.Mesh) -> float:
    """Return the volume by the divergence theorem, for faces that all point outwards."""
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mesh", nargs="?", help="a closed mesh; without it, a knot")
    parser.add_argument("--points", type=int, default=100_000)
    options = parser.parse_args()
    mesh = clbvh.load_mesh(options.mesh) if options.mesh else clbvh.make_shape("knot", triangles=20_000)
    with clbvh.Tracer(clbvh.build(mesh)) as tracer:
        estimate, error = estimate_volume(tracer, mesh, options.points)
        deepest = tracer.signed_distance(mesh.vertices.mean(axis=0)[None] + mesh.origin)[0]
    print(f"volume by {options.points:,} points: {estimate:.6g} +- {error:.2g}, by its faces: {volume(mesh):.6g}")
    print(f"signed distance of the vertices' mean, positive inside: {deepest:.6g}")


if __name__ == "__main__":
    main()
