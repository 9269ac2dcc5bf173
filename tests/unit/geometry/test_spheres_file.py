"""Files of spheres: both formats, and what is refused."""

from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest

from clbvh.errors import MeshError
from clbvh.geometry.loading import spheres_file
from clbvh.geometry.loading.spheres_file import read_spheres

CENTRES = np.array([[0, 0, 0], [1, 2.5, -3e-30], [4e6, 0, 0.1]])
RADII = np.array([1, 0.5, 1e-3])
ROWS = "0,0,0,1\n1, 2.5, -3e-30, 0.5\n4e6,0,0.1,1e-3\n"


@pytest.fixture
def write(tmp_path):
    def write_file(name: str, content: bytes | str):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write_file


def pack(save=np.savez, **arrays) -> bytes:
    file = io.BytesIO()
    save(file, **arrays)
    return file.getvalue()


@pytest.mark.parametrize(
    "text", [ROWS, "x, y, z, radius\n" + ROWS, "# atoms\n" + ROWS.replace("\n", "\r\n"), "\ufeff" + ROWS, "\n" + ROWS]
)
def test_a_table_is_read(write, text):
    centres, radii = read_spheres(write("a.csv", text))
    assert (centres == CENTRES).all()
    assert (radii == RADII).all()


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize("dtype", ["<f8", ">f4", "<i4"])
def test_an_archive_is_read(write, save, dtype):
    whole = np.array([[0, 1, 2], [3, 4, 5]], dtype)
    centres, radii = read_spheres(write("a.npz", pack(save, centres=np.asfortranarray(whole), radii=whole[:, 1])))
    assert (centres == whole).all()
    assert (radii == whole[:, 1]).all()
    assert centres.dtype == radii.dtype == np.float64
    assert centres.flags.c_contiguous


def test_radii_may_be_left_out(write):
    centres, radii = read_spheres(write("a.npz", pack(centres=CENTRES)))
    assert (centres == CENTRES).all()
    assert radii is None
    centres, radii = read_spheres(write("a.CSV", "1,2,3\n"))
    assert (centres == [[1, 2, 3]]).all()
    assert radii is None


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.txt", ROWS, r"must end in \.npz or \.csv"),
        ("a.csv", "", "no spheres"),
        ("a.npz", "", "the file is empty"),
        ("a.csv", "x,y,z,r\n", "no spheres"),
        ("a.csv", "1,2\n", "x, y, z and a radius, not '1,2'"),
        ("a.csv", "1,2,3,4,5\n", "x, y, z and a radius"),
        ("a.csv", ROWS + "1,2,3\n", "sphere 3 must have 4 numbers like the first one, not '1,2,3'"),
        ("a.csv", "1,2,3,4\n1,2,x,4\n", "damaged"),
        ("a.csv", b"\xff\xfe\x00", "damaged"),
        ("a.npz", b"PK", "damaged"),
        ("a.npz", pack(radii=RADII), "no array 'centres'"),
        ("a.npz", pack(centres=RADII), r"centres must have shape \(n, 3\), not \(3,\)"),
        ("a.npz", pack(centres=CENTRES, radii=RADII[:2]), r"radii must have shape \(3,\), one for each centre, not"),
        ("a.npz", pack(centres=np.array([["a", "b", "c"]])), "centres must be numbers"),
        ("a.npz", pack(centres=np.array([[None] * 3])), "centres must be numbers, not object"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_named(write, name, content, message):
    path = write(name, content)
    with pytest.raises(MeshError, match=message) as caught:
        read_spheres(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(MeshError, match=r"gone\.npz: no such file"):
        read_spheres(tmp_path / "gone.npz")


def make_archive(header: str, payload: bytes) -> bytes:
    text = header.encode().ljust(117) + b"\n"
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("centres.npy", b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + payload)
    return file.getvalue()


@pytest.mark.parametrize("rows", [2, 10**12, 2**61])
def test_an_archive_that_promises_more_than_it_has_is_refused(write, rows):
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({rows}, 3), }}"
    with pytest.raises(MeshError, match=f"centres has 3 numbers instead of {3 * rows:,}"):
        read_spheres(write("a.npz", make_archive(header, bytes(24))))


def test_a_file_that_needs_more_memory_than_there_is_is_refused_first(write, monkeypatch):
    asked = []

    def refuse(subject, needed_bytes, error):
        asked.append(needed_bytes)
        raise error(f"{subject} needs too much")

    monkeypatch.setattr(spheres_file, "check_memory", refuse)
    for name, content in (("a.csv", ROWS), ("a.npz", pack(np.savez_compressed, centres=np.zeros((100_000, 3))))):
        with pytest.raises(MeshError, match="needs too much"):
            read_spheres(write(name, content))
    assert asked[1] > 3 * 100_000 * 24
