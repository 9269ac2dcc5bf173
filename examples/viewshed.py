"""The ground that an antenna sees, as a picture: the viewshed of a mast in mountains.

    python examples/viewshed.py [MESH] [-o viewshed.png] [--mast 0.003] [--width 640]

Without a mesh it stands on mountains of 10 km by 10 km. y is up. What is orange sees the top of the mast.
"""

from __future__ import annotations

import argparse

import imageio.v3 as imageio
import numpy as np

import clbvh

SEEN, HIDDEN = (255, 150, 40), (120, 128, 140)


def raise_mast(mesh: clbvh.Mesh, height: float) -> np.ndarray:
    """Return the top of a mast on the highest ground, (3,)."""
    return mesh.vertices[mesh.vertices[:, 1].argmax()] + [0, height, 0]


def paint(mesh: clbvh.Mesh, is_seen: np.ndarray) -> clbvh.Mesh:
    """Return the mesh with the vertices that are seen in one colour, the others in another one."""
    colours = np.where(is_seen[:, None], SEEN, HIDDEN).astype(np.uint8)
    return clbvh.Mesh.from_arrays(mesh.vertices, mesh.faces, appearance=clbvh.Appearance(colours=colours[mesh.faces]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mesh", nargs="?", help="a mesh file; without it, mountains")
    parser.add_argument("-o", "--output", default="viewshed.png")
    parser.add_argument("--mast", type=float, default=0.003, help="height of the mast, in sizes of the mesh")
    parser.add_argument("--width", type=int, default=640)
    options = parser.parse_args()
    mesh = clbvh.load_mesh(options.mesh) if options.mesh else clbvh.make_shape("terrain", triangles=200_000, seed=7)
    mast = raise_mast(mesh, options.mast * np.ptp(mesh.vertices, axis=0).max())
    with clbvh.Tracer(mesh) as tracer:
        vertices = tracer.closest_point(mesh.vertices)  # points that know the surface they are on
        is_seen = tracer.line_of_sight(vertices, mast)
    view = clbvh.View(shading="studio", width=options.width, height=options.width * 9 // 16)
    imageio.imwrite(options.output, clbvh.render(paint(mesh, is_seen), view).rgb)
    print(f"{options.output}: the mast sees {is_seen.mean():.1%} of {len(is_seen):,} points")


if __name__ == "__main__":
    main()
