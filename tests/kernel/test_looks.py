"""How surfaces look: normals in 32 bits against numpy, and textures at their edges."""

import numpy as np
import pytest

import clbvh
from clbvh.layouts.pack_normals import pack_normals
from clbvh.rendering.look_tables import TextureTables

BUNDLE = "look_shells"

# Of the octahedral map with 16 bits a side.
NORMAL_ERROR_DEGREES = 0.0045

# The texels of a texture of one row, and those around it by the rules of its edges.
ROW = [10, 60, 110, 160]
AROUND = {
    "repeat": [*ROW, *ROW, *ROW],
    "clamp": [*[10] * 4, *ROW, *[160] * 4],
    "mirror": [*ROW[::-1], *ROW, *ROW[::-1]],
}


def find_directions(kind):
    if kind == "axes":
        return np.concatenate((np.eye(3), -np.eye(3)))
    if kind == "edges":
        signs = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        return signs[np.abs(signs).sum(axis=1) > 0]
    return np.random.default_rng(3).normal(size=(5000, 3))


@pytest.mark.parametrize("kind", ["axes", "edges", "random-seed3"])
def test_normals_come_back(run_shell, kind):
    directions = find_directions(kind)
    normals = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    packed = pack_normals(normals.astype(np.float32))
    (decoded,) = run_shell("decode_normals", [packed], [(np.float32, (3,))], BUNDLE)
    np.testing.assert_allclose(np.linalg.norm(decoded, axis=1), 1, rtol=0, atol=2e-7)
    sines = np.linalg.norm(np.cross(decoded.astype(float), normals), axis=1)
    assert np.degrees(sines).max() < NORMAL_ERROR_DEGREES
    assert (np.einsum("ij,ij->i", decoded, normals) > 0).all()


def test_axes_are_exact(run_shell):
    axes = find_directions("axes")
    (decoded,) = run_shell("decode_normals", [pack_normals(axes.astype(np.float32))], [(np.float32, (3,))], BUNDLE)
    assert (decoded == axes).all()


def read(run_shell, texture, uvs):
    tables = TextureTables()
    number = tables.number(texture)
    arrays = tables.arrays()
    uvs = np.asarray(uvs, np.float32)
    ids = np.full(len(uvs), number, np.int32)
    inputs = [uvs, ids, arrays["textures"], arrays["texels"], arrays["decoded_srgb"]]
    (colours,) = run_shell("read_textures", inputs, [(np.float32, (4,))], BUNDLE)
    return colours


def make_row(wrap, *, is_vertical=False, is_srgb=False):
    pixels = np.full((1, len(ROW), 4), 255, np.uint8)
    pixels[0, :, :3] = np.array(ROW)[:, None]
    if is_vertical:
        # Row 0 is the top.
        pixels = np.ascontiguousarray(pixels.transpose(1, 0, 2)[::-1])
    return clbvh.Texture("row", pixels, is_srgb=is_srgb, wrap=(wrap, wrap))


@pytest.mark.parametrize("is_vertical", [False, True])
@pytest.mark.parametrize("wrap", AROUND)
def test_textures_go_on_beyond_their_edges(run_shell, wrap, is_vertical):
    # Centres of texels and points between them, from one size before the texture to one behind it.
    places = np.arange(-3.5, 7.01, 0.25)
    uvs = np.full((len(places), 2), 0.5)
    uvs[:, int(is_vertical)] = places / len(ROW)
    colours = read(run_shell, make_row(wrap, is_vertical=is_vertical), uvs)
    expected = np.interp(places, np.arange(-4, 8) + 0.5, AROUND[wrap]) / 255
    np.testing.assert_allclose(colours[:, 0], expected, rtol=0, atol=1e-6)
    assert (colours[:, 3] == 1).all()


def test_srgb_is_decoded_before_it_is_blended(run_shell):
    pixels = np.array([[[0, 0, 0, 255], [255, 255, 255, 255]]], np.uint8)
    texture = clbvh.Texture("edge", pixels, is_srgb=True, wrap=("clamp", "clamp"))
    assert read(run_shell, texture, [(0.5, 0.5)])[0, 0] == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize("place", [np.nan, np.inf, -np.inf, 1e30, -1e30])
def test_places_that_no_texture_needs_have_some_colour(run_shell, place):
    colours = read(run_shell, make_row("repeat"), [(place, 0.5), (0.5, place)])
    assert ((colours >= 0) & (colours <= 1)).all()
