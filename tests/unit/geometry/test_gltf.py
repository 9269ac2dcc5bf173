"""glTF: the scene graph, primitives, accessors, buffers; and what is refused by name."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
import trimesh

from clbvh import Mesh, load_mesh
from clbvh.errors import MeshError
from clbvh.support import memory

from .gltf_files import CODES, Gltf, pack_glb

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
TRIANGLE = SQUARE[:3]
UP = np.array([0, 0, 1])
IDENTITY = np.eye(4).T.ravel().tolist()


@pytest.fixture
def gltf():
    return Gltf()


@pytest.fixture
def load(tmp_path):
    """A function that loads a document as GLB."""
    return lambda gltf: load_mesh(gltf.write_glb(tmp_path / "a.glb"))


def corners_of(mesh: Mesh) -> np.ndarray:
    """Return the corners of the triangles in the file's coordinates, (F, 3, 3)."""
    return mesh.vertices[mesh.faces]


# --- The scene graph -------------------------------------------------------------------------------------------------


def test_transforms_are_applied_from_the_root_down(gltf, load):
    half = math.sqrt(0.5)
    child = gltf.add_part(TRIANGLE, node={"is_root": False, "translation": [1, 0, 0]})
    turned = gltf.add_node(is_root=False, rotation=[0, 0, half, half], children=[child])
    gltf.add_node(scale=[2, 2, -2], translation=[0, 0, 5], children=[turned])
    # (x, y, 0) is moved to (x + 1, y, 0), turned to (-y, x + 1, 0), scaled and moved; the mirror swaps two corners.
    assert corners_of(load(gltf)) == pytest.approx(np.array([[[-2, 4, 5], [0, 4, 5], [0, 2, 5]]]), abs=1e-6)


def test_a_matrix_is_written_column_by_column(gltf, load):
    matrix = np.array([[0, -2, 0, 7], [2, 0, 0, 8], [0, 0, 2, 9], [0, 0, 0, 1.0]])
    gltf.add_part(TRIANGLE, node={"matrix": matrix.T.ravel().tolist()})
    expected = TRIANGLE @ matrix[:3, :3].T + matrix[:3, 3]
    assert corners_of(load(gltf)) == pytest.approx(expected[None], abs=1e-6)


def test_the_smallest_mirror_turns_the_corners_round(gltf, load):
    gltf.add_part(TRIANGLE, node={"matrix": np.diag([-1e-120, 1e-120, 1e-120, 1]).ravel().tolist()})
    assert load(gltf).faces.tolist() == [[2, 1, 0]]


def test_parts_follow_the_file_depth_first(gltf, load, tmp_path):
    """As trimesh has them too, but for the vertices, which it lists once for each primitive."""
    deep = gltf.add_part(TRIANGLE + 2, node={"is_root": False})
    inner = gltf.add_part(TRIANGLE + 1, node={"is_root": False, "children": [deep]})
    late = gltf.add_part(TRIANGLE + 3, node={"is_root": False})
    gltf.add_node(mesh=0, children=[inner, late], translation=[-2, -2, -2])
    gltf.add_part(TRIANGLE + 5)
    assert corners_of(load(gltf))[:, 0, 0].tolist() == [0, -1, 0, 1, 5]
    scene = trimesh.load_scene(tmp_path / "a.glb", process=False)
    assert sorted(scene.to_geometry().triangles[:, 0, 0].tolist()) == [-1, 0, 0, 1, 5]


def test_a_mesh_of_several_nodes_is_listed_for_each(gltf, load):
    gltf.add_part(SQUARE, [[0, 1, 2], [0, 2, 3]])
    gltf.add_node(mesh=0, translation=[0, 0, 3])
    mesh = load(gltf)
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
    assert corners_of(mesh)[:, 0, 2].tolist() == [0, 0, 3, 3]


def test_primitives_share_the_vertices_of_an_accessor(gltf, load):
    positions = gltf.add_accessor(SQUARE, "f4")
    halves = [gltf.add_accessor(corners, "u1") for corners in ([0, 1, 2], [0, 2, 3])]
    gltf.add_node(mesh=gltf.add_mesh(*({"attributes": {"POSITION": positions}, "indices": half} for half in halves)))
    mesh = load(gltf)
    assert (len(mesh.vertices), mesh.faces.tolist()) == (4, [[0, 1, 2], [0, 2, 3]])


