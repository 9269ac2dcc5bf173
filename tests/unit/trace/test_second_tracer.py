"""A second tracer of a process finds everything in place: nothing is compiled, no file is opened."""

from __future__ import annotations

import subprocess
import sys

_SCRIPT = """
import os
import sys
import numpy as np
from numba.core.event import install_recorder
import clbvh
from clbvh.device import program

opened, compiled = [], []

def listen(event, arguments):
    # Settings are looked for at each opening, and there are none.
    is_found = event != "open" or os.path.exists(str(arguments[0]))
    if is_second and is_found and event in ("open", "os.listdir", "os.scandir", "subprocess.Popen"):
        opened.append(str(arguments[0]))

def use(bvh):
    rays = np.random.default_rng(0).normal(size=(2, 50, 3))
    with clbvh.Tracer(bvh) as tracer:
        tracer.closest_hit(*rays).locations
        tracer.all_hits(*rays)
        tracer.any_hit(*rays)
        tracer.signed_distance(rays[0])
        tracer.update(bvh.mesh.vertices * 2)
        tracer.closest_hit(*rays)

is_second = False
sys.addaudithook(listen)
# A build asks the system for its memory, so trees are built before.
bvhs = [clbvh.build(clbvh.make_shape("icosphere", triangles=triangles)) for triangles in (80, 320)]
use(bvhs[0])
compile_now = program._compile
program._compile = lambda *given: compiled.append(given[-2]) or compile_now(*given)
is_second = True
with install_recorder("numba:compile") as recorder:
    use(bvhs[1])
is_second = False
print(len(recorder.buffer), compiled, opened)
"""


def test_it_compiles_nothing_and_opens_no_file():
    ran = subprocess.run([sys.executable, "-c", _SCRIPT], capture_output=True, text=True, check=False)
    assert (ran.stdout, ran.stderr) == ("0 [] []\n", "")
