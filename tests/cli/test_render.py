"""`clbvh render`: exit codes, messages, files written."""

from __future__ import annotations

import json
import struct

import imageio.v3 as imageio
import numpy as np
import pytest

from .command import hidden_drivers, refuses, run_clbvh, run_process

TETRAHEDRON = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
0 0 1
3 0 2 1
3 0 1 3
3 0 3 2
3 1 2 3
"""

REPORT_KEYS = {
    "triangles", "nodes", "depth", "sah_cost", "tree_from_cache", "workers", "device", "layout", "width", "height",
    "rays", "hits", "mrays_per_s", "timings_ms",
}  # fmt: skip
TIMING_KEYS = {
    "load", "cache", "build", "open", "layout", "compile", "upload", "kernel", "download",
    "other", "total", "write",
}  # fmt: skip


@pytest.fixture
def mesh(tmp_path):
    path = tmp_path / "tetrahedron.ply"
    path.write_text(TETRAHEDRON)
    return path


def test_a_mesh_becomes_a_picture_and_a_table(mesh, tmp_path):
    result = run_clbvh("render", mesh, "-o", tmp_path / "out.ppm")
    assert result.returncode == 0, result.stderr
    assert imageio.imread(tmp_path / "out.ppm").shape == (450, 800, 3)
    for word in ("tetrahedron.ply, 4 triangles", "SAH cost", "kernel", "total", "800 x 450"):
        assert word in result.stdout
    assert result.stderr == ""


def read_times(output):
    """Return the milliseconds of each phase of the printed table."""
    table = output[output.index("phase ") :].splitlines()[1:]
    return {line.split()[0]: float(line.split()[1].replace(",", "")) for line in table}


def test_the_rows_of_the_table_add_up_to_its_total(mesh, tmp_path):
    times = read_times(run_clbvh("render", mesh, "-o", tmp_path / "out.ppm", "--workers", 2).stdout)
    assert times.keys() == TIMING_KEYS - {"cache"}
    parts = [ms for phase, ms in times.items() if phase not in ("total", "write")]
    assert sum(parts) == pytest.approx(times["total"], abs=0.05 * (len(parts) + 1))
    assert times["layout"] > 0


def test_json_is_one_object_and_nothing_else(mesh, tmp_path):
    result = run_clbvh("render", mesh, "-o", tmp_path / "out.ppm", "--json", "--width", 64, "--height", 48)
    report = json.loads(result.stdout)
    assert report.keys() >= REPORT_KEYS
    assert report["timings_ms"].keys() == TIMING_KEYS
    assert (report["triangles"], report["width"], report["height"], report["rays"]) == (4, 64, 48, 64 * 48)
    assert 0 < report["hits"] < report["rays"]
    assert result.stderr == ""


def test_hits_are_written_by_pixel_and_agree_with_the_report(mesh, tmp_path):
    arguments = ("--hits", tmp_path / "hits.npz", "--width", 64, "--height", 48, "--json")
    report = json.loads(run_clbvh("render", mesh, "-o", tmp_path / "out.png", *arguments).stdout)
    with np.load(tmp_path / "hits.npz") as hits:
        by_pixel = ("t", "u", "v", "prim_id", "geometry_id", "instance_id")
        assert {name: hits[name].shape for name in hits} == {
            **dict.fromkeys(by_pixel, (48, 64)), "geometry_names": (1,), "instance_names": (1,),
        }  # fmt: skip
        is_hit = hits["prim_id"] >= 0
        assert is_hit.sum() == report["hits"]
        assert np.isfinite(hits["t"][is_hit]).all()
        assert np.isinf(hits["t"][~is_hit]).all()


def test_two_pictures_of_one_run_are_the_same(mesh, tmp_path):
    arguments = ("-o", tmp_path / "a.ppm", "-o", tmp_path / "a.png", "--width", 40, "--height", 30)
    assert run_clbvh("render", mesh, *arguments).returncode == 0
    assert (imageio.imread(tmp_path / "a.ppm") == imageio.imread(tmp_path / "a.png")).all()


def test_options_override_a_scene(tmp_path, mesh):
    scene = tmp_path / "scene.toml"
    scene.write_text('[[object]]\npath = "tetrahedron.ply"\n[view]\nwidth = 20\nheight = 10\n')
    plain = run_clbvh("render", scene, "-o", tmp_path / "a.ppm", "--json")
    assert json.loads(plain.stdout)["width"] == 20
    options = ("--width", 30, "--shading", "normal", "--eye", "3,3,3", "--look-at", "0,0,0", "--up", "0,0,1")
    changed = run_clbvh("render", scene, "-o", tmp_path / "b.ppm", "--json", "--background", "1,0,0", *options)
    report = json.loads(changed.stdout)
    assert (report["width"], report["height"]) == (30, 10)
    normals = imageio.imread(tmp_path / "b.ppm")
    assert (normals[0, 0] == 0).all()
    assert (normals[5, 15] != 0).any()
    # The same view in another shading with one ray for each pixel.
    lit = run_clbvh(
        "render", scene, "-o", tmp_path / "c.ppm", "--width", 30, "--background", "1,0,0", "--shading", "lambert",
        *options[4:],
    )  # fmt: skip
    assert lit.returncode == 0
    picture = imageio.imread(tmp_path / "c.ppm")
    assert picture[0, 0].tolist() == [255, 0, 0]
    np.testing.assert_array_equal((picture == [255, 0, 0]).all(axis=2), (normals == 0).all(axis=2))
    assert (picture[5, 15] != normals[5, 15]).any()


def test_cameras_of_all_kinds_replace_that_of_a_scene(tmp_path, mesh):
    scene = tmp_path / "scene.toml"
    scene.write_text('[[object]]\npath = "tetrahedron.ply"\n[view]\nprojection = "fisheye"\nwidth = 40\nheight = 20\n')
    pictures = {}
    for kind in (None, "perspective", "orthographic", "orthographic:9", "fisheye", "fisheye:300", "panorama"):
        options = () if kind is None else ("--projection", kind)
        result = run_clbvh("render", scene, "-o", tmp_path / "a.png", *options)
        assert (result.returncode, result.stderr) == (0, "")
        pictures[kind] = imageio.imread(tmp_path / "a.png").tobytes()
    assert pictures[None] == pictures["fisheye"]
    assert len(set(pictures.values())) == len(pictures) - 1


def test_brute_and_tree_give_the_same_picture(mesh, tmp_path):
    for builder in ("sah", "brute"):
        name = tmp_path / f"{builder}.ppm"
        assert run_clbvh("render", mesh, "-o", name, "--builder", builder, "--width", 80).returncode == 0
    assert (tmp_path / "sah.ppm").read_bytes() == (tmp_path / "brute.ppm").read_bytes()


def test_leaves_of_the_frontier_are_not_cut_again_unless_asked(mesh, tmp_path):
    for asked, layout in (("auto", "bvh2"), ("bvh8", "bvh8")):
        picture = tmp_path / f"{asked}.ppm"
        options = ("--builder", "frontier", "--layout", asked, "--width", 80, "--height", 45)
        result = run_clbvh("render", mesh, "-o", picture, *options, "--json")
        assert json.loads(result.stdout)["layout"] == layout
    assert (tmp_path / "auto.ppm").read_bytes() == (tmp_path / "bvh8.ppm").read_bytes()


def test_validation_is_reported(mesh, tmp_path):
    result = run_clbvh("render", mesh, "-o", tmp_path / "a.ppm", "--validate", "--width", 40, "--height", 30)
    assert result.returncode == 0
    assert "tree and 1,200 pixels agree with the reference" in result.stdout


def test_workers_build_what_one_process_builds(tmp_path):
    scene = tmp_path / "knot.toml"
    scene.write_text('[[object]]\nshape = "knot"\ntriangles = 30000\n[view]\nup = "y"\nwidth = 64\nheight = 40\n')
    pictures = []
    for workers in (1, 2):
        name = tmp_path / f"{workers}.ppm"
        result = run_clbvh("render", scene, "-o", name, "--workers", workers, "--json")
        assert json.loads(result.stdout)["workers"] == workers
        pictures.append(name.read_bytes())
    assert pictures[0] == pictures[1]


def test_a_missing_mesh_is_bad_input(tmp_path):
    refuses(run_clbvh("render", tmp_path / "gone.ply", "-o", tmp_path / "a.ppm"), 2, "gone.ply", "no such file")


def test_a_mesh_with_nan_is_bad_input(tmp_path, mesh):
    mesh.write_text(TETRAHEDRON.replace("0 1 0\n", "0 nan 0\n"))
    refuses(run_clbvh("render", mesh, "-o", tmp_path / "a.ppm"), 2, "vertex 2", "nan")


def test_a_face_out_of_range_is_bad_input(tmp_path, mesh):
    mesh.write_text(TETRAHEDRON.replace("3 1 2 3", "3 1 2 4"))
    refuses(run_clbvh("render", mesh, "-o", tmp_path / "a.ppm"), 2, "face 3", "vertex 4")


def test_a_truncated_mesh_is_bad_input_and_writes_nothing(tmp_path, mesh):
    header = TETRAHEDRON.split("end_header")[0].replace("ascii", "binary_little_endian") + "end_header\n"
    mesh.write_bytes(header.encode() + struct.pack("<3f", 0, 0, 0))
    refuses(run_clbvh("render", mesh, "-o", tmp_path / "a.ppm"), 2, "tetrahedron.ply")
    assert [path.name for path in tmp_path.iterdir()] == ["tetrahedron.ply"]


def test_a_bad_scene_is_bad_input(tmp_path):
    (tmp_path / "bad.toml").write_text("[[object]]\nname = 3\n")
    refuses(run_clbvh("render", tmp_path / "bad.toml", "-o", tmp_path / "a.ppm"), 2, "bad.toml", "name: expected str")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--eye", "1,2"), ("eye", "three finite numbers", "1,2")),
        (("--shading", "phong"), ("shading", "phong")),
        (("--width", "0"), ("width", "0")),
        (("--builder", "magic"), ("builder", "magic")),
        (("--layout", "magic"), ("layout", "magic")),
        (("--bins", "1"), ("bins", "1")),
        (("--quality", "best"), ("quality", "best")),
        (("--leaf-size", "0"), ("leaf_size", "0")),
        (("--fov", "180"), ("fov", "180")),
        (("--projection", "pinhole"), ("projection", "pinhole", "panorama")),
        (("--projection", "panorama:3"), ("panorama", "no value")),
        (("--projection", "fisheye:wide"), ("fisheye", "wide")),
        (("--projection", "fisheye:400"), ("fisheye", "360")),
        (("--projection", "fisheye", "--fov", "40"), ("fov", "projection")),
        (("--aperture", "-1"), ("aperture", "-1")),
        (("--aperture", "1", "--focus-distance", "0"), ("focus_distance", "0")),
        (("--hits", "hits.csv"), ("hits.csv", ".npz")),
    ],
)
def test_options_out_of_range_are_wrong_usage(mesh, tmp_path, options, words):
    refuses(run_clbvh("render", mesh, "-o", tmp_path / "a.ppm", *options), 2, *words)


def test_an_output_that_cannot_be_is_found_before_the_work(mesh, tmp_path):
    refuses(run_clbvh("render", mesh, "-o", tmp_path / "a.gif"), 2, "a.gif", ".png, .jpg, .jpeg, .ppm")
    refuses(run_clbvh("render", mesh, "-o", tmp_path / "gone" / "a.ppm"), 2, "does not exist")


def test_an_unknown_device_exits_3(mesh, tmp_path):
    refuses(run_clbvh("render", mesh, "-o", tmp_path / "a.ppm", "--device", "no such card"), 3, "no such card")


def test_a_machine_without_a_driver_exits_3(mesh, tmp_path):
    result = run_process("render", mesh, "-o", tmp_path / "a.ppm", **hidden_drivers(tmp_path))
    refuses(result, 3, "clbvh doctor")


def test_a_missing_output_is_wrong_usage(mesh):
    result = run_clbvh("render", mesh)
    assert result.returncode == 2
    assert "--output" in result.stderr


def test_a_known_mesh_that_is_nowhere_says_how_to_get_it(tmp_path):
    environment = {"CLBVH_MESHES": str(tmp_path), "CLBVH_CACHE": str(tmp_path)}
    result = run_clbvh("render", "bunny", "-o", tmp_path / "a.ppm", **environment)
    refuses(result, 2, "clbvh fetch bunny", "CLBVH_MESHES")


@pytest.mark.parametrize("name", ["bun_zipper.ply", "drill_shaft_zip.ply"])
def test_real_meshes_validate(real_mesh_path, tmp_path, name):
    path = real_mesh_path(name)
    result = run_clbvh("render", path, "-o", tmp_path / "a.ppm", "--validate", "--width", 200, "--height", 120)
    assert result.returncode == 0, result.stderr
    assert "agree with the reference" in result.stdout
