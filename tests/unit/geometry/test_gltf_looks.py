"""Looks in glTF files: attributes, materials, textures, and what becomes of them in a scene of several parts."""

from __future__ import annotations

import base64
import io

import numpy as np
import pytest
import trimesh
from PIL import Image

import clbvh
from clbvh.geometry.appearance.srgb import linear_to_srgb
from clbvh.geometry.loading.load import load_parts

from .gltf_files import Gltf

SQUARE = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0.0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
UNIT = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, -1, 0], [-1, 0, 0.0]])
UVS = np.array([[0, 0], [1, 0], [1, 0.5], [0.25, 0.75]])
PIXELS = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)
UPSIDE_DOWN = [1, -1]


def png(pixels=PIXELS):
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG")
    return stream.getvalue()


def make(material=None, *, attributes=None, **document):
    """Return a document of one square with attributes and a material."""
    gltf = Gltf()
    primitive = {
        "attributes": {"POSITION": gltf.add_accessor(SQUARE, "f4")},
        "indices": gltf.add_accessor(FACES.ravel(), "u2"),
    }
    for name, (values, dtype, *keys) in (attributes or {}).items():
        primitive["attributes"][name] = gltf.add_accessor(values, dtype, **(keys[0] if keys else {}))
    if material is not None:
        primitive["material"] = 0
        gltf.document["materials"] = [material]
    gltf.document |= document
    gltf.add_node(mesh=gltf.add_mesh(primitive))
    return gltf


def with_image(gltf, *, texture=None, **sampler):
    """Add an embedded image, and a texture of it."""
    gltf.document["images"] = [{"bufferView": gltf.add_view(png()), "mimeType": "image/png"}]
    gltf.document["samplers"] = [sampler]
    gltf.document["textures"] = [texture or {"source": 0, "sampler": 0}]
    return gltf


def looks_of(gltf, tmp_path):
    return clbvh.load_mesh(gltf.write_glb(tmp_path / "a.glb")).appearance


def test_attributes_follow_the_corners(tmp_path):
    looks = looks_of(make(attributes={"NORMAL": (UNIT * 2, "f4"), "TEXCOORD_0": (UVS, "f4")}), tmp_path)
    np.testing.assert_allclose(looks.normals, UNIT[FACES], atol=1e-7)
    np.testing.assert_allclose(looks.uvs, (UVS * UPSIDE_DOWN + [0, 1])[FACES], atol=1e-7)
    assert looks.materials == ()


@pytest.mark.parametrize(("dtype", "most"), [("f4", 1), ("u1", 255), ("u2", 65535)])
@pytest.mark.parametrize("width", [3, 4])
def test_colours_are_linear_in_the_file(tmp_path, dtype, most, width):
    shares = np.array([[0, 0.2, 0.4, 0.6], [0.6, 0.8, 1, 0.4], [1, 1, 0, 0], [0.1, 0.5, 0.9, 1]])[:, :width]
    stored = shares * most if most == 1 else np.rint(shares * most)
    attributes = {"COLOR_0": (stored, dtype, {"normalized": most != 1})}
    looks = looks_of(make({"alphaMode": "BLEND"}, attributes=attributes), tmp_path)
    expected = np.rint(linear_to_srgb(stored[:, :3] / most) * 255)[FACES]
    np.testing.assert_allclose(looks.colours[..., :3], expected, atol=1)
    alpha = np.rint(shares[:, 3] * 255) if width == 4 else np.full(4, 255)
    np.testing.assert_array_equal(looks.colours[..., 3], alpha[FACES])


def test_quantised_normals_and_coordinates_are_shares(tmp_path):
    keys = {"normalized": True}
    attributes = {"NORMAL": (np.rint(UNIT * 127), "i1", keys), "TEXCOORD_0": (np.rint(UVS * 65535), "u2", keys)}
    looks = looks_of(make(attributes=attributes), tmp_path)
    np.testing.assert_allclose(looks.normals, UNIT[FACES], atol=0.01)
    np.testing.assert_allclose(looks.uvs, (UVS * UPSIDE_DOWN + [0, 1])[FACES], atol=1e-4)


