"""A library whose levels do not all have the same kernels."""

from __future__ import annotations

import pytest

from clbvh.device.host import compile
from clbvh.device.host.compile import build_library, find_objects
from clbvh.device.host.library import LEVEL_VARIABLE, HostLibrary
from clbvh.device.host.variants import Variant


@pytest.mark.skipif(compile.find_compiler() is None, reason="there is no compiler")
def test_a_kernel_that_a_level_lacks_is_that_of_the_level_below(tmp_path, monkeypatch):
    known = list(target.levels) if (target := compile.find_own_target()) else []
    if len(known) < 2:
        pytest.skip("processors of this kind have one level")
    low, high = known[:2]
    monkeypatch.setattr(compile, "WITHOUT_LEVEL", {high: ("settle_tiles",)})
    variants = [Variant.of(name, {}) for name in ("settle_tiles", "meet_boxes")]
    path = tmp_path / "host.so"
    build_library(path, find_objects(), [low, high], variants=variants)
    monkeypatch.setenv(LEVEL_VARIABLE, high)
    library = HostLibrary(path)
    addresses = {}
    for level in (low, high):
        for variant in variants:
            name = f"{level}_{variant.entry(variant.name)}"
            if hasattr(library._library, name):
                addresses[name] = library._library[name]
    assert len(addresses) == 3
    entries = [library.kernels(variant.name, {})[variant.name].entry.__name__ for variant in variants]
    assert entries == [f"{low}_settle_tiles", f"{high}_meet_boxes"]
    # Alone, a level has everything.
    build_library(path.with_name("one.so"), find_objects(), [high], variants=variants)
    only = HostLibrary(path.with_name("one.so"))
    assert only.kernels("settle_tiles", {})["settle_tiles"].entry.__name__ == f"{high}_settle_tiles"
