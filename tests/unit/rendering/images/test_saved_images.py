"""Images read back from files: bit for bit, or within half a step of 16 bits."""

from __future__ import annotations

import io
import json
import struct
import sys
import zlib

import numpy as np
import pytest
from PIL import Image

from clbvh import Camera, ConfigError
from clbvh.rendering.channels import CHANNELS
from clbvh.rendering.image_files import read_exr
from clbvh.rendering.images import Images, check_images_path, encode_channel, read_camera

HEIGHT, WIDTH = 5, 7
CAMERA = Camera(eye=(1, 2, 3), look_at=(0, 0, 0))
MISSES = np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH) % 4 == 0


def read_chunks(data):
    """Yield the kind and the content of each chunk; the check sums are compared."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at = 8
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        content = data[at + 8 : at + 8 + length]
        assert struct.unpack(">I", data[at + 8 + length : at + 12 + length])[0] == zlib.crc32(kind + content)
        yield kind, content
        at += 12 + length


def decode(data):
    """Return the pixels of a file that uses the filter of the row above alone, (height, width, channels)."""
    chunks = dict(read_chunks(data))
    width, height, bits, colour_type, *others = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
    assert others == [0, 0, 0]
    channel_count = {0: 1, 4: 2, 2: 3, 6: 4}[colour_type]
    rows = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(height, -1)
    assert (rows[:, 0] == 2).all()
    plain = np.cumsum(rows[:, 1:], axis=0, dtype=np.uint8)
    return plain.reshape(-1).view(f">u{bits // 8}").reshape(height, width, channel_count)


def make_arrays(seed=0):
    generator = np.random.default_rng(seed)
    arrays = {}
    for name, channel in CHANNELS.items():
        shape = (HEIGHT, WIDTH, max(3 if channel.kind == "rgb" else 1, len(channel.exr_names)))
        shape = shape[: 3 if shape[2] > 1 else 2]
        if channel.kind == "rgb":
            arrays[name] = generator.integers(0, 256, shape).astype(np.uint8)
        elif channel.kind == "colour":
            arrays[name] = generator.random(shape).astype(np.float32)
        elif channel.kind == "share":
            arrays[name] = (~MISSES).astype(np.float32)
        elif channel.kind == "id":
            arrays[name] = np.where(MISSES, -1, generator.integers(0, 65535, shape)).astype(np.int32)
        elif channel.kind == "distance":
            arrays[name] = np.where(MISSES, np.inf, generator.uniform(0.5, 40, shape)).astype(np.float32)
        elif channel.kind == "direction":
            vectors = generator.normal(size=shape)
            vectors /= np.linalg.norm(vectors, axis=-1, keepdims=True)
            arrays[name] = np.where(MISSES[..., None], 0, vectors).astype(np.float32)
        else:
            values = np.where(MISSES[..., None], np.nan, generator.normal(size=shape) * 30)
            arrays[name] = values.astype(np.float64 if name == "position" else np.float32)
    return arrays


ARRAYS = make_arrays()


@pytest.fixture
def images():
    return Images(dict(ARRAYS), CAMERA, geometry_names=("a", "\u00e9"), instance_names=("x",))


def test_npz_holds_every_bit_the_camera_and_the_names(images, tmp_path):
    images.save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as loaded:
        facts = {"camera_to_world", "intrinsics", "size", "geometry_names", "instance_names"}
        assert set(loaded) == set(ARRAYS) | facts
        for name, array in ARRAYS.items():
            assert loaded[name].dtype == array.dtype
            assert loaded[name].tobytes() == array.tobytes()
        assert (loaded["camera_to_world"] == CAMERA.camera_to_world()).all()
        assert (loaded["intrinsics"] == CAMERA.intrinsics(WIDTH, HEIGHT)).all()
        assert loaded["geometry_names"].tolist() == ["a", "\u00e9"]


def test_exr_holds_every_bit_of_float32_and_ids(images, tmp_path):
    openexr = pytest.importorskip("OpenEXR")
    images.save(tmp_path / "a.exr")
    channels = read_exr(tmp_path / "a.exr")
    expected = [name for channel in CHANNELS.values() for name in channel.exr_names]
    assert sorted(channels) == sorted(expected)
    for name, array in ARRAYS.items():
        for part, exr_name in enumerate(CHANNELS[name].exr_names):
            values = array if array.ndim == 2 else array[..., part]
            if CHANNELS[name].kind == "id":
                assert channels[exr_name].dtype == np.uint32
                assert (channels[exr_name].view(np.int32) == values).all()
            else:
                assert channels[exr_name].tobytes() == values.astype(np.float32).tobytes()
    assert {"R", "G", "B", "A", "depth.Z", "normal.X", "normal_camera.Z", "instance_id.ID"} <= set(channels)
    head = openexr.File(str(tmp_path / "a.exr")).header()
    assert json.loads(head["camera_to_world"]) == CAMERA.camera_to_world().tolist()
    assert json.loads(head["geometry_names"]) == ["a", "\u00e9"]


def read_png(folder, note):
    pixels = decode((folder / note["file"]).read_bytes())
    return pixels[..., 0] if pixels.shape[2] == 1 else pixels


def test_png_files_follow_the_scales_beside_them(images, tmp_path):
    images.save(tmp_path / "out.png")
    facts = json.loads((tmp_path / "out.json").read_text())
    names = {f"out-{name}.png" for name in ARRAYS} | {"out.json"}
    assert {path.name for path in tmp_path.iterdir()} == names
    assert facts["intrinsics"] == CAMERA.intrinsics(WIDTH, HEIGHT).tolist()
    camera = read_camera(tmp_path / "out.json")
    assert camera.eye == CAMERA.eye
    np.testing.assert_allclose(camera.rays(WIDTH, HEIGHT)[1], CAMERA.rays(WIDTH, HEIGHT)[1], atol=1e-15)
    for name, array in ARRAYS.items():
        note = facts["channels"][name]
        pixels = read_png(tmp_path, note)
        kind = CHANNELS[name].kind
        assert pixels.dtype == (np.uint8 if kind in ("rgb", "share") else ">u2"), name
        if "scale" not in note:
            assert kind in ("rgb", "colour")
            continue
        if array.ndim == 3 and array.shape[2] == 2:
            assert (pixels[..., 2] == ~MISSES).all()
            pixels = pixels[..., :2]
        values = pixels / note["scale"] + note["offset"]
        assert np.abs(values - array)[~MISSES].max() <= 0.5000001 / note["scale"], name
        assert (pixels[MISSES] == 0).all()
        if kind != "share":
            assert (pixels[~MISSES] > 0).all()
    with Image.open(tmp_path / "out-depth.png") as image:
        assert json.loads(image.text["clbvh"]) == {"channel": "depth", **facts["channels"]["depth"]}


def test_ppm_files_have_the_pixels_of_png_files(images, tmp_path):
    images.save(tmp_path / "one.png", depth_scale=1000)
    images.save(tmp_path / "two.PPM", depth_scale=1000)
    assert (tmp_path / "two.json").read_text() == (tmp_path / "one.json").read_text().replace(".png", ".ppm").replace(
        "one-", "two-"
    )
    for name in ARRAYS:
        pixels = decode((tmp_path / f"one-{name}.png").read_bytes())
        kind = b"P5" if pixels.shape[2] == 1 else b"P6"
        data = (tmp_path / f"two-{name}.ppm").read_bytes()
        assert data.startswith(kind + f"\n{WIDTH} {HEIGHT}\n".encode())
        assert data.endswith(b"\n" + pixels.tobytes())


def test_colours_of_png_files_are_srgb(images, tmp_path):
    images.save(tmp_path / "out.png")
    assert (decode((tmp_path / "out-rgb.png").read_bytes()) == ARRAYS["rgb"]).all()
    linear = ARRAYS["colour"].astype(np.float64)
    expected = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055) * 65535
    assert np.abs(decode((tmp_path / "out-colour.png").read_bytes()) - expected).max() <= 1


def test_normals_of_zero_components_are_exact():
    normals = np.array([[[0, 0, -1], [0, 1, 0], [0, 0, 0]]], np.float32)
    coded = encode_channel("normal", normals)
    assert coded.pixels.tolist() == [[[32768, 32768, 1], [32768, 65535, 32768], [0, 0, 0]]]
    assert 32768 / coded.scale + coded.offset == pytest.approx(0, abs=1e-15)


@pytest.mark.parametrize(
    ("most", "scale"), [(40.0, 1000), (65.0, 1000), (66.0, 500), (1e-30, 5e34), (3e9, 2e-5), (65535.0, 1)]
)
def test_depths_get_a_round_scale_that_fits(most, scale):
    coded = encode_channel("depth", np.array([[most / 2, most, np.inf]], np.float32))
    assert coded.scale == pytest.approx(scale, rel=1e-12)
    assert coded.offset == 0
    assert coded.pixels.max() <= 65535
    assert coded.pixels.tolist()[0][2] == 0


def test_a_given_depth_scale_is_taken_or_refused(images, tmp_path):
    coded = encode_channel("depth", np.array([[0.0001, 1.2344, 5]], np.float32), 1000)
    assert coded.pixels.tolist() == [[1, 1234, 5000]]
    images.save(tmp_path / "out.png", depth_scale=1000)
    assert json.loads((tmp_path / "out.json").read_text())["channels"]["range"]["scale"] == 1000
    with pytest.raises(ConfigError, match=r"depth_scale can be 1\d+"):
        images.save(tmp_path / "other.png", depth_scale=100000)
    for wrong in (0, -1, np.nan, np.inf, True, "1000"):
        with pytest.raises(ConfigError, match="depth_scale must be"):
            images.save(tmp_path / "other.png", depth_scale=wrong)
    assert not list(tmp_path.glob("other*"))
    with pytest.raises(ConfigError, match="depth_scale is for PNG and PPM files"):
        images.save(tmp_path / "a.npz", depth_scale=1000)


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("depth", np.full((2, 2), np.inf, np.float32)),
        ("motion", np.full((2, 2, 2), np.nan, np.float32)),
        ("position", np.full((2, 2, 3), 7.0)),
        ("instance_id", np.full((2, 2), -1, np.int32)),
        ("depth", np.array([[-1.0, 2.0]], np.float32)),
    ],
    ids=["no depth", "no motion", "one position", "no ids", "behind"],
)
def test_odd_images_are_written(name, array):
    coded = encode_channel(name, array)
    known = np.isfinite(array) & (array != -1 if name == "instance_id" else True)
    values = coded.pixels[..., : array.shape[2] if array.ndim == 3 else None] / coded.scale + coded.offset
    np.testing.assert_allclose(values[known], array[known], atol=0.5 / coded.scale)
    assert (coded.pixels[..., : array.shape[2] if array.ndim == 3 else None][~known] == 0).all()


def make_ids(*ids):
    arrays = {"depth": np.ones((1, len(ids)), np.float32), "primitive_id": np.array([ids], np.int32)}
    return Images(arrays, CAMERA, geometry_names=(), instance_names=())


def test_ids_beyond_sixteen_bits_go_over_three_bytes(tmp_path):
    ids = (65535, -1, 0, 2**24 - 2, 70000)
    make_ids(*ids).save(tmp_path / "out.png")
    note = json.loads((tmp_path / "out.json").read_text())["channels"]["primitive_id"]
    assert note["pixel"] == "R + 256 G + 65536 B"
    pixels = decode((tmp_path / "out-primitive_id.png").read_bytes())
    assert pixels.dtype == np.uint8
    assert (pixels @ [1, 256, 65536] / note["scale"] + note["offset"]).tolist() == [list(ids)]


def test_ids_of_sixteen_bits_stay_grey(tmp_path):
    make_ids(65533, -1).save(tmp_path / "out.png")
    assert decode((tmp_path / "out-primitive_id.png").read_bytes())[..., 0].tolist() == [[65534, 0]]


def test_ids_beyond_three_bytes_leave_no_file(tmp_path):
    with pytest.raises(ConfigError, match=r"up to 16,777,214, and here it goes to 16,777,215: write \.exr"):
        make_ids(2**24 - 1).save(tmp_path / "out.png")
    assert not list(tmp_path.iterdir())


def test_only_rgb_is_no_exr(tmp_path):
    pytest.importorskip("OpenEXR")
    images = Images({"rgb": ARRAYS["rgb"]}, CAMERA, geometry_names=(), instance_names=())
    with pytest.raises(ConfigError, match="ask for the channel colour"):
        images.save(tmp_path / "a.exr")
    assert not list(tmp_path.iterdir())


class TestTargets:
    @pytest.mark.parametrize("name", ["a.pgm", "a", "a.jpg"])
    def test_other_suffixes_are_refused(self, tmp_path, name):
        with pytest.raises(ConfigError, match=r"must end in \.exr, \.npz, \.png, \.ppm"):
            check_images_path(tmp_path / name, ["depth"])

    def test_every_png_file_is_checked_first(self, images, tmp_path):
        (tmp_path / "out-uv.png").mkdir()
        with pytest.raises(ConfigError, match=r"out-uv\.png: this is a folder"):
            images.save(tmp_path / "out.png")
        assert [path.name for path in tmp_path.iterdir()] == ["out-uv.png"]

    def test_a_missing_library_is_found_before_the_work(self, tmp_path, monkeypatch):
        monkeypatch.setitem(sys.modules, "OpenEXR", None)
        with pytest.raises(ConfigError, match="pip install OpenEXR"):
            check_images_path(tmp_path / "a.exr", ["depth"])

    def test_no_path_at_all(self, images):
        with pytest.raises(ConfigError, match="a path, not"):
            images.save(io.BytesIO())
