"""The examples as scripts: their output and the files they write are right."""

import json
import re
import runpy
import sys
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import trimesh

import clbvh

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def run(session, tmp_path, monkeypatch, capsys):
    """A function from an example and its arguments to its output; it runs in an empty folder."""

    def run_example(name, *arguments):
        path = str(EXAMPLES / f"{name}.py")
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [path, *arguments])
        runpy.run_path(path, run_name="__main__")
        return capsys.readouterr().out

    return run_example


@pytest.fixture
def sphere(tmp_path):
    path = tmp_path / "sphere.ply"
    trimesh.creation.icosphere(3).export(path)
    return str(path)


def test_ambient_occlusion_of_a_sphere_is_open_sky(run, sphere, tmp_path):
    assert "100% of the sky, from 100% to 100%" in run("ambient_occlusion", sphere, "--rays", "4")
    written = trimesh.load(tmp_path / "occlusion.ply", process=False)
    assert (written.visual.vertex_colors == 255).all()


def test_ambient_occlusion_of_the_knot_is_dark_in_places(run, tmp_path):
    text = run("ambient_occlusion", "--rays", "8", "-o", "dark.ply")
    mean, least, most = map(int, re.search(r"see (\d+)% of the sky, from (\d+)% to (\d+)%", text).groups())
    assert least < 30 < mean < most == 100
    assert (tmp_path / "dark.ply").is_file()


def test_depth_map_of_a_sphere(run, sphere, tmp_path):
    text = run("depth_map", sphere, "--width", "65")
    assert "device=" in text
    near, far = map(float, re.search(r"from (\S+) to ([\d.e+-]+),", text).groups())
    assert near == pytest.approx(4, abs=0.01)
    assert 4.5 < far <= 5.01
    picture = imageio.imread(tmp_path / "depth.png")
    assert picture.shape == (65, 65)
    assert picture[32, 32] == picture.max()
    assert picture[0, 0] == 0
    assert np.count_nonzero(picture) / picture.size == pytest.approx(np.pi / 4, rel=0.1)


def test_inside_test_finds_the_volume(run, sphere):
    text = run("inside_test", sphere, "--points", "20000")
    estimate, error, exact = map(float, re.search(r"points: (\S+) \+- (\S+), by its faces: (\S+)", text).groups())
    assert abs(estimate - exact) < 5 * error
    assert exact == pytest.approx(4 / 3 * np.pi, rel=0.02)
    assert float(text.split(":")[-1]) == pytest.approx(1, rel=0.02)
    assert "volume" in run("inside_test", "--points", "1000")


def test_lidar_scan_of_a_sphere(run, sphere, tmp_path):
    text = run("lidar_scan", sphere, "--steps", "30", "--beams", "16", "--cloud", "points.ply")
    returned, pulses = (
        int(number.replace(",", "")) for number in re.search(r"([\d,]+) of ([\d,]+) pulses", text).groups()
    )
    assert 0 < returned < pulses == 12 * 30 * 16
    cloud = trimesh.load(tmp_path / "points.ply")
    assert len(cloud.vertices) == returned
    # The mesh is within a hundredth of the sphere; the scanner's noise has a deviation of 0.002.
    assert np.abs(np.linalg.norm(cloud.vertices, axis=1) - 1).max() < 0.03
    assert imageio.imread(tmp_path / "lidar-scan.png").shape == (405, 720, 3)


def test_sky_view_of_a_plain_is_open_and_of_a_pit_is_not(run, tmp_path):
    plain = trimesh.Trimesh([[0, 0, 0], [8, 0, 0], [8, 0, 8], [0, 0, 8]], [[0, 2, 1], [0, 3, 2]])
    plain.export(tmp_path / "plain.ply")
    assert "16 x 16 points see 100.0% of the sky" in run("sky_view", "plain.ply", "--width", "16", "--rays", "16")
    # From the middle of the ground of a cylinder as deep as it is wide, the sky is a disc of 45 degrees: half of it
    # by the cosine law.
    pit = trimesh.creation.annulus(1, 8, 1, sections=128)
    pit.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))
    plate = trimesh.creation.box((16, 0.1, 16), trimesh.transformations.translation_matrix((0, -0.55, 0)))
    trimesh.util.concatenate([pit, plate]).export(tmp_path / "pit.ply")
    names = runpy.run_path(str(EXAMPLES / "sky_view.py"))
    mesh = clbvh.load_mesh(tmp_path / "pit.ply")
    with clbvh.Tracer(mesh) as tracer:
        ground = tracer.closest_hit([[0, 5, 0]], [[0, -1, 0]])
        assert ground.locations[0, 1] == pytest.approx(-0.5)
        assert names["sky_view_factor"](tracer, ground, 1024)[0] == pytest.approx(0.5, abs=0.01)


