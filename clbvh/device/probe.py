"""Touches drivers in a process of its own, so that a crash or a hang of one affects nothing else.

`python -m clbvh.device.probe WHAT` does one thing and writes one JSON object on its standard output; `run_probe` starts
it and reads the answer. WHAT is one of

- ``list``: describe pyopencl and all devices;
- ``try DEVICE``: run kernels on one device, its number or "host", and check the result;
- ``load NAME``: load a driver's library as the loader would, for the linker's message when that fails.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from typing import Any, NamedTuple

from ..errors import ClbvhError

# One more than a power of two: a driver that rounds the range shows itself.
_ITEM_COUNT = 1025
# Step from key to key, coprime to the count: the keys are all numbers below the count, in no order.
_STEP = 512
_KEY_BITS = 11

# A compiler that no longer works must not hide behind kernels that it compiled earlier.
_WITHOUT_CACHES = {"POCL_KERNEL_CACHE": "0", "PYOPENCL_NO_CACHE": "1", "CUDA_CACHE_DISABLE": "1"}


class ProbeResult(NamedTuple):
    """The outcome: the JSON object, the reason of a failure or nothing, and all of standard error."""

    answer: dict[str, Any]
    failure: str
    log: str


def run_probe(*arguments: str, timeout_s: float, environment: Mapping[str, str] | None = None) -> ProbeResult:
    """Run `python -m clbvh.device.probe` with these arguments and more variables, and wait for its answer."""
    try:
        # "-W ignore": a library's warning is not a driver's failure, whatever PYTHONWARNINGS says.
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "-m", __name__, *arguments],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            env={**os.environ, **_WITHOUT_CACHES, **(environment or {})},
            text=True,
            errors="replace",
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return ProbeResult({}, f"did not answer within {timeout_s:g} s", "")
    code = done.returncode
    failure = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}" * bool(code)
    try:
        answer = json.loads(done.stdout)
    except ValueError:
        return ProbeResult({}, failure or "gave no readable answer", done.stderr)
    return ProbeResult(answer, answer.get("error", failure and f"answered, but then {failure}"), done.stderr)


def _list() -> dict[str, Any]:
    from .select import import_pyopencl, survey_devices

    version, survey = import_pyopencl().VERSION_TEXT, survey_devices()
    devices = [device.as_dict() for device in survey.devices]
    return {"pyopencl": version, "devices": devices, "problems": survey.problems}


def _try(device: str) -> dict[str, Any]:
    import numpy as np

    from .open import open_device
    from .radix_sort import sort_pairs

    keys = np.arange(_ITEM_COUNT, dtype=np.uint64) * _STEP % _ITEM_COUNT
    found = np.zeros_like(keys)
    with open_device(device) as session:
        pairs = session.allocate(keys.nbytes)
        session.write(pairs, keys << 32)
        session.download(sort_pairs(session, pairs, _ITEM_COUNT, _KEY_BITS), found)
    wrong_count = int(np.count_nonzero(found >> 32 != np.arange(_ITEM_COUNT)))
    return {"error": f"computed {wrong_count} of {_ITEM_COUNT} numbers wrong"} if wrong_count else {}


def _main(task: str, argument: str = "") -> None:
    # The output of drivers must not end up in the answer.
    answer_file = os.dup(1)
    os.dup2(2, 1)
    try:
        answer = _list() if task == "list" else _try(argument) if task == "try" else {}
        if task == "load":
            ctypes.CDLL(argument)
    except (ClbvhError, OSError) as error:
        # The cause has the loader's own words, without the advice to run the doctor.
        answer = {"error": str(error.__cause__ or error)}
    os.write(answer_file, json.dumps(answer).encode())


if __name__ == "__main__":
    _main(*sys.argv[1:])
