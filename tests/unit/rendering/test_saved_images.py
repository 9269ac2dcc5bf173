"""Images read back from files: bit for bit, or within half a step of 16 bits."""

import json
import struct
import sys
import zlib

import numpy as np
import pytest

from clbvh import Camera, ConfigError, Images
from clbvh.rendering.channels import CHANNELS
from clbvh.rendering.image_files import read_exr
from clbvh.rendering.images import check_images_path, encode_channel, read_camera

HEIGHT, WIDTH = 5, 7
CAMERA = Camera(eye=(1, 2, 3), look_at=(0, 0, 0))
MISSES = np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH) % 4 == 0


def decode(data):
    """Return the pixels of a PNG file that uses the filter of the row above alone; the check sums are compared."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    chunks, at = {}, 8
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        chunks[kind] = data[at + 8 : at + 8 + length]
        assert struct.unpack(">I", data[at + 8 + length : at + 12 + length])[0] == zlib.crc32(kind + chunks[kind])
        at += 12 + length
    width, height, bits, colour_type, *others = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
    assert others == [0, 0, 0]
    rows = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(height, -1)
    assert (rows[:, 0] == 2).all()
    plain = np.cumsum(rows[:, 1:], axis=0, dtype=np.uint8)
    shape = (height, width) if colour_type == 0 else (height, width, 3)
    return plain.reshape(-1).view(f">u{bits // 8}").reshape(shape)


def make_arrays():
    generator = np.random.default_rng(0)
    arrays = {}
    for name, channel in CHANNELS.items():
        count = 3 if channel.kind == "rgb" else len(channel.exr_names)
        shape = (HEIGHT, WIDTH, count) if count > 1 else (HEIGHT, WIDTH)
        misses = MISSES[..., None] if count > 1 else MISSES
        vectors = generator.normal(size=shape)
        arrays[name] = {
            "rgb": lambda shape=shape: generator.integers(0, 256, shape),
            "colour": lambda shape=shape: generator.random(shape),
            "share": lambda: ~MISSES,
            "id": lambda shape=shape: np.where(MISSES, -1, generator.integers(0, 65535, shape)),
            "distance": lambda shape=shape: np.where(MISSES, np.inf, generator.uniform(0.5, 40, shape)),
            "direction": lambda v=vectors, m=misses: np.where(m, 0, v / np.linalg.norm(v, axis=-1, keepdims=True)),
            "vector": lambda vectors=vectors, misses=misses: np.where(misses, np.nan, 30 * vectors),
        }[channel.kind]().astype(channel.dtype)
    return arrays


ARRAYS = make_arrays()


def make_images(arrays=ARRAYS):
    return Images(dict(arrays), CAMERA, geometry_names=("a", "\u00e9"), instance_names=("x",))


def test_npz_holds_every_bit_the_camera_and_the_names(tmp_path):
    make_images().save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as loaded:
        for name, array in ARRAYS.items():
            assert (loaded[name].dtype, loaded[name].tobytes()) == (array.dtype, array.tobytes())
        assert (loaded["camera_to_world"] == CAMERA.camera_to_world()).all()
        assert (loaded["intrinsics"] == CAMERA.intrinsics(WIDTH, HEIGHT)).all()
        assert loaded["geometry_names"].tolist() == ["a", "\u00e9"]


def test_exr_holds_every_bit_of_float32_and_ids(tmp_path):
    openexr = pytest.importorskip("OpenEXR")
    make_images().save(tmp_path / "a.exr")
    channels = read_exr(tmp_path / "a.exr")
    assert sorted(channels) == sorted(name for channel in CHANNELS.values() for name in channel.exr_names)
    for name, array in ARRAYS.items():
        for part, exr_name in enumerate(CHANNELS[name].exr_names):
            values = array if array.ndim == 2 else array[..., part]
            kept = values.view(np.uint32) if CHANNELS[name].kind == "id" else values.astype(np.float32)
            assert (channels[exr_name].dtype, channels[exr_name].tobytes()) == (kept.dtype, kept.tobytes())
    head = openexr.File(str(tmp_path / "a.exr")).header()
    assert json.loads(head["camera_to_world"]) == CAMERA.camera_to_world().tolist()
    assert json.loads(head["geometry_names"]) == ["a", "\u00e9"]
    with pytest.raises(ConfigError, match="ask for the channel colour"):
        make_images({"rgb": ARRAYS["rgb"]}).save(tmp_path / "b.exr")


def test_png_files_follow_the_scales_beside_them(tmp_path):
    make_images().save(tmp_path / "out.png")
    facts = json.loads((tmp_path / "out.json").read_text())
    assert {path.name for path in tmp_path.iterdir()} == {f"out-{name}.png" for name in ARRAYS} | {"out.json"}
    np.testing.assert_allclose(read_camera(tmp_path / "out.json").rays()[1], CAMERA.rays(WIDTH, HEIGHT)[1], atol=1e-15)
    for name, array in ARRAYS.items():
        note, kind = facts["channels"][name], CHANNELS[name].kind
        pixels = decode((tmp_path / note["file"]).read_bytes())
        assert pixels.dtype == (np.uint8 if kind in ("rgb", "share") else ">u2"), name
        if "scale" not in note:
            assert kind in ("rgb", "colour")
            continue
        if array.shape[2:] == (2,):
            assert (pixels[..., 2] == ~MISSES).all()
            pixels = pixels[..., :2]
        values = pixels / note["scale"] + note["offset"]
        assert np.abs(values - array)[~MISSES].max() <= 0.5000001 / note["scale"], name
        assert (pixels[MISSES] == 0).all()
        assert kind == "share" or (pixels[~MISSES] > 0).all()
    # Colours are sRGB.
    linear = ARRAYS["colour"].astype(np.float64)
    expected = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055) * 65535
    assert np.abs(decode((tmp_path / "out-colour.png").read_bytes()) - expected).max() <= 1
    # PPM files have the same pixels.
    make_images().save(tmp_path / "out.PPM")
    assert json.loads((tmp_path / "out.json").read_text())["channels"]["rgb"]["file"] == "out-rgb.ppm"
    for name in ARRAYS:
        pixels, data = decode((tmp_path / f"out-{name}.png").read_bytes()), (tmp_path / f"out-{name}.ppm").read_bytes()
        assert data.startswith((b"P5" if pixels.ndim == 2 else b"P6") + f"\n{WIDTH} {HEIGHT}\n".encode())
        assert data.endswith(b"\n" + pixels.tobytes())


def test_depths_get_a_round_scale_that_fits():
    for most, scale in ((40.0, 1000), (65.0, 1000), (66.0, 500), (1e-30, 5e34), (3e9, 2e-5), (65535.0, 1)):
        coded = encode_channel("depth", np.array([[most / 2, most, np.inf]], np.float32))
        assert (coded.scale, coded.offset) == (pytest.approx(scale, rel=1e-12), 0)
        assert 0 == coded.pixels[0, 2] < coded.pixels[0, 0] < coded.pixels[0, 1]


def test_a_given_depth_scale_is_taken_or_refused(tmp_path):
    coded = encode_channel("depth", np.array([[0.0001, 1.2344, 65.5]], np.float32), 1000)
    assert coded.pixels.tolist() == [[1, 1234, 65500]]
    assert encode_channel("depth", np.array([[65535.0]], np.float32), 1).pixels.tolist() == [[65535]]
    with pytest.raises(ConfigError, match=r"depth_scale can be 0\.99998\d at most"):
        encode_channel("depth", np.array([[65536.0]], np.float32), 1)
    for wrong in (100000, 0, -1, np.nan, np.inf, True, "1000"):
        with pytest.raises(ConfigError, match="depth_scale"):
            make_images().save(tmp_path / "other.png", depth_scale=wrong)
    assert not list(tmp_path.iterdir())
    with pytest.raises(ConfigError, match="depth_scale is for PNG and PPM files"):
        make_images().save(tmp_path / "a.npz", depth_scale=1000)


def test_odd_images_are_written():
    rows = [
        ("depth", np.full((2, 2), np.inf, np.float32)), ("motion", np.full((2, 2, 2), np.nan, np.float32)),
        ("position", np.full((2, 2, 3), 7.0)), ("instance_id", np.full((2, 2), -1, np.int32)),
        ("depth", np.array([[-1.0, 2.0]], np.float32)), ("normal", np.float32([[[0, 0, -1], [0, 1, 0]]])),
    ]  # fmt: skip
    for name, array in rows:
        coded = encode_channel(name, array)
        known = np.isfinite(array) & (array != -1 if name == "instance_id" else True)
        pixels = coded.pixels[..., : array.shape[2] if array.ndim == 3 else None]
        np.testing.assert_allclose((pixels / coded.scale + coded.offset)[known], array[known], atol=0.5 / coded.scale)
        assert (pixels[~known] == 0).all()


def test_ids_have_sixteen_bits_or_three_bytes_or_leave_no_file(tmp_path):
    def save(*ids):
        make_images({"primitive_id": np.array([ids], np.int32)}).save(tmp_path / "out.png")
        return decode((tmp_path / "out-primitive_id.png").read_bytes())

    with pytest.raises(ConfigError, match=r"up to 16,777,214, and here it goes to 16,777,215: write \.exr"):
        save(2**24 - 1)
    assert not list(tmp_path.iterdir())
    assert save(65533, -1).tolist() == [[65534, 0]]
    ids = (65535, -1, 0, 2**24 - 2, 70000)
    pixels = save(*ids)
    note = json.loads((tmp_path / "out.json").read_text())["channels"]["primitive_id"]
    assert (note["pixel"], pixels.dtype) == ("R + 256 G + 65536 B", np.uint8)
    assert (pixels @ [1, 256, 65536] / note["scale"] + note["offset"]).tolist() == [list(ids)]


def test_targets_are_checked_before_the_work(tmp_path, monkeypatch):
    (tmp_path / "out-uv.png").mkdir()
    with pytest.raises(ConfigError, match=r"out-uv\.png: this is a folder"):
        make_images().save(tmp_path / "out.png")
    assert [path.name for path in tmp_path.iterdir()] == ["out-uv.png"]
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(ConfigError, match="pip install OpenEXR"):
        check_images_path(tmp_path / "a.exr", ["depth"])
