"""A script without a guard went unnoticed when its mesh was too small for the workers: they died without a word."""

from __future__ import annotations

import subprocess
import sys

import pytest

SCRIPT = """
import clbvh
with clbvh.SubtreePool(workers={workers}) as pool:
    mesh = clbvh.Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    print(clbvh.build(mesh, pool=pool).node_count)
{end}
"""


def run_unguarded(folder, end, workers=1):
    script = folder / "unguarded.py"
    script.write_text(SCRIPT.format(end=end, workers=workers))
    return subprocess.run([sys.executable, script], capture_output=True, text=True, check=False, timeout=30)


@pytest.mark.parametrize("workers", [1, 2])
def test_the_script_is_told(tmp_path, workers):
    run = run_unguarded(tmp_path, "", workers)
    assert run.returncode == 1
    assert run.stderr.count('if __name__ == "__main__":') == 1
    assert run.stderr.count("Traceback") == 1


def test_an_error_of_the_scripts_own_is_not_covered_up(tmp_path):
    run = run_unguarded(tmp_path, "    raise SystemExit(7)")
    assert run.returncode == 7
