"""A run of the fuzz: starts workers, notices files that fail, hang or kill, and goes on behind them."""

import os
import select
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]

# Seconds in which a worker must say something: it imports and compiles before the first file, and reads one file, of at
# most 64 KiB, in about a millisecond. Far above both, so that a busy machine is no failure.
START_LIMIT_S = 300
FILE_LIMIT_S = 60


@dataclass(frozen=True)
class Failure:
    """A file that a reader neither accepted nor refused."""

    reader: str
    index: int
    reason: str


@dataclass
class Outcome:
    """The results of a run: how often each reader accepted and refused, and all failures."""

    counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    failures: list[Failure] = field(default_factory=list)
    peak_kib: int = 0


def fuzz(seed, count, readers, file_limit_s=FILE_LIMIT_S, outcome=None):
    """Let each reader read `count` damaged files, which follow from the seed one by one, whatever `count` is.

    The results are added to those in `outcome`.
    """
    outcome = outcome or Outcome()
    begin = 0
    while begin < count:
        begin = _run_worker(seed, begin, count, readers, outcome, file_limit_s)
    return outcome


def _run_worker(seed, begin, end, readers, outcome, file_limit_s):
    """Run a worker until it ends; return the index from which the next one goes on."""
    command = [sys.executable, "-m", "tests.fuzz.worker", *map(str, (seed, begin, end)), *readers]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(_ROOT), os.environ.get("PYTHONPATH", "")])}
    current = None
    with subprocess.Popen(command, cwd=_ROOT, stdout=subprocess.PIPE, env=environment) as process:
        try:
            for line in _read_lines(process, file_limit_s):
                match line.split():
                    case ["begin", reader, index]:
                        current = reader, int(index)
                    case ["end", word, *reason] if current:
                        outcome.counts[current[0], word] += 1
                        if word == "failed":
                            outcome.failures.append(Failure(*current, " ".join(reason)))
                    case ["peak", kib]:
                        outcome.peak_kib = max(outcome.peak_kib, int(kib))
                        return end
            code = process.poll()
        finally:
            process.kill()
    if current is None:
        raise RuntimeError(f"the worker of the fuzz ended with {code} before it read a file")
    reason = f"took longer than {file_limit_s} s" if code is None else f"the process ended with {code}"
    outcome.counts[current[0], "failed"] += 1
    outcome.failures.append(Failure(*current, reason))
    return current[1] + 1


def _read_lines(process, file_limit_s):
    """Yield the lines of a worker, until it ends or says nothing for too long."""
    descriptor, rest, limit_s = process.stdout.fileno(), b"", START_LIMIT_S
    while select.select([descriptor], [], [], limit_s)[0]:
        limit_s = file_limit_s
        data = os.read(descriptor, 1 << 16)
        if not data:
            process.wait()
            return
        *lines, rest = (rest + data).split(b"\n")
        yield from (line.decode(errors="replace") for line in lines)
