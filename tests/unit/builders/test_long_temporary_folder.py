"""A folder for temporary files whose name leaves no room for that of a socket."""

from __future__ import annotations

import os
import subprocess
import sys

SCRIPT = """
import clbvh
mesh = clbvh.make_shape("icosphere", triangles=80)
with clbvh.SubtreePool(1) as pool:
    print(clbvh.build(mesh, pool=pool, task_threshold=10).node_count > 1)
"""


def test_workers_start(tmp_path):
    folder = tmp_path / ("long" * 30)
    folder.mkdir()
    environment = {**os.environ, "TMPDIR": str(folder)}
    ran = subprocess.run([sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True)
    assert (ran.stdout, ran.stderr) == ("True\n", "")
    assert list(folder.iterdir()) == []
