"""Spheres: checks, local coordinates and boxes, and the files that they are read from."""

import io
import zipfile
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh import MeshError, Spheres
from clbvh.files.open_scene import open_points
from clbvh.geometry.corners import Boxes
from clbvh.geometry.loading import spheres_file
from clbvh.geometry.loading.spheres_file import read_spheres
from clbvh.geometry.spheres import bound_spheres

CENTRES = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 2.0, 1.0]]
# The share of its radius by which a box is larger than its sphere, and the rounding of coordinates.
MARGIN, ROUNDING = 2.0**-18, 2.0**-24
ROWS = "0,0,0,1\n4, 0, 0.0, 2\n# the last one\n0,2e0,1,0.5\n"


def test_centres_and_radii_are_kept_and_once_more_around_zero_and_about_1_in_size():
    spheres = Spheres(CENTRES, [1, 2, 0.5], name="atoms")
    assert (spheres.centres.tolist(), spheres.radii.tolist()) == (CENTRES, [1, 2, 0.5])
    # From -1 to 6, from -2 to 2.5, and from -2 to 2.
    assert (spheres.origin.tolist(), spheres.scale) == ([2.5, 0.25, 0], 0.25)
    assert (spheres.local_centres * 4).tolist() == [[-2.5, -0.25, 0], [1.5, -0.25, 0], [-2.5, 1.75, 1]]
    assert (spheres.local_radii * 4).tolist() == [1, 2, 0.5]
    assert (spheres.local_box * 4).tolist() == [[-3.5, -2.25, -2], [3.5, 2.25, 2]]
    assert (spheres.centres.dtype, spheres.local_centres.dtype) == (np.float64, np.float32)
    moved = spheres.with_spheres(spheres.centres * 2 + 100)
    assert (moved.radii.tolist(), moved.name, moved.origin.tolist()) == ([1, 2, 0.5], "atoms", [104.5, 101.25, 100.25])
    assert moved.with_spheres(CENTRES, 3).radii.tolist() == [3, 3, 3]


def test_spheres_of_any_size_anywhere_have_room_and_a_radius():
    for radius in (1e-30, 1.0, 1e30):
        for place in (0.0, 5e6, -1e30):
            spheres = Spheres([[place, 0, -place]], radius)
            assert 0.49 <= spheres.local_radii[0] <= 1
            assert np.abs(spheres.local_centres[0]).max() <= 1
    assert Spheres([[0, 0, 0], [1, 0, 0]], [1e30, 1e-30]).local_radii[1] >= np.finfo(np.float32).tiny
    # The box around all is nearly as large as a power of two, which would become the end of local coordinates.
    assert Spheres([[-3, 0, 0], [3, 0, 0]], 1 - 1e-10).scale == 0.125


@pytest.mark.filterwarnings("error")
def test_bad_arrays_are_refused_by_name():
    for centres, radii, message in (
        (np.zeros((0, 3)), 1, "there are no spheres"),
        ([[0, 0, 0], [0, np.nan, 0]], 1, "sphere 1 has a centre .*not finite: y = nan"),
        (CENTRES, [1, 0, -1], "sphere 1 has the radius 0, but .*above 0"),
        (CENTRES, [[1], [2], [3]], r"one number or have shape \(3,\), not \(3, 1\)"),
        (CENTRES, 1e160, "1e.160 units wide .*in another unit"),
        (np.zeros((1, 3)), 1e-160, "less than 3e-151 or more than 3e.150"),
        ([[1e308, 0, 0], [-1e308, 0, 0]], 1e308, "units wide to each side of the centre"),
    ):
        with pytest.raises(MeshError, match=f"^thing: .*{message}"):
            Spheres(centres, radii, name="thing")
    with pytest.raises(MeshError, match="2 spheres cannot replace the present 3"):
        Spheres(CENTRES, 1).with_spheres(CENTRES[:2])


