"""A command in a session of its own, with its own folders, so that a test sees all that it leaves behind (Linux).

A moment is counted from the call of `clbvh.cli.main`: before that Python itself is starting.
"""

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from ..cli.command import make_answer, make_environment
from .sessions import list_session, wait_until

TIMEOUT_S = 120

# Python ignores Ctrl-C where the shell that started the tests does, as it does for a job in the background. Workers
# import this file, too. The byte says that `main` begins.
_LAUNCHER = """
if __name__ == "__main__":
    import os, signal, sys
    ignores = sys.argv.pop(1) == "ignore"
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    from clbvh.cli import main
    os.write(int(sys.argv.pop(1)), b".")
    # Not earlier: a signal during the line above would not be one during `main`.
    signal.signal(signal.SIGINT, signal.SIG_IGN if ignores else signal.default_int_handler)
    main()
"""

_SHARED_MEMORY = Path("/dev/shm")

# PoCL leaves files with this name in its cache even when nothing goes wrong.
_DRIVERS_OWN = "tempfile_"

_SCENE = '[[object]]\nshape = "knot"\ntriangles = 20000\n[view]\nup = "y"\nwidth = 64\nheight = 40\n'

Outcome = tuple[int, str, str]


@dataclass
class Place:
    """Folders for the commands of one test."""

    folder: Path
    temporary: Path = field(init=False)
    output: Path = field(init=False)  # where commands run, beside a small scene
    cache: Path = field(init=False)  # the user's

    def __post_init__(self) -> None:
        self.temporary, self.output, self.cache = (self.folder / name for name in ("tmp", "out", "cache"))
        for folder in (self.temporary, self.output, self.cache):
            folder.mkdir(parents=True, exist_ok=True)
        (self.output / "scene.toml").write_text(_SCENE)
        self._launcher = self.folder / "launch.py"
        self._launcher.write_text(_LAUNCHER)
        self._shared_before = set(_SHARED_MEMORY.iterdir())

    def start(
        self, *words: object, environment: dict[str, str] | None = None, ignore_interrupts=False, **options
    ) -> subprocess.Popen[str]:
        """Start a command, and return when `main` begins."""
        interrupts = "ignore" if ignore_interrupts else "take"
        read_end, write_end = os.pipe()
        variables = {"TMPDIR": str(self.temporary), "CLBVH_CACHE": str(self.cache)} | (environment or {})
        process = subprocess.Popen(
            [sys.executable, self._launcher, interrupts, str(write_end), *map(str, words)],
            start_new_session=True,
            pass_fds=[write_end],
            env=make_environment(**variables),
            stdout=options.pop("stdout", subprocess.PIPE),
            stderr=subprocess.PIPE,
            cwd=self.output,
            text=True,
            **options,
        )
        os.close(write_end)
        os.read(read_end, 1)
        os.close(read_end)
        return process

    def finish(self, process: subprocess.Popen[str]) -> Outcome:
        """Wait for a command, and return its exit code, stdout and stderr; kill all of it if that takes too long."""
        try:
            output, errors = process.communicate(timeout=TIMEOUT_S)
        except subprocess.TimeoutExpired:
            for number in list_session(process.pid):
                os.kill(number, signal.SIGKILL)
            process.communicate()
            raise
        # Whether something is compiled depends on the tests before.
        return process.returncode, output or "", make_answer(process.returncode, "", errors).stderr

    def run(self, *words: object, **options) -> Outcome:
        """Run a command to its end."""
        return self.finish(self.start(*words, **options))

    def signal_at(self, moment_s: float, number: signal.Signals, *words: object, **options) -> Outcome:
        """Run a command, and send a signal to all its processes at a moment; it may have ended by then."""
        process = self.start(*words, **options)
        time.sleep(moment_s)
        if process.poll() is None:
            os.killpg(process.pid, number)
        outcome = self.finish(process)
        assert wait_until(lambda: not list_session(process.pid), 10), "processes are left"
        return outcome

    def time(self, *words: object) -> float:
        """Return the seconds that a command takes from the call of `main` on."""
        process = self.start(*words)
        begin = time.perf_counter()
        code, _, errors = self.finish(process)
        assert code == 0, errors
        return time.perf_counter() - begin

    def leftovers(self) -> list[str]:
        """Return the names of all that should not be there: temporary files, shared memory, unfinished files."""
        unfinished = [path for path in self.cache.rglob("*") if ".tmp" in path.name and _DRIVERS_OWN not in path.name]
        unfinished += [path for path in self.output.iterdir() if path.name.startswith(".") or path.stat().st_size == 0]
        shared = [path for path in _SHARED_MEMORY.iterdir() if path not in self._shared_before and "clbvh" in path.name]
        return [str(path) for path in [*self.temporary.iterdir(), *unfinished, *shared]]
