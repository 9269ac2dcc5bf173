"""glTF: the scene graph, primitives, accessors, buffers; and what is refused by name."""

import numpy as np
import pytest
import trimesh

import clbvh
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


def add_skinned_ball(gltf, rng, *, sets=1, dtype="f4", mirror=1.0, is_bound=True):
    """Add a ball that three joints carry; return the matrices of the joints, and joints and weights of its vertices."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    corners = ball.triangles.reshape(-1, 3)
    world, joints = [np.diag([0.01 * mirror, 0.01, 0.01, 1])], []
    armature = gltf.add_node(scale=[0.01 * mirror, 0.01, 0.01], children=[1])
    for number in range(3):
        axis, shift = rng.normal(size=3), rng.normal(size=3)
        angle, scale = rng.uniform(1), rng.uniform(0.5, 2)
        axis *= np.sin(angle / 2) / np.linalg.norm(axis)
        keys = {"translation": shift.tolist(), "rotation": [*axis, np.cos(angle / 2)], "scale": [scale] * 3}
        joints.append(gltf.add_node(is_root=False, children=[armature + number + 2] if number < 2 else [], **keys))
        turn = trimesh.transformations.rotation_matrix(angle, axis)
        world.append(
            world[-1] @ (trimesh.transformations.translation_matrix(shift) @ turn @ np.diag([scale] * 3 + [1]))
        )
    skin, bound = {"joints": joints}, np.eye(4)
    if is_bound:
        bound = np.linalg.inv(0.3 * rng.normal(size=(3, 4, 4)) * [[1], [1], [1], [0]] + np.diag([3, 3, 3, 1.0]))
        bound = bound.astype(np.float32).astype(np.float64)
        skin["inverseBindMatrices"] = gltf.add_accessor(bound.transpose(0, 2, 1).reshape(-1, 16), "f4")
    gltf.document["skins"] = [skin]
    ids = rng.integers(3, size=(len(corners), 4 * sets))
    weights = rng.random(ids.shape)
    weights /= weights.sum(axis=1, keepdims=True)
    stored = np.floor(weights * 255) if dtype == "u1" else weights
    attributes = {"POSITION": gltf.add_accessor(corners, "f4")}
    attributes["NORMAL"] = gltf.add_accessor(np.repeat(ball.face_normals, 3, axis=0), "f4")
    for number in range(sets):
        columns = slice(4 * number, 4 * number + 4)
        attributes[f"JOINTS_{number}"] = gltf.add_accessor(ids[:, columns], "u1")
        values = gltf.add_accessor(stored[:, columns], dtype, normalized=dtype == "u1")
        attributes[f"WEIGHTS_{number}"] = values
    # The transform of its node, and those above it, do not count.
    child = gltf.add_node(is_root=False, mesh=gltf.add_mesh({"attributes": attributes}), skin=0, scale=[7, 0, 7])
    gltf.add_node(translation=[100, 0, 0], children=[child])
    points, normals = np.zeros_like(corners), np.zeros_like(corners)
    for vertex, point in enumerate(corners.astype(np.float32).astype(np.float64)):
        matrix = np.zeros((4, 4))
        for joint, weight in zip(ids[vertex], stored[vertex] / stored[vertex].sum(), strict=True):
            matrix += weight * (world[joint + 1] @ (bound[joint] if is_bound else bound))
        points[vertex] = (matrix @ [*point, 1])[:3]
        normals[vertex] = np.linalg.inv(matrix[:3, :3]).T @ ball.face_normals[vertex // 3]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return points.reshape(-1, 3, 3), normals.reshape(-1, 3, 3)


@pytest.mark.parametrize(
    "case",
    [{}, {"sets": 2}, {"dtype": "u1"}, {"mirror": -1.0}, {"is_bound": False}],
    ids=lambda case: "-".join(case) or "plain",
)
def test_skins_are_posed_by_their_joints_alone(gltf, tmp_path, case):
    points, normals = add_skinned_ball(gltf, np.random.default_rng(5), **case)
    path = gltf.write_glb(tmp_path / "a.glb")
    mesh = load_mesh(path)
    # Mirrored faces are turned round.
    order = [2, 1, 0] if "mirror" in case else [0, 1, 2]
    np.testing.assert_allclose(mesh.vertices[mesh.faces], points[:, order], rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(mesh.appearance.normals, normals[:, order], atol=1e-4)
    (instance,) = (scene := clbvh.Scene()).add_parts(path)
    np.testing.assert_array_equal(instance.transform, np.eye(4))
    np.testing.assert_array_equal(scene.geometries[0].shape.vertices, mesh.vertices)


def test_what_is_wrong_with_a_skin_is_named(gltf, load):
    add_skinned_ball(gltf, np.random.default_rng(5))
    document = gltf.document
    primitive, skin = document["meshes"][0]["primitives"][0], document["skins"][0]
    for table, key, value, message in (
        (document["scenes"][0], "nodes", [5], r"skins\[0\] has the joint nodes\[1\], which is not in the scene"),
        (skin, "joints", [1, 2, 99], r"refers to nodes\[99\]"),
        (skin, "joints", [1, 2], "a joint that is not among the 2 of its skin"),
        (skin, "joints", [1, 2, 3, 0], "3 inverse bind matrices for 4 joints"),
        (document["nodes"][4], "skin", 1, r"refers to skins\[1\]"),
        (primitive["attributes"], "WEIGHTS_0", primitive["attributes"]["NORMAL"], "vectors of 3 numbers, not 4"),
    ):
        before, table[key] = table[key], value
        with pytest.raises(MeshError, match=message):
            load(gltf)
        table[key] = before
    # Without joints it stays with its node.
    del primitive["attributes"]["JOINTS_0"]
    document["nodes"][4]["scale"] = [1, 1, 1]
    np.testing.assert_allclose(load(gltf).vertices.mean(axis=0), [100, 0, 0], atol=1e-5)


def test_hidden_nodes_show_nothing(gltf, tmp_path):
    def show(source):
        """The names of the parts, and the heights that a ray meets; of one mesh, and of instances."""
        found = []
        for scene in (clbvh.Scene(source), clbvh.Scene()):
            if scene.is_empty:
                scene.add_parts(source)
            with clbvh.Tracer(scene) as tracer:
                hits = tracer.all_hits([[0.5, 0.25, 9]], [0, 0, -1])
                distance = tracer.closest_point([[0.5, 0.25, 9]]).distance
            picture = clbvh.render(scene, width=8, height=8, shading="lambert")
            assert {hits.count == 0, np.isinf(distance).all(), picture.hits.count == 0} == {hits.count == 0}
            found.append((9 - hits.t).tolist())
        assert found[0] == found[1]
        return found[0]

    flat = np.diag([1, 1, 0, 1.0])
    flat[:3, :3] = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3] @ flat[:3, :3]
    for height, keys in enumerate((
        {"scale": [0, 0, 0]}, {}, {"scale": [1, 0, 1]}, {"matrix": flat.T.ravel().tolist()}, {},
        {"extensions": {"KHR_node_visibility": {"visible": False}}},
    )):  # fmt: skip
        gltf.add_part(np.add(TRIANGLE, [0, 0, height]), node={"name": f"{height}", **keys})
    below = gltf.add_part(np.add(TRIANGLE, [0, 0, 7]), node={"is_root": False})
    for keys in ({"scale": [1, 1, 0]}, {"extensions": {"KHR_node_visibility": {"visible": False}}}):
        gltf.add_node(children=[below], **keys)
        assert show(gltf.write_glb(tmp_path / "a.glb")) == [4, 1]
        gltf.document["nodes"].pop(), gltf.document["scenes"][0]["nodes"].pop()
    path = gltf.write_glb(tmp_path / "a.glb")
    assert [part.name for part in load_mesh(path).parts] == ["1", "4"]
    # An animation that shows a node does not change how it stands.
    sampler = {"input": gltf.add_accessor([0, 1], "f4"), "output": gltf.add_accessor([[1, 1, 1]] * 2, "f4")}
    channel = {"sampler": 0, "target": {"node": 0, "path": "scale"}}
    gltf.document["animations"] = [{"samplers": [sampler], "channels": [channel]}]
    gltf.document["scenes"][0]["nodes"] = [0, 2, 3]
    path = gltf.write_glb(tmp_path / "a.glb")
    assert show(path) == []
    assert show(trimesh.load_scene(path)) == []
    with clbvh.Tracer(load_mesh(path)) as tracer:
        assert not tracer.any_hit([[0.5, 0.25, 9]], [0, 0, -1]).any()
