"""The conformance check: a device's answers are the stored ones, and a difference is named by its ray; its script."""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clbvh import ConfigError, InternalError, ValidationError, build
from clbvh.conformance import check, expected
from clbvh.conformance.cases import make_cases
from clbvh.conformance.check import (
    ALL_LAYOUTS,
    answer_pictures,
    answer_rays,
    check_device,
    collect_expected,
    compare_answer,
)
from clbvh.conformance.expected import Expected, digest_of, load_expected, store_expected


def test_rays_of_every_kind_hit_and_miss_the_meshes_that_answers_are_stored_for(session):
    digests, stored = load_expected()
    assert {case.name: digest_of(case) for case in make_cases()} == digests
    assert list(stored) == list(digests)
    # Answers that are all misses would be equal everywhere.
    for case in make_cases():
        bvh = build(case.mesh)
        answers = dict(answer_rays(case, bvh, "bvh2", session.info))
        assert 0.05 < answers["any_hit"]["is_hit"].mean() < 0.95, case.name
        assert (answers["all_hits"]["count"] > 1).any() or case.name == "single", case.name
        assert not case.is_closed or 0.05 < answers["contains"]["is_inside"].mean() < 0.95, case.name
        colours = dict(answer_pictures(case, bvh, "bvh2", session.info))["picture lambert"]["colour"]
        assert 0 < (colours[:, 3] == 255).sum() < len(colours), case.name


def test_the_answers_of_the_device_are_the_stored_ones_in_every_layout(session):
    result = check_device(session.info, meshes=("soup", "plates", "far ball"))
    assert result.is_equal, [str(difference) for difference in result.differences]
    assert {layout for layout, _ in result.compared} == {"fast", *ALL_LAYOUTS}
    assert min(result.compared.values()) > 0


def test_a_part_that_differs_is_named_with_its_first_row():
    prim_id = np.arange(40, dtype=np.int32)
    stored = {"prim_id": Expected.of(prim_id)}
    assert compare_answer("bvh4", "closest_hit", "soup", {"prim_id": prim_id}, stored) == []
    prim_id[[17, 30]] = 5
    (difference,) = compare_answer("bvh4", "closest_hit", "soup", {"prim_id": prim_id}, stored)
    assert (difference.row, difference.value) == (17, "5")
    assert str(difference).startswith("bvh4, closest_hit, mesh 'soup': prim_id differs, first in row 17")
    # The last bit of a number differs, the sign of a zero does not, another shape does.
    numbers = Expected.of(np.array([0.0, 0.1, 3.0]))
    assert numbers.find_difference(np.array([-0.0, 0.1, 3.0])) is None
    assert numbers.find_difference(np.array([0.0, np.nextafter(0.1, 1), 3.0])) == 1
    assert Expected.of(np.arange(6)).find_difference(np.arange(6).reshape(3, 2)) is not None


def test_what_is_stored_is_loaded_and_fits_and_a_wrong_answer_is_found_and_not_stored(session, tmp_path, monkeypatch):
    cases = [case for case in make_cases() if case.name == "single"]
    answers = collect_expected(cases, session.info)
    monkeypatch.setattr(expected, "EXPECTED_PATH", tmp_path / "expected.json")
    store_expected(cases, answers)
    assert load_expected()[1] == answers
    assert check_device(session.info, meshes=("single",)).is_equal

    def answer_wrongly(case, bvh, layout, device):
        for query, answer in answer_rays(case, bvh, layout, device):
            if layout == "bvh8" and query == "count_hits":
                answer["count"][3] += 1
            yield query, answer

    monkeypatch.setattr(check, "answer_rays", answer_wrongly)
    result = check_device(session.info, layouts=("bvh2", "bvh8"), meshes=("single",))
    (difference,) = result.differences
    assert (difference.layout, difference.query, difference.mesh, difference.row) == ("bvh8", "count_hits", "single", 3)
    assert not result.is_equal
    with pytest.raises(ValidationError, match="layouts disagree, so nothing is stored: bvh8, count_hits"):
        collect_expected(cases, session.info)
    # What is damaged is our bug.
    (tmp_path / "expected.json").write_text("{}")
    with pytest.raises(InternalError, match="stored answers"):
        load_expected()


def test_inputs_with_other_bytes_are_not_compared_and_unknown_ones_are_refused(session, monkeypatch):
    digests, stored = load_expected()
    monkeypatch.setattr(check, "load_expected", lambda: ({**digests, "single": "other"}, stored))
    result = check_device(session.info, layouts=("brute",), meshes=("single",))
    assert (result.unusable, result.compared, result.is_equal) == (("single",), {}, False)
    with pytest.raises(ConfigError, match=r"'bunny' is no mesh .* single, soup"):
        check_device(session.info, meshes=("bunny",))


@pytest.fixture
def script(monkeypatch):
    """The script behind `make conformance`, as a module."""
    path = Path(__file__).parents[3] / ".ci" / "compare_runtimes.py"
    spec = importlib.util.spec_from_file_location("compare_runtimes", path)
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up.
    monkeypatch.setitem(sys.modules, "compare_runtimes", module)
    spec.loader.exec_module(module)
    return module


def test_findings_of_the_simulator_are_counted_and_the_planted_write_has_a_place(script):
    errors = "\nInvalid write of size 1 at global memory address 0x4\n\tKernel: any_hit\n\tEntity: Global(0,0,0)\n\n"
    race = "Write-write data race at global memory address 0x4\n\tKernel: any_hit\n"
    assert [script.count_findings(text) for text in (errors, race + errors, "clbvh: all is well\n")] == [1, 2, 0]
    assert script._RIGHT_WRITE in (script.PROJECT / "cl" / script._PLANTED_KERNEL).read_text()


def test_a_runtime_without_a_driver_or_that_takes_too_long_fails(script, tmp_path):
    gone = tmp_path / "libgone.so"
    for runtime, library, words in [
        (replace(script.RUNTIMES[1], find_library=lambda: gone), gone, "no device matches"),
        (replace(script.RUNTIMES[0], time_limit_s=0.05), None, "no answer within 0.05 s"),
    ]:
        outcome = script.check_runtime(runtime, library)
        assert outcome.is_failure
        assert words in outcome.answer
