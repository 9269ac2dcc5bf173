"""What was measured on a device is found again, there and nowhere else."""

import dataclasses
import json

import numpy as np
import pytest

from clbvh import Tracer, build
from clbvh.device.settings import Settings, default_settings, find_settings, keep_settings, settings_path
from clbvh.rendering.painters import FrameRenderer, OneRayPainter
from clbvh.structs import VIEW
from tests.worlds import open_mesh

MEASURED = Settings("bvh4", 128, (16, 4), is_measured=True, measured_ms=12.5)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("CLBVH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def info(session, cache):
    return session.info


def test_what_is_kept_is_found_for_that_device_and_driver(info, cache):
    path = keep_settings(info, MEASURED)
    assert path == settings_path(info)
    assert path.is_relative_to(cache)
    facts = json.loads(path.read_text())
    assert (facts["device"], facts["driver_version"]) == (info.name, info.driver_version)
    assert find_settings(dataclasses.replace(info, number=7)) == MEASURED
    for field in ("name", "platform", "platform_version", "driver_version"):
        other = dataclasses.replace(info, **{field: "another"})
        assert find_settings(other) == default_settings(other), field


def test_a_damaged_file_is_ignored_and_replaced(info):
    no_tile = '{"layout": "bvh8", "work_group_size": 64, "tile": [8], "measured_ms": 1}'
    for text in ("", "{", "[]", "null", "{}", '{"layout": "bvh8"}', "\x00", no_tile):
        keep_settings(info, MEASURED).write_text(text)
        assert find_settings(info) == default_settings(info), text
    keep_settings(info, MEASURED)
    assert find_settings(info) == MEASURED


def test_tracers_and_pictures_use_it(session, info, mesh, rays, tracer):
    expected = tracer.closest_hit(*rays)
    keep_settings(info, MEASURED)
    launched = []

    class Recorded(type(session)):
        def run(self, kernel, work_size, work_group, **arguments):
            launched.append((kernel.name, work_group))
            super().run(kernel, work_size, work_group, **arguments)

    with Recorded(info) as recorded:
        world = open_mesh(recorded, mesh, build(mesh))
        view = np.zeros(1, VIEW)
        view["width"], view["height"], view["forward"] = 20, 10, (0, 0, 1)
        FrameRenderer(recorded, world).render(view, OneRayPainter(recorded, world))
    assert [group for name, group in launched if name == "render"] == [(16, 4)]
    with Tracer(mesh, device=info) as tuned:
        assert tuned.layout == "bvh4"
        found = tuned.closest_hit(*rays)
    np.testing.assert_array_equal((found.prim_id, found.t), (expected.prim_id, expected.t))
