"""`clbvh tune`: measures, keeps, prints; and the next command uses what it found."""

import json
from pathlib import Path

import pytest

from clbvh.layout import LAYOUT_WIDTHS
from clbvh.render.tune import Trial, _choose, tune

from .command import run_clbvh


@pytest.fixture(scope="module")
def tuned(_opened_device, tmp_path_factory):
    cache = tmp_path_factory.mktemp("cache")
    answer = run_clbvh("tune", "--json", "--device", _opened_device.info.number, CLBVH_CACHE=str(cache))
    assert (answer.returncode, answer.stderr) == (0, "")
    return cache, json.loads(answer.stdout)


def test_every_layout_group_and_tile_is_measured(tuned):
    _, facts = tuned
    assert [trial["choice"] for trial in facts["trials"] if trial["what"] == "layout"] == list(LAYOUT_WIDTHS)
    for what in ("layout", "group size", "tile"):
        trials = [trial for trial in facts["trials"] if trial["what"] == what]
        assert len(trials) >= 3
        assert all(trial["ms"] > 0 for trial in trials)
        (best,) = (trial for trial in trials if trial["is_best"])
        assert best["ms"] <= 1.03 * min(trial["ms"] for trial in trials)


def test_the_next_command_uses_what_was_kept(tuned, session):
    cache, facts = tuned
    path = Path(facts["kept_in"])
    kept = json.loads(path.read_text())
    assert kept["layout"] == facts["settings"]["layout"]
    # Made up, so that it differs from what the kind of device says.
    kept["layout"] = "bvh4"
    path.write_text(json.dumps(kept))
    listed = json.loads(run_clbvh("devices", "--json", CLBVH_CACHE=str(cache)).stdout)["devices"]
    assert listed[session.info.number]["layout"] == "bvh4"


def test_a_table_for_readers(session, tmp_path):
    answer = run_clbvh("tune", "--device", session.info.number, CLBVH_CACHE=str(tmp_path))
    assert answer.returncode == 0
    for word in (*LAYOUT_WIDTHS, "taken", "group size", "tile", "8 x 8", str(tmp_path)):
        assert word in answer.stdout


def test_what_is_hardly_faster_is_not_taken():
    trials: list[Trial] = []
    assert _choose(trials, "tile", {(8, 8): 100.0, (4, 4): 99.0}, (8, 8)) == (8, 8)
    assert _choose(trials, "tile", {(8, 8): 100.0, (4, 4): 90.0}, (8, 8)) == (4, 4)
    assert [(trial.choice, trial.is_best) for trial in trials] == [
        ("8 x 8", True), ("4 x 4", False), ("8 x 8", False), ("4 x 4", True)
    ]  # fmt: skip


def test_it_works_on_a_small_mesh(session):
    info, settings, trials = tune(session.info, triangles=500, size=(32, 18))
    assert info == session.info
    assert settings.is_measured
    assert sum(trial.is_best for trial in trials) == 3