def test_the_scene_that_is_shown(gltf, load):
    for height in range(3):
        gltf.add_part(TRIANGLE + height * UP, node={"is_root": False})
    gltf.document |= {"scenes": [{"nodes": [0]}, {"nodes": [2]}], "scene": 1}
    assert corners_of(load(gltf))[:, 0, 2].tolist() == [2]
    del gltf.document["scene"]
    assert corners_of(load(gltf))[:, 0, 2].tolist() == [0]
    del gltf.document["scenes"]
    gltf.document["nodes"][1]["children"] = [0]
    assert corners_of(load(gltf))[:, 0, 2].tolist() == [1, 0, 2]
    del gltf.document["nodes"]
    assert corners_of(load(gltf))[:, 0, 2].tolist() == [0, 1, 2]


@pytest.mark.parametrize("children", [[0], [1], [2, 2]], ids=["itself", "its-parent", "twice"])
def test_nodes_that_are_no_tree_are_refused(gltf, load, children):
    gltf.add_node(is_root=False, children=children)
    gltf.add_node(children=[0])
    gltf.add_part(TRIANGLE, node={"is_root": False})
    with pytest.raises(MeshError, match=r"nodes\[\d\] has two parents or is one of its own"):
        load(gltf)


@pytest.mark.parametrize(
    ("node", "message"),
    [
        ({"translation": [0, 0]}, "translation of a node must be 3 finite numbers"),
        ({"translation": [0, 0, 1e400]}, "translation of a node must be 3 finite numbers"),
        ({"scale": "large"}, "scale of a node must be 3 finite numbers"),
        ({"scale": [[1], [1, 2], 3]}, "scale of a node must be 3 finite numbers"),
        ({"rotation": [0, 0, 0, 0]}, "rotation of length 0"),
        ({"matrix": [1] * 9}, "matrix of a node must be 16 finite numbers"),
        ({"matrix": [*IDENTITY[:3], 1, *IDENTITY[4:]]}, "no affine transform"),
        ({"children": [7]}, r"nodes\[7\], but has 1 nodes"),
        ({"children": ["a"]}, r"nodes\['a'\]"),
        ({"children": 1}, "'children' must be a list"),
        ({"mesh": 1}, r"meshes\[1\], but has 1 meshes"),
        ({"translation": [1e308] * 3, "scale": [1e308] * 3}, "not finite|float"),
    ],
)
def test_a_bad_node_is_refused(gltf, load, node, message):
    gltf.add_part(SQUARE, [[0, 1, 2]])
    gltf.document["nodes"][0] |= node
    with pytest.raises(MeshError, match=message):
        load(gltf)


# --- Primitives ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("is_indexed", [True, False])
@pytest.mark.parametrize(
    ("mode", "faces"),
    [
        (4, [[0, 1, 2], [3, 4, 5]]),
        (5, [[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4]]),
        (6, [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]),
    ],
    ids=["triangles", "strip", "fan"],
)
def test_every_way_to_write_triangles(gltf, load, mode, faces, is_indexed):
    points = np.random.default_rng(mode).normal(size=(6, 3))
    order = [5, 3, 1, 0, 2, 4] if is_indexed else range(6)
    gltf.add_part(points, order if is_indexed else None, mode=mode)
    gltf.add_part(TRIANGLE)
    mesh = load(gltf)
    assert mesh.faces.tolist() == [[order[corner] for corner in face] for face in faces] + [[6, 7, 8]]
    assert corners_of(mesh)[0] == pytest.approx(points[[order[corner] for corner in faces[0]]], abs=1e-6)


def test_points_and_lines_are_no_triangles(gltf, load):
    for mode in range(4):
        gltf.add_part(SQUARE, mode=mode)
    with pytest.raises(MeshError, match="no triangles"):
        load(gltf)
    gltf.add_part(TRIANGLE, mode=5)
    gltf.add_part(TRIANGLE[:2], mode=6)
    assert load(gltf).faces.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize(
    ("primitive", "message"),
    [
        ({"mode": 7}, r"meshes\[0\].primitives\[0\] has the mode 7"),
        ({"mode": "fan"}, "has the mode fan"),
        ({"indices": 0}, r"accessors\[0\] has vertex indices, so it must be SCALAR"),
        ({"attributes": {"POSITION": 1}}, r"accessors\[1\] has vectors of 1 numbers, not 3"),
        ({"attributes": {"POSITION": 9}}, r"accessors\[9\], but has 2 accessors"),
        ({"attributes": []}, "'attributes' must be an object"),
        ({"indices": None}, r"primitives\[0\] has 4 corners, but triangles need a multiple of 3"),
    ],
)
def test_a_bad_primitive_is_refused(gltf, load, primitive, message):
    gltf.add_part(SQUARE, [0, 1, 2])
    gltf.document["meshes"][0]["primitives"][0] |= primitive
    with pytest.raises(MeshError, match=message):
        load(gltf)


