"""Written files are whole or absent, and say what was rendered."""

from __future__ import annotations

import imageio.v3 as imageio
import numpy as np
import pytest

from clbvh import Mesh
from clbvh.errors import ConfigError
from clbvh.rendering import image_files as files
from clbvh.trace.hits.hits import Hits
from clbvh.trace.hits.surface import Surface

RGB = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
HITS = Hits(np.float32([[1.5, np.inf]]), np.float32([[0.25, 0]]), np.float32([[0.5, 0]]), np.int32([[7, -1]]))


def test_a_ppm_is_binary_with_a_plain_header(tmp_path):
    files.write_picture(tmp_path / "a.ppm", RGB)
    data = (tmp_path / "a.ppm").read_bytes()
    assert data.split()[:4] == [b"P6", b"3", b"2", b"255"]
    assert data.endswith(RGB.tobytes())


@pytest.mark.parametrize("name", ["a.png", "a.PPM", "a.ppm"])
def test_a_picture_reads_back_as_it_was(tmp_path, name):
    files.write_picture(tmp_path / name, RGB)
    assert (imageio.imread(tmp_path / name) == RGB).all()


@pytest.mark.parametrize("name", ["a.jpg", "a.JPEG"])
def test_a_jpeg_is_close_to_the_picture_and_smaller(tmp_path, name):
    rows, columns = np.indices((64, 96), np.float32)
    smooth = np.stack((2 * columns, 3 * rows, columns + rows), axis=2).astype(np.uint8)
    smooth[20:40, 30:60] = 250, 10, 30  # edges, also of colours
    files.write_picture(tmp_path / name, smooth)
    assert (tmp_path / name).read_bytes()[:3] == b"\xff\xd8\xff"
    assert np.abs(imageio.imread(tmp_path / name).astype(int) - smooth).max() <= 12
    assert (tmp_path / name).stat().st_size < smooth.size / 3


@pytest.mark.parametrize("name", ["a.ppm", "a.jpg", "a.jpeg"])
def test_only_a_png_can_be_transparent(tmp_path, name):
    with pytest.raises(ConfigError, match=rf"a \{name[1:]} file has no transparency; write a \.png"):
        files.write_picture(tmp_path / name, np.dstack((RGB, RGB[..., 0])))
    assert not (tmp_path / name).exists()


def test_hits_read_back_as_they_were(tmp_path):
    files.write_hits(tmp_path / "h.npz", HITS, ("a", "b"), ("a", "b 2", "\u00e9"))
    with np.load(tmp_path / "h.npz") as loaded:
        assert loaded["geometry_names"].tolist() == ["a", "b"]
        assert loaded["instance_names"].tolist() == ["a", "b 2", "\u00e9"]
        names = {"geometry_id", "instance_id", "prim_id", "t", "u", "v"}
        assert set(loaded) == names | {"geometry_names", "instance_names"}
        for name in names:
            assert (loaded[name] == getattr(HITS, name)).all()
            assert loaded[name].dtype == getattr(HITS, name).dtype


def test_hits_name_the_parts_of_all_meshes(tmp_path):
    def make(count, names):
        parts = [(name, face, face + 1) for face, name in enumerate(names)]
        return Mesh.from_arrays(np.eye(3), [[0, 1, 2]] * count, parts=parts)

    meshes = [make(1, ()), make(2, "ab"), make(3, "cde")]
    ids = np.array([0, 1, 2, 2, -1], np.int32)
    surface = Surface.from_shapes(meshes, ("a", "b", "c"), np.arange(3), np.tile(np.eye(4), (3, 1, 1)))
    t = np.zeros(5)
    hits = Hits(t, t, t, np.array([0, 1, 0, 2, -1], np.int32), surface=surface, known_instance_id=ids)
    files.write_hits(tmp_path / "h.npz", hits, ("a", "b", "c"), ("a", "b", "c"))
    with np.load(tmp_path / "h.npz") as loaded:
        assert loaded["part_id"].tolist() == [-1, 1, 2, 4, -1]
        assert loaded["part_names"].tolist() == ["a", "b", "c", "d", "e"]


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    (tmp_path / "h.npz").write_bytes(b"old")

    def fail(file, **arrays):
        file.write(b"half")
        raise OSError("no space left on device")

    monkeypatch.setattr(np, "savez", fail)
    with pytest.raises(OSError, match="no space"):
        files.write_hits(tmp_path / "h.npz", HITS, ("a",), ("a",))
    assert [path.name for path in tmp_path.iterdir()] == ["h.npz"]
    assert (tmp_path / "h.npz").read_bytes() == b"old"


def test_a_new_file_has_the_rights_of_any_other(tmp_path):
    files.write_picture(tmp_path / "a.ppm", RGB)
    (tmp_path / "other").touch()
    assert (tmp_path / "a.ppm").stat().st_mode == (tmp_path / "other").stat().st_mode


@pytest.mark.parametrize("name", ["a.gif", "a", "a.npz"])
def test_other_kinds_of_pictures_are_refused(tmp_path, name):
    with pytest.raises(ConfigError, match=r"must end in \.png, \.jpg, \.jpeg, \.ppm"):
        files.check_picture_path(tmp_path / name)


def test_other_kinds_of_hit_files_are_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"must end in \.npz"):
        files.check_hits_path(tmp_path / "hits.csv")


def test_a_missing_folder_is_found_before_the_work(tmp_path):
    with pytest.raises(ConfigError, match="does not exist"):
        files.check_picture_path(tmp_path / "gone" / "a.ppm")


def test_a_folder_is_no_file(tmp_path):
    (tmp_path / "a.ppm").mkdir()
    with pytest.raises(ConfigError, match="this is a folder"):
        files.check_picture_path(tmp_path / "a.ppm")
