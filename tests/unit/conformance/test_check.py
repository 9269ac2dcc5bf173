"""The conformance check: a device's answers are the stored ones, and a difference is named by its ray."""

import numpy as np
import pytest

from clbvh.builders.build import build
from clbvh.conformance import check as check_module
from clbvh.conformance.cases import make_cases
from clbvh.conformance.check import ALL_LAYOUTS, answer_pictures, answer_rays, check_device, compare_answer
from clbvh.conformance.expected import Expected, digest_of, load_expected
from clbvh.errors import ConfigError, InternalError


def test_the_inputs_have_the_same_bytes_here_as_where_the_answers_were_stored():
    digests, expected = load_expected()
    assert {case.name: digest_of(case) for case in make_cases()} == digests
    assert list(expected) == list(digests)


def test_rays_of_every_kind_hit_and_miss(session):
    # Answers that are all misses would be equal everywhere.
    for case in make_cases():
        bvh = build(case.mesh)
        answers = dict(answer_rays(case, bvh, "bvh2", session.info))
        share = answers["any_hit"]["is_hit"].mean()
        assert 0.05 < share < 0.95, case.name
        assert (answers["all_hits"]["count"] > 1).any() or case.name == "single", case.name
        if case.is_closed:
            assert 0.05 < answers["contains"]["is_inside"].mean() < 0.95
        colours = dict(answer_pictures(case, bvh, "bvh2", session.info))["picture lambert"]["colour"]
        assert 0 < (colours[:, 3] == 255).sum() < len(colours), case.name


def test_the_answers_of_the_device_are_the_stored_ones_in_every_layout(session):
    result = check_device(session.info, meshes=("soup", "plates", "far ball"))
    assert result.is_equal, [str(difference) for difference in result.differences]
    assert {layout for layout, _ in result.compared} == set(ALL_LAYOUTS)
    assert min(result.compared.values()) > 0


def test_a_part_that_differs_is_named_with_its_first_row():
    prim_id = np.arange(40, dtype=np.int32)
    stored = {"prim_id": Expected.of(prim_id)}
    assert compare_answer("bvh4", "closest_hit", "soup", {"prim_id": prim_id}, stored) == []
    other = prim_id.copy()
    other[[17, 30]] = 5
    (difference,) = compare_answer("bvh4", "closest_hit", "soup", {"prim_id": other}, stored)
    assert (difference.row, difference.value) == (17, "5")
    assert str(difference).startswith("bvh4, closest_hit, mesh 'soup': prim_id differs, first in row 17")


def test_the_last_bit_of_a_number_differs_and_the_sign_of_a_zero_does_not():
    numbers = np.array([0.0, 0.1, 3.0])
    stored = Expected.of(numbers)
    assert stored.find_difference(np.array([-0.0, 0.1, 3.0])) is None
    assert stored.find_difference(np.array([0.0, np.nextafter(0.1, 1), 3.0])) == 1


def test_answers_of_another_shape_differ_even_with_the_same_bytes():
    assert Expected.of(np.arange(6)).find_difference(np.arange(6).reshape(3, 2)) is not None


def test_a_wrong_answer_of_one_layout_is_found(session, monkeypatch):
    def answer_wrongly(case, bvh, layout, device):
        for query, answer in answer_rays(case, bvh, layout, device):
            if layout == "bvh4" and query == "count_hits":
                answer["count"][3] += 1
            yield query, answer

    monkeypatch.setattr(check_module, "answer_rays", answer_wrongly)
    result = check_device(session.info, layouts=("bvh2", "bvh4"), meshes=("single",))
    (difference,) = result.differences
    assert (difference.layout, difference.query, difference.mesh, difference.row) == ("bvh4", "count_hits", "single", 3)
    assert not result.is_equal


def test_inputs_with_other_bytes_are_not_compared(session, monkeypatch):
    digests, expected = load_expected()
    monkeypatch.setattr(check_module, "load_expected", lambda: ({**digests, "single": "other"}, expected))
    result = check_device(session.info, layouts=("brute",), meshes=("single",))
    assert result.unusable == ("single",)
    assert result.compared == {}
    assert not result.is_equal


def test_an_unknown_mesh_is_refused(session):
    with pytest.raises(ConfigError, match=r"'bunny' is no mesh .* single, soup"):
        check_device(session.info, meshes=("bunny",))


def test_damaged_stored_answers_are_an_error(tmp_path, monkeypatch):
    (tmp_path / "expected.json").write_text("{}")
    monkeypatch.setattr("clbvh.conformance.expected.EXPECTED_PATH", tmp_path / "expected.json")
    with pytest.raises(InternalError, match="stored answers"):
        load_expected()
