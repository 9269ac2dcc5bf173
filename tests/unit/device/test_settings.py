"""What was measured on a device is found again, there and nowhere else."""

import dataclasses
import json
from pathlib import Path

import pytest

from clbvh.device.settings import (
    Settings,
    default_settings,
    find_settings,
    keep_settings,
    settings_path,
)
from clbvh.errors import ConfigError

MEASURED = Settings("bvh4", 128, (16, 4), is_measured=True, measured_ms=12.5)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("CLBVH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def info(session):
    return session.info


def test_without_a_measurement_the_kind_decides(info):
    usual = {"gpu": ("bvh2", 64), "accelerator": ("bvh2", 64), "cpu": ("bvh8", 32), "other": ("bvh2", 64)}
    for kind, (layout, work_group_size) in usual.items():
        settings = find_settings(dataclasses.replace(info, kind=kind))
        assert settings == Settings(layout, work_group_size, (8, 8))
        assert not settings.is_measured


def test_what_is_kept_is_found(info, cache):
    path = keep_settings(info, MEASURED)
    assert path == settings_path(info)
    assert path.is_relative_to(cache)
    assert find_settings(info) == MEASURED
    facts = json.loads(path.read_text())
    assert (facts["device"], facts["driver_version"]) == (info.name, info.driver_version)


def test_the_layout_of_a_description_is_that_of_its_kind(info, monkeypatch):
    keep_settings(info, MEASURED)
    monkeypatch.setattr(Path, "open", lambda *_, **__: pytest.fail("a file is read"))
    assert dataclasses.replace(info, kind="cpu").layout == "bvh8"


@pytest.mark.parametrize("field", ["name", "platform", "platform_version", "driver_version"])
def test_another_device_or_driver_knows_nothing_of_it(info, field):
    keep_settings(info, MEASURED)
    other = dataclasses.replace(info, **{field: "another"})
    assert find_settings(other) == default_settings(other)
    assert find_settings(dataclasses.replace(info, number=7)) == MEASURED


@pytest.mark.parametrize(
    "text",
    [
        "", "{", "[]", "null", "{}", '{"layout": "bvh8"}', "\x00",
        '{"layout": "bvh8", "work_group_size": 64, "tile": [8], "measured_ms": 1}',
    ],
)  # fmt: skip
def test_a_damaged_file_is_ignored_and_replaced(info, text):
    keep_settings(info, MEASURED).write_text(text)
    assert find_settings(info) == default_settings(info)
    keep_settings(info, MEASURED)
    assert find_settings(info) == MEASURED


def test_a_cache_that_cannot_be_written_is_named(info, cache):
    cache.write_text("a file")
    with pytest.raises(ConfigError, match=r"cannot be kept"):
        keep_settings(info, MEASURED)
    assert find_settings(info) == default_settings(info)


def test_tracers_and_pictures_use_it(session, info):
    import numpy as np

    from clbvh import Tracer, build, make_shape
    from clbvh.rendering.painters import FrameRenderer, OneRayPainter
    from tests.worlds import open_mesh

    mesh = make_shape("icosphere", triangles=320)
    rays = np.tile([[0.0, 0.0, 0.0]], (100, 1)), np.random.default_rng(0).normal(size=(100, 3))
    with Tracer(build(mesh), device=info) as usual:
        expected = usual.closest_hit(*rays)
    keep_settings(info, MEASURED)
    launched = []
    run = type(session).run

    class Recorded(type(session)):
        def run(self, kernel, work_size, work_group, **arguments):
            launched.append((kernel.name, work_group))
            run(self, kernel, work_size, work_group, **arguments)

    with Recorded(info) as session:
        world = open_mesh(session, mesh, build(mesh))
        from clbvh.structs import VIEW

        view = np.zeros(1, VIEW)
        view["width"], view["height"], view["forward"] = 20, 10, (0, 0, 1)
        FrameRenderer(session, world).render(view, OneRayPainter(session, world))
        FrameRenderer(session, world).render(view, OneRayPainter(session, world, (2, 2)))
    assert [group for name, group in launched if name == "render"] == [(16, 4), (2, 2)]
    with Tracer(build(mesh), device=info) as tuned:
        assert tuned.layout == "bvh4"
        found = tuned.closest_hit(*rays)
    np.testing.assert_array_equal(found.prim_id, expected.prim_id)
    np.testing.assert_array_equal(found.t, expected.t)
