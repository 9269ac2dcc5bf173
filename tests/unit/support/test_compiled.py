"""Machine code is never older than any source it was made from, and only compiled functions lack annotations."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import clbvh
from clbvh.bvh.bvh import find_depths
from clbvh.support import compiled as home
from clbvh.support.compiled import INTERPRETED_ROOMS, digest_sources, find_compiled_cache

PACKAGE = Path(clbvh.__file__).parent
SOURCES = sorted(path.relative_to(PACKAGE) for path in PACKAGE.rglob("*.py"))

# Decorators of functions whose types numba infers.
COMPILING = {"compiled", "intrinsic", "overload", "instruction"}

# A package whose function `twice` is compiled into `quadruple`, which stands in another file.
TWICE = "from clbvh.support.compiled import compiled\n\n\n@compiled\ndef twice(x):\n    return {factor} * x\n"
QUADRUPLE = """
from clbvh.support import compiled as home
home._PACKAGE = __import__("pathlib").Path(__file__).parent
from clbvh.support.compiled import compiled
from doubling.twice import twice

@compiled
def quadruple(x):
    return twice(twice(x))

print(quadruple(3))
"""


def decorators_of(function):
    nodes = (node.func if isinstance(node, ast.Call) else node for node in function.decorator_list)
    return {node.id for node in nodes if isinstance(node, ast.Name)}


def functions_of(tree, *, inside_compiled=False):
    """Yield the functions that are not compiled, nor defined inside compiled ones."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef):
            is_compiled = inside_compiled or bool(decorators_of(node) & COMPILING)
            if not is_compiled:
                yield node
            yield from functions_of(node, inside_compiled=is_compiled)
        else:
            yield from functions_of(node, inside_compiled=inside_compiled)


def test_functions_that_are_not_compiled_are_annotated():
    bare = []
    for name in SOURCES:
        for function in functions_of(ast.parse((PACKAGE / name).read_text())):
            arguments = function.args.posonlyargs + function.args.args + function.args.kwonlyargs
            named = [one for one in arguments if one.arg not in ("self", "cls")]
            if name.as_posix() == "cli/fetch.py":  # a progress bar's duck type
                continue
            if function.returns is None or any(one.annotation is None for one in named):
                bare.append(f"{name}:{function.lineno} {function.name}")
    assert not bare


@pytest.mark.parametrize("room", INTERPRETED_ROOMS)
def test_rooms_outside_the_digest_compile_nothing(room):
    for path in (PACKAGE / room).rglob("*.py"):
        # The study names numba among the versions of a machine.
        assert re.search(r"(import|from) numba|support\.compiled", path.read_text()) is None


def test_any_change_of_a_source_is_another_digest(tmp_path):
    (tmp_path / "cli").mkdir()
    (tmp_path / "one.py").write_text("a = 1\n")
    (tmp_path / "cli" / "two.py").write_text("b = 1\n")
    digests = [digest_sources(tmp_path)]
    (tmp_path / "one.py").write_text("a = 2\n")
    digests.append(digest_sources(tmp_path))
    (tmp_path / "one.py").rename(tmp_path / "other.py")
    digests.append(digest_sources(tmp_path))
    assert len(set(digests)) == 3
    (tmp_path / "cli" / "two.py").write_text("b = 2\n")
    assert digest_sources(tmp_path) == digests[-1]


def test_an_edit_of_an_imported_compiled_file_is_seen(tmp_path):
    """What numba alone gets wrong: the caller's own file is the same."""
    folder = tmp_path / "doubling"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "quadruple.py").write_text(QUADRUPLE)
    answers = []
    for factor in (2, 2, 5):
        (folder / "twice.py").write_text(TWICE.format(factor=factor))
        command = [sys.executable, "-c", "import doubling.quadruple"]
        path = f"{tmp_path}:{PACKAGE.parent}"
        environment = {
            "PATH": "",
            "PYTHONPATH": path,
            "PYTHONDONTWRITEBYTECODE": "1",
            "CLBVH_CACHE": str(tmp_path / "cache"),
            "HOME": str(tmp_path),
        }
        answers.append(int(subprocess.run(command, env=environment, capture_output=True, check=True).stdout))
    assert answers == [12, 12, 75]


COUNTING = """
import json
from clbvh.support.compiled import _dispatchers, compiled

@compiled
def add(a, b):
    return a + b

@compiled
def add_numbers(a):
    return add(a, 1) + add(a, 2) + add(3, a)

assert add_numbers(5) == 21
ours = {one.__name__: one for one in _dispatchers.values()}
versions = {name: len(one.signatures) for name, one in ours.items()}
print(json.dumps([len(ours["add_numbers"].stats.cache_misses), versions]))
"""


def test_numbers_in_calls_make_no_versions_and_a_second_process_loads(tmp_path):
    (tmp_path / "counting.py").write_text(COUNTING)
    environment = {"PATH": "", "PYTHONPATH": f"{tmp_path}:{PACKAGE.parent}", "HOME": str(tmp_path)}
    answers = []
    for _ in range(2):
        command = [sys.executable, "-c", "import counting"]
        output = subprocess.run(command, env=environment, capture_output=True, check=True).stdout
        answers.append(json.loads(output))
    cold, warm = answers
    assert cold == [1, {"add": 1, "add_numbers": 1}]
    assert warm == [0, {"add": 0, "add_numbers": 1}]


def test_the_folder_is_in_use():
    assert find_depths(np.array([1, 0, 1]), np.array([0, 1, 1])).tolist() == [0, 1, 1]
    assert any(find_compiled_cache().rglob("bvh.find_depths-*.nbc"))


def test_modules_that_are_imported_at_once_leave_numba_as_it_was(monkeypatch):
    """Each thread saves the setting, changes it and restores it."""
    before = home._settings.CACHE_DIR

    def open_slowly(function):
        time.sleep(0.02)

    monkeypatch.setattr(home, "_njit", lambda **options: lambda function: SimpleNamespace(get_call_template=None))
    monkeypatch.setattr(home, "_MachineCodeCache", open_slowly)
    monkeypatch.setattr(home, "_dispatchers", {})
    threads = [threading.Thread(target=home.compiled, args=(abs,)) for _ in range(4)]
    for delay, thread in enumerate(threads):
        thread.start()
        time.sleep(0.005 * delay)
    for thread in threads:
        thread.join()
    assert before == home._settings.CACHE_DIR
