"""Mesh files of every format: recognised, in order, whole or refused in one sentence; and where known meshes are."""

import numpy as np
import pytest
import trimesh

from clbvh import ConfigError, MeshError, load_mesh, make_shape
from clbvh.geometry.fetch import KNOWN_MESHES, find_known_mesh

from .test_ply import make_ply
from .test_stl_off import facet

PLY = make_ply([[0, 1, 2]])
FLOATS = make_ply([[0, 1, 3]], types=("float", "float", "float"))
BINARY = make_ply(kind="binary_little_endian")
PLYS = {"ply text": make_ply(extra=True).rstrip(b"\n"), "ply binary": make_ply(kind="binary_big_endian", extra=True)}
CORNERS = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
SOLID = f"solid\n{facet(CORNERS)}endsolid\n"


def test_the_content_decides_and_not_the_name(tmp_path):
    obj = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    for name, content in (("a.stl", PLY), ("a", PLY), ("a.ply", obj), ("a.off", SOLID.encode())):
        (tmp_path / name).write_bytes(content)
        assert load_mesh(str(tmp_path / name)).face_count == 1
        assert load_mesh(tmp_path / name).name == name


def test_other_files_are_read_by_trimesh_or_name_its_packages(tmp_path, monkeypatch):
    path = tmp_path / "cart.3mf"
    path.write_bytes(b"PK cart")
    cart = trimesh.Scene()
    cart.add_geometry(trimesh.creation.box(), node_name="left", geom_name="box")
    cart.graph.update("right", geometry="box", matrix=trimesh.transformations.translation_matrix([5, 0, 0]))

    def load(file_obj, file_type, **options):
        assert (file_obj.read(), file_type, options["process"]) == (b"PK cart", "3mf", False)
        return trimesh.exchange.export.scene_to_dict(cart, use_base64=False)

    monkeypatch.setitem(trimesh.exchange.load.mesh_loaders, "3mf", load)
    mesh = load_mesh(path)
    assert (mesh.name, mesh.face_count, mesh.vertices.max()) == ("cart.3mf", 24, 5.5)
    assert {part.name for part in mesh.parts} == {"left", "right"}
    cart = None
    with pytest.raises(MeshError, match=r"cart\.3mf: the 3MF file is damaged or incomplete$"):
        load_mesh(path)
    wrapper = trimesh.exceptions.ExceptionWrapper(ModuleNotFoundError("No module named 'lxml'"))
    monkeypatch.setitem(trimesh.exchange.load.mesh_loaders, "3mf", wrapper)
    with pytest.raises(MeshError, match=r"a \.3mf file is .* needs lxml and networkx: run .*clbvh\[formats\]"):
        load_mesh(path)
    path.rename(tmp_path / "cart.vtu")
    with pytest.raises(MeshError, match=r"known kind: PLY, .* of others give what trimesh\.load, meshio\.read or"):
        load_mesh(tmp_path / "cart.vtu")


