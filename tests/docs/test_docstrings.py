"""Every public name has an example, and all examples of docstrings are right.

An example brings its own imports: it is read alone, on the site and by `help`.
"""

from __future__ import annotations

import doctest
import importlib
import importlib.util
import inspect
import pkgutil
import re
from collections.abc import Iterator

import clbvh

from .public_names import INTEGRATIONS, list_public_names
from .snippets import REPOSITORY

# Closing needs no example.
WITHOUT_EXAMPLE = {name for name in list_public_names() if name.endswith(".close")}

FLAGS = doctest.ELLIPSIS


def find_examples() -> Iterator[doctest.DocTest]:
    """Yield the examples of all docstrings of clbvh."""
    finder = doctest.DocTestFinder()
    modules = [info.name for info in pkgutil.walk_packages(clbvh.__path__, "clbvh.")]
    for name in ["clbvh", *modules]:
        if not name.endswith("__main__"):
            yield from (found for found in finder.find(importlib.import_module(name), globs={}) if found.examples)


def test_public_names_have_an_example():
    names = list_public_names()
    without = {name for name, value in names.items() if ">>> " not in (inspect.getdoc(value) or "")}
    assert without <= WITHOUT_EXAMPLE


def test_no_module_has_a_public_name():
    """Its import would replace the name."""
    assert [name for name in clbvh.__all__ if importlib.util.find_spec(f"clbvh.{name}")] == []


def test_public_names_are_in_the_reference():
    pages = "\n".join(page.read_text() for page in (REPOSITORY / "docs" / "reference").glob("*.md"))
    names = {name.rpartition(".")[2] for name in re.findall(r"^::: (\S+)$", pages, re.MULTILINE)}
    assert set(clbvh.__all__) - {"__version__"} <= names
    for path in INTEGRATIONS:
        assert set(importlib.import_module(path).__all__) <= names


def test_members_that_the_reference_lists_are_all_there_are():
    for page in (REPOSITORY / "docs" / "reference").glob("*.md"):
        for name, listed in re.findall(
            r"^::: (clbvh\.\w+)\n(?: +.*\n)*? +members: \[([^]]*)\]", page.read_text(), re.M
        ):
            owner = getattr(clbvh, name.partition(".")[2])
            attributes = {member for member in dir(owner) if inspect.isdatadescriptor(getattr(owner, member, None))}
            methods = {known.rpartition(".")[2] for known in list_public_names() if known.startswith(f"{name}.")}
            public = methods | {member for member in attributes if not member.startswith("_")}
            assert set(re.split(r",\s+", listed)) == public, name


def test_examples_are_right(session, tmp_path, monkeypatch):
    report: list[str] = []
    runner = doctest.DocTestRunner(verbose=False, optionflags=FLAGS)
    for example in find_examples():
        folder = tmp_path / example.name
        folder.mkdir(exist_ok=True)
        monkeypatch.chdir(folder)
        runner.run(example, out=report.append)
    assert runner.tries > 100
    assert runner.failures == 0, "".join(report)
