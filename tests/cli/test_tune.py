"""`clbvh tune`: measures, keeps, prints; and the next command uses the settings."""

import json
from pathlib import Path

import pytest

from clbvh.device.select import list_devices
from clbvh.rendering import tune as tune_module
from clbvh.rendering.tune import Trial, _choose, tune
from clbvh.structs import LAYOUT_WIDTHS

from .command import refuses, run_clbvh


@pytest.fixture(scope="module")
def measured(_opened_device):
    """The settings and the trials of a small mesh and a small picture."""
    return tune(_opened_device.info, triangles=500, size=(32, 18))


@pytest.fixture
def run_tune(measured, session, tmp_path, monkeypatch):
    """A function from arguments to the command's answer; it measures the default sizes, in no time."""

    def measure(device=None, **sizes):
        assert (device, sizes) == (str(session.info.number), {})
        return measured

    monkeypatch.setattr(tune_module, "tune", measure)
    return lambda *words: run_clbvh("tune", "--device", session.info.number, *words, CLBVH_CACHE=str(tmp_path))


def test_every_layout_work_group_and_tile_is_measured(measured, session):
    info, settings, trials = measured
    assert info == session.info
    assert settings.is_measured
    assert [trial.choice for trial in trials if trial.what == "layout"] == list(LAYOUT_WIDTHS)
    for what in ("layout", "work-group size", "tile"):
        of_kind = [trial for trial in trials if trial.what == what]
        assert len(of_kind) >= 3
        assert all(trial.ms > 0 for trial in of_kind)
        (best,) = (trial for trial in of_kind if trial.is_best)
        assert best.ms <= 1.03 * min(trial.ms for trial in of_kind)


def test_the_next_command_uses_the_kept_settings(run_tune, measured, session, tmp_path):
    answer = run_tune("--json")
    assert (answer.returncode, answer.stderr) == (0, "")
    facts = json.loads(answer.stdout)
    assert facts["settings"]["layout"] == measured[1].layout
    assert [trial["choice"] for trial in facts["trials"]] == [trial.choice for trial in measured[2]]
    path = Path(facts["kept_in"])
    assert path.is_relative_to(tmp_path)
    kept = json.loads(path.read_text())
    assert kept["layout"] == facts["settings"]["layout"]
    # Made up, so that it differs from the default of this kind of device.
    kept["layout"] = "bvh4"
    path.write_text(json.dumps(kept))
    listed = json.loads(run_clbvh("devices", "--json", CLBVH_CACHE=str(tmp_path)).stdout)["devices"]
    assert listed[session.info.number]["layout"] == "bvh4"


def test_a_table_for_readers(run_tune, tmp_path):
    answer = run_tune()
    assert answer.returncode == 0
    for word in (*LAYOUT_WIDTHS, "taken", "work-group size", "tile", "8 x 8", str(tmp_path)):
        assert word in answer.stdout


def test_a_gain_within_the_noise_changes_nothing():
    trials: list[Trial] = []
    assert _choose(trials, "tile", {(8, 8): 100.0, (4, 4): 99.0}, (8, 8)) == (8, 8)
    assert _choose(trials, "tile", {(8, 8): 100.0, (4, 4): 90.0}, (8, 8)) == (4, 4)
    assert [(trial.choice, trial.is_best) for trial in trials] == [
        ("8 x 8", True), ("4 x 4", False), ("8 x 8", False), ("4 x 4", True)
    ]  # fmt: skip


def test_all_devices_are_measured_and_then_listed(measured, monkeypatch, tmp_path):
    asked = []

    def measure(info):
        asked.append(info)
        return info, *measured[1:]

    monkeypatch.setattr(tune_module, "tune", measure)
    answer = run_clbvh("tune", "--all", CLBVH_CACHE=str(tmp_path))
    assert (answer.returncode, answer.stderr) == (0, "")
    assert asked == [device for device in list_devices() if not device.is_emulated]
    assert answer.stdout.splitlines()[-1].startswith("the devices from now on: 0: ")
    assert len(list(tmp_path.rglob("*.json"))) == len(asked)
    refuses(run_clbvh("tune", "--all", "--device", "0"), 2, "give one of them")