def test_distance_grid_of_a_sphere(run, sphere, tmp_path):
    text = run("distance_grid", sphere, "--cells", "24", "--grid", "grid.npz")
    cells, faces, deepest = map(float, re.search(r"cells: (\S+), by faces: (\S+); deepest: (\S+)", text).groups())
    assert cells == pytest.approx(faces, rel=0.02)
    assert deepest == pytest.approx(1, rel=0.02)
    grid = np.load(tmp_path / "grid.npz")
    expected = 1 - np.linalg.norm(grid["points"], axis=-1)
    assert grid["distance"].shape == expected.shape == (26, 26, 26)
    assert np.abs(grid["distance"] - expected).max() < 0.01
    picture = imageio.imread(tmp_path / "distance-grid.png").astype(int)
    orange = picture[..., 0] > picture[..., 2] + 40
    assert orange[240, 300]
    assert not orange[0, 0]


def test_turntable_follows_the_point_that_was_picked(run, sphere, tmp_path):
    text = run("turntable", sphere, "--frames", "4", "--sheet", "sheet.png", "--pick", "180", "120")
    assert "4 frames" in text
    assert len(imageio.imread(tmp_path / "turntable.gif")) == 4
    # Seen in front, hidden behind.
    sheet = imageio.imread(tmp_path / "sheet.png")
    front, back = sheet[:240, :360], sheet[240:, :360]
    assert (front == (255, 196, 40)).all(axis=-1).any()
    assert not (back == (255, 196, 40)).all(axis=-1).any()
    assert (back == (110, 130, 160)).all(axis=-1).any()


def test_camera_images_agree_with_their_intrinsics(run, tmp_path):
    text = run("camera_images", "--width", "160")
    assert "160 x 120" in text
    assert "5 objects" in text
    assert float(re.search(r"within (\S+) m", text)[1]) < 1e-9
    depth, normals, ids = (
        imageio.imread(tmp_path / "camera-images" / f"{name}.png") for name in ("depth", "normals", "ids")
    )
    assert depth.dtype == np.uint16
    assert depth.shape == ids.shape == normals.shape[:2] == (120, 160)
    assert ((depth > 0) == (ids > 0)).all()
    # Towards the camera, whose z points away from it.
    assert (normals[ids > 0, 2] <= 128).all()
    assert json.loads((tmp_path / "camera-images" / "camera.json").read_text())["K"][0][2] == pytest.approx(331.5 / 4)


def test_robot_arm_keeps_clear_of_the_knot(run, tmp_path):
    text = run("robot_arm", "--steps", "30", "--width", "96")
    distance = float(re.search(r"([\d.]+) mm from link 4 to the knot", text)[1])
    assert distance == pytest.approx(100, abs=5)
    assert "neighbours: 0;" in text
    picture = imageio.imread(tmp_path / "robot-arm.png").astype(int)
    yellow = (picture[..., 0] > 150) & (picture[..., 1] > 110) & (picture[..., 2] < 60)
    assert picture.shape == (54, 96, 3)
    assert yellow.any()


def test_sun_hours_of_a_city(run, tmp_path):
    text = run("sun_hours", "--blocks", "2", "--cell", "8", "--width", "64")
    suns, least, most = map(float, re.search(r"([\d.]+) suns: ([\d.]+) to ([\d.]+) hours", text).groups())
    # At the equinox the day has twelve hours, and a wall to the north has none of them.
    assert (suns, least, most) == (48, 0, 12)
    assert imageio.imread(tmp_path / "sun-hours.png").shape == (36, 64, 3)


def test_viewshed_of_a_sphere_is_the_cap_that_the_mast_sees(run, sphere, tmp_path):
    text = run("viewshed", sphere, "--mast", "0.5", "--width", "64")
    # From the height h over a sphere of radius 1 a share of h / (2 (1 + h)); h is half the diameter.
    assert float(re.search(r"sees ([\d.]+)%", text)[1]) == pytest.approx(25, abs=2)
    assert imageio.imread(tmp_path / "viewshed.png").shape == (36, 64, 3)
