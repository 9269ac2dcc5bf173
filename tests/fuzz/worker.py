"""The process that reads damaged files: `python -m tests.fuzz.worker SEED BEGIN END NAME ...`.

It says on stdout what it is about to read and how that ended, so that whoever started it knows the file that made it
hang or die.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import traceback
import warnings
from pathlib import Path
from random import Random

from clbvh.errors import AppearanceWarning

from .readers import READERS, Reader
from .traps import MEMORY_BYTES, TRAPS


def make_file(reader: Reader, name: str, seed: int, index: int) -> bytes:
    """Return the damaged file of an index; it depends on nothing but the arguments."""
    return reader.make(Random(f"{seed}/{name}/{index}"))


def find_target(name: str) -> Reader:
    """Return a target by its name. Geometry needs a device, which the others' memory should not have to hold."""
    if name == "geometry":
        from .geometry import GEOMETRY

        return GEOMETRY
    return (READERS | TRAPS)[name]


def _say(*words: object) -> None:
    print(*words, flush=True)


def _limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def main(seed: int, begin: int, end: int, names: list[str]) -> None:
    """Read the damaged files `begin` to `end` - 1 of each reader."""
    warnings.simplefilter("error")
    warnings.simplefilter("ignore", AppearanceWarning)  # the rest of the file is read
    targets = {name: find_target(name) for name in names}
    with tempfile.TemporaryDirectory(prefix="clbvh-fuzz-") as name:
        folder = Path(name)
        for reader in names:
            for original in targets[reader].originals:
                assert targets[reader].read(original, folder), f"a valid file of {reader} is refused"
        _limit_memory()
        for index in range(begin, end):
            for reader in names:
                _say("begin", reader, index)
                content = make_file(targets[reader], reader, seed, index)
                try:
                    outcome = "accepted" if targets[reader].read(content, folder) else "refused"
                except Exception as error:
                    place = traceback.extract_tb(error.__traceback__)[-1]
                    reason = " ".join(f"{type(error).__name__}: {error}".split())[:300]
                    outcome = f"failed {reason} ({place.filename}:{place.lineno})"
                _say("end", outcome)
    _say("peak", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:4]), sys.argv[4:])