@pytest.mark.parametrize("smallest", [-30, -9, -1])
def test_each_box_contains_its_sphere_and_a_margin_and_little_more(smallest):
    rng = np.random.default_rng(9)
    spheres = Spheres(rng.normal(size=(100, 3)) + 1e3, 10.0 ** rng.uniform(smallest, 0, 100))
    corners = bound_spheres(spheres)
    assert np.abs(corners).max() <= 1
    for sphere in range(100):
        radius = Fraction(float(spheres.local_radii[sphere])) * (1 + Fraction(MARGIN))
        for axis in range(3):
            centre = Fraction(float(spheres.local_centres[sphere, axis]))
            lower, upper = (Fraction(float(end)) for end in np.sort(corners[sphere, :, axis]))
            slack = 3 * ROUNDING * max(abs(lower), abs(upper)) + 2.0**-140
            assert 0 <= centre - radius - lower <= slack
            assert 0 <= upper - centre - radius <= slack
    points, ids = spheres.find_corners()
    assert (points[ids].min(axis=1) == corners[:, 0]).all()
    assert (points[ids].max(axis=1) == corners[:, 1]).all()


@pytest.mark.parametrize("size", [1e-100, 1.0, 1e100])
def test_local_boxes_contain_what_float64_has_of_them(size):
    generator = np.random.default_rng(4)
    lower = generator.normal(size=(100, 3)) * size
    upper = lower + generator.exponential(0.1, (100, 3)) * size
    boxes = Boxes.from_arrays(lower, upper, "boxes")
    least, greatest = (boxes.corners[:, end].astype(np.float64) for end in range(2))
    assert (least <= (lower - boxes.origin) * boxes.scale).all()
    assert (greatest >= (upper - boxes.origin) * boxes.scale).all()
    assert 0.5 <= np.abs(boxes.corners).max() <= 1 + 2.0**-20
    for corner in (np.nan, 1.7e308, 1e160):
        with pytest.raises(MeshError, match=r"^boxes: .* give it in another unit"):
            Boxes.from_arrays(np.array([[0, 0, -corner]]), np.array([[1, 1, corner]]), "boxes")


def pack(save=np.savez, **arrays):
    file = io.BytesIO()
    save(file, **arrays)
    return file.getvalue()


@pytest.fixture
def read(tmp_path):
    def read_content(name, content):
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_spheres(tmp_path / name)

    return read_content


def test_tables_and_archives_are_read(read):
    crlf = "# atoms\n" + ROWS.replace("\n", "\r\n")
    for text in (ROWS, "x, y, z, radius\n" + ROWS, crlf, "\ufeff" + ROWS, "\n" + ROWS):
        centres, radii = read("a.csv", text)
        assert (centres.tolist(), radii.tolist()) == (CENTRES, [1, 2, 0.5])
    for save in (np.savez, np.savez_compressed):
        for dtype in ("<f8", ">f4", "<i4"):
            whole = np.asfortranarray(CENTRES, dtype)
            centres, radii = read("a.npz", pack(save, centres=whole, radii=whole[:, 1]))
            assert (centres.tolist(), radii.tolist()) == (CENTRES, [0, 0, 2])
            assert (centres.dtype, centres.flags.c_contiguous) == (np.float64, True)
    assert read("a.npz", pack(centres=CENTRES))[1] is read("a.CSV", "1,2,3\n")[1] is None


def make_archive(rows):
    """An archive that promises more numbers than it has."""
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({rows}, 3), }}".encode().ljust(117) + b"\n"
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("centres.npy", b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + bytes(24))
    return file.getvalue()


def test_files_that_cannot_be_read_are_refused_by_name(read, tmp_path, monkeypatch):
    promises = [("a.npz", make_archive(rows), f"centres has 3 numbers instead of {3 * rows:,}") for rows in (2, 2**61)]
    for name, content, message in (
        *promises,
        ("a.txt", ROWS, r"must end in \.npz or \.csv"),
        ("a.csv", ROWS + "1,2,3\n", "sphere 3 must have 4 numbers like the first one, not '1,2,3'"),
        ("a.csv", b"\xff\xfe\x00", "damaged"),
        ("a.npz", pack(radii=[1]), "no array 'centres'"),
        ("a.npz", pack(centres=CENTRES, radii=[1, 2]), r"radii must have shape \(3,\), one for each centre, not"),
        ("a.npz", pack(centres=np.array([[None] * 3])), "centres must be numbers, not object"),
    ):
        with pytest.raises(MeshError, match=message) as caught:
            read(name, content)
        assert str(caught.value).startswith(f"{tmp_path / name}: ")
        assert "\n" not in str(caught.value)
    asked = []

    def refuse(subject, needed_bytes, error):
        asked.append(needed_bytes)
        raise error(f"{subject} needs too much")

    monkeypatch.setattr(spheres_file, "check_memory", refuse)
    for name, content in (("a.csv", ROWS), ("a.npz", pack(np.savez_compressed, centres=np.zeros((100_000, 3))))):
        with pytest.raises(MeshError, match="needs too much"):
            read(name, content)
    assert asked[1] > 3 * 100_000 * 24


