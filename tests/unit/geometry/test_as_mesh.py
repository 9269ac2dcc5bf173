"""What users may give for a mesh: a `Mesh`, arrays, a path, or an object of another library with its looks."""

from types import SimpleNamespace

import meshio
import numpy as np
import pandas
import pytest
import trimesh
from PIL import Image
from trimesh.visual import ColorVisuals, TextureVisuals
from trimesh.visual.material import MultiMaterial, PBRMaterial, SimpleMaterial

import clbvh
from clbvh import MeshError
from clbvh.geometry.appearance.srgb import srgb_to_linear
from clbvh.geometry.as_mesh import as_mesh

CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
FACES = np.array([[0, 1, 2]])
MESH = clbvh.Mesh.from_arrays(CORNERS, FACES)
PIXELS = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)
BYTES = np.random.default_rng(0).integers(0, 256, (12, 4), np.uint8)


class NoArray:
    def __array__(self, *args, **how):
        raise TypeError("no numbers here")


def test_every_form_is_the_same_mesh_and_can_be_traced(tmp_path):
    path = tmp_path / "triangle.off"
    path.write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    pairs = (CORNERS, FACES), [CORNERS.tolist(), FACES.tolist()], (np.ma.masked_array(CORNERS), FACES)
    for thing in (MESH, trimesh.Trimesh(CORNERS, FACES), path, str(path), *pairs):
        mesh = as_mesh(thing)
        assert mesh.fingerprint == MESH.fingerprint
        np.testing.assert_array_equal(mesh.vertices, CORNERS)
        assert not np.shares_memory(mesh.vertices, CORNERS)
        assert clbvh.build(thing).nodes.tobytes() == clbvh.build(MESH).nodes.tobytes()
    with clbvh.Tracer(pairs[0]) as tracer:
        assert tracer.closest_hit([[0.25, 0.25, 2]], [[0, 0, -1]]).t == 2
    assert as_mesh(MESH) is MESH


def test_anything_else_is_refused_in_one_sentence():
    masked = np.ma.masked_array(CORNERS, mask=np.eye(3))
    for thing, message in (
        (5, r"clbvh\.Mesh, a mesh of trimesh, .* pair \(vertices, faces\), not int 5"),
        (CORNERS, r"a numpy\.ndarray"),
        (trimesh.Scene(), "no node with a triangle mesh"),
        (clbvh.Mesh, r"expected a clbvh.Mesh.*not "),
        ((NoArray(), FACES), "no numbers here"),
        ((masked, FACES), "some are masked"),
        ((np.broadcast_to(CORNERS[:1], (2**40, 3)), FACES), "a mesh of 1,099,511,627,776 vertices needs about .* free"),
    ):
        with pytest.raises(MeshError, match=message):
            as_mesh(thing)
    with pytest.raises(MeshError, match=r"clbvh\.Bvh, a clbvh\.Mesh"):
        clbvh.Tracer(7)


def test_cells_of_meshio_are_cut_in_their_order():
    points = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 2, 0.0]]
    cells = [("quad", [[0, 1, 2, 3]]), ("line", [[0, 1]]), ("triangle", [[3, 2, 4]]), ("polygon", [[0, 1, 2, 4, 3]])]
    mesh = as_mesh(meshio.Mesh(points, cells))
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [3, 2, 4], [0, 1, 2], [0, 2, 4], [0, 4, 3]]
    assert mesh.vertices.tolist() == points
    for kind, size, message in (
        ("triangle6", 6, "Mesh: cells of the type triangle6 are not read: triangle, quad and polygon are"),
        ("tetra", 4, "Mesh: there are no triangle, quad or polygon cells among these: tetra"),
    ):
        with pytest.raises(MeshError, match=message):
            clbvh.build(meshio.Mesh(np.zeros((6, 3)), [(kind, [range(size)])]))
    with pytest.raises(MeshError, match=r"Mesh: vertices must have shape \(V, 3\), not \(5, 2\)"):
        clbvh.Scene(meshio.Mesh(np.array(points)[:, :2], cells))


class TensorMap(dict):
    """Tensors by name, as attributes, too; a name without a tensor is a `KeyError`."""

    __getattr__ = dict.__getitem__


def tensor(array):
    return SimpleNamespace(cpu=lambda: SimpleNamespace(numpy=lambda: array))


def test_meshes_of_open3d_have_their_colours():
    shares = np.array([[1, 0.5, 0], [0, 0, 0], [0, 1, 0.2]])
    legacy = SimpleNamespace(vertices=CORNERS.tolist(), triangles=FACES.tolist(), vertex_colors=shares.tolist())
    vertex = TensorMap(positions=tensor(CORNERS.astype(np.float32)), colors=tensor(shares.astype(np.float32)))
    tensors = SimpleNamespace(vertex=vertex, triangle=TensorMap(indices=tensor(FACES)))
    for thing in (legacy, tensors):
        mesh = as_mesh(thing)
        assert mesh.fingerprint == MESH.fingerprint
        assert mesh.appearance.colours[0].tolist() == [[255, 128, 0, 255], [0, 0, 0, 255], [0, 255, 51, 255]]
    legacy.vertex_colors = []
    del vertex["colors"]
    assert as_mesh(legacy).appearance is as_mesh(tensors).appearance is None
    empty = SimpleNamespace(vertex=TensorMap(), triangle=TensorMap())
    with pytest.raises(MeshError, match=r"a types\.SimpleNamespace has no triangles that can be read$"):
        as_mesh(empty)


