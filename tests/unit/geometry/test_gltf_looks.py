"""Looks in glTF files: attributes, materials, textures, and what becomes of them in a scene of several parts."""

import base64
import io

import numpy as np
import pytest
import trimesh
from PIL import Image

import clbvh
from clbvh.geometry.appearance.srgb import linear_to_srgb

from .gltf_files import Gltf

SQUARE = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0.0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
UNIT = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, -1, 0], [-1, 0, 0.0]])
UVS = np.array([[0, 0], [1, 0], [1, 0.5], [0.25, 0.75]])
PIXELS = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)
UPSIDE_DOWN = [1, -1]


def png():
    stream = io.BytesIO()
    Image.fromarray(PIXELS).save(stream, "PNG")
    return stream.getvalue()


def add_square(gltf, attributes=None, **keys):
    """Return a primitive of a square."""
    primitive = {"attributes": {"POSITION": gltf.add_accessor(SQUARE, "f4")}, **keys}
    primitive["indices"] = gltf.add_accessor(FACES.ravel(), "u2")
    for name, (values, dtype, *options) in (attributes or {}).items():
        primitive["attributes"][name] = gltf.add_accessor(values, dtype, **(options[0] if options else {}))
    return primitive


def make(material=None, *, attributes=None, **document):
    """Return a document of one square with attributes and a material, and an embedded image."""
    gltf = Gltf()
    gltf.add_node(mesh=gltf.add_mesh(add_square(gltf, attributes, **({} if material is None else {"material": 0}))))
    gltf.document["images"] = [{"bufferView": gltf.add_view(png()), "mimeType": "image/png"}]
    gltf.document |= {"samplers": [{"wrapS": 33071, "wrapT": 33648}], "textures": [{"source": 0, "sampler": 0}]}
    gltf.document |= {"materials": [material or {}]} | document
    return gltf


def looks_of(gltf, tmp_path):
    return clbvh.load_mesh(gltf.write_glb(tmp_path / "a.glb")).appearance


def test_attributes_follow_the_corners_and_v_counts_from_the_top(tmp_path):
    keys = {"normalized": True}
    for attributes, tolerance in (
        ({"NORMAL": (UNIT * 2, "f4"), "TEXCOORD_0": (UVS, "f4")}, 1e-7),
        ({"NORMAL": (np.rint(UNIT * 127), "i1", keys), "TEXCOORD_0": (np.rint(UVS * 65535), "u2", keys)}, 0.01),
    ):
        looks = looks_of(make(attributes=attributes), tmp_path)
        np.testing.assert_allclose(looks.normals, UNIT[FACES], atol=tolerance)
        np.testing.assert_allclose(looks.uvs, (UVS * UPSIDE_DOWN + [0, 1])[FACES], atol=tolerance)
        assert looks.materials == ()


@pytest.mark.parametrize(("dtype", "most"), [("f4", 1), ("u1", 255), ("u2", 65535)])
def test_colours_are_linear_in_the_file(tmp_path, dtype, most):
    shares = np.array([[0, 0.2, 0.4, 0.6], [0.6, 0.8, 1, 0.4], [1, 1, 0, 0], [0.1, 0.5, 0.9, 1]])
    for width in (3, 4):
        stored = (shares * most if most == 1 else np.rint(shares * most))[:, :width]
        attributes = {"COLOR_0": (stored, dtype, {"normalized": most != 1})}
        looks = looks_of(make({"alphaMode": "BLEND"}, attributes=attributes), tmp_path)
        expected = np.rint(linear_to_srgb(stored[:, :3] / most) * 255)[FACES]
        np.testing.assert_allclose(looks.colours[..., :3], expected, atol=1)
        alpha = np.rint(shares[:, 3] * 255) if width == 4 else np.full(4, 255)
        np.testing.assert_array_equal(looks.colours[..., 3], alpha[FACES])