class TestPointClouds:
    GRID = np.stack(np.meshgrid(np.arange(40.0), np.arange(30.0), [0.0]), axis=-1).reshape(-1, 3)
    RED = np.array([255, 0, 0], np.uint8)

    @pytest.mark.parametrize("scale", [1e-3, 1.0, 1e6])
    def test_the_radius_follows_the_spacing(self, scale):
        # Six neighbours are 1, 1, 1, 1 and the square root of two away.
        cloud = Spheres.from_points(self.GRID * scale)
        assert np.unique(cloud.radii).size == 1
        assert cloud.radii[0] == pytest.approx(0.75 * 2**0.5 * scale, rel=1e-9)
        assert "spheres of the radius" in cloud.note
        points = np.random.default_rng(0).random((200_000, 3)) * [1, 1, 0] * scale
        assert Spheres.from_points(points).radii[0] == pytest.approx(scale / 200_000**0.5, rel=0.2)

    def test_few_and_equal_points_have_a_radius(self):
        for points in (self.GRID[:1], self.GRID[:2], np.zeros((9, 3)), np.repeat(self.GRID[:2], 20, axis=0)):
            assert Spheres.from_points(points).radii[0] > 0
        assert Spheres.from_points(self.GRID, 0.25).note == ""

    def test_objects_and_files_are_taken_with_their_colours(self, session, tmp_path):
        colours = np.tile([255, 0, 0, 255], (len(self.GRID), 1)).astype(np.uint8)
        cloud = trimesh.PointCloud(self.GRID, colors=colours)
        cloud.export(tmp_path / "scan.ply")
        rows = "".join(f"v {x} {y} {z} 1 0 0\n" for x, y, z in self.GRID.tolist())
        (tmp_path / "scan.obj").write_text(rows)
        legacy = SimpleNamespace(points=self.GRID, colors=colours[:, :3] / 255)
        for source in (cloud, tmp_path / "scan.ply", tmp_path / "scan.obj", Spheres.from_points(legacy)):
            with clbvh.Tracer(source) as tracer:
                assert tracer.closest_hit([3.1, 4.1, 5], [0, 0, -1]).t < 5
                (spheres,) = tracer._caster.world.state.shapes
                assert (spheres.appearance.colours == colours).all()
        with clbvh.Renderer(tmp_path / "scan.ply", width=40, height=30) as renderer:
            picture = renderer.render(side="top", up="z", shading="albedo", samples=1)
            assert (picture.rgb[15, 20] == self.RED).all()
            assert any("scan.ply: the points are spheres" in note for note in picture.notes)
        (tmp_path / "a.toml").write_text('[[object]]\npath = "scan.ply"\n')
        assert clbvh.open_scene(tmp_path / "a.toml")[0].geometries[0].shape.prim_count == 1200
        with pytest.raises(MeshError, match=r"1,200 vertices but no faces: a point cloud, which clbvh\.Scene takes"):
            clbvh.load_mesh(tmp_path / "scan.ply")

    def test_a_radius_is_for_points_alone(self, tmp_path):
        trimesh.PointCloud(self.GRID).export(tmp_path / "scan.ply")
        trimesh.creation.box().export(tmp_path / "box.ply")
        (placed,) = open_points([tmp_path / "scan.ply"], 0.3).instances
        assert np.unique(placed.geometry.shape.radii).tolist() == [0.3]
        with pytest.raises(clbvh.SceneError, match=r"box\.ply: the file has faces"):
            open_points([tmp_path / "box.ply"], 0.3)
