"""The collector of cycles in a command: few looks at old objects, none at imported ones, young garbage as ever."""

from __future__ import annotations

import subprocess
import sys

SCRIPT = """
import gc
from clbvh.cli.garbage import collect_rarely, uncollected

before = gc.get_threshold()
collect_rarely()
after = gc.get_threshold()
print(after[:2] == before[:2], after[2] > before[2] or sys.version_info >= (3, 14))

class Cycle:
    def __init__(self):
        self.me = self
    def __del__(self):
        collected.append(1)

def make_cycles():
    for _ in range(20 * before[0]):
        Cycle()
    return len(collected) > 0

collected = []
frozen = gc.get_freeze_count()
try:
    with uncollected():
        print("inside", make_cycles())
        raise ImportError
except ImportError:
    print("frozen", gc.get_freeze_count() - frozen > 20 * before[0])
print("after", make_cycles())
"""


def test_imported_objects_are_left_alone_and_young_garbage_is_not():
    process = subprocess.run(
        [sys.executable, "-c", f"import sys\n{SCRIPT}"], capture_output=True, text=True, check=True
    )
    assert process.stdout.splitlines() == ["True True", "inside False", "frozen True", "after True"]
    assert process.stderr == ""