def test_a_material_of_numbers(tmp_path):
    material = {
        "name": "lamp",
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.1, 0.2, 0.3, 0.4],
            "metallicFactor": 0.5,
            "roughnessFactor": 0.25,
        },
        "emissiveFactor": [1, 0.5, 0],
        "alphaMode": "MASK",
        "alphaCutoff": 0.3,
        "extensions": {
            "KHR_materials_emissive_strength": {"emissiveStrength": 20},
            "KHR_materials_transmission": {"transmissionFactor": 0.75},
            "KHR_materials_ior": {"ior": 1.33},
        },
    }
    (read,) = looks_of(make(material), tmp_path).materials
    assert read == clbvh.Material(
        "lamp", (0.1, 0.2, 0.3), 0.4, 0.3, 0.5, 0.25, (20.0, 10.0, 0.0), ior=1.33, transmission=0.75
    )


def test_a_material_that_says_nothing_is_the_one_of_the_specification(tmp_path):
    (read,) = looks_of(make({}), tmp_path).materials
    assert read == clbvh.Material(base_colour=(1.0, 1.0, 1.0), metallic=1.0, roughness=1.0)


@pytest.mark.parametrize(("mode", "alpha", "cutoff"), [("OPAQUE", 1, None), ("BLEND", 0.4, None), ("MASK", 0.4, 0.5)])
def test_alpha_counts_by_the_mode(tmp_path, mode, alpha, cutoff):
    info = {"baseColorFactor": [1, 1, 1, 0.4], "baseColorTexture": {"index": 0}}
    gltf = with_image(make({"alphaMode": mode, "pbrMetallicRoughness": info}))
    (read,) = looks_of(gltf, tmp_path).materials
    assert (read.alpha, read.alpha_cutoff) == (alpha, cutoff)
    expected = PIXELS.copy()
    expected[..., 3] = 255 if mode == "OPAQUE" else PIXELS[..., 3]
    np.testing.assert_array_equal(read.base_colour_texture.pixels, expected)