def test_materials_of_numbers(tmp_path):
    pbr = {"baseColorFactor": [0.1, 0.2, 0.3, 0.4], "metallicFactor": 0.5, "roughnessFactor": 0.25}
    extensions = {
        "KHR_materials_emissive_strength": {"emissiveStrength": 20},
        "KHR_materials_transmission": {"transmissionFactor": 0.75},
        "KHR_materials_ior": {"ior": 1.33},
    }
    lamp = {"name": "lamp", "pbrMetallicRoughness": pbr, "emissiveFactor": [1, 0.5, 0], "extensions": extensions}
    expected = clbvh.Material(
        "lamp", (0.1, 0.2, 0.3), 0.4, 0.3, 0.5, 0.25, (20.0, 10.0, 0.0), ior=1.33, transmission=0.75
    )
    old = {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [0.1, 0.2, 0.3, 1], "glossinessFactor": 0.75}}
    for table, material in (
        (lamp | {"alphaMode": "MASK", "alphaCutoff": 0.3}, expected),
        ({}, clbvh.Material(base_colour=(1.0, 1.0, 1.0), metallic=1.0, roughness=1.0)),
        ({"extensions": old}, clbvh.Material(base_colour=(0.1, 0.2, 0.3), metallic=0.0, roughness=0.25)),
    ):
        assert looks_of(make(table), tmp_path).materials == (material,)


@pytest.mark.parametrize(("mode", "alpha", "cutoff"), [("OPAQUE", 1, None), ("BLEND", 0.4, None), ("MASK", 0.4, 0.5)])
def test_alpha_counts_by_the_mode(tmp_path, mode, alpha, cutoff):
    info = {"baseColorFactor": [1, 1, 1, 0.4], "baseColorTexture": {"index": 0}}
    (read,) = looks_of(make({"alphaMode": mode, "pbrMetallicRoughness": info}), tmp_path).materials
    assert (read.alpha, read.alpha_cutoff) == (alpha, cutoff)
    expected = PIXELS.copy()
    expected[..., 3] = 255 if mode == "OPAQUE" else PIXELS[..., 3]
    np.testing.assert_array_equal(read.base_colour_texture.pixels, expected)


@pytest.mark.parametrize("place", ["embedded", "data", "file", "file above"])
def test_textures_from_everywhere(tmp_path, place):
    info = {"index": 0}
    pbr = {"baseColorTexture": info, "metallicRoughnessTexture": info}
    gltf = make({"pbrMetallicRoughness": pbr, "emissiveTexture": info, "normalTexture": info | {"scale": -2}})
    if place == "data":
        gltf.document["images"] = [{"uri": "data:image/png;base64," + base64.b64encode(png()).decode()}]
    elif place != "embedded":
        above = "../" if place == "file above" else ""
        gltf.document["images"] = [{"uri": f"{above}my%20wood.png"}]
        (tmp_path / "model").mkdir()
        (tmp_path / "model" / above / "my wood.png").write_bytes(png())
        tmp_path = tmp_path / "model"
    (read,) = looks_of(gltf, tmp_path).materials
    np.testing.assert_array_equal(read.base_colour_texture.pixels[..., :3], PIXELS[..., :3])
    assert read.base_colour_texture is read.emission_texture
    assert read.metallic_roughness_texture is read.normal_texture
    assert (read.base_colour_texture.is_srgb, read.normal_texture.is_srgb) == (True, False)
    assert read.base_colour_texture.wrap == ("clamp", "mirror")
    assert read.normal_scale == -2


def test_the_filter_is_that_of_textures_that_grow(tmp_path):
    samplers = [{"magFilter": 9728, "minFilter": 9987}, {"magFilter": 9729, "minFilter": 9728}, {"minFilter": 9728}]
    textures = [*({"source": 0, "sampler": number} for number in range(3)), {"source": 0}]
    pbr = {f"{name}Texture": {"index": number} for number, name in enumerate(("baseColor", "metallicRoughness"))}
    material = {"pbrMetallicRoughness": pbr, "emissiveTexture": {"index": 2}, "normalTexture": {"index": 3}}
    (read,) = looks_of(make(material, samplers=samplers, textures=textures), tmp_path).materials
    assert [texture.filter for texture in read.textures] == ["nearest", "linear", "linear", "linear"]