# --- Accessors -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", ["u1", "u2", "u4"])
def test_every_type_of_index(gltf, load, dtype):
    """Not divided even where a file says so, which it must not."""
    positions, indices = gltf.add_accessor(SQUARE, "f4"), gltf.add_accessor([3, 1, 2], dtype, normalized=True)
    gltf.add_node(mesh=gltf.add_mesh({"attributes": {"POSITION": positions}, "indices": indices}))
    assert load(gltf).faces.tolist() == [[3, 1, 2]]


@pytest.mark.parametrize("dtype", ["i1", "u1", "i2", "u2"])
@pytest.mark.parametrize("is_normalised", [False, True])
def test_quantised_positions(gltf, load, dtype, is_normalised):
    """As KHR_mesh_quantization has them; the smallest signed number stands for -1, like the one above it."""
    info = np.iinfo(dtype)
    whole = np.array([[info.max, 0, 1], [info.min, info.max, 0], [0, 3, 7]])
    gltf.document |= {"extensionsRequired": ["KHR_mesh_quantization"], "extensionsUsed": ["KHR_mesh_quantization"]}
    positions = gltf.add_accessor(whole, dtype, normalized=is_normalised)
    gltf.add_node(mesh=gltf.add_mesh({"attributes": {"POSITION": positions}}))
    expected = np.maximum(whole / info.max, -1) if is_normalised else whole
    assert corners_of(load(gltf))[0] == pytest.approx(expected, rel=1e-6, abs=1e-7)


def test_interleaved_positions(gltf, load):
    rows = np.zeros((4, 5), "<f4")
    rows[:, 1:4] = SQUARE
    view = gltf.add_view(b"pad!" + rows.tobytes(), byteStride=rows.itemsize * 5)
    accessor = {"bufferView": view, "byteOffset": 8, "componentType": CODES["f4"], "count": 4, "type": "VEC3"}
    gltf.document["accessors"].append(accessor)
    gltf.add_node(mesh=gltf.add_mesh({"attributes": {"POSITION": 0}, "mode": 6}))
    assert corners_of(load(gltf)).tolist() == SQUARE[[[0, 1, 2], [0, 2, 3]]].tolist()


@pytest.mark.parametrize("has_base", [True, False])
def test_sparse_positions(gltf, load, has_base):
    changed, places = np.array([[5.0, 6, 7], [8, 9, 10]]), np.array([2, 0])
    positions = gltf.add_accessor(SQUARE, "f4")
    accessor = gltf.document["accessors"][positions]
    if not has_base:
        del accessor["bufferView"]
    accessor["sparse"] = {
        "count": 2,
        "indices": {"bufferView": gltf.add_view(places.astype("<u2").tobytes()), "componentType": CODES["u2"]},
        "values": {"bufferView": gltf.add_view(b"...." + changed.astype("<f4").tobytes()), "byteOffset": 4},
    }
    gltf.add_node(mesh=gltf.add_mesh({"attributes": {"POSITION": positions}, "mode": 6}))
    expected = SQUARE.copy() if has_base else np.zeros((4, 3))
    expected[places] = changed
    assert corners_of(load(gltf)) == pytest.approx(expected[[[0, 1, 2], [0, 2, 3]]], abs=1e-6)
    accessor["sparse"]["indices"]["componentType"] = CODES["u1"]
    gltf.buffer = gltf.buffer.replace(b"\x02\0\0\0", b"\x02\x04\0\0")
    with pytest.raises(MeshError, match="refers to an item beyond the 4 of its accessor"):
        load(gltf)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"count": 5}, r"accessors\[0\] ends at byte 60 of bufferViews\[0\], which has 48 bytes"),
        ({"count": 10**12}, "which has 48 bytes"),
        ({"count": -1}, "'count' must be a whole number from 0, not '-1'"),
        ({"count": 1.5}, "'count' must be a whole number from 0"),
        ({"count": True}, "'count' must be a whole number from 0"),
        ({"byteOffset": 4}, "which has 48 bytes"),
        ({"componentType": 5130}, "has the componentType 5130"),
        ({"componentType": []}, "has the componentType"),
        ({"type": "VEC7"}, "must have one of the types SCALAR"),
        ({"bufferView": 1}, r"bufferViews\[1\], but has 1 bufferViews"),
    ],
)
def test_a_bad_accessor_is_refused(gltf, load, change, message):
    gltf.add_part(SQUARE, mode=6)
    gltf.document["accessors"][0] |= change
    with pytest.raises(MeshError, match=message):
        load(gltf)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"byteLength": 50}, "ends at byte 50, but its buffer has 48 bytes"),
        ({"byteOffset": 2**63}, "but its buffer has 48 bytes"),
        ({"byteStride": 8}, "items of 12 bytes, but a byteStride of 8"),
        ({"byteStride": 2**63}, "which has 48 bytes"),
        ({"buffer": 1}, r"buffers\[1\], but has 1 buffers"),
        ({"byteLength": None}, "'byteLength' must be a whole number"),
    ],
)
def test_a_bad_buffer_view_is_refused(gltf, load, change, message):
    gltf.add_part(SQUARE, mode=6)
    gltf.document["bufferViews"][0] |= change
    with pytest.raises(MeshError, match=message):
        load(gltf)


