"""Damaged files with looks: any byte may be wrong, and the result is a mesh or a `MeshError`, with warnings at most."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import trimesh
from PIL import Image

import clbvh

MATERIAL = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.new("RGB", (2, 2)), emissiveFactor=[1, 0, 0])


def make_files(folder):
    """Write a file of each kind, with all the looks that trimesh writes."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    textured = ball.copy()
    textured.visual = trimesh.visual.TextureVisuals(uv=ball.vertices[:, :2], material=MATERIAL)
    coloured = ball.copy()
    coloured.visual.vertex_colors = np.arange(4 * len(ball.vertices), dtype=np.uint8).reshape(-1, 4)
    coloured.export(folder / "a.ply", encoding="ascii", vertex_normal=True)
    coloured.export(folder / "b.ply", vertex_normal=True)
    coloured.export(folder / "c.glb", include_normals=True)
    textured.export(folder / "d.glb")
    textured.export(folder / "e.obj", include_normals=True)
    lines = [f"{x:.3f} {y:.3f} {z:.3f} 1 2 3" for x, y, z in ball.vertices]
    faces = [f"3 {a} {b} {c} 4 5 6" for a, b, c in ball.faces]
    (folder / "f.off").write_text("\n".join(["COFF", f"{len(lines)} {len(faces)} 0", *lines, *faces]))
    return sorted(path for path in folder.iterdir() if path.suffix in (".ply", ".glb", ".obj", ".off", ".mtl"))


@pytest.mark.parametrize("seed", range(3))
def test_a_wrong_byte_is_no_crash(tmp_path, seed):
    generator = np.random.default_rng(seed)
    outcomes = set()
    for path in make_files(tmp_path):
        content = path.read_bytes()
        target = tmp_path / "e.obj" if path.suffix == ".mtl" else path
        for _ in range(25):
            damaged = bytearray(content)
            for at in generator.integers(0, len(content), 3):
                damaged[at] = generator.choice([0, 45, 47, 48, 57, 255, generator.integers(256)])
            path.write_bytes(damaged)
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                try:
                    clbvh.load_mesh(target)
                    outcomes.add("warned" if caught else "read")
                except clbvh.MeshError:
                    outcomes.add("refused")
            assert {warning.category for warning in caught} <= {clbvh.AppearanceWarning}, path
        path.write_bytes(content)
    assert outcomes == {"warned", "read", "refused"}