def test_coordinates_are_placed_by_the_transform_of_the_texture(tmp_path):
    attributes = {"TEXCOORD_1": (UVS, "f4")}
    alone = make({"normalTexture": {"index": 0, "texCoord": 1}}, attributes=attributes)
    np.testing.assert_allclose(looks_of(alone, tmp_path).uvs, (UVS * UPSIDE_DOWN + [0, 1])[FACES], atol=1e-6)
    transform = {"offset": [0.5, 0.25], "rotation": np.pi / 2, "scale": [2, 3], "texCoord": 1}
    info = {"index": 0, "texCoord": 0, "extensions": {"KHR_texture_transform": transform}}
    looks = looks_of(make({"pbrMetallicRoughness": {"baseColorTexture": info}}, attributes=attributes), tmp_path)
    # A quarter turn counterclockwise, as seen with v upwards: (u, v) becomes (v, -u) where v points down.
    u, v = (UVS * [2, 3]).T
    np.testing.assert_allclose(looks.uvs, np.column_stack((v + 0.5, 1 - (-u + 0.25)))[FACES], atol=1e-6)


def test_parts_are_joined_with_their_looks(tmp_path):
    gltf = Gltf()
    gltf.document["materials"] = [{"name": "a"}, {"name": "b"}]
    one = add_square(gltf, {"NORMAL": (UNIT, "f4")}, material=1)
    two = add_square(gltf, {"COLOR_0": (np.zeros((4, 3)), "f4")})
    gltf.add_node(mesh=gltf.add_mesh(one, two))
    three = gltf.add_mesh(add_square(gltf, material=0))
    gltf.add_node(mesh=three, rotation=[0.5**0.5, 0, 0, 0.5**0.5])  # z to -y
    mesh = clbvh.load_mesh(gltf.write_glb(tmp_path / "a.glb"))
    looks = mesh.appearance
    assert [looks.materials[i].name for i in looks.material_ids] == ["b", "b", "", "", "a", "a"]
    np.testing.assert_array_equal(looks.colours[:, 0, 0], [255, 255, 0, 0, 255, 255])
    np.testing.assert_allclose(looks.normals[:2], UNIT[FACES], atol=1e-7)
    # The faces of the others are flat.
    np.testing.assert_allclose(looks.normals[2:], clbvh.smooth_normals_by_angle(mesh, 0)[2:], atol=1e-7)


@pytest.mark.parametrize("scale", [[1, 1, 3], [2, -3, -1], [-1, -1, -1]])
def test_looks_are_moved_with_their_node(tmp_path, scale):
    ball = trimesh.creation.icosphere(subdivisions=1)
    gltf, corners = Gltf(), ball.triangles.reshape(-1, 3)
    values = {"POSITION": corners, "NORMAL": np.repeat(ball.face_normals, 3, axis=0), "TEXCOORD_0": corners[:, :2]}
    attributes = {name: gltf.add_accessor(array, "f4") for name, array in values.items()}
    gltf.add_node(mesh=gltf.add_mesh({"attributes": attributes}), scale=scale, rotation=[0.6, 0, 0, 0.8])
    mesh = clbvh.load_mesh(gltf.write_glb(tmp_path / "a.glb"))
    np.testing.assert_allclose(mesh.appearance.normals, clbvh.smooth_normals_by_angle(mesh, 0), atol=1e-5)
    # Coordinates stay with their points.
    turned = ball.triangles[:, ::-1] if np.prod(scale) < 0 else ball.triangles
    np.testing.assert_allclose(mesh.appearance.uvs, turned[..., :2] * UPSIDE_DOWN + [0, 1], atol=1e-6)


def test_what_cannot_be_used_is_one_warning(tmp_path):
    nan, lost = UNIT * np.float32(np.nan), {"emissiveTexture": {"index": 0}}
    for gltf, message in (
        (make(attributes={"NORMAL": (UNIT[:3], "f4")}), "normals cannot be used: there are 3 for 4"),
        (make(attributes={"COLOR_0": (nan, "f4")}), "colours cannot be used"),
        (make({"extensions": {"KHR_materials_ior": {"ior": 1e400}}}), "a material cannot be used|finite"),
        (make({"emissiveTexture": {"index": 3}}), r"a texture cannot be used: .*textures\[3\]"),
        (make(lost, images=[{"uri": "lost.png"}]), r"a texture cannot be used: .*lost\.png is missing"),
        (make(lost, textures=[{"extensions": {"KHR_texture_basisu": {}}}]), "no image that is read, but KHR_texture_b"),
    ):
        path = gltf.write_glb(tmp_path / "a.glb")
        with pytest.warns(clbvh.AppearanceWarning, match=message) as caught:
            mesh = clbvh.load_mesh(path)
        assert len(caught) == 1
        assert mesh.faces.tolist() == FACES.tolist()
