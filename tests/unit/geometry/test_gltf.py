"""glTF: the scene graph, primitives, accessors, buffers; and what is refused by name."""

import numpy as np
import pytest

from clbvh import MeshError, load_mesh
from clbvh.support import memory

from .gltf_files import CODES, Gltf, pack_glb

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
TRIANGLE = SQUARE[:3]
QUAD = [[0, 1, 2], [0, 2, 3]]


@pytest.fixture
def gltf():
    return Gltf()


@pytest.fixture
def load(tmp_path):
    """A function that loads a document as GLB."""
    return lambda gltf: load_mesh(gltf.write_glb(tmp_path / "a.glb"))


@pytest.fixture
def corners(load):
    """A function that returns the corners of the triangles of a document, (F, 3, 3)."""

    def find(gltf):
        mesh = load(gltf)
        return mesh.vertices[mesh.faces]

    return find


def test_a_matrix_is_written_column_by_column(gltf, corners):
    matrix = np.array([[0, -2, 0, 7], [2, 0, 0, 8], [0, 0, 2, 9], [0, 0, 0, 1.0]])
    gltf.add_part(TRIANGLE, node={"matrix": matrix.T.ravel().tolist()})
    assert corners(gltf)[0] == pytest.approx(TRIANGLE @ matrix[:3, :3].T + matrix[:3, 3], abs=1e-6)


def test_the_scene_that_is_shown(gltf, corners):
    for height in range(3):
        gltf.add_part(np.add(TRIANGLE, [0, 0, height]), node={"is_root": False})
    gltf.document |= {"scenes": [{"nodes": [0]}, {"nodes": [2]}], "scene": 1}
    assert corners(gltf)[:, 0, 2].tolist() == [2]
    del gltf.document["scene"]
    assert corners(gltf)[:, 0, 2].tolist() == [0]
    del gltf.document["scenes"]
    gltf.document["nodes"][1]["children"] = [0]
    assert corners(gltf)[:, 0, 2].tolist() == [1, 0, 2]
    del gltf.document["nodes"]
    assert corners(gltf)[:, 0, 2].tolist() == [0, 1, 2]


@pytest.mark.parametrize("is_indexed", [True, False])
def test_every_way_to_write_triangles(load, is_indexed):
    order = [5, 3, 1, 0, 2, 4] if is_indexed else list(range(6))
    for mode, faces in (
        (4, [[0, 1, 2], [3, 4, 5]]),
        (5, [[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4]]),
        (6, [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]),
    ):
        gltf = Gltf()
        gltf.add_part(np.eye(6)[:, :3], order if is_indexed else None, mode=mode)
        gltf.add_part(TRIANGLE)
        assert load(gltf).faces.tolist() == [*np.array(order)[faces].tolist(), [6, 7, 8]], mode


def test_quantised_positions_and_indices_of_every_type(corners, load):
    for dtype in ("i1", "u1", "i2", "u2"):
        info = np.iinfo(dtype)
        whole = np.array([[info.max, 0, 1], [info.min, info.max, 0], [0, 3, 7]])
        for is_normalised in (False, True):
            gltf = Gltf()
            gltf.document["extensionsRequired"] = ["KHR_mesh_quantization"]
            positions = gltf.add_accessor(whole, dtype, normalized=is_normalised)
            gltf.add_node(mesh=gltf.add_mesh({"attributes": {"POSITION": positions}}))
            # The smallest signed number stands for -1, like the one above it.
            expected = np.maximum(whole / info.max, -1) if is_normalised else whole
            assert corners(gltf)[0] == pytest.approx(expected, rel=1e-6, abs=1e-7), dtype
    for dtype in ("u1", "u2", "u4"):
        gltf = Gltf()
        positions, indices = gltf.add_accessor(SQUARE, "f4"), gltf.add_accessor([3, 1, 2], dtype, normalized=True)
        gltf.add_node(mesh=gltf.add_mesh({"attributes": {"POSITION": positions}, "indices": indices}))
        assert load(gltf).faces.tolist() == [[3, 1, 2]], dtype