@pytest.mark.parametrize("place", ["embedded", "data", "file", "file above"])
def test_textures_from_everywhere(tmp_path, place):
    pbr = {"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 0}}
    gltf = with_image(
        make({"pbrMetallicRoughness": pbr, "emissiveTexture": {"index": 0}, "emissiveFactor": [1, 1, 1]}),
        wrapS=33071,
        wrapT=33648,
    )
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
    assert read.base_colour_texture.is_srgb
    assert read.emission_texture.is_srgb
    assert read.base_colour_texture is read.emission_texture
    assert not read.metallic_roughness_texture.is_srgb
    assert read.base_colour_texture.wrap == ("clamp", "mirror")


@pytest.mark.parametrize(("scale", "read_scale"), [(None, 1), (0.25, 0.25), (-2, -2), (1e9, 100)])
def test_textures_of_normals(tmp_path, scale, read_scale):
    info = {"index": 0} | ({} if scale is None else {"scale": scale})
    (read,) = looks_of(with_image(make({"normalTexture": info})), tmp_path).materials
    np.testing.assert_array_equal(read.normal_texture.pixels[..., :3], PIXELS[..., :3])
    assert not read.normal_texture.is_srgb
    assert read.normal_scale == read_scale


def test_coordinates_of_normals_alone_are_placed_by_their_transform(tmp_path):
    info = {"index": 0, "texCoord": 1}
    gltf = make({"normalTexture": info}, attributes={"TEXCOORD_1": (UVS, "f4")})
    looks = looks_of(with_image(gltf), tmp_path)
    np.testing.assert_allclose(looks.uvs, (UVS * [1, -1] + [0, 1])[FACES], atol=1e-6)


def test_coordinates_are_placed_by_the_transform_of_the_texture(tmp_path):
    transform = {"offset": [0.5, 0.25], "rotation": np.pi / 2, "scale": [2, 3], "texCoord": 1}
    info = {"index": 0, "texCoord": 0, "extensions": {"KHR_texture_transform": transform}}
    gltf = make({"pbrMetallicRoughness": {"baseColorTexture": info}}, attributes={"TEXCOORD_1": (UVS, "f4")})
    looks = looks_of(with_image(gltf), tmp_path)
    # A quarter turn counterclockwise, as seen with v upwards: (u, v) becomes (v, -u) where v points down.
    u, v = (UVS * [2, 3]).T
    expected = np.column_stack((v + 0.5, 1 - (-u + 0.25)))
    np.testing.assert_allclose(looks.uvs, expected[FACES], atol=1e-6)


def test_the_older_materials_of_sketchfab(tmp_path):
    old = {"diffuseFactor": [0.1, 0.2, 0.3, 1], "glossinessFactor": 0.75}
    (read,) = looks_of(make({"extensions": {"KHR_materials_pbrSpecularGlossiness": old}}), tmp_path).materials
    assert (read.base_colour, read.metallic, read.roughness) == ((0.1, 0.2, 0.3), 0, 0.25)


def add_square(gltf, *, normals=False, material=None, colours=False):
    primitive = {"attributes": {"POSITION": gltf.add_accessor(SQUARE, "f4")}}
    primitive["indices"] = gltf.add_accessor(FACES.ravel(), "u2")
    if normals:
        primitive["attributes"]["NORMAL"] = gltf.add_accessor(UNIT, "f4")
    if colours:
        primitive["attributes"]["COLOR_0"] = gltf.add_accessor(np.zeros((4, 3)), "f4")
    if material is not None:
        primitive["material"] = material
    return primitive


def test_parts_are_joined_with_their_looks(tmp_path):
    gltf = Gltf()
    gltf.document["materials"] = [{"name": "a"}, {"name": "b"}]
    one = add_square(gltf, normals=True, material=1)
    two = add_square(gltf, colours=True)
    three = add_square(gltf, material=0)
    gltf.add_node(mesh=gltf.add_mesh(one, two))
    gltf.add_node(mesh=gltf.add_mesh(three), rotation=[0.5**0.5, 0, 0, 0.5**0.5])  # z to -y
    path = gltf.write_glb(tmp_path / "a.glb")
    mesh = clbvh.load_mesh(path)
    looks = mesh.appearance
    assert [looks.materials[i].name for i in looks.material_ids] == ["b", "b", "", "", "a", "a"]
    np.testing.assert_array_equal(looks.colours[:, 0, 0], [255, 255, 0, 0, 255, 255])
    np.testing.assert_allclose(looks.normals[:2], UNIT[FACES], atol=1e-7)
    # The faces of the others are flat.
    np.testing.assert_allclose(looks.normals[2:], clbvh.smooth_normals_by_angle(mesh, 0)[2:], atol=1e-7)

    first, second = load_parts(path).meshes
    assert first.appearance.materials[0].name == "b"
    assert [material.name for material in second.appearance.materials] == ["a"]
    assert second.appearance.normals is None
    assert second.appearance.material_ids is None


@pytest.mark.parametrize("scale", [[1, 1, 3], [-1, 1, 1], [2, -3, -1], [-1, -1, -1]])
def test_normals_are_moved_with_their_node(tmp_path, scale):
    ball = trimesh.creation.icosphere(subdivisions=1)
    gltf = Gltf()
    flat = np.repeat(ball.face_normals, 3, axis=0)
    primitive = {"attributes": {"POSITION": gltf.add_accessor(ball.triangles.reshape(-1, 3), "f4")}}
    primitive["attributes"]["NORMAL"] = gltf.add_accessor(flat, "f4")
    primitive["attributes"]["TEXCOORD_0"] = gltf.add_accessor(ball.triangles.reshape(-1, 3)[:, :2], "f4")
    gltf.add_node(mesh=gltf.add_mesh(primitive), scale=scale, rotation=[0.6, 0, 0, 0.8])
    mesh = clbvh.load_mesh(gltf.write_glb(tmp_path / "a.glb"))
    np.testing.assert_allclose(mesh.appearance.normals, clbvh.smooth_normals_by_angle(mesh, 0), atol=1e-5)
    # Coordinates stay with their points.
    turned = [1, -1] if np.prod(scale) < 0 else [1, 1]
    corners = ball.triangles[:, ::-1] if turned[1] < 0 else ball.triangles
    np.testing.assert_allclose(mesh.appearance.uvs, corners[..., :2] * UPSIDE_DOWN + [0, 1], atol=1e-6)


@pytest.mark.parametrize(
    ("gltf", "message"),
    [
        (lambda: make(attributes={"NORMAL": (UNIT[:3], "f4")}), "normals cannot be used: there are 3 for 4"),
        (lambda: make(attributes={"NORMAL": (UNIT * np.float32(np.nan), "f4")}), "normals cannot be used: some are"),
        (lambda: make(attributes={"NORMAL": (UVS, "f4")}), "normals cannot be used: .*vectors of 2"),
        (lambda: make(attributes={"COLOR_0": (UNIT * np.float32(np.nan), "f4")}), "colours cannot be used"),
        (lambda: make({"pbrMetallicRoughness": {"baseColorFactor": [1, 2]}}), "a material cannot be used"),
        (lambda: make({"pbrMetallicRoughness": 5}), "a material cannot be used"),
        (lambda: make({"extensions": {"KHR_materials_ior": {"ior": 1e400}}}), "a material cannot be used|finite"),
        (lambda: make({"emissiveTexture": {"index": 3}}), r"a texture cannot be used: .*textures\[3\]"),
        (lambda: make({"emissiveTexture": 3}), "a texture cannot be used"),
        (
            lambda: make({"emissiveTexture": {"index": 0}}, textures=[{"source": 0}], images=[{"uri": "lost.png"}]),
            "a texture cannot be used: .*lost.png is missing",
        ),
        (
            lambda: make({"emissiveTexture": {"index": 0}}, textures=[{"source": 0}], images=[{"uri": "."}]),
            "cannot be read: this is a folder",
        ),
        (
            lambda: make({"emissiveTexture": {"index": 0}}, textures=[{"source": 0}], images=[{"uri": "http://x/y"}]),
            "only files are read",
        ),
        (
            lambda: with_image(
                make({"emissiveTexture": {"index": 0}}), texture={"extensions": {"KHR_texture_basisu": {}}}
            ),
            "no image that is read, but KHR_texture_basisu",
        ),
        (
            lambda: make(
                {"emissiveTexture": {"index": 0}}, textures=[{"source": 0}], images=[{"uri": "data:image/png,abc"}]
            ),
            "no picture in a format that is read",
        ),
    ],
)
def test_what_cannot_be_used_is_one_warning(tmp_path, gltf, message):
    path = gltf().write_glb(tmp_path / "a.glb")
    with pytest.warns(clbvh.AppearanceWarning, match=message) as caught:
        mesh = clbvh.load_mesh(path)
    assert len(caught) == 1
    assert mesh.faces.tolist() == FACES.tolist()


def test_an_index_of_a_material_that_is_not_there_is_a_warning(tmp_path):
    gltf = make({})
    gltf.document["materials"] = []
    with pytest.warns(clbvh.AppearanceWarning, match=r"materials\[0\]"):
        assert looks_of(gltf, tmp_path) is None


def test_what_trimesh_writes_is_read(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=2)
    uvs = np.random.default_rng(0).random((len(ball.vertices), 2))
    material = trimesh.visual.material.PBRMaterial(
        name="gold", baseColorFactor=[255, 128, 0, 255], metallicFactor=0.75, roughnessFactor=0.5,
        baseColorTexture=Image.fromarray(PIXELS[..., :3]), emissiveFactor=[0, 0, 1],
    )  # fmt: skip
    ball.visual = trimesh.visual.TextureVisuals(uv=uvs, material=material)
    ball.export(tmp_path / "a.glb", include_normals=True)
    mesh = clbvh.load_mesh(tmp_path / "a.glb")
    np.testing.assert_allclose(mesh.appearance.uvs, uvs[ball.faces], atol=1e-6)
    np.testing.assert_allclose(mesh.appearance.normals, ball.vertex_normals[ball.faces], atol=1e-5)
    (read,) = mesh.appearance.materials
    assert (read.name, read.metallic, read.roughness, read.emission) == ("gold", 0.75, 0.5, (0, 0, 1))
    assert read.base_colour == pytest.approx((1, 128 / 255, 0), abs=1e-6)
    np.testing.assert_array_equal(read.base_colour_texture.pixels[..., :3], PIXELS[..., :3])
