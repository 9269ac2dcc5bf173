"""Files of pictures, of images for programs and of light: whole or absent, as they were, refused where damaged."""

import io
import json
import sys
from contextlib import suppress

import imageio.v3 as imageio
import numpy as np
import pytest

from clbvh import Camera, ConfigError, Images, SceneError
from clbvh.files import image_files as files
from clbvh.rendering.channels import CHANNELS
from clbvh.rendering.images import check_images_path, encode_channel, read_camera
from clbvh.views.environment_files import read_environment_map, read_exr, read_radiance

RGB = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)


def test_a_picture_reads_back_as_it_was_or_close_to_it(tmp_path):
    for name in ("a.png", "a.PPM"):
        files.write_picture(tmp_path / name, RGB)
        assert (imageio.imread(tmp_path / name) == RGB).all()
    rows, columns, _ = np.indices((64, 96, 3))
    smooth = (rows + columns).astype(np.uint8)
    smooth[20:40, 30:60] = 250, 10, 30  # edges, also of colours
    files.write_picture(tmp_path / "a.JPEG", smooth)
    assert (tmp_path / "a.JPEG").read_bytes()[:3] == b"\xff\xd8\xff"
    assert np.abs(imageio.imread(tmp_path / "a.JPEG").astype(int) - smooth).max() <= 12
    # A new file has the rights of any other.
    (tmp_path / "other").touch()
    assert (tmp_path / "a.PPM").stat().st_mode == (tmp_path / "other").stat().st_mode


def test_other_names_are_refused_before_the_work(tmp_path):
    (tmp_path / "folder.ppm").mkdir()
    with_alpha = np.dstack((RGB, RGB[..., 0]))
    rows = [
        ("a.gif", RGB, r"must end in \.png"), ("a", RGB, r"must end in \.png"), ("gone/a.ppm", RGB, "does not exist"),
        ("folder.ppm", RGB, "this is a folder"), ("a.jpg", with_alpha, r"a \.jpg file has no transparency"),
        ("a.ppm", with_alpha, r"a \.ppm file has no transparency; write a \.png"),
    ]  # fmt: skip
    for name, pixels, words in rows:
        with pytest.raises(ConfigError, match=words):
            files.write_picture(tmp_path / name, pixels)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.ppm"]


def encode_exr(channels, attributes=None):
    pytest.importorskip("OpenEXR")
    file = io.BytesIO()
    files.write_exr(file, channels, attributes)
    return file.getvalue()


def test_damaged_exr_files_are_refused(tmp_path):
    content = encode_exr({"R": RGB[..., 0].astype(np.float32)}, {"camera": '{"a": "\u00e9"}'})
    for damaged in (b"", content[:3], content[:100], content[:-20], content[:-1], b"solid cube\n" * 40):
        (tmp_path / "a.exr").write_bytes(damaged)
        with pytest.raises(SceneError, match=r"a\.exr: this is no OpenEXR file"):
            read_exr(tmp_path / "a.exr")


def test_environment_maps_are_colours_or_grey(tmp_path):
    path, pixels = tmp_path / "a.exr", np.random.default_rng(0).uniform(-0.1, 9, (3, 6, 3)).astype(np.float16)
    for names in ("RGB", "Y"):
        path.write_bytes(encode_exr({name: pixels[..., number] for number, name in enumerate(names)}))
        read = read_environment_map(path)
        assert read.dtype == np.float32
        assert (read == np.maximum(pixels[..., : len(names)], 0)).all()
    for channels, words in (({"Y": np.float32([[1, np.nan]])}, "finite"), ({"R": pixels[..., 0]}, "this file has R")):
        path.write_bytes(encode_exr(channels))
        with pytest.raises(SceneError, match=words):
            read_environment_map(path)


HEAD = b"#?RADIANCE\n# made by a test\nFORMAT=32-bit_rle_rgbe\n\n"


def compress_row(row):
    """Return a row, (width, 4) uint8, as literal pieces of up to 128 bytes, and its second half, a run, in runs."""
    out = bytearray((2, 2, len(row) >> 8, len(row) & 255))
    half = len(row) // 2
    for values in row.T:
        for at in range(0, half, 128):
            piece = values[at : min(at + 128, half)]
            out += bytes((len(piece), *piece.tolist()))
        for at in range(half, len(row), 127):
            out += bytes((128 + min(127, len(row) - at), values[at]))
    return bytes(out)


def write(path, rgbe, *, compressed=True, head=HEAD, size=None):
    height, width = rgbe.shape[:2]
    rows = b"".join(map(compress_row, rgbe)) if compressed else rgbe.tobytes()
    path.write_bytes(head + (size or f"-Y {height} +X {width}\n".encode()) + rows)
    return path