def test_interleaved_positions(gltf, corners):
    rows = np.zeros((4, 5), "<f4")
    rows[:, 1:4] = SQUARE
    view = gltf.add_view(b"pad!" + rows.tobytes(), byteStride=rows.itemsize * 5)
    accessor = {"bufferView": view, "byteOffset": 8, "componentType": CODES["f4"], "count": 4, "type": "VEC3"}
    gltf.document["accessors"].append(accessor)
    gltf.add_node(mesh=gltf.add_mesh({"attributes": {"POSITION": 0}, "mode": 6}))
    assert corners(gltf).tolist() == SQUARE[QUAD].tolist()


@pytest.mark.parametrize("has_base", [True, False])
def test_sparse_positions(gltf, load, corners, has_base):
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
    expected = SQUARE * has_base
    expected[places] = changed
    assert corners(gltf) == pytest.approx(expected[QUAD], abs=1e-6)
    gltf.buffer = gltf.buffer.replace(b"\x02\0\0\0", b"\x02\x04\0\0")
    with pytest.raises(MeshError, match="refers to an item beyond the 4 of its accessor"):
        load(gltf)


def test_bad_documents_are_refused_by_name(load):
    first = np.eye(4).ravel().tolist()
    for place, change, message in (
        ("nodes", {"translation": [0, 0, 1e400]}, "translation of a node must be 3 finite numbers"),
        ("nodes", {"rotation": [0, 0, 0, 0]}, "rotation of length 0"),
        ("nodes", {"matrix": [*first[:3], 1, *first[4:]]}, "no affine transform"),
        ("nodes", {"translation": [1e308] * 3, "scale": [1e308] * 3}, "not finite|float"),
        ("nodes", {"children": [0]}, r"nodes\[0\] has two parents or is one of its own"),
        ("nodes", {"extensions": {"EXT_mesh_gpu_instancing": {}}}, "is drawn many times by EXT_mesh_gpu_instancing"),
        ("accessors", {"count": 5}, r"accessors\[0\] ends at byte 60 of bufferViews\[0\], which has 48 bytes"),
        ("bufferViews", {"byteLength": 70}, "ends at byte 70, but its buffer has 54 bytes"),
        ("bufferViews", {"byteStride": 8}, "items of 12 bytes, but a byteStride of 8"),
        ("primitives", {"indices": 0}, r"accessors\[0\] has vertex indices, so it must be SCALAR"),
        ("primitives", {"indices": None}, "has 4 corners, but triangles need a multiple of 3"),
    ):
        gltf = Gltf()
        gltf.add_part(SQUARE, [0, 1, 2])
        things = gltf.document["meshes"][0] if place == "primitives" else gltf.document
        things[place][0] |= change
        with pytest.raises(MeshError, match=message):
            load(gltf)


def test_an_index_cannot_borrow_vertices_of_the_next_part(gltf, load):
    gltf.add_part(SQUARE, [0, 1, 4])
    gltf.add_part(TRIANGLE)
    with pytest.raises(MeshError, match=r"primitives\[0\]: face 0 refers to vertex 4, .* 4 vertices \(0 to 3\)"):
        load(gltf)


def test_buffers_are_read_from_the_text_and_from_files_below_the_folder(gltf, tmp_path):
    gltf.add_part(TRIANGLE)
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "a b.bin").write_bytes(gltf.buffer + b"more")
    escaped = "data:," + "".join(f"%{byte:02x}" for byte in gltf.buffer)
    for buffer in ({}, *({"uri": uri} for uri in (escaped, "parts/a%20b.bin", "parts\\a b.bin"))):
        assert load_mesh(gltf.write_gltf(tmp_path / "a.gltf", **buffer)).face_count == 1
    outside = "only files in the folder of the glTF file or below it are read"
    rows = [({"uri": uri}, outside) for uri in ("/etc/hostname", "../a.bin", "a/../../a", "http://a/b", "%2e%2e/a")]
    for buffer, message in (
        *rows,
        ({"uri": "lost.bin"}, r"lost\.bin is missing"),
        ({"uri": "data:,%00%00"}, "declares 36 bytes, but has 2"),
        ({"uri": "."}, "this is a folder"),
        ({"byteLength": 37}, "declares 37 bytes, but has 36"),
    ):
        with pytest.raises(MeshError, match=message):
            load_mesh(gltf.write_gltf(tmp_path / "a.gltf", **buffer))


