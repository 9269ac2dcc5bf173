"""Every public name is in the reference, and all examples of docstrings are right.

An example brings its own imports: it is read alone, on the site and by `help`.
"""

import doctest
import importlib
import pkgutil
import re
from collections.abc import Iterator

import clbvh

from .snippets import REPOSITORY

INTEGRATIONS = ("clbvh.integrations.trimesh",)
FLAGS = doctest.ELLIPSIS


def find_examples() -> Iterator[doctest.DocTest]:
    """Yield the examples of all docstrings of clbvh."""
    finder = doctest.DocTestFinder()
    modules = [info.name for info in pkgutil.walk_packages(clbvh.__path__, "clbvh.")]
    for name in ["clbvh", *modules]:
        if not name.endswith("__main__"):
            yield from (found for found in finder.find(importlib.import_module(name), globs={}) if found.examples)


def test_public_names_are_in_the_reference():
    pages = "\n".join(page.read_text() for page in (REPOSITORY / "docs" / "reference").glob("*.md"))
    names = {name.rpartition(".")[2] for name in re.findall(r"^::: (\S+)$", pages, re.MULTILINE)}
    assert set(clbvh.__all__) - {"__version__"} <= names
    for path in INTEGRATIONS:
        assert set(importlib.import_module(path).__all__) <= names


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
