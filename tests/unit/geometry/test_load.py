"""Mesh files: what is read, in which order, with which digits; and what is refused."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from clbvh import Mesh, load_mesh
from clbvh.errors import AppearanceWarning, MeshError
from clbvh.geometry.loading import ply
from clbvh.geometry.shapes.make_shape import make_shape

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
# Polygons of mixed size, a triangle before and after the others; and what they become.
MIXED = [[0, 1, 3], [4, 6, 7, 5], [0, 4, 5, 1], [0, 1, 3, 2], [2, 3, 7]]
MIXED_CUT = [[0, 1, 3], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [0, 1, 3], [0, 3, 2], [2, 3, 7]]

TRIANGLE_PLY = (
    b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
)


def in_file_coordinates(mesh: Mesh) -> np.ndarray:
    return mesh.vertices


def load(folder: Path, name: str, content: bytes | str) -> Mesh:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return load_mesh(path)


def make_ply(
    polygons: list[list[int]],
    *,
    kind: str = "ascii",
    vertices: np.ndarray = CUBE,
    coordinate: str = "float",
    count: str = "uchar",
    index: str = "int",
    name: str = "vertex_indices",
    extra: bool = False,
    newline: str = "\n",
) -> bytes:
    """Write a PLY file, with properties and elements around those that matter when `extra` is set."""
    header = ["ply", f"format {kind} 1.0", "comment by hand"]
    if extra:
        header += ["element camera 2", "property float zoom", "property list uint8 short lens"]
    header += [f"element vertex {len(vertices)}"]
    header += ["property uchar red", "property double quality"] if extra else []
    header += [f"property {coordinate} {axis}" for axis in "xyz"]
    header += ["property list uchar float weights"] if extra else []
    header += [f"element face {len(polygons)}"]
    header += ["property short flag", "property list uchar float stress"] if extra else []
    header += [f"property list {count} {index} {name}"]
    header += ["property uchar alpha", "element edge 1", "property int vertex1"] if extra else []
    text = newline.join([*header, "end_header", ""]).encode()

    codes = {"float": "f", "double": "d", "int": "i", "uint": "I", "short": "h", "ushort": "H", "uchar": "B"}
    rows: list[list[tuple[str, float]]] = []
    if extra:
        rows += [[("f", 1.5), ("B", 2), ("h", -1), ("h", 5)], [("f", 2.5), ("B", 0)]]
    for i, vertex in enumerate(vertices):
        row = [(codes[coordinate], x) for x in vertex]
        weights = [("B", i % 3)] + [("f", 0.5)] * (i % 3)
        rows.append([("B", 200), ("d", 0.1), *row, *weights] if extra else row)
    for i, polygon in enumerate(polygons):
        row = [(codes[count], len(polygon)), *((codes[index], corner) for corner in polygon)]
        rows.append([("h", -7), ("B", i % 2), *[("f", 0.25)] * (i % 2), *row, ("B", 255)] if extra else row)
    if extra:
        rows += [[("i", 3)]]

    if kind == "ascii":
        return text + "".join(" ".join(f"{value:.17g}" for _, value in row) + newline for row in rows).encode()
    order = ">" if kind == "binary_big_endian" else "<"
    for row in rows:
        for code, value in row:
            text += struct.pack(order + code, value if code in "fd" else int(value))
    return text


# --- What is read ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("extra", [False, True], ids=["plain", "extra"])
@pytest.mark.parametrize("polygons", [MIXED, MIXED[1:4]], ids=["mixed", "quads"])
def test_ply_polygons_are_cut_in_place(tmp_path, kind, extra, polygons):
    mesh = load(tmp_path, "a.ply", make_ply(polygons, kind=kind, extra=extra))
    assert mesh.faces.tolist() == MIXED_CUT[1 if polygons is not MIXED else 0 : 7 if polygons is not MIXED else None]
    assert in_file_coordinates(mesh).tolist() == CUBE.tolist()
    assert mesh.name == "a.ply"


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("coordinate", ["float", "double", "int", "short"])
@pytest.mark.parametrize(("count", "index"), [("uchar", "int"), ("int", "uint"), ("ushort", "uchar")])
def test_ply_types(tmp_path, kind, coordinate, count, index):
    content = make_ply([[0, 1, 3]], kind=kind, coordinate=coordinate, count=count, index=index, name="vertex_index")
    mesh = load(tmp_path, "a.ply", content)
    assert mesh.faces.tolist() == [[0, 1, 3]]
    assert in_file_coordinates(mesh).tolist() == CUBE.tolist()


@pytest.mark.parametrize("index", ["int", "float"])
def test_ply_polygons_of_any_size(tmp_path, index):
    mesh = load(tmp_path, "a.ply", make_ply([[0, 1, 3, 2, 6, 7], [4, 5, 7], [0, 4, 5, 1, 2]], index=index))
    assert mesh.faces.tolist() == [
        [0, 1, 3],
        [0, 3, 2],
        [0, 2, 6],
        [0, 6, 7],
        [4, 5, 7],
        [0, 4, 5],
        [0, 5, 1],
        [0, 1, 2],
    ]


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize(
    ("strips", "faces"),
    [
        ([[0, 1, 2, 3]], [[0, 1, 2], [1, 3, 2]]),
        # A strip ends at -1, and at the end of a list; each begins with its own winding.
        ([[0, 1, 2, 3, -1, 4, 5, 6, 7], [1, 2, 3]], [[0, 1, 2], [1, 3, 2], [4, 5, 6], [5, 7, 6], [1, 2, 3]]),
        # Triangles with a vertex twice lead round a corner.
        ([[0, 1, 2, 2, 3, 4]], [[0, 1, 2], [2, 4, 3]]),
        ([[-1, 0, 1, -1, 5, 6, 7, -1]], [[5, 6, 7]]),
    ],
)
def test_ply_strips_are_cut_into_triangles(tmp_path, kind, strips, faces):
    content = make_ply(strips, kind=kind).replace(b"element face", b"element tristrips")
    assert load(tmp_path, "a.ply", content).faces.tolist() == faces


@pytest.mark.parametrize("strips", [[[0, 1], [2, -1, 3]], [[0]], [[1, 1, 1, 1]]])
def test_ply_strips_without_a_triangle_are_no_surface(tmp_path, strips):
    content = make_ply(strips).replace(b"element face", b"element tristrips")
    with pytest.raises(MeshError, match="no faces"):
        load(tmp_path, "a.ply", content)


@pytest.mark.parametrize(
    "text", [("\n3 ", "\n 3 "), ("\n3 ", "\n3\t"), ("\n3 ", "\n\n3 "), ("\n", "\r\n"), ("\n", "\r")]
)
def test_ply_text_may_be_spaced_as_it_likes(tmp_path, text):
    content = make_ply([[0, 1, 3], [4, 5, 7], [2, 3, 7]]).decode().replace(*text)
    assert load(tmp_path, "a.ply", content).faces.tolist() == [[0, 1, 3], [4, 5, 7], [2, 3, 7]]


def test_a_signature_above_the_elements_of_a_ply_header_is_skipped(tmp_path):
    signed = TRIANGLE_PLY.replace(b"element vertex", b"Created by a program, source file:\nelement vertex")
    assert load(tmp_path, "a.ply", signed).faces.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
def test_ply_lines_may_end_as_on_windows(tmp_path, kind):
    assert load(tmp_path, "a.ply", make_ply(MIXED, kind=kind, newline="\r\n")).faces.tolist() == MIXED_CUT


@pytest.mark.parametrize(("kind", "coordinate"), [("ascii", "float"), ("binary_little_endian", "double")])
def test_digits_of_survey_coordinates_survive(tmp_path, kind, coordinate):
    far = CUBE * 1e-3 + [5e6, 6e6, 300]
    mesh = load(tmp_path, "a.ply", make_ply(MIXED, kind=kind, coordinate=coordinate, vertices=far))
    assert mesh.vertices[7] - mesh.vertices[0] == pytest.approx([1e-3, 1e-3, 1e-3], abs=2e-9)


@pytest.mark.parametrize("file_type", ["ply", "ascii.ply", "obj", "stl", "ascii.stl", "off", "glb"])
@pytest.mark.parametrize("seed", [3])
def test_every_format_keeps_the_triangles_in_order(tmp_path, file_type, seed):
    rng = np.random.default_rng(seed)
    sphere = make_shape("icosphere", triangles=500)
    vertices = sphere.vertices + rng.normal(0, 0.05, sphere.vertices.shape)
    faces = sphere.faces[rng.permutation(sphere.face_count)]
    source = trimesh.Trimesh(vertices, faces, process=False)
    if file_type == "ascii.ply":
        content = source.export(file_type="ply", encoding="ascii")
    elif file_type == "ascii.stl":
        content = source.export(file_type="stl_ascii")
    else:
        content = source.export(file_type=file_type)
    mesh = load(tmp_path, f"a.{file_type}", content)
    assert mesh.faces.shape == faces.shape
    assert in_file_coordinates(mesh)[mesh.faces] == pytest.approx(vertices[faces], abs=1e-6)


def test_obj_with_groups_and_materials_keeps_the_order(tmp_path):
    text = """
    # made by hand
    mtllib none.mtl
    o first
    v 0 0 0
    v 1 0 0 0.5 0.5 0.5
      v 1 1 0 1.0
    vt 0 0
    vn 0 0 1
    usemtl red
    f 1/1/1 2/1/1 3/1/1
    v 0 1 0
    g second
    usemtl blue
    f -4//1 -2//1 -1//1   # counted back
    o third
    usemtl red
    v 0 0 1
    f 1 2 \\
      3 4
    f\t5 4 3
    l 1 2
    """
    with pytest.warns(AppearanceWarning, match="none.mtl is missing"):
        mesh = load(tmp_path, "a.obj", text)
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3], [4, 3, 2]]
    assert in_file_coordinates(mesh).tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1]]


@pytest.mark.parametrize(
    "head", ["OFF\n8 5 0\n", "OFF 8 5 0\n", "# by hand\nCOFF\n\n8 5 0 # counts\n", "OFF\r\n8 5\r\n"]
)
def test_off_with_colours_and_comments(tmp_path, head):
    text = head
    text += "".join(f"{x:g} {y:g} {z:g} 255 0 0\n\n" for x, y, z in CUBE)
    text += "".join(f" {len(p)} {' '.join(map(str, p))} 0.5 0.5 0.5 # red\n" for p in MIXED)
    mesh = load(tmp_path, "a.off", text)
    assert mesh.faces.tolist() == MIXED_CUT
    assert in_file_coordinates(mesh).tolist() == CUBE.tolist()


def facet(corners, normal="0 0 1") -> str:
    inner = "\n".join(f"   vertex {x} {y} {z}" for x, y, z in corners)
    return f" facet normal {normal}\n  outer loop\n{inner}\n  endloop\n endfacet\n"


def test_ascii_stl_with_several_solids(tmp_path, caplog):
    a, b, c = CUBE[[0, 1, 3]], CUBE[[4, 6, 7]], CUBE[[2, 3, 7]]
    text = f"solid facet vertex\n{facet(a)}{facet(b, '-nan(ind) nan nan')}endsolid\n"
    text += f"SOLID two\n{facet(c).upper()}ENDSOLID two"
    mesh = load(tmp_path, "a.stl", text)
    assert in_file_coordinates(mesh)[mesh.faces].tolist() == [a.tolist(), b.tolist(), c.tolist()]
    assert not caplog.records


def test_binary_stl_that_begins_with_solid(tmp_path):
    content = b"solid thing".ljust(80, b"\0") + struct.pack("<I", 1)
    content += struct.pack("<12fH", 0, 0, 1, *CUBE[[0, 1, 3]].ravel(), 0)
    assert in_file_coordinates(load(tmp_path, "a.stl", content)).tolist() == CUBE[[0, 1, 3]].tolist()


def test_a_scene_is_flattened_with_its_transforms(tmp_path):
    part = trimesh.Trimesh(CUBE[:4], [[0, 1, 3], [0, 3, 2]], process=False)
    scene = trimesh.Scene()
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1], [0, 0, 0])
    mirror = np.diag([-2.0, 1.0, 1.0, 1.0])
    for node, transform in (("plain", np.eye(4)), ("turned", turn), ("mirrored", mirror)):
        transform = transform.copy()
        transform[:3, 3] = [10, 0, 0]
        scene.add_geometry(part, geom_name="part", node_name=node, transform=transform)
    mesh = load(tmp_path, "a.glb", scene.export(file_type="glb"))
    assert mesh.faces.tolist() == [[0, 1, 3], [0, 3, 2], [4, 5, 7], [4, 7, 6], [11, 9, 8], [10, 11, 8]]
    expected = np.concatenate((CUBE[:4], CUBE[:4] @ turn[:3, :3].T, CUBE[:4] * [-2, 1, 1])) + np.array([10, 0, 0])
    assert in_file_coordinates(mesh) == pytest.approx(expected, abs=1e-6)


def test_parts_of_a_gltf_keep_the_order_of_the_file(tmp_path):
    """Two nodes, the first with a mesh of three primitives."""
    positions = b"".join(struct.pack("<9f", *(CUBE[[0, 1, 3]] + 10 * part).ravel()) for part in range(4))
    accessors = [
        {"bufferView": 0, "byteOffset": 36 * part, "componentType": 5126, "count": 3, "type": "VEC3"}
        for part in range(4)
    ]
    primitives = [{"attributes": {"POSITION": part}} for part in range(4)]
    content = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"name": "a", "mesh": 0}, {"name": "b", "mesh": 1}],
        "meshes": [{"primitives": primitives[:3]}, {"primitives": primitives[3:]}],
        "accessors": accessors,
        "bufferViews": [{"buffer": 0, "byteLength": len(positions)}],
        "buffers": [{"byteLength": len(positions), "uri": "a.bin"}],
    }
    (tmp_path / "a.bin").write_bytes(positions)
    mesh = load(tmp_path, "a.gltf", json.dumps(content))
    assert in_file_coordinates(mesh)[mesh.faces[:, 0], 0].tolist() == [0, 10, 20, 30]


def test_gltf_with_its_buffer_in_a_second_file(tmp_path):
    part = trimesh.Trimesh(CUBE, [[0, 1, 3]], process=False)
    for name, content in trimesh.Scene(part).export(file_type="gltf").items():
        (tmp_path / name).write_bytes(content)
    assert load_mesh(tmp_path / "model.gltf").faces.tolist() == [[0, 1, 3]]
    for buffer in tmp_path.glob("*.bin"):
        buffer.unlink()
    with pytest.raises(MeshError, match=r"model.gltf: .*\.bin is missing"):
        load_mesh(tmp_path / "model.gltf")


@pytest.mark.parametrize("name", ["a.PLY", "a.stl", "a.obj", "a.txt", "a"])
def test_the_content_decides_and_not_the_name(tmp_path, name):
    assert load(tmp_path, name, TRIANGLE_PLY).face_count == 1
    assert load_mesh(str(tmp_path / name)).name == name


@pytest.mark.parametrize("name", ["a.OBJ", "a.ply", "a"])
def test_an_obj_under_another_name(tmp_path, name):
    assert load(tmp_path, name, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").face_count == 1


def test_degenerate_and_repeated_faces_stay(tmp_path):
    mesh = load(tmp_path, "a.ply", make_ply([[0, 1, 3], [0, 0, 0], [0, 1, 3], [1, 1, 2]]))
    assert mesh.faces.tolist() == [[0, 1, 3], [0, 0, 0], [0, 1, 3], [1, 1, 2]]
    assert mesh.degenerate_count == 2


def test_plain_formats_do_without_trimesh(tmp_path):
    (tmp_path / "a.ply").write_bytes(TRIANGLE_PLY)
    code = "import sys, clbvh; clbvh.load_mesh('a.ply'); sys.exit('trimesh' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=False).returncode == 0


# --- What is refused -------------------------------------------------------------------------------------------------

PLY_HEADER = TRIANGLE_PLY[: TRIANGLE_PLY.index(b"end_header")]
BINARY_PLY = make_ply(MIXED, kind="binary_little_endian")
FLOAT_PLY = make_ply([[0, 1, 3]], count="float", index="float")
TWO_SOLIDS = f"solid\n{facet(CUBE[:3])}endsolid\nsolid\n{facet(CUBE[:3])}"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        pytest.param("a.ply", b"", "the file is empty", id="empty"),
        pytest.param("a.ply", b"hello\n", "not a PLY file", id="not-a-ply"),
        pytest.param("a.xyzw", b"hello\n", "not a mesh file of a known kind", id="unknown"),
        pytest.param("a", bytes(range(256)), "not a mesh file of a known kind", id="noise"),
        pytest.param("a.glb", b"hello", "cut off or damaged", id="not-a-glb"),
        pytest.param("a.gltf", b"{}", "the file has no triangles", id="empty-gltf"),
        pytest.param("a.gltf", b"{", "cut off or damaged: its JSON text", id="cut-gltf"),
        pytest.param("a.off", b"hello\n", "does not begin with the word 'OFF'", id="not-an-off"),
        pytest.param("a.off", b"OFF BINARY\n", "binary OFF file, and only text is read", id="binary-off"),
        pytest.param("a.off", b"OFF\n", "does not say how many", id="off-without-counts"),
        pytest.param("a.off", b"OFF\n-1 2 0\n", "declares -1 vertices", id="off-negative-count"),
        pytest.param("a.off", b"OFF\n%d 1 0\n" % 10**30, "cut off", id="off-huge-count"),
        pytest.param(
            "a.off", b"OFF\n3 1 0\n0 0 0\n1 0\n0 1 0\n3 0 1 2\n", "vertex 1 has 2 numbers instead of 3", id="off-short"
        ),
        pytest.param("a.off", b"OFF\n1 1 0\n0 0 0\n4 0 0 0\n", "face 0 declares 4 corners", id="off-short-face"),
        pytest.param(
            "a.off", b"OFF\n1 1 0\n0 0 0\n3 0 0 0\n3 0 0 0\n", "1 vertices and 1 faces, but has 3 lines", id="off-long"
        ),
        pytest.param("a.off", b"OFF\n1 1 0\n0 0 x\n3 0 0 0\n", "OFF file is damaged", id="off-word"),
        pytest.param(
            "a.off", b"OFF\n1 1 0\n0 0 0\n3 0 0 1\n", r"face 0 refers to vertex 1.*\(0 to 0\)", id="off-index"
        ),
        pytest.param("a.obj", b"hello\n", "no vertices", id="not-an-obj"),
        pytest.param("a.obj", b"v 0 0 0\nv 1 1", "vertex 1 is 'v 1 1', and not three", id="obj-cut-vertex"),
        pytest.param("a.obj", b"v 0 0 0\nf 1 1", "cut off in a face: face 0 has 2 corners", id="obj-cut-face"),
        pytest.param("a.obj", b"v 0 0 0\nf 1 1 2\n", r"face 0 refers to vertex 2, .*\(1 to 1\)", id="obj-index"),
        pytest.param("a.obj", b"v 0 0 0\nf 1 1 0\n", "face 0 refers to vertex 0", id="obj-index-0"),
        pytest.param("a.obj", b"v 0 0 0\nf 1 1 -2\n", "face 0 refers to vertex", id="obj-index-back"),
        pytest.param("a.obj", b"v 0 0 0\nv 0 zero 0\n", "vertex 1 is 'v 0 zero 0', and not", id="obj-word"),
        pytest.param("a.obj", b"v 0 0 0\nf 1 1 1\nf 1 a 1\n", "'a'", id="obj-face-word"),
        pytest.param("a.obj", b"v 0 0 0\n", "1 vertices but no faces", id="obj-points"),
        pytest.param("a.stl", b"hello", "cut off or not an STL file", id="stl-short"),
        pytest.param("a.stl", b"\0" * 84, "the file has no triangles", id="stl-no-faces"),
        pytest.param("a.stl", b"solid a\nendsolid a\n", "the file has no triangles", id="stl-no-facets"),
        pytest.param("a.obj", b"\r\n \n", "the file is empty", id="blank"),
        pytest.param("a.off", b"OFF\n0 0 0\n", "the file has no triangles", id="off-no-vertices"),
        pytest.param("a.ply", make_ply([], vertices=CUBE[:0]), "the file has no triangles", id="ply-no-rows"),
        pytest.param("a.stl", b"\1" * 84, "cut off or not an STL file", id="stl-huge"),
        pytest.param("a.stl", b"solid a\n", "cut off or not an STL file", id="stl-cut"),
        pytest.param("a.stl", b"endsolid\nsolid", "cut off or not an STL file", id="stl-turned"),
        pytest.param(
            "a.stl", f"solid\n{facet(CUBE[:4])}endsolid", "not of whole solids of whole facets", id="stl-quad"
        ),
        pytest.param(
            "a.stl", f"solid\n{facet(CUBE[:3])} facet normal\nendsolid", "not of whole solids of", id="stl-open"
        ),
        pytest.param("a.stl", f"solid\n{facet([(0, 0, 'x')] * 3)}endsolid", "not three numbers", id="stl-word"),
        pytest.param(
            "a.stl", f"solid\n{facet([(0, 0, '0 0')] * 3)}endsolid", "a vertex is not three numbers", id="stl-4"
        ),
        pytest.param("a.stl", TWO_SOLIDS, "not of whole solids", id="stl-open-solid"),
        pytest.param("a.ply", PLY_HEADER, "cut off .*'end_header'", id="ply-cut-header"),
        pytest.param("a.ply", b"ply\nelement vertex 0\nend_header\n", "no 'format' line", id="ply-no-format"),
        pytest.param("a.ply", b"ply\nformat ascii 1.0\nend_header\n", "has no triangles", id="ply-no-vertices"),
        pytest.param("a.ply", TRIANGLE_PLY.replace(b"ascii", b"morse"), "'format morse 1.0'", id="ply-format"),
        pytest.param(
            "a.ply", TRIANGLE_PLY.replace(b"vertex 3", b"vertex -3"), "'element vertex -3'", id="ply-negative"
        ),
        pytest.param("a.ply", TRIANGLE_PLY.replace(b"float y", b"real y"), "'property real y'", id="ply-type"),
        pytest.param("a.ply", TRIANGLE_PLY.replace(b"float y", b"float v"), "no vertices with x, y", id="ply-no-y"),
        pytest.param(
            "a.ply", TRIANGLE_PLY.replace(b"vertex_indices", b"corners"), "no list 'vertex_indices'", id="ply-no-list"
        ),
        pytest.param("a.ply", TRIANGLE_PLY.replace(b"face 1", b"face 2"), "cut off: .* 2 rows", id="ply-short"),
        pytest.param("a.ply", TRIANGLE_PLY.replace(b"face 1", b"face 0"), "goes on behind", id="ply-long"),
        pytest.param(
            "a.ply", TRIANGLE_PLY.replace(b"face 1", b"face 0")[:-8], "3 vertices but no faces", id="ply-points"
        ),
        pytest.param(
            "a.ply",
            TRIANGLE_PLY.replace(b"vertex 3", b"vertex 99999999999999999999"),
            "cut off: .* 99,999,999,999,999,999,999 rows of 'vertex'",
            id="ply-huge-vertex-count",
        ),
        pytest.param("a.ply", TRIANGLE_PLY.replace(b"face 1", b"face 4000000000"), "cut off", id="ply-huge-face-count"),
        pytest.param("a.ply", TRIANGLE_PLY.replace(b"\n3 0", b"\n-3 0"), "a list of -3 items", id="ply-negative-list"),
        pytest.param("a.ply", TRIANGLE_PLY.replace(b"\n3 0", b"\n2.5 0"), "PLY file is damaged", id="ply-odd-list"),
        pytest.param("a.ply", TRIANGLE_PLY.replace(b"\n3 0", b"\nnan 0"), "PLY file is damaged", id="ply-nan-list"),
        pytest.param("a.ply", TRIANGLE_PLY.replace(b"\n3 0", b"\ninf 0"), "PLY file is damaged", id="ply-endless-list"),
        pytest.param("a.ply", TRIANGLE_PLY.replace(b"\n3 0", b"\n2 0"), "more numbers", id="ply-two-gon"),
        pytest.param("a.ply", TRIANGLE_PLY.replace(b"0 1 2\n", b"0 1 3\n"), r"vertex 3, .*\(0 to 2\)", id="ply-index"),
        pytest.param("a.ply", TRIANGLE_PLY.replace(b"0 1 2\n", b"0 1 -1\n"), "face 0 .* vertex -1", id="ply-index-neg"),
        pytest.param(
            "a.ply", TRIANGLE_PLY.replace(b"0 1 2\n", b"0 1 1.5\n"), "PLY file is damaged", id="ply-index-odd"
        ),
        pytest.param(
            "a.ply", make_ply([[0, 1, 3]], index="float").replace(b"0 1 3", b"0 1 1.5"), "vertex 1.5", id="ply-half"
        ),
        pytest.param(
            "a.ply", make_ply([[0, 1, 3]], index="float").replace(b"0 1 3", b"0 nan 1"), "vertex nan", id="ply-nan-id"
        ),
        pytest.param("a.ply", FLOAT_PLY.replace(b"3 0", b"nan 0"), "list of nan", id="ply-nan-size"),
        pytest.param(
            "a.ply", make_ply([[0, 1, 3], [1, 0, 2]]).replace(b"3 0", b"x 0"), "PLY file is damaged", id="ply-face"
        ),
        pytest.param("a.ply", TRIANGLE_PLY.replace(b"1 0 0", b"1 nan 0"), "vertex 1 .* y = nan", id="ply-nan"),
        pytest.param("a.ply", TRIANGLE_PLY.replace(b"1 0 0", b"1 0 -inf"), "vertex 1 .* z = -inf", id="ply-inf"),
        pytest.param("a.ply", TRIANGLE_PLY.replace(b"1 0 0", b"1 0 1e999"), "vertex 1 .* z = inf", id="ply-overflow"),
        pytest.param("a.ply", TRIANGLE_PLY.replace(b"1 0 0", b"1 0 O"), "PLY file is damaged", id="ply-word"),
        pytest.param(
            "a.ply", BINARY_PLY + b"x", "goes on behind the end that its header declares", id="ply-binary-long"
        ),
        pytest.param(
            "a.ply",
            BINARY_PLY.replace(b"face 5", b"face 4000000000"),
            "cut off: .* 4,000,000,000 rows",
            id="ply-binary-huge-face-count",
        ),
        pytest.param(
            "a.ply",
            make_ply([[0, 1, 3]], kind="binary_little_endian", count="int").replace(
                struct.pack("<4i", 3, 0, 1, 3), struct.pack("<4i", 2**31 - 1, 0, 1, 3)
            ),
            "a list of 2147483647 items",
            id="ply-binary-huge-list",
        ),
        pytest.param(
            "a.ply",
            make_ply([[0, 1, 3]], kind="binary_little_endian", count="int").replace(
                struct.pack("<4i", 3, 0, 1, 3), struct.pack("<4i", -1, 0, 1, 3)
            ),
            "a list of -1 items",
            id="ply-binary-negative-list",
        ),
    ],
)
def test_bad_files_are_refused_in_one_sentence(tmp_path, name, content, message):
    with pytest.raises(MeshError, match=message) as caught:
        load(tmp_path, name, content)
    assert str(caught.value).startswith(f"{tmp_path / name}: ")
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_folder(tmp_path):
    with pytest.raises(MeshError, match=r"none\.ply: no such file"):
        load_mesh(tmp_path / "none.ply")
    with pytest.raises(MeshError, match="this is a folder"):
        load_mesh(tmp_path)
    with pytest.raises(MeshError, match="this is not the path of a file"):
        load_mesh("a\0b.ply")


def test_running_out_of_memory_is_no_damage(tmp_path, monkeypatch):
    def read(*_):
        raise MemoryError

    monkeypatch.setattr(ply, "read_ply", read)
    with pytest.raises(MeshError, match=r"a\.ply: there is not enough free memory to read the file"):
        load(tmp_path, "a.ply", TRIANGLE_PLY)


def test_a_part_of_a_scene_cannot_borrow_vertices_of_the_next(tmp_path):
    content = bytearray(trimesh.Trimesh(CUBE, [[0, 1, 3]], process=False).export(file_type="glb"))
    at = content.rindex(struct.pack("<3I", 0, 1, 3))
    content[at : at + 12] = struct.pack("<3I", 0, 1, 8)
    with pytest.raises(MeshError, match=r"primitives\[0\]: face 0 refers to vertex 8, .* 8 vertices \(0 to 7\)"):
        load(tmp_path, "a.glb", bytes(content))


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("extra", [False, True], ids=["plain", "extra"])
def test_a_ply_that_is_cut_off_anywhere_is_refused(tmp_path, kind, extra):
    content = make_ply(MIXED, kind=kind, extra=extra).rstrip(b"\n")
    for end in range(len(content)):
        with pytest.raises(MeshError):
            load(tmp_path, "a.ply", content[:end])


@pytest.mark.parametrize("file_type", ["stl", "stl_ascii", "off", "glb"])
def test_a_file_that_is_cut_off_is_refused(tmp_path, file_type):
    sphere = make_shape("icosphere", triangles=20)
    content = trimesh.Trimesh(sphere.vertices, sphere.faces, process=False).export(file_type=file_type)
    content = (content if isinstance(content, bytes) else content.encode()).rstrip(b"\n")
    # The last number of an OFF file may be cut unnoticed, if what is left of it is a number too.
    for end in range(0, len(content) - 1, 7):
        with pytest.raises(MeshError):
            load(tmp_path, "a." + file_type[:3], content[:end])


def test_header_of_gltf_that_lies_about_its_buffer(tmp_path):
    content = json.loads(json.dumps({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}]}))
    content |= {"nodes": [{"mesh": 0}], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}]}
    content |= {"accessors": [{"componentType": 5126, "count": 10**12, "type": "VEC3", "bufferView": 0}]}
    content |= {"bufferViews": [{"buffer": 0, "byteLength": 10**13}], "buffers": [{"byteLength": 0, "uri": "data:,"}]}
    with pytest.raises(MeshError, match="ends at byte 10,000,000,000,000, but its buffer has 0 bytes"):
        load(tmp_path, "a.gltf", json.dumps(content))


# --- Real meshes -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "vertex_count", "face_count"),
    [("bun_zipper", 35_947, 69_451), ("drill_shaft_zip", 881, 1_288), ("dragon_871k", 435_545, 871_306)],
)
def test_real_meshes(name, vertex_count, face_count):
    path = Path(os.environ.get("CLBVH_MESHES", "")) / f"{name}.ply"
    if not path.is_file():
        pytest.skip(f"CLBVH_MESHES names no folder with {path.name}")
    mesh = load_mesh(path)
    expected = trimesh.load_mesh(path, process=False)
    assert (len(mesh.vertices), mesh.face_count) == (vertex_count, face_count)
    assert (mesh.faces == expected.faces).all()
    assert abs(in_file_coordinates(mesh) - expected.vertices).max() < 1e-7
