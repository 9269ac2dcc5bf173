"""The facts of a machine, and what has changed since the study before."""

from __future__ import annotations

import pytest

from clbvh.study.machine import Machine, describe_machine, find_version, keep_machine, read_machines


def make(**facts):
    return Machine({"cores": "2", **facts}, None)


def test_changes_are_named(tmp_path):
    assert keep_machine(tmp_path, make(numpy="1")) == []
    assert keep_machine(tmp_path, make(numpy="1")) == []
    assert keep_machine(tmp_path, make(numpy="2", numba="3")) == [
        "numpy was 1, and is 2", "numba was missing, and is 3",
    ]  # fmt: skip
    # Back again: these samples are seen again.
    assert keep_machine(tmp_path, make(numpy="1")) == []
    assert list(read_machines(tmp_path)) == [make(numpy="2", numba="3").digest, make(numpy="1").digest]


@pytest.mark.usefixtures("_opened_device")
def test_facts_of_this_machine():
    machine = describe_machine()
    assert machine.facts["numpy"] == find_version("numpy")
    assert machine.facts["device kind"] == machine.device.kind
    assert int(machine.facts["cores"]) >= 1
    assert describe_machine().digest == machine.digest
    assert all(isinstance(value, str) for value in machine.facts.values())


def test_a_package_that_is_not_installed_has_no_version():
    assert find_version("no-such-package-of-ours") is None
