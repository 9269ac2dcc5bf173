"""The commands that bring a driver: one source for the doctor and the documentation."""

from pathlib import Path

import pytest

from clbvh.device.doctor.platforms import PLATFORMS, find_commands, find_platform

DOCS = Path(__file__).parents[3] / "docs"


@pytest.mark.parametrize("known", PLATFORMS, ids=lambda known: known.name)
def test_the_documentation_has_the_row_of_each_platform(known):
    text = (DOCS / "devices.md").read_text()
    row = f"| {known.name} | {known.included} | {'; '.join(f'`{command}`' for command in known.commands)} |"
    assert row in text.splitlines()


@pytest.mark.parametrize(
    ("system", "machine", "name"),
    [
        ("linux", "x86_64", "Linux x86-64"),
        ("linux", "aarch64", "Linux aarch64"),
        ("darwin", "arm64", "macOS arm64"),
        ("win32", "AMD64", "Windows x86-64"),
    ],
)
def test_a_machine_finds_its_platform(system, machine, name):
    assert find_platform(system, machine).name == name
    assert find_commands(system, machine) == find_platform(system, machine).commands


def test_a_platform_that_is_not_in_the_table_is_led_to_conda():
    assert find_platform("linux", "riscv64") is None
    assert find_commands("linux", "riscv64") == ("conda install -c conda-forge pyopencl pocl",)