def test_bad_files_are_refused_in_one_sentence(tmp_path):
    rows = [
        ("a.ply", b"", "the file is empty"),
        ("a.gltf", b"{}", "the file has no triangles"),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0\n0 1 0\n3 0 1 2\n", "vertex 1 has 2 numbers instead of 3"),
        ("a.off", b"OFF\n1 1 0\n0 0 0\n4 0 0 0\n", "face 0 declares 4 corners"),
        ("a.obj", b"v 0 0 0\nf 1 1 2\n", r"face 0 refers to vertex 2, .*\(1 to 1\)"),
        ("a.obj", b"v 0 0 0\nf 1 1 0\n", "face 0 refers to vertex 0"),
        ("a.stl", b"\0" * 84, "the file has no triangles"),
        ("a.stl", f"solid\n{facet([*CORNERS, (1, 1, 0)])}endsolid", "not of whole solids of whole facets"),
        ("a.ply", PLY.replace(b"float y", b"float v"), "no vertices with x, y"),
        ("a.ply", PLY.replace(b"face 1", b"face 2"), "cut off: .* 2 rows"),
        ("a.ply", PLY.replace(b"face 1", b"face 0"), "goes on behind"),
        ("a.ply", PLY.replace(b"vertex 4", b"vertex 9" + b"9" * 19), "cut off: .* 99,999,999,999,999,999,999 rows"),
        ("a.ply", PLY.replace(b"\n3 0", b"\n-3 0"), "a list of -3 items"),
        ("a.ply", PLY.replace(b"0 1 2\n", b"0 1 4\n"), r"vertex 4, .*\(0 to 3\)"),
        ("a.ply", FLOATS.replace(b"0 1 3\n", b"0 1 1.5\n"), "vertex 1.5"),
        ("a.ply", PLY.replace(b"2 0 0", b"1 0 1e999"), "vertex 1 .* z = inf"),
        ("a.ply", BINARY + b"x", "goes on behind the end that its header declares"),
    ]
    for length in (2**31 - 1, -1):
        content = make_ply([[0, 1, 2]], "binary_little_endian", types=("float", "int", "int"))
        header, end, body = content.partition(b"end_header\n")
        forged = header + end + body[:48] + np.int32(length).tobytes() + body[52:]
        rows.append(("a.ply", forged, f"a list of {length} items"))
    for name, content, message in rows:
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        with pytest.raises(MeshError, match=message) as caught:
            load_mesh(path)
        assert str(caught.value).startswith(f"{path}: ")
        assert "\n" not in str(caught.value)
    for path, message in ((tmp_path / "none.ply", r"none\.ply: no such file"), (tmp_path, "this is a folder")):
        with pytest.raises(MeshError, match=message):
            load_mesh(path)


@pytest.mark.parametrize("kind", ["ply text", "ply binary", "stl", "stl_ascii", "off", "glb"])
def test_a_file_that_is_cut_off_is_refused(tmp_path, kind):
    if kind in PLYS:
        content = PLYS[kind]
    else:
        sphere = make_shape("icosphere", triangles=20)
        content = trimesh.Trimesh(sphere.vertices, sphere.faces, process=False).export(file_type=kind)
        content = (content if isinstance(content, bytes) else content.encode()).rstrip(b"\n")
    # The last number of an OFF file may be cut unnoticed, if what is left of it is a number too.
    for end in range(0, len(content) - 1, 3 if kind in PLYS else 23):
        (tmp_path / f"a.{kind[:3]}").write_bytes(content[:end])
        with pytest.raises(MeshError):
            load_mesh(tmp_path / f"a.{kind[:3]}")


def test_known_meshes_are_found_in_the_folder_by_their_best_name_then_in_the_cache(tmp_path, monkeypatch):
    meshes, cache = tmp_path / "meshes", tmp_path / "cache"
    for folder, variable in ((meshes, "CLBVH_MESHES"), (cache, "CLBVH_CACHE")):
        folder.mkdir()
        monkeypatch.setenv(variable, str(folder))
    for name in KNOWN_MESHES:
        (meshes / f"{name}.ply").mkdir()
        (cache / KNOWN_MESHES[name].file_name).mkdir()
        with pytest.raises(MeshError, match=f"run 'clbvh fetch {name}', or set CLBVH_MESHES .*{meshes}"):
            find_known_mesh(name)
        (meshes / f"{name}.ply").rmdir()
        (cache / KNOWN_MESHES[name].file_name).rmdir()
    for name, file_names in (
        ("bunny", ["bun_zipper.ply", "bunny.ply"]),
        ("dragon", ["dragon_vrip.ply", "dragon_871k.ply", "dragon.ply"]),
        ("drill", ["drill_shaft_zip.ply", "drill.ply"]),
    ):
        (cache / file_names[0]).touch()
        assert find_known_mesh(name) == cache / file_names[0]
        for file_name in reversed(file_names):
            (meshes / file_name).touch()
            assert find_known_mesh(name) == meshes / file_name
    with pytest.raises(ConfigError, match="no known mesh 'teapot': the known ones are bunny, dragon, drill"):
        find_known_mesh("teapot")
