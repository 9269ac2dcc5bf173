"""Runs the command as a user does: in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

TIMEOUT_S = 120

_DEVICE_VARIABLES = ("CLBVH_DEVICE", "OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH")

# The installed script does just this.
_SCRIPT = "from clbvh.cli import main; main()"


def run_clbvh(*arguments: object, folder: Path | None = None, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run `clbvh` with these arguments and wait for it.

    Parameters
    ----------
    *arguments
        Words of the command line; paths and numbers are welcome.
    folder : Path, optional
        The working folder.
    **environment
        Variables on top of the test's own, of which those that choose a device or a driver are dropped.
    """
    inherited = {name: value for name, value in os.environ.items() if name not in _DEVICE_VARIABLES}
    return subprocess.run(
        [sys.executable, "-c", _SCRIPT, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        env=inherited | environment,
        cwd=folder,
        check=False,
    )
