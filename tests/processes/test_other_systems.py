"""clbvh on a system without fork, /proc and POSIX's modules, as Windows and macOS are: simulated on this one.

Python's own modules and the libraries are imported first: they are those of this system.
"""

import subprocess
import sys

import pytest

TIMEOUT_S = 300

WITHOUT = """
import asyncio, ctypes, multiprocessing.connection, multiprocessing.resource_tracker, importlib, os, pkgutil, resource
import shutil, signal, subprocess, sys, tempfile
import cyclopts, imageio.v3, numpy, platformdirs, pooch, psutil, pyopencl, rich.progress, trimesh

for module in {modules!r}:
    sys.modules[module] = None
for owner, names in ((os, {os_names!r}), (signal, {signal_names!r})):
    for name in names:
        if hasattr(owner, name):
            delattr(owner, name)
"""

WINDOWS = {
    "modules": ["fcntl", "resource", "pwd", "grp", "termios", "pty", "syslog", "posix"],
    "os_names": [
        "fork", "register_at_fork", "getuid", "geteuid", "getgid", "sched_getaffinity", "posix_fallocate", "sysconf",
        "mkfifo", "memfd_create", "killpg", "getpgid", "setsid", "statvfs", "O_NOFOLLOW", "O_NONBLOCK", "O_DIRECTORY",
        "O_CLOEXEC", "pread", "preadv", "waitid", "WNOHANG", "fchmod", "chown", "getloadavg", "nice", "set_blocking",
    ],
    "signal_names": [
        "SIGHUP", "SIGKILL", "SIGUSR1", "SIGALRM", "pthread_sigmask", "setitimer", "sigwait", "siginterrupt",
    ],
}  # fmt: skip
MACOS = {
    "modules": [],
    "os_names": ["sched_getaffinity", "posix_fallocate", "memfd_create"],
    "signal_names": ["sigtimedwait"],
}

IMPORT_ALL = """
import clbvh
names = [module.name for module in pkgutil.walk_packages(clbvh.__path__, "clbvh.")]
for name in names:
    importlib.import_module(name)
print(len(names))
"""

USE = """
import pathlib
from clbvh.builders.processes import shared_memory
from clbvh.support import memory
memory._PROC = pathlib.Path("no such folder")
assert not shared_memory._HAS_ANONYMOUS_FILES
mesh = clbvh.make_shape("icosphere", triangles=80)
bvh = clbvh.build(mesh)
with clbvh.Tracer(bvh) as tracer:
    hits = tracer.closest_hit([[0.0, 0.0, 5.0]], [[0.0, 0.0, -1.0]])
assert hits.t[0] < 5, hits.t
from clbvh.cli.app import run
try:
    run(["render", "demo", "-o", "out.ppm", "--workers", "1", "--width", "32", "--height", "18"])
except SystemExit as ended:
    assert not ended.code, ended.code
"""


def run_without(missing, code, folder):
    process = subprocess.run(
        [sys.executable, "-c", WITHOUT.format(**missing) + code],
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        cwd=folder,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    return process.stdout


@pytest.mark.parametrize("missing", [WINDOWS, MACOS], ids=["windows", "macos"])
def test_every_module_can_be_imported_and_one_process_builds_casts_and_renders(missing, tmp_path):
    assert int(run_without(missing, IMPORT_ALL + USE, tmp_path).split()[0]) > 100
    assert (tmp_path / "out.ppm").read_bytes().startswith(b"P6")