def make_rgbe(height, width):
    rgbe = np.random.default_rng(0).integers(129, 256, (height, width, 4)).astype(np.uint8)
    rgbe[:, width // 2 :] = 128  # a run
    rgbe[0, 0, 3], rgbe[0, 1, 3] = 0, 1
    exponent = rgbe[..., 3:].astype(int)
    return rgbe, np.where(exponent > 0, rgbe[..., :3] * 2.0 ** (exponent - 136), 0.0)


def test_radiance_pixels_are_those_of_the_formula(tmp_path):
    path = tmp_path / "a.hdr"
    for size in ((1, 8), (3, 9), (5, 700)):
        rgbe, colours = make_rgbe(*size)
        for compressed in (True, False):
            pixels = read_radiance(write(path, rgbe, compressed=compressed))
            assert pixels.dtype == np.float32
            assert (pixels == colours).all()
    rgbe, colours = make_rgbe(2, 3)
    assert (read_environment_map(str(write(tmp_path / "b.HDR", rgbe, compressed=False))) == colours).all()
    # Exposures are divided out, and other orders are turned.
    rgbe, colours = make_rgbe(2, 9)
    head = HEAD.replace(b"\n\n", b"\nEXPOSURE= 4\nEXPOSURE=0.5\n\n")
    assert (read_radiance(write(path, rgbe, head=head)) == colours / 2).all()
    assert (read_radiance(write(path, rgbe, size=b"+Y 2 +X 9\n")) == colours[::-1]).all()
    assert (read_radiance(write(path, rgbe, size=b"-Y 2 -X 9\n")) == colours[:, ::-1]).all()


def test_damaged_radiance_files_are_refused(tmp_path):
    path = tmp_path / "bad.hdr"
    head, one = HEAD + b"-Y 1 +X 9\n\x02\x02\x00\x09", b"-Y 1 +X 1\n1234"
    rows = [
        (b"\x89PNG\r\n", "no Radiance file"), (HEAD, "no Radiance file"), (HEAD + b"-Y 2 +Z 3\n", "the size must read"),
        (HEAD + b"-Y 999999999 +X 999999999\n", "empty or too large"),
        (HEAD.replace(b"rgbe", b"xyze") + one, "must be 32-bit_rle_rgbe"),
        (HEAD.replace(b"\n\n", b"\nEXPOSURE=no\n\n") + one, "exposure must be above 0"),
        (head + b"\x00\x89\x07" * 4, "row 0 of 1 is damaged"), (head + b"\x8a\x07" * 40, "row 0 of 1 is damaged"),
        (HEAD + b"-Y 1 +X 3\n" + b"\x01\x01\x01\x03" * 3, "run-length code of old files"),
    ]  # fmt: skip
    rgbe, _ = make_rgbe(3, 40)
    for compressed in (True, False):
        whole = write(path, rgbe, compressed=compressed).read_bytes()
        rows += [(whole[:-missing], r"bad\.hdr: .*row 2 of 3") for missing in (1, 5)]
    for content, words in rows:
        path.write_bytes(content)
        with pytest.raises(SceneError, match=words):
            read_radiance(path)
    # Any change of bytes gives pixels or one error.
    generator, whole = np.random.default_rng(0), write(path, make_rgbe(4, 20)[0]).read_bytes()
    for _ in range(200):
        changed = bytearray(whole)
        for at in generator.integers(0, len(whole), 3):
            changed[at : at + generator.integers(0, 3)] = generator.bytes(int(generator.integers(0, 4)))
        path.write_bytes(changed)
        with suppress(SceneError):
            assert read_radiance(path).ndim == 3


HEIGHT, WIDTH = 5, 7
CAMERA = Camera(eye=(1, 2, 3), look_at=(0, 0, 0))
MISSES = np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH) % 4 == 0


def read_pixels(path):
    """The pixels of a PPM file; those of the PNG file beside it are the same."""
    kind, size, most, data = path.read_bytes().split(b"\n", 3)
    width, height = map(int, size.split())
    pixels = np.frombuffer(data, ">u2" if most == b"65535" else np.uint8)
    return pixels.reshape((height, width) if kind == b"P5" else (height, width, 3))


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


def test_png_and_ppm_files_follow_the_scales_beside_them(tmp_path):
    for ending in ("png", "PPM"):
        make_images().save(tmp_path / f"out.{ending}")
    facts = json.loads((tmp_path / "out.json").read_text())
    files = {f"out-{name}.{ending}" for name in ARRAYS for ending in ("png", "ppm")}
    assert {path.name for path in tmp_path.iterdir()} == files | {"out.json"}
    np.testing.assert_allclose(read_camera(tmp_path / "out.json").rays()[1], CAMERA.rays(WIDTH, HEIGHT)[1], atol=1e-15)
    for name, array in ARRAYS.items():
        note, kind = facts["channels"][name], CHANNELS[name].kind
        pixels = read_pixels(tmp_path / note["file"])
        assert pixels.dtype == (np.uint8 if kind in ("rgb", "share") else ">u2"), name
        # Pillow leaves the lower eight bits of colours out.
        of_png = imageio.imread(tmp_path / f"out-{name}.png")
        assert (of_png == pixels >> 8 * (pixels.itemsize - of_png.itemsize)).all()
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
    assert np.abs(read_pixels(tmp_path / "out-colour.ppm") - expected).max() <= 1


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
        make_images({"prim_id": np.array([ids], np.int32)}).save(tmp_path / "out.ppm")
        return read_pixels(tmp_path / "out-prim_id.ppm")

    with pytest.raises(ConfigError, match=r"up to 16,777,214, and here it goes to 16,777,215: write \.exr"):
        save(2**24 - 1)
    assert not list(tmp_path.iterdir())
    assert save(65533, -1).tolist() == [[65534, 0]]
    ids = (65535, -1, 0, 2**24 - 2, 70000)
    pixels = save(*ids)
    note = json.loads((tmp_path / "out.json").read_text())["channels"]["prim_id"]
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
