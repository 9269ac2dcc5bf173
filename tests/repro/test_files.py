"""Files that were read wrong, read without end, or ended in a traceback."""

import codecs
import os
import subprocess
import sys
import warnings

import numpy as np
import pytest

import clbvh
from clbvh import AppearanceWarning, Bvh, ConfigError, MeshError, SceneError, TreeFileError, load_mesh, open_scene
from clbvh.files.scene_file import read_scene_file
from clbvh.geometry.loading.spheres_file import read_spheres

from ..unit.geometry.test_stl_off import facet, make_stl

VERTICES = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
"""
TRIANGLES = 1e-9 * np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0], [0, 1, 0]]])


@pytest.fixture
def write(tmp_path):
    """A function that writes a file and returns its path."""

    def write(name, content):
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


@pytest.mark.filterwarnings("ignore::clbvh.AppearanceWarning")  # of normals that are not there
def test_obj_lines_took_a_vertex_or_the_next_line_away(write):
    for text in (
        "\ufeff" + VERTICES + "f 1 2 3\nf 2 3 4\n",
        VERTICES.replace("v 1", "# C:\\parts\\\nv 1") + "f 1 2 3\nf 2 3 4\n",
        VERTICES.replace("v 1", "v 1 0 0 # moved to \\\r\n#v 1") + "f 1 2 3\nf 2 3 4\n",
        VERTICES.replace("\n", "\r\n") + "f 1 2 \\ \r\n 3\r\nf 2 3 4",
        VERTICES.replace("v 1 0 0", "v \\\n 1 \\\n 0 0 0.5 0.5 0.5") + "f 1// 2//7 3/7\nf\t-3 -2 -1",
        VERTICES + "o one\nf 1 2 3\nvp 1 2 3\nvn 1 0 0\nvt 1 0\ng two#2\ns off\nfx 1\nl 1 2\np 1\nf +2 3 04",
    ):
        mesh = load_mesh(write("a.obj", text))
        assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], text
        assert mesh.faces.tolist() == [[0, 1, 2], [1, 2, 3]], text


def test_obj_vertices_and_faces_that_are_none_were_left_out(write):
    lines = VERTICES.splitlines(keepends=True)
    for line in ("v", "v\t# 0 0 0\n", "v 1 2\n", "v 1_0 0 0\n"):
        text = "".join([*lines[:2], line, "\n", *lines[2:], "f 1 2 3\n"])
        with pytest.raises(MeshError, match=r"vertex 2 is 'v.*', and not three coordinates"):
            load_mesh(write("a.obj", text))
    for face in ("f", "f 1 2", "f 1 2 3_0", "f 1 2 3.0", f"f 1 2 {'9' * 5000}", "f 1 2 ⅔"):
        with pytest.raises(MeshError, match=r"face 1 "):
            load_mesh(write("a.obj", VERTICES + "f 1 2 3\n" + face))
    for statement in ("surf 0 1 0 1 1 2 3", "call part.obj"):
        with pytest.raises(MeshError, match=f"the statement '{statement.split()[0]}' is not read"):
            load_mesh(write("a.obj", VERTICES + "f 1 2 3\n" + statement))


def test_ply_words_that_were_no_numbers_were_left_out(write):
    for line in ("0 1 0,7", "0 1 0 abc", "0 1", "0 1 -", "0 1 --5", "0 1 1.5.5", "0 1 1e+", "0 1 0x10"):
        with pytest.raises(MeshError):
            load_mesh(write("a.ply", f"{PLY}0 0 0\n{line}\n1 0 0\n3 0 1 2\n"))
    for face in ("4 0 1 - 2 0", "4 0 1 2 +", "3 0 + 1 2"):
        with pytest.raises(MeshError):
            load_mesh(write("a.ply", f"{PLY}0 0 0\n1 0 0\n0 1 0\n{face}\n"))
    for number in ("1", "+1", "1.", ".5", "-.5", "1.5e3", "1E-3", "1.e+3", "  2", "2\t"):
        mesh = load_mesh(write("a.ply", f"{PLY}0 0 0\n1 0 0\n0 1 {number}\n3 0 1 2\n"))
        assert mesh.vertices[2, 2] == pytest.approx(float(number), rel=1e-7)


def make_text(triangles):
    return "".join(f"solid part\n{facet(triangle.tolist())}endsolid part\n" for triangle in triangles)


def make_binary(triangles):
    return make_stl(0, b"solid of two", triangles)


@pytest.mark.parametrize("make", [make_text, make_binary])
def test_stl_corners_nearer_than_a_tolerance_were_merged_whatever_the_unit(write, make):
    mesh = load_mesh(write("a.stl", make(TRIANGLES)))
    assert mesh.faces.tolist() == [[0, 1, 2], [1, 3, 2]]
    assert mesh.vertices[mesh.faces] == pytest.approx(TRIANGLES, rel=1e-6, abs=1e-16)
    # One unit in the last place is a difference.
    moved = TRIANGLES.astype(np.float32)
    moved[1, 0, 0] = np.nextafter(moved[1, 0, 0], np.float32(1))
    assert load_mesh(write("a.stl", make(moved.astype(np.float64)))).faces.tolist() == [[0, 1, 2], [3, 4, 2]]


@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_a_device_was_read_without_end_and_a_pipe_waited_for(tmp_path, mesh, kind):
    endless = tmp_path / "a"
    os.mkfifo(endless) if kind == "pipe" else endless.symlink_to("/dev/zero")
    # A process of its own, with little memory, so that a command that reads on fails soon.
    limit = "import resource; resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))"
    command = [sys.executable, "-c", f"{limit}; from clbvh.cli import main; main()", "render", endless]
    run = subprocess.run([*command, "-o", tmp_path / "out.ppm"], capture_output=True, text=True, timeout=60)
    assert (run.returncode, len(run.stderr.splitlines())) == (2, 1)
    assert "not a file" in run.stderr
    for suffix, read, error in (
        (".ply", load_mesh, MeshError),
        (".toml", open_scene, SceneError),
        (".tree", lambda path: Bvh.load(path, mesh), TreeFileError),
    ):
        endless = endless.rename(endless.with_suffix(suffix))
        with pytest.raises(error, match=r"this is a (named pipe|device), not a file"):
            read(endless)


def test_numbers_of_a_scene_without_bound_ended_in_a_traceback(write, monkeypatch):
    for shape in ("knot", "terrain", "blobs", "boxes", "icosphere", "palace"):
        text = f'[[object]]\nshape = "{shape}"\ntriangles = 2147483648'
        with pytest.raises(SceneError, match=f"the shape '{shape}' cannot be made: .* triangles are too many"):
            read_scene_file(write("a.toml", text))
    for line in (
        "triangles = 9e18", "triangles = 9223372036854775808", f"triangles = 0x{'f' * 10_000}", "size = inf",
        f"triangles = {'9' * 5000}", f"size = 1{'0' * 400}", "size = 1e400", f"size = {'[' * 5000}",
    ):  # fmt: skip
        with pytest.raises(SceneError) as caught:
            read_scene_file(write("a.toml", f'[[object]]\nshape = "blobs"\n{line}\n'))
        assert len(str(caught.value)) < 1000
    with pytest.raises(MeshError, match=r"not finite|float"):
        read_scene_file(write("a.toml", '[[object]]\nshape = "blobs"\nspread = 1e308\n'))
    # Refused as before, but numpy warned of it on the terminal.
    boxes = '[[object]]\nshape = "boxes"\ntriangles = 12\nspread = 1000\nscale = 1.7e308\n'
    with pytest.raises(SceneError, match="float64 has no room"):
        clbvh.render(write("a.toml", boxes), width=8, height=8)
    with pytest.raises(SceneError, match="more than the 1,048,576 expected"):
        read_scene_file(write("a.toml", "#" * (1 << 20) + "\n"))
    monkeypatch.setattr("clbvh.support.memory.free_memory_bytes", lambda: 10**9)
    with pytest.raises(ConfigError, match="10,000,000 triangles need about 1,500 MB of memory, but 1,000 MB are free"):
        clbvh.make_shape("knot", triangles=10_000_000)


def test_bytes_behind_the_last_triangle_of_an_stl_file_were_no_stl_file(write):
    corners = TRIANGLES.astype(np.float32)
    for header in (b"", b"solid of two"):
        content = make_stl(0, header, corners)
        for more in (b"\0" * 92, b"\n", b"made by hand"):
            for name in ("a.stl", "a"):
                with pytest.warns(
                    AppearanceWarning, match=rf" {len(more)} bytes behind the last triangle .* left out$"
                ):
                    mesh = load_mesh(write(name, content + more))
                assert (mesh.vertices[mesh.faces] == corners).all()
        with pytest.raises(MeshError, match="cut off"):
            load_mesh(write("a.stl", content[:-1]))


def test_headers_of_off_files_as_people_have_them_were_refused(write):
    rows = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n3 1 2 3\n"
    for header in (
        *(
            "OFF\n4 2 0\n",
            "OFF4 2 0\n",
            "OFF 4 2 0\n",
            "off\n4 2 0\n",
            "OFF\n4\n2\n0\n",
            "OFF 4\n2 0\n",
            "OFF\n4 2\n0\n",
        ),
        *("off4 2\n", "OFF\n4 2\n", "# by hand\n\noff # small\n4 # vertices\n\n2\n0\n", "noff\n4 2 0\n"),
    ):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore" if "noff" in header else "error")  # which announces normals
            mesh = load_mesh(write("a.off", header + rows))
        assert mesh.faces.tolist() == [[0, 1, 2], [1, 2, 3]], header
        assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    colours = load_mesh(
        write("a.off", "coff3 1 0\n" + "0 0 0 255 0 0\n1 0 0 255 0 0\n0 1 0 255 0 0\n3 0 1 2\n")
    ).appearance
    assert (colours.colours == [255, 0, 0, 255]).all()
    for header, message in (
        ("OFF\n5 2 0\n", "is cut off: 5 vertices and 2 faces take as many lines, but it has 6"),
        ("OFF\n3 2 0\n", "goes on behind the end that it declares: 3 vertices"),
        ("OFF\nfour two\n", "must follow 'OFF', not 'four two'"),
        ("OFF\n-4 2 0\n", "must follow 'OFF', not '-4 2'"),
        ("OFF\n4\n", "must follow|goes on|cut off"),
        ("nOFF\n3\n4 2 0\n", "not an OFF file"),
        ("OFFICE 4 2 0\n", "not an OFF file"),
    ):
        with pytest.raises(MeshError, match=message):
            load_mesh(write("a.off", header + rows))
    with pytest.raises(MeshError, match="face 1 begins with 'x', which is no number of corners"):
        load_mesh(write("a.off", "OFF\n4 2 0\n" + rows.replace("\n3 1", "\nx 1")))


def test_ply_rows_longer_than_declared_names_declared_twice_and_comments_among_the_data_were_refused(write):
    points = "0 0 0\n1 0 0\n0 1 2\n"
    colours = PLY.replace("end_header", "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header")
    twice = PLY.replace("property float z\n", "property float z\nproperty float x\n")
    lists = PLY.replace("end_header", "property list uchar int vertex_indices\nend_header")
    for text, warning in (
        (PLY + points + "3 0 1 2 2\n", "1 rows of 'face' have more numbers than are declared"),
        (PLY + points + "3 0 1 2 6 0.5 0.5 1 0 1 1 0 255\n", "1 rows of 'face'"),
        (PLY + points.replace("\n", " 7 8\n") + "3 0 1 2\n", "3 rows of 'vertex' have more numbers"),
        (PLY + points.replace("1 0 0", "1 0 0 9") + "3 0 1 2\n", "1 rows of 'vertex'"),
        (colours + points + "3 0 1 2 255 0 0 255\n", "1 rows of 'face'"),
        (twice + points.replace("\n", " 9\n") + "3 0 1 2\n", "'x' is declared twice, and the first one is read"),
        (lists + points + "3 0 1 2 3 2 1 0\n", "'vertex_indices' is declared twice"),
        (PLY.replace("end_h", "element vertex 1\nproperty float x\nend_h") + points + "3 0 1 2\n9\n", "'vertex' is"),
        (f"{PLY}comment the points\n{points.replace('1 0 0', '1 0 0 # here')}# a face\nobj_info 1 2 3\n3 0 1 2\n", ""),
    ):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            mesh = load_mesh(write("a.ply", text))
        assert mesh.faces.tolist() == [[0, 1, 2]], text
        assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 2]]
        assert [warning in str(each.message) for each in caught] == [True] * bool(warning)
    assert mesh.appearance is None
    with pytest.warns(AppearanceWarning):
        looks = load_mesh(write("a.ply", colours + points + "3 0 1 2 255 0 0 255\n")).appearance
    assert (looks.colours == [255, 0, 0, 255]).all()
    header, body = (
        twice.replace("ascii", "binary_little_endian"),
        np.float32([[0, 0, 0, 9], [1, 0, 0, 9], [0, 1, 2, 9]]),
    )
    with pytest.warns(AppearanceWarning, match="'x' is declared twice"):
        mesh = load_mesh(write("a.ply", header.encode() + body.tobytes() + b"\3" + np.int32([0, 1, 2]).tobytes()))
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 2]]
    for text, message in (
        (points.replace("1 0 0", "1 0") + "3 0 1 2 2\n", "row 1 of 'vertex' has 2 numbers instead of 3"),
        (points + "4 0 1 2\n", "row 0 of 'face' has 4 numbers instead of 5"),
        (points.replace("1 0 0", "1 0 o") + "3 0 1 2\n", "the lines of 'vertex' have 'o' where a number is declared"),
        (points + "3 0 1 2.5\n", "the lines of 'face' have '2.5' where a whole number is declared"),
        (points, "the file is cut off: its header declares 1 rows of 'face'"),
        (points + "3 0 1 2\n3 0 1 2\n", "the file goes on behind the end that its header declares"),
    ):
        with pytest.raises(MeshError, match=message):
            load_mesh(write("a.ply", PLY + text))


def test_texts_in_utf_16_were_refused(write):
    write("a.mtl", "newmtl röt\nKd 1 0 0\n".encode("utf-16"))
    obj = f"mtllib a.mtl\n{VERTICES}usemtl röt\nf 1 2 3\nf 2 3 4\n"
    off = "OFF 4 2 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n3 1 2 3\n"
    solid = make_text(np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]]))
    for name, text, count in (
        ("a.obj", obj, 2),
        ("a.off", off, 2),
        ("a.stl", solid, 1),
        ("a.ply", PLY + "0 0 0\n" * 3 + "3 0 1 2\n", 1),
    ):
        for mark, encoding in ((codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be")):
            mesh = load_mesh(write(name, mark + text.replace("\n", "\r\n").encode(encoding)))
            assert mesh.face_count == count
            if name == "a.obj":
                assert mesh.appearance.materials[0].base_colour == (1, 0, 0)
            with pytest.raises(MeshError, match="the text in UTF-16 is damaged or cut off"):
                load_mesh(write(name, mark + text.encode(encoding)[:-1]))
    table = "x,y,z,radius\n1,2,3,4\n"
    centres, radii = read_spheres(write("a.csv", table.encode("utf-16")))
    assert (centres.tolist(), radii.tolist()) == ([[1, 2, 3]], [4])


def test_messages_quoted_the_exceptions_of_libraries(write):
    for name, content, message in (
        ("a.csv", "1,2,3\n4,five,6\n", "sphere 1 must be 3 numbers, not '4,five,6'"),
        ("a.csv", b"1,2,3\n\xff\xff,2,3\n", "the file of spheres is damaged or cut off"),
        ("a.csv", "1,2,3\n1_0,2,3\n", "the file of spheres is damaged or cut off"),
        ("a.npz", b"PK\3\4 and no more", "the file of spheres is damaged or cut off"),
        ("a.gltf", '{"nodes": 5, "scenes": [{"nodes": [0]}]}', "the GLTF file|nodes"),
    ):
        read = load_mesh if name == "a.gltf" else read_spheres
        with pytest.raises(MeshError, match=f"{name}: .*{message}") as caught:
            read(write(name, content))
        assert "Error" not in str(caught.value)
    write("a.png", b"\x89PNG\r\n\x1a\n damaged")
    write("a.mtl", "newmtl a\nmap_Kd a.png\nKe 1 2 x\n")
    with pytest.warns(AppearanceWarning, match="cannot be used: damaged, or of an unknown kind") as caught:
        load_mesh(write("a.obj", VERTICES + "mtllib a.mtl\nusemtl a\nf 1 2 3\n"))
    assert "Error" not in str(caught[0].message)
