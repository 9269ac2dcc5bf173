"""Machine code is never older than any source it was made from; only compiled functions lack annotations."""

import ast
import json
import math
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
from clbvh.support import compiled as home
from clbvh.support.compiled import INTERPRETED_ROOMS
from clbvh.support.loop_functions import exponent_of, power_of_two, times_power_of_two

PACKAGE = Path(clbvh.__file__).parent
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


def list_plain_functions(tree):
    """Yield the functions that are not compiled, nor defined inside of compiled ones."""
    for node in ast.iter_child_nodes(tree):
        decorators = ast.unparse(node.decorator_list) if isinstance(node, ast.FunctionDef) else ""
        if not re.match(r"(compiled|intrinsic|overload|instruction)\b", decorators):
            if isinstance(node, ast.FunctionDef):
                yield node
            yield from list_plain_functions(node)


def test_functions_that_are_not_compiled_are_annotated():
    for path in PACKAGE.rglob("*.py"):
        for function in list_plain_functions(ast.parse(path.read_text())):
            arguments = function.args.posonlyargs + function.args.args + function.args.kwonlyargs
            bare = [one.arg for one in arguments if one.annotation is None and one.arg not in ("self", "cls")]
            # A progress bar's duck type.
            if path.name != "fetch.py":
                assert (bare, function.returns is None) == ([], False), f"{path}:{function.lineno}"


def test_rooms_outside_the_digest_compile_nothing():
    for room in INTERPRETED_ROOMS:
        for path in (PACKAGE / room).rglob("*.py"):
            # The study names numba among the versions of a machine.
            assert re.search(r"(import|from) numba|support\.compiled", path.read_text()) is None, path


def run_alone(folder, code):
    """What a process prints, as JSON, that has nothing but a folder and the package."""
    environment = {"PATH": "", "PYTHONPATH": f"{folder}:{PACKAGE.parent}", "HOME": str(folder)}
    environment |= {"PYTHONDONTWRITEBYTECODE": "1", "CLBVH_CACHE": str(folder / "cache")}
    process = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, check=True)
    return json.loads(process.stdout)


def test_an_edit_of_an_imported_compiled_file_is_seen(tmp_path):
    """What numba alone gets wrong: the caller's own file is the same."""
    folder = tmp_path / "doubling"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "quadruple.py").write_text(QUADRUPLE)
    answers = []
    for factor in (2, 2, 5):
        (folder / "twice.py").write_text(TWICE.format(factor=factor))
        answers.append(run_alone(tmp_path, "import doubling.quadruple"))
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
versions = {name: [len(one.signatures), len(one.calls.part.signatures)] for name, one in ours.items()}
print(json.dumps([len(ours["add_numbers"].stats.cache_misses), versions]))
"""


def test_numbers_in_calls_make_no_versions_and_a_second_process_loads(tmp_path):
    (tmp_path / "counting.py").write_text(COUNTING)
    assert run_alone(tmp_path, "import counting") == [1, {"add": [0, 1], "add_numbers": [1, 0]}]
    assert run_alone(tmp_path, "import counting") == [0, {"add": [0, 0], "add_numbers": [1, 0]}]
    # What only compiled functions call has no file.
    assert len(list(tmp_path.rglob("*.nbc"))) == 1


def test_python_and_compiled_functions_call_the_same_function():
    @home.compiled
    def half(x):
        return 1.0 / x if x != 2 else raises()

    @home.compiled
    def raises():
        raise ValueError("two")

    @home.compiled
    def two_halves(x):
        return half(x) + half(3)

    assert two_halves(4) == 1 / 4 + 1 / 3
    assert half(4) == 1 / 4  # after a part was made of it
    assert half(4.0) == 1 / 4
    assert two_halves(4.0) == 1 / 4 + 1 / 3  # after it was compiled for Python
    for function in (half, two_halves):
        with pytest.raises(ValueError, match="two"):
            function(2)
        with pytest.raises(ZeroDivisionError):
            function(0)


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


VALUES = [1.0, 1.5, 2.0, 3.999, 0.1, 1e300, 1e-300, np.finfo(float).max, np.finfo(float).tiny, 1e-310, 5e-324]


def test_powers_of_two_are_those_of_the_library():
    for value in VALUES:
        assert exponent_of(-value) == exponent_of(value) == math.frexp(value)[1] - 1
        # Scaled by its own exponent, every number is from 1 to 2.
        assert 1 <= times_power_of_two(value, -exponent_of(value)) < 2
    assert exponent_of(0.0) == -1
    for exponent in (-1022, -1, 0, 1, 52, 1023):
        assert power_of_two(exponent) == math.ldexp(1.0, exponent)
    # A product is rounded once, and may be beyond normal powers.
    for exponent in (-1100, -1074, -1023, -1022, 0, 1023):
        for value in (1.0, 1.7, -1.25, 0.0):
            assert times_power_of_two(value, exponent) == math.ldexp(value, exponent)
    assert times_power_of_two(5e-324, 1074) == 1.0
    assert times_power_of_two(2.0**-1000, 2000) == 2.0**1000
