"""Numbers of a scene file that ended in a traceback: more triangles than fit the memory, integers of many digits."""

from __future__ import annotations

import pytest

import clbvh
from clbvh.errors import ConfigError, MeshError, SceneError
from clbvh.rendering.scene_file import read_scene_file

from ..cli.command import run_clbvh


@pytest.fixture
def write(tmp_path):
    def write_text(text: str):
        path = tmp_path / "a.toml"
        path.write_text(text)
        return path

    return write_text


@pytest.mark.parametrize("count", ["9_000_000_000_000_000_000", "9223372036854775807", "1073741824000", "2147483648"])
@pytest.mark.parametrize("shape", ["knot", "terrain", "blobs", "boxes", "icosphere", "palace"])
def test_more_triangles_than_a_mesh_can_have(write, count, shape):
    with pytest.raises(SceneError, match=f"the shape '{shape}' cannot be made: .* triangles are too many"):
        read_scene_file(write(f'[[object]]\nshape = "{shape}"\ntriangles = {count}\n'))


def test_more_triangles_than_fit_the_memory(monkeypatch):
    from clbvh.geometry import make_shape

    monkeypatch.setattr("clbvh.support.memory.free_memory_bytes", lambda: 10**9)
    with pytest.raises(ConfigError, match="10,000,000 triangles need about 1,500 MB of memory, but 1,000 MB are free"):
        make_shape("knot", triangles=10_000_000)


@pytest.mark.parametrize(
    "line",
    [
        "triangles = 9e18",
        "triangles = 9223372036854775808",
        f"triangles = 0x{'f' * 10_000}",
        f"triangles = {'9' * 5000}",
        f"size = 1{'0' * 400}",
        f"seed = -{'9' * 400}",
        "size = inf",
        "size = 1e400",
        f"size = {'[' * 5000}",
    ],
    ids=lambda line: line[:30],
)
def test_a_number_out_of_range(write, line):
    with pytest.raises(SceneError) as caught:
        read_scene_file(write(f'[[object]]\nshape = "blobs"\n{line}\n'))
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("option", ["spread", "size"])
def test_a_shape_beyond_float32(write, option):
    with pytest.raises(MeshError, match=r"not finite|float"):
        read_scene_file(write(f'[[object]]\nshape = "blobs"\n{option} = 1e308\n'))


def test_a_transform_beyond_float64(write):
    """Refused as before, but numpy warned of it on the terminal."""
    text = '[[object]]\nshape = "boxes"\ntriangles = 12\nspread = 1000\nscale = 1.7e308\n'
    with pytest.raises(SceneError, match="float64 has no room"):
        clbvh.render(write(text), width=8, height=8)


def test_a_scene_of_many_bytes(write):
    with pytest.raises(SceneError, match="more than the 1,048,576 expected"):
        read_scene_file(write("#" * (1 << 20) + "\n"))


def test_the_command_says_so_in_one_line(write, tmp_path):
    path = write('[[object]]\nshape = "knot"\ntriangles = 9_000_000_000_000_000_000\n')
    answer = run_clbvh("stats", path, "--workers", 1)
    assert (answer.returncode, len(answer.stderr.splitlines())) == (2, 1)
    assert "9,000,000,000,000,000,000 triangles are too many" in answer.stderr
