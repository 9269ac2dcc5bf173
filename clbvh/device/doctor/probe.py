"""Touches drivers in a process of its own, so that a crash or a hang of one affects nothing else.

`python -m clbvh.device.doctor.probe WHAT` does one thing and writes one JSON object on its standard output.
`run_probe` starts it and reads the answer; the calling process never loads OpenCL itself. WHAT is one of

- ``list``: describe pyopencl, its loader and all platforms;
- ``try NUMBER``: compile and run a small kernel on one device of that list, and check the result;
- ``load NAME``: load a driver's library as the loader would.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import DeviceError

# One more than a power of two: a driver that rounds the range shows itself.
_ITEM_COUNT = 1025

# Exact in float32, so that the result can be compared bit by bit.
_KERNEL = """
__kernel void double_and_add(__global const float *restrict source, __global float *restrict target)
{
    const size_t i = get_global_id(0);
    target[i] = 2.0f * source[i] + (float)i;
}
"""

# A compiler that no longer works must not hide behind kernels that it compiled earlier.
_WITHOUT_CACHES = {"POCL_KERNEL_CACHE": "0", "PYOPENCL_NO_CACHE": "1", "CUDA_CACHE_DISABLE": "1"}

# Time limit for a killed probe to end; one that hangs in the operating system never does.
_KILL_TIMEOUT_S = 5


@dataclass(frozen=True)
class ProbeResult:
    """The outcome of a probe.

    Attributes
    ----------
    answer : dict
        The JSON object; empty if there is none.
    failure : str
        The reason of a failure; empty without one.
    log : str
        The output of the probe and of the drivers on standard error.
    wall_s : float
        Duration of the process.
    """

    answer: dict[str, Any]
    failure: str
    log: str
    wall_s: float


def run_probe(*arguments: str, timeout_s: float, environment: Mapping[str, str] | None = None) -> ProbeResult:
    """Run `python -m clbvh.device.doctor.probe` with these arguments and more variables, and wait for its answer."""
    started = time.perf_counter()
    # "-W ignore": a library's warning is not a driver's failure, whatever PYTHONWARNINGS says.
    process = subprocess.Popen(
        [sys.executable, "-W", "ignore", "-m", __name__, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, **_WITHOUT_CACHES, **(environment or {})},
        text=True,
        errors="replace",
    )
    # No `with`, whose end would wait for the process: one that hangs in the operating system cannot be killed.
    try:
        output, log = process.communicate(timeout=timeout_s)
        failure = _explain_exit(process.returncode)
    except subprocess.TimeoutExpired:
        output, log = _kill(process)
        failure = f"did not answer within {timeout_s:g} s"
    except BaseException:
        process.kill()
        raise
    wall_s = time.perf_counter() - started

    try:
        answer = json.loads(output)
    except ValueError:
        return ProbeResult({}, failure or "gave no readable answer", log, wall_s)
    if failure and "error" not in answer:
        failure = f"answered, but then {failure}"
    return ProbeResult(answer, answer.get("error", failure), log, wall_s)


def _kill(process: subprocess.Popen[str]) -> tuple[str, str]:
    process.kill()
    try:
        return process.communicate(timeout=_KILL_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        return "", ""


def _explain_exit(code: int) -> str:
    if code == 0:
        return ""
    if code > 0:
        return f"ended with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    return f"was killed by {name}"


def _list() -> dict[str, Any]:
    """Describe pyopencl, the loader and the devices."""
    from ..select import import_pyopencl, survey_devices

    cl = import_pyopencl()
    survey = survey_devices()
    return {
        "pyopencl": cl.VERSION_TEXT,
        "loader": _find_loaded_loader(),
        "devices": [device.as_dict() for device in survey.devices],
        "problems": list(survey.problems),
    }


def _find_loaded_loader() -> str:
    """Return the path of the libOpenCL in this process; empty if the system does not tell."""
    try:
        maps = Path("/proc/self/maps").read_text()
    except OSError:
        return ""
    paths = (line.split(maxsplit=5)[-1] for line in maps.splitlines())
    return next((path for path in paths if Path(path).name.startswith("libOpenCL")), "")


def _try(number: int) -> dict[str, Any]:
    """Compile and run a small kernel on one device."""
    import numpy as np

    from ..match import pick_device
    from ..pocl_linker import explain_missing_linker
    from ..select import import_pyopencl, survey_devices

    cl = import_pyopencl()
    device = pick_device(survey_devices().devices, number)
    if reason := explain_missing_linker(device.driver_version):
        return {"device": str(device), "error": reason}
    try:
        context = cl.Context([device.cl_device])
        queue = cl.CommandQueue(context)
        program = cl.Program(context, _KERNEL).build()

        source = np.arange(_ITEM_COUNT, dtype=np.float32)
        target = np.full(_ITEM_COUNT, np.nan, dtype=np.float32)
        flags = cl.mem_flags
        source_buffer = cl.Buffer(context, flags.READ_ONLY | flags.COPY_HOST_PTR, hostbuf=source)
        target_buffer = cl.Buffer(context, flags.READ_WRITE | flags.COPY_HOST_PTR, hostbuf=target)
        program.double_and_add(queue, (_ITEM_COUNT,), None, source_buffer, target_buffer)
        cl.enqueue_copy(queue, target, target_buffer)
        queue.finish()
    except cl.Error as error:
        return {"device": str(device), "error": str(error)}

    wrong_count = int(np.count_nonzero(target != np.float32(3) * source))
    if wrong_count:
        return {"device": str(device), "error": f"computed {wrong_count} of {_ITEM_COUNT} numbers wrong"}
    return {"device": str(device)}


def _load(name: str) -> dict[str, Any]:
    """Load a library, for the linker's message when that fails."""
    import ctypes

    try:
        ctypes.CDLL(name)
    except OSError as error:
        return {"error": str(error)}
    return {}


def _main(arguments: list[str]) -> None:
    # The output of drivers must not end up in the answer.
    answer_file = os.dup(1)
    os.dup2(2, 1)
    try:
        if arguments == ["list"]:
            answer = _list()
        elif len(arguments) == 2 and arguments[0] == "try":
            answer = _try(int(arguments[1]))
        elif len(arguments) == 2 and arguments[0] == "load":
            answer = _load(arguments[1])
        else:
            sys.exit("usage: python -m clbvh.device.doctor.probe list | try NUMBER | load NAME")
    except DeviceError as error:
        # The cause has the loader's own words, without the advice to run the doctor.
        answer = {"error": str(error.__cause__ or error)}
    os.write(answer_file, json.dumps(answer).encode())


if __name__ == "__main__":
    _main(sys.argv[1:])