def test_a_bad_container_is_refused(tmp_path):
    empty = pack_glb(b"{}", None)
    for content, message in (
        (empty[:-1], "declares 24 bytes, but has 23"),
        (empty.replace(b"\2\0\0\0", b"\1\0\0\0", 1), "GLB 1, but GLB 2 is read"),
        (empty.replace(b"\4\0\0\0J", b"\5\0\0\0J"), "a chunk declares 5 bytes, but 4 follow"),
        (pack_glb(b"[" * 100_000, None), "JSON text cannot be read"),
        (pack_glb(b'{"asset": {"version": "1.0"}}', None), "glTF 1.0, but glTF 2 is read"),
    ):
        (tmp_path / "a.glb").write_bytes(content)
        with pytest.raises(MeshError, match=message):
            load_mesh(tmp_path / "a.glb")


def test_required_extensions_that_change_triangles_are_refused_by_name(gltf, load):
    gltf.add_part(TRIANGLE)
    for name in ("KHR_materials_unlit", "KHR_texture_basisu", "EXT_texture_webp", "KHR_lights_punctual"):
        gltf.document["extensionsRequired"] = [name]
        assert load(gltf).face_count == 1
    compressions = "KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"
    others = "EXT_new_shapes", "", 5, "KHR_materials", "xKHR_mesh_quantization"
    rows = [(name, f"compressed by {name}, which is not read") for name in compressions]
    for name, message in (*rows, *((name, f"requires the glTF extension '{name}', which is not") for name in others)):
        gltf.document["extensionsRequired"] = [name]
        with pytest.raises(MeshError, match=message):
            load(gltf)


def test_what_a_small_file_makes_is_bounded(gltf, load, monkeypatch):
    gltf.add_part(np.tile(TRIANGLE, (1000, 1)), [0, 1, 2])
    accessor = gltf.document["accessors"][1]
    del accessor["bufferView"]
    accessor["count"] = 300
    assert load(gltf).face_count == 100
    accessor["count"] = 10**8
    with pytest.raises(MeshError, match="declares 100,000,000 items, for which the file has no bytes"):
        load(gltf)
    del gltf.document["meshes"][0]["primitives"][0]["indices"]
    for _ in range(999):
        gltf.add_node(mesh=0)
    monkeypatch.setattr(memory, "free_memory_bytes", lambda: 1 << 28)
    with pytest.raises(MeshError, match="1,000,000 triangles and 3,000,000 vertices need about 450 MB of memory"):
        load(gltf)


def test_compression_beside_uncompressed_data_is_passed_over(gltf, load):
    gltf.add_part(SQUARE, [0, 1, 2], extensions={"KHR_draco_mesh_compression": {"bufferView": 0}})
    gltf.document["bufferViews"][0]["extensions"] = {"EXT_meshopt_compression": {"buffer": 0}}
    assert load(gltf).face_count == 1
    del gltf.document["accessors"][0]["bufferView"]
    with pytest.raises(MeshError, match="compressed by KHR_draco_mesh_compression"):
        load(gltf)


def test_nodes_may_be_as_deep_as_they_like(gltf, corners):
    gltf.add_part(TRIANGLE, node={"is_root": False})
    for number in range(5000):
        gltf.add_node(is_root=False, children=[number], translation=[1, 0, 0])
    gltf.document["scenes"][0]["nodes"] = [5000]
    assert corners(gltf)[0, 0].tolist() == [5000, 0, 0]