# --- Buffers and containers ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("uri", ["parts/a%20b.bin", "./parts/a b.bin", "parts\\a b.bin"])
def test_a_buffer_in_a_file_below_the_folder(gltf, tmp_path, uri):
    gltf.add_part(TRIANGLE)
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "a b.bin").write_bytes(gltf.buffer + b"more")
    assert load_mesh(gltf.write_gltf(tmp_path / "a.gltf", uri=uri)).face_count == 1


@pytest.mark.parametrize(
    "uri", ["/etc/hostname", "../a.bin", "a/../../a.bin", "file:///etc/hostname", "http://a/b", "C:\\a", "%2e%2e/a"]
)
def test_a_buffer_elsewhere_is_refused(gltf, tmp_path, uri):
    gltf.add_part(TRIANGLE)
    with pytest.raises(MeshError, match="only files in the folder of the glTF file or below it are read"):
        load_mesh(gltf.write_gltf(tmp_path / "a.gltf", uri=uri))


@pytest.mark.parametrize(
    ("buffer", "message"),
    [
        ({"uri": "data:;base64,AA=A"}, "not base64"),
        ({"uri": "data:,%00%00"}, "declares 36 bytes, but has 2"),
        ({"uri": "."}, "this is a folder"),
        ({"uri": "a\0b"}, "cannot be read"),
        ({"uri": 5}, "a uri that is no text"),
        ({"byteLength": 37}, "declares 37 bytes, but has 36"),
    ],
)
def test_a_bad_buffer_is_refused(gltf, tmp_path, buffer, message):
    gltf.add_part(TRIANGLE)
    with pytest.raises(MeshError, match=message):
        load_mesh(gltf.write_gltf(tmp_path / "a.gltf", **buffer))


def test_a_text_with_its_buffer_within(gltf, tmp_path):
    gltf.add_part(TRIANGLE)
    assert load_mesh(gltf.write_gltf(tmp_path / "a.gltf")).face_count == 1
    content = "".join(f"%{byte:02x}" for byte in gltf.buffer)
    assert load_mesh(gltf.write_gltf(tmp_path / "a.gltf", uri=f"data:,{content}")).face_count == 1
    (tmp_path / "a.gltf").write_bytes(b"\xef\xbb\xbf" + (tmp_path / "a.gltf").read_bytes())
    assert load_mesh(tmp_path / "a.gltf").face_count == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (pack_glb(b"{}", None)[:-1], "declares 24 bytes, but has 23"),
        (pack_glb(b"{}", None).replace(b"\2\0\0\0", b"\1\0\0\0", 1), "GLB 1, but GLB 2 is read"),
        (pack_glb(b"{}", None).replace(b"JSON", b"XML "), "first chunk is not JSON"),
        (pack_glb(b"{}", None).replace(b"\4\0\0\0J", b"\5\0\0\0J"), "a chunk declares 5 bytes, but 4 follow"),
        (pack_glb(b"[]", None), "must be one object"),
        (pack_glb(b"[" * 100_000, None), "JSON text cannot be read"),
        (pack_glb(b'{"asset": {"version": "1.0"}}', None), "glTF 1.0, but glTF 2 is read"),
        (pack_glb(b'{"asset": {"version": ' + b"9" * 5000 + b"}}", None), "JSON text cannot be read"),
        (pack_glb(b'{"asset": 2}', None), "'asset' must be an object"),
        (pack_glb(b'{"nodes": {}}', None), "'nodes' must be a list"),
        (pack_glb(b'{"nodes": [5]}', None), r"nodes\[0\] must be an object"),
    ],
)
def test_a_bad_container_is_refused(tmp_path, content, message):
    path = tmp_path / "a.glb"
    path.write_bytes(content)
    with pytest.raises(MeshError, match=message):
        load_mesh(path)