@pytest.mark.parametrize("colours", [CORNERS[:1], CORNERS + np.nan, CORNERS[0]], ids=["too few", "nan", "one"])
def test_colours_that_cannot_be_used_are_left_out_with_a_warning(colours):
    with pytest.warns(clbvh.AppearanceWarning, match="SimpleNamespace: the colours cannot be used: "):
        mesh = as_mesh(SimpleNamespace(vertices=CORNERS, triangles=FACES, vertex_colors=colours))
    assert mesh.appearance is None
    assert mesh.face_count == 1


@pytest.mark.parametrize("take", [as_mesh, clbvh.Scene, clbvh.Tracer])
def test_graphs_that_cannot_be_read_are_refused_in_one_sentence(take):
    triangle, nodes = SimpleNamespace(vertices=CORNERS, faces=FACES), type("Graph", (dict,), {"nodes_geometry": ["a"]})
    for graph, geometry in (
        (None, {}),
        ({}, {}),
        (nodes(a=None), {}),
        (nodes(a=(np.eye(4), "b")), {}),
        (nodes(a=("no matrix", "b")), {"b": triangle}),
        (nodes(a=(np.eye(4), "b")), {"b": SimpleNamespace(vertices=None, faces=None)}),
    ):
        with pytest.raises(MeshError, match=r"a types\.SimpleNamespace has no triangles that can be read$"):
            take(SimpleNamespace(graph=graph, geometry=geometry))


def test_vertices_of_a_table_are_its_columns_by_name():
    table = pandas.DataFrame({"id": [7, 8, 9], **dict(zip("zyx", CORNERS.T[::-1], strict=True))})
    faces = pandas.DataFrame(FACES, columns=["a", "b", "c"])
    assert as_mesh((table, faces)).fingerprint == MESH.fingerprint
    with pytest.raises(MeshError, match=r"mesh: vertices must have shape \(V, 3\), not \(3, 4\)"):
        as_mesh((table.rename(columns=str.upper), faces))


def make_box(visual=None, **colours):
    box = trimesh.creation.box()
    box.visual = visual or ColorVisuals(box, **colours)
    return box


def material_of(material):
    (read,) = as_mesh(make_box(TextureVisuals(uv=np.zeros((8, 2)), material=material))).appearance.materials
    return read


def test_colours_and_coordinates_of_trimesh():
    faces = trimesh.creation.box().faces
    np.testing.assert_array_equal(as_mesh(make_box(vertex_colors=BYTES[:8])).appearance.colours, BYTES[faces])
    looks = as_mesh(make_box(face_colors=BYTES)).appearance
    np.testing.assert_array_equal(looks.colours, np.repeat(BYTES[:, None], 3, axis=1))
    assert looks.materials[0].base_colour == (1, 1, 1)
    assert as_mesh(trimesh.creation.box()).appearance is None
    uvs, ids = BYTES[:8, :2] / 256, np.arange(12) % 2
    several = MultiMaterial([PBRMaterial(name="a"), PBRMaterial(name="b")])
    looks = as_mesh(make_box(TextureVisuals(uv=uvs, material=several, face_materials=ids))).appearance
    np.testing.assert_array_equal(looks.uvs, np.float32(uvs)[faces])
    assert [material.name for material in looks.materials] == ["a", "b"]
    assert looks.material_ids.tolist() == ids.tolist()


def test_materials_of_trimesh():
    image = Image.fromarray(PIXELS)
    simple = material_of(SimpleMaterial(image=image, diffuse=[255, 128, 0, 64], glossiness=98))
    assert simple.base_colour == pytest.approx(srgb_to_linear(np.array([255, 128, 0]) / 255))
    assert (simple.alpha, simple.roughness) == (64 / 255, pytest.approx(0.02**0.25))
    np.testing.assert_array_equal(simple.base_colour_texture.pixels, PIXELS)
    physical = material_of(
        PBRMaterial(
            name="paint", baseColorFactor=[0, 51, 255, 102], metallicFactor=0.25, alphaMode="MASK", alphaCutoff=0.3,
            emissiveFactor=[1, 0.5, 0], baseColorTexture=image, metallicRoughnessTexture=image, normalTexture=image,
        )
    )  # fmt: skip
    assert physical.base_colour == pytest.approx((0, 0.2, 1))
    assert (physical.name, physical.metallic, physical.roughness, physical.alpha_cutoff) == ("paint", 0.25, 1.0, 0.3)
    assert (physical.alpha, physical.emission) == (pytest.approx(0.4), (1, 0.5, 0))
    np.testing.assert_array_equal(physical.base_colour_texture.pixels, PIXELS)
    textures = physical.base_colour_texture, physical.metallic_roughness_texture, physical.normal_texture
    assert [texture.is_srgb for texture in textures] == [True, False, False]
