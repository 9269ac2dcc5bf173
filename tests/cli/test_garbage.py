"""The collector of cycles in a command: fewer looks at old objects, none at the end, and young garbage as ever."""

from __future__ import annotations

import subprocess
import sys

# Functions at exit run in the reverse order: the first one sees what the collector is left with.
SCRIPT = """
import atexit, gc
from clbvh.cli.garbage import collect_rarely

before = gc.get_threshold()
atexit.register(lambda: print("last", gc.get_freeze_count() > 1000))
collect_rarely()
atexit.register(lambda: print("first", gc.get_freeze_count()))
after = gc.get_threshold()
print(after[:2] == before[:2], after[2] > before[2] or sys.version_info >= (3, 14))

class Cycle:
    def __init__(self):
        self.me = self
    def __del__(self):
        collected.append(1)

collected = []
for _ in range(20 * before[0]):
    Cycle()
print(len(collected) > 0)
"""


def test_old_objects_are_left_alone_and_young_garbage_is_not():
    process = subprocess.run(
        [sys.executable, "-c", f"import sys\n{SCRIPT}"], capture_output=True, text=True, check=True
    )
    assert process.stdout.splitlines() == ["True True", "True", "first 0", "last True"]
    assert process.stderr == ""
