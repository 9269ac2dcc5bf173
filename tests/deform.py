"""Meshes that move."""

import numpy as np


def deform(mesh, frame):
    """Vertices that have moved by up to a tenth of the mesh, by another way in each frame."""
    size = np.ptp(mesh.vertices)
    return mesh.vertices + 0.1 * size * np.sin(mesh.vertices[:, ::-1] / size * 5 + frame)
