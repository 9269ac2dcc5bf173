"""The targets that the library is compiled for, and what the build hook makes of them."""

import importlib.util
import sys
from pathlib import Path

import pytest
from packaging.tags import parse_tag

from clbvh import ConfigError
from clbvh.device.host import compile
from clbvh.device.host.targets import TARGETS, find_machine, find_target

REPOSITORY = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def hook_class():
    spec = importlib.util.spec_from_file_location("hatch_build", REPOSITORY / "hatch_build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.CustomBuildHook


@pytest.fixture
def run_hook(hook_class, tmp_path, monkeypatch):
    """Run the hook with a compiler that writes what it was asked for; return that and the build's data."""
    asked = []
    monkeypatch.setattr(
        compile, "build_library", lambda path, _, levels=(), target=None: asked.append((path, levels, target))
    )

    def run(name):
        if name is None:
            monkeypatch.delenv("CLBVH_HOST_TARGET", raising=False)
        else:
            monkeypatch.setenv("CLBVH_HOST_TARGET", name)
        data = {"artifacts": [], "force_include": {}}
        hook = hook_class(str(tmp_path), {}, None, None, str(tmp_path), "wheel")
        hook.initialize("standard", data)
        return asked.pop(), data

    return run


def test_names_tags_and_files_of_targets_differ_where_they_must():
    assert len({target.name for target in TARGETS}) == len(TARGETS)
    tags = [set(parse_tag(f"py3-none-{target.tag}")) for target in TARGETS]
    assert sum(map(len, tags)) == len(set().union(*tags)) == len(TARGETS) + 2
    assert len({(target.system, target.library_name) for target in TARGETS}) == len(TARGETS)


@pytest.mark.parametrize(
    ("system", "machine", "name"),
    [
        ("linux", "x86_64", "linux-x86_64"),
        ("linux", "aarch64", "linux-aarch64"),
        ("darwin", "arm64", "macos-arm64"),
        ("win32", "AMD64", "windows-x86_64"),
        ("linux", "riscv64", None),
    ],
)
def test_a_machine_finds_its_target_by_what_python_says_of_it(monkeypatch, system, machine, name):
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr("platform.machine", lambda: machine)
    found = find_target()
    assert (found and found.name) == name


def test_an_unknown_target_is_refused_with_the_known_ones():
    with pytest.raises(ConfigError, match="there is no target beos, but linux-x86_64, "):
        find_target("beos")


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_a_wheel_of_a_target_has_all_levels_and_its_tags(run_hook, tmp_path, target):
    (path, levels, asked), data = run_hook(target.name)
    assert (tuple(levels), asked) == ((), target)
    assert data["tag"] == f"py3-none-{target.tag}"
    assert data["pure_python"] is False
    # The package in the checkout keeps its own library.
    assert not path.is_relative_to(tmp_path / "clbvh")
    assert data["force_include"] == {str(path): f"clbvh/compiled/{target.library_name}"}
    assert data["artifacts"] == []


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere nothing is compiled from source")
def test_a_wheel_without_a_target_is_for_this_machine_alone(run_hook, tmp_path):
    (path, levels, asked), data = run_hook(None)
    assert (path, levels, asked) == (
        tmp_path / "clbvh/compiled" / find_target().library_name,
        [compile.find_level()],
        None,
    )
    assert data["tag"] == f"py3-none-linux_{find_machine()}"
    assert data["artifacts"] == [f"/clbvh/compiled/{path.name}"]
    assert run_hook("own")[0][2] == find_target()
