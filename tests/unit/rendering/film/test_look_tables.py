"""Whether rays may pass through surfaces, which kernels are compiled for before the tables are made."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from clbvh import Appearance, Material, Spheres, Texture, make_shape
from clbvh.rendering.look_tables import has_cutouts

MESH = make_shape("cube", triangles=12)
OPAQUE = np.full((MESH.face_count, 3, 4), 255, np.uint8)
HOLE = OPAQUE.copy()
HOLE[-1, -1, 3] = 254
PIXELS = np.full((4, 4, 4), 255, np.uint8)
PIXELS_WITH_HOLE = PIXELS.copy()
PIXELS_WITH_HOLE[2, 1, 3] = 0
UVS = np.zeros((MESH.face_count, 3, 2))

OPAQUE_LOOKS = {
    "no looks": None,
    "colours": Appearance(colours=OPAQUE),
    "colours without alpha": Appearance(colours=OPAQUE[..., :3]),
    "a material": Appearance(materials=[Material("red", base_colour=(1, 0, 0))]),
    "a texture": Appearance(uvs=UVS, materials=[Material("wall", base_colour_texture=Texture("wall", PIXELS))]),
}
CUT_OUT_LOOKS = {
    "a corner": Appearance(colours=HOLE),
    "a material": Appearance(materials=[Material("red"), Material("glass", alpha=0.5)], material_ids=np.arange(12) % 2),
    "a pixel": Appearance(uvs=UVS, materials=[Material("net", base_colour_texture=Texture("net", PIXELS_WITH_HOLE))]),
}


def dress(looks):
    return dataclasses.replace(MESH, appearance=looks)


def test_nothing_is_opaque():
    assert not has_cutouts([])


@pytest.mark.parametrize("name", OPAQUE_LOOKS)
def test_opaque_surfaces_have_none(name):
    assert not has_cutouts([dress(OPAQUE_LOOKS[name]), Spheres([[0, 0, 0]], 1.0)])


@pytest.mark.parametrize("name", CUT_OUT_LOOKS)
def test_one_cut_out_surface_of_several_is_enough(name):
    opaque = [dress(looks) for looks in OPAQUE_LOOKS.values()]
    assert has_cutouts([*opaque, dress(CUT_OUT_LOOKS[name]), *opaque])