# --- Extensions ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"])
def test_a_required_compression_is_refused_by_name(gltf, load, name):
    gltf.add_part(TRIANGLE)
    gltf.document["extensionsRequired"] = [name]
    with pytest.raises(MeshError, match=f"compressed by {name}, which is not read"):
        load(gltf)


def test_draco_beside_uncompressed_data(gltf, load):
    gltf.add_part(SQUARE, [0, 1, 2], extensions={"KHR_draco_mesh_compression": {"bufferView": 0}})
    assert load(gltf).face_count == 1
    del gltf.document["accessors"][1]["bufferView"]
    with pytest.raises(MeshError, match="compressed by KHR_draco_mesh_compression"):
        load(gltf)
    del gltf.document["accessors"][0]["bufferView"]
    with pytest.raises(MeshError, match="compressed by KHR_draco_mesh_compression"):
        load(gltf)


def test_meshopt_beside_uncompressed_data(gltf, load, tmp_path):
    gltf.add_part(SQUARE, [0, 1, 2])
    gltf.document["bufferViews"][0]["extensions"] = {"EXT_meshopt_compression": {"buffer": 0}}
    assert load(gltf).face_count == 1
    gltf.write_gltf(tmp_path / "a.gltf")
    text = (tmp_path / "a.gltf").read_text().replace('"uri"', '"nowhere"')
    (tmp_path / "a.gltf").write_text(text)
    with pytest.raises(MeshError, match="compressed by EXT_meshopt_compression"):
        load_mesh(tmp_path / "a.gltf")


@pytest.mark.parametrize(
    "name", ["KHR_materials_unlit", "KHR_texture_basisu", "EXT_texture_webp", "KHR_lights_punctual"]
)
def test_an_extension_that_moves_no_triangle_may_be_required(gltf, load, name):
    gltf.add_part(TRIANGLE)
    gltf.document["extensionsRequired"] = [name]
    assert load(gltf).face_count == 1


@pytest.mark.parametrize("name", ["EXT_new_shapes", "", 5, "KHR_materials", "xKHR_mesh_quantization"])
def test_any_other_required_extension_is_refused_by_name(gltf, load, name):
    gltf.add_part(TRIANGLE)
    gltf.document["extensionsRequired"] = [name]
    with pytest.raises(MeshError, match=f"requires the glTF extension '{name}', which is not read"):
        load(gltf)


def test_instances_on_the_gpu_are_refused_by_name(gltf, load):
    gltf.add_part(TRIANGLE, node={"extensions": {"EXT_mesh_gpu_instancing": {"attributes": {}}}})
    with pytest.raises(MeshError, match=r"nodes\[0\] is drawn many times by EXT_mesh_gpu_instancing"):
        load(gltf)


# --- Size ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["positions", "indices"])
def test_zeros_for_which_the_file_has_no_bytes_are_bounded(gltf, load, kind):
    gltf.add_part(SQUARE, [0, 1, 2])
    accessor = gltf.document["accessors"][0 if kind == "positions" else 1]
    del accessor["bufferView"]
    accessor["count"] = 300
    assert load(gltf).face_count == (1 if kind == "positions" else 100)
    accessor["count"] = 10**8
    with pytest.raises(MeshError, match="declares 100,000,000 items, for which the file has no bytes"):
        load(gltf)


def test_a_mesh_that_many_nodes_draw_must_fit_the_memory(gltf, load, monkeypatch):
    gltf.add_part(np.tile(SQUARE[:3], (1000, 1)), node={"is_root": False})
    for _ in range(1000):
        gltf.add_node(mesh=0)
    monkeypatch.setattr(memory, "free_memory_bytes", lambda: 1 << 28)
    with pytest.raises(MeshError, match="1,000,000 triangles and 3,000,000 vertices need about 450 MB of memory"):
        load(gltf)


def test_nodes_are_visited_in_linear_time(gltf, load):
    """Counted in calls, since a clock differs between machines: a quadratic walk would make some 10^8."""
    count = 5000
    gltf.add_part(TRIANGLE, node={"is_root": False})
    for number in range(count):
        gltf.add_node(is_root=False, children=[number], translation=[1, 0, 0])
    gltf.document["scenes"][0]["nodes"] = [count]
    calls = 0

    def count_calls(*_) -> None:
        nonlocal calls
        calls += 1

    sys.setprofile(count_calls)
    try:
        mesh = load(gltf)
    finally:
        sys.setprofile(None)
    assert corners_of(mesh)[0, 0].tolist() == [count, 0, 0]
    assert calls < 200 * count
