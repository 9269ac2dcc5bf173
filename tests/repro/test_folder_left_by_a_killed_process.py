"""A coordinator that was killed left the folder of its fork server's socket among the temporary files."""

from __future__ import annotations

import os
import subprocess
import sys
import time

PATIENCE_S = 10

SCRIPT = """
import time, clbvh
with clbvh.SubtreePool(workers={workers}) as pool:
    pool.wait_ready()
    print("ready", flush=True)
    time.sleep(60)
"""


def test_the_workers_remove_it(short_path):
    for workers in (1, 2):
        with subprocess.Popen(
            [sys.executable, "-c", SCRIPT.format(workers=workers)],
            stdout=subprocess.PIPE,
            env={**os.environ, "TMPDIR": str(short_path)},
        ) as process:
            assert process.stdout.readline() == b"ready\n"
            assert list(short_path.iterdir())
            process.kill()
        deadline = time.monotonic() + PATIENCE_S
        while list(short_path.iterdir()) and time.monotonic() < deadline:
            time.sleep(0.02)
        assert list(short_path.iterdir()) == []
