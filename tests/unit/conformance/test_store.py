"""Storing the answers anew: only what all layouts agree on."""

import pytest

from clbvh.conformance import check as check_module, expected as expected_module
from clbvh.conformance.cases import make_cases
from clbvh.conformance.check import answer_rays, check_device, collect_expected
from clbvh.conformance.expected import load_expected, store_expected
from clbvh.errors import ValidationError


def test_what_is_stored_is_loaded_and_fits(session, tmp_path, monkeypatch):
    cases = [case for case in make_cases() if case.name == "single"]
    answers = collect_expected(cases, session.info)
    monkeypatch.setattr(expected_module, "EXPECTED_PATH", tmp_path / "expected.json")
    store_expected(cases, answers)
    assert load_expected()[1] == answers
    assert check_device(session.info, meshes=("single",)).is_equal is True


def test_layouts_that_disagree_are_not_stored(session, monkeypatch):
    def answer_wrongly(case, bvh, layout, device):
        for query, answer in answer_rays(case, bvh, layout, device):
            if layout == "bvh8" and query == "closest_hit":
                answer["prim_id"][0] = 7
            yield query, answer

    monkeypatch.setattr(check_module, "answer_rays", answer_wrongly)
    cases = [case for case in make_cases() if case.name == "single"]
    with pytest.raises(ValidationError, match="layouts disagree, so nothing is stored: bvh8, closest_hit"):
        collect_expected(cases, session.info)
