"""Several views in one file: contact sheets and turntables with their animations; and heat maps of rays."""

import sys

import numpy as np
import pytest
from PIL import Image

import clbvh
from clbvh import Camera, ConfigError, Fisheye, build, make_shape
from clbvh.choices import STANDARD_VIEWS
from clbvh.files.image_files import GROUND, INK
from clbvh.rendering import series
from clbvh.rendering.heat_map import count_picture, draw_heat_map, draw_heat_map_of, open_counter
from clbvh.trace.hits.closest import count_steps
from clbvh.views.cameras.framing import frame_mesh

BOX = (np.array([[0, 0, 0], [4, 0, 0], [0, 2, 0], [0, 0, 1.0]]), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
WIDTH, HEIGHT = 80, 60
BALL = clbvh.make_shape("icosphere", triangles=80)
SIZE = {"width": 40, "height": 30}


@pytest.fixture(scope="module")
def sheet():
    return clbvh.contact_sheet(BOX, width=WIDTH, height=HEIGHT, shading="lambert", up="y")


def test_a_sheet_has_the_views_in_their_places_whole_and_at_one_scale(sheet, tmp_path):
    strip = sheet.rgb.shape[0] // 2 - HEIGHT
    assert sheet.rgb.shape == (2 * (HEIGHT + strip), 4 * WIDTH, 3)
    assert tuple(sheet.pictures) == STANDARD_VIEWS
    sizes = {"front": (4, 2), "back": (4, 2), "left": (1, 2), "right": (1, 2), "top": (4, 1), "bottom": (4, 1)}
    for number, (view, picture) in enumerate(sheet.pictures.items()):
        top, left = number // 4 * (HEIGHT + strip), number % 4 * WIDTH
        np.testing.assert_array_equal(sheet.rgb[top : top + HEIGHT, left : left + WIDTH], picture.rgb)
        caption = sheet.rgb[top + HEIGHT : top + HEIGHT + strip, left : left + WIDTH]
        assert (caption[:, 0] == GROUND).all()
        assert caption.max() > 150
        rows, columns = np.nonzero(picture.alpha)
        assert min(rows.min(), columns.min(), HEIGHT - 1 - rows.max(), WIDTH - 1 - columns.max()) > 0
        if view in sizes:
            found = np.array([np.ptp(columns) + 1, np.ptp(rows) + 1]) * sheet.pixel_size
            np.testing.assert_allclose(found, sizes[view], atol=2.5 * sheet.pixel_size)
    # The ruler in the last place is the widest line, and as long as its label, a round length, says.
    panel = (sheet.rgb[-HEIGHT - strip :, -WIDTH:] == INK).all(axis=-1)
    assert panel.sum(axis=1).max() in (round(length / sheet.pixel_size) for length in (2, 5))
    sheet.save(tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as image:
        np.testing.assert_array_equal(np.asarray(image), sheet.rgb)


@pytest.fixture
def frames(monkeypatch):
    """The frames that are written, behind their rate."""
    written = []
    monkeypatch.setattr(series, "write_animation", lambda path, frames, rate: written.extend([rate, *frames]))
    return written


def test_a_turntable_has_the_pictures_of_a_turn_about_up(frames, tmp_path):
    done = []
    view = clbvh.View(up=(0, 1, 0), transparent=True, background=(0.0, 1.0, 0.0), ground=False, samples=2, **SIZE)
    turn = {"frames": 3, "frames_per_s": 7, "on_frame": lambda *pair: done.append(pair)}
    clbvh.render_turntable(clbvh.build(BALL), tmp_path / "a.gif", view, **turn, up=(0, 0, 1))
    assert frames[0] == 7
    assert done == [(1, 3), (2, 3), (3, 3)]
    assert frames[1][0, 0].tolist() == [0, 255, 0]
    with clbvh.Renderer(BALL, view, up=(0, 0, 1), transparent=False) as renderer:
        cameras = renderer.turntable(3)
        np.testing.assert_array_equal(frames[1:], [renderer.render(camera=camera).rgb for camera in cameras])
    # Counterclockwise, seen from above.
    angles = np.unwrap([np.arctan2(camera.eye[1], camera.eye[0]) for camera in cameras])
    np.testing.assert_allclose(np.diff(np.degrees(angles)), 120)
    assert len({round(camera.eye[2], 9) for camera in cameras}) == 1


def test_wrong_turns_are_refused_before_any_work(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    rows = [
        ("a.gif", {"frames": True}, "frames of a turn"), ("a.gif", {"frames": 90_001}, "frames of a turn"),
        ("a.gif", {"frames_per_s": np.inf}, "frames_per_s"), ("a.mp4", {}, "pip install imageio-ffmpeg"),
    ]  # fmt: skip
    for name, turn, words in rows:
        with pytest.raises(ConfigError, match=words):
            clbvh.render_turntable("no such mesh.ply", tmp_path / name, **turn)


COLOURS = [(250, 20, 20), (20, 250, 20), (20, 20, 250), (240, 240, 10)]


def make_frames(height, width):
    return [np.full((height, width, 3), colour, np.uint8) for colour in COLOURS]


def test_a_gif_has_the_frames_and_repeats(tmp_path):
    frames = make_frames(5, 7)
    for rate, duration in ((12.5, 80), (1000, 20)):
        series.write_animation(tmp_path / "a.gif", iter(frames), rate)
        with Image.open(tmp_path / "a.gif") as image:
            assert (image.n_frames, image.info["loop"]) == (len(frames), 0)
            for number, frame in enumerate(frames):
                image.seek(number)
                assert image.info["duration"] == duration
                assert (np.asarray(image.convert("RGB")) == frame).all()


# imageio-ffmpeg's reader leaves its pipes to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("size", [(16, 23), (17, 32)], ids=str)
def test_a_video_has_the_frames_and_even_sides(tmp_path, size):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    height, width = size
    series.write_animation(tmp_path / "a.mp4", make_frames(*size), 10)
    facts, *read = ffmpeg.read_frames(str(tmp_path / "a.mp4"))
    assert facts["size"] == (width + width % 2, height + height % 2)
    assert (facts["fps"], facts["codec"], len(read)) == (10, "h264", len(COLOURS))
    for frame, colour in zip(read, COLOURS, strict=True):
        pixels = np.frombuffer(frame, np.uint8).reshape(height + height % 2, -1, 3)
        assert np.abs(pixels.astype(int) - colour).max() < 12
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path):
    pytest.importorskip("imageio_ffmpeg")

    def fail_after(count, error):
        yield from make_frames(8, 8)[:count]
        raise error

    for name in ("a.gif", "a.mp4"):
        (tmp_path / name).write_bytes(b"old")
        for count, error in ((0, RuntimeError), (1, KeyboardInterrupt), (3, RuntimeError)):
            with pytest.raises(error):
                series.write_animation(tmp_path / name, fail_after(count, error), 25)
            assert (tmp_path / name).read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 2


def lightness(colours):
    """Return CIE L* of sRGB colours."""
    share = np.asarray(colours, float) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    luminance = linear @ [0.2126, 0.7152, 0.0722]
    return np.where(luminance > 0.008856, 116 * np.cbrt(luminance) - 16, 903.3 * luminance)


def test_more_is_evenly_lighter_and_the_bar_is_below():
    picture = draw_heat_map(np.arange(200).reshape(1, 200).repeat(4, axis=0), "nodes")
    assert (picture[:4] == picture[0]).all()
    steps = np.diff(lightness(picture[0])[:200:20])
    assert 0 < steps.max() < 1.5 * steps.min()
    for counts in (np.zeros((3, 40), int), np.full((3, 40), 7), np.ones((2, 1), int), np.ones((2, 3840), int)):
        shape = draw_heat_map(counts, "triangles").shape
        assert shape[0] > len(counts)
        assert shape[1] == counts.shape[1]


def test_a_few_bright_pixels_do_not_darken_the_others():
    counts = np.full((100, 100), 50)
    counts[0, 0] = 10_000
    picture = draw_heat_map(counts, "nodes")
    assert lightness(picture[50, 50]) > 80
    assert lightness(picture[0, 0]) == lightness(picture[:100]).max()


def test_counts_are_those_of_the_pictures_rays():
    bvh = build(make_shape("knot", triangles=1000))
    camera = frame_mesh(bvh.mesh, aspect=2)
    with open_counter(bvh) as caster:
        expected = count_steps(caster, *camera.rays(40, 20)).reshape(20, 40)
    for quantity, field in (("triangles", "prim_tests"), ("nodes", "node_steps")):
        picture = draw_heat_map_of(bvh, camera, 40, 20, quantity)
        assert np.array_equal(picture, draw_heat_map(expected[field], quantity))
    # Beyond the circle of a fisheye, rays go straight behind the camera, where the mesh is; but nobody casts them.
    camera = Camera(eye=(0, 0, 6), look_at=(0, 0, 9), projection=Fisheye(360))
    steps, is_seen = count_picture(bvh, camera, 40, 20)["node_steps"], camera.sees(40, 20)
    assert steps[~is_seen].min() > 0
    expected = draw_heat_map(np.where(is_seen, steps, 0), "nodes")
    np.testing.assert_array_equal(draw_heat_map_of(bvh, camera, 40, 20, "nodes"), expected)
