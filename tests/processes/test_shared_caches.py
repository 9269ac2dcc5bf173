"""Two commands at once on the same caches, which are empty: both are right."""

from __future__ import annotations

import pytest

from ..profiles import is_long
from .place import Place, scene_in

ROUNDS = 20 if is_long() else 1
WORDS = ("render", "scene.toml", "--cache", "--width", 64)


@pytest.mark.parametrize("round_", range(ROUNDS))
def test_two_commands_share_empty_caches(tmp_path, round_):
    place = scene_in(Place(tmp_path))
    environment = {"POCL_CACHE_DIR": str(tmp_path / "pocl"), "XDG_CACHE_HOME": str(tmp_path / "xdg")}
    if is_long():
        environment["NUMBA_CACHE_DIR"] = str(tmp_path / "numba")
    both = [place.start(*WORDS, "-o", name, environment=environment) for name in ("a.ppm", "b.ppm")]
    for process in both:
        code, _, errors = place.finish(process)
        assert (code, errors) == (0, "")
    assert place.run(*WORDS, "-o", "c.ppm", environment=environment)[0] == 0
    pictures = {(place.output / name).read_bytes() for name in ("a.ppm", "b.ppm", "c.ppm")}
    assert len(pictures) == 1
    assert len(list((place.cache / "trees").iterdir())) == 1
    assert place.leftovers() == []
