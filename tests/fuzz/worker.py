"""The process that reads damaged files: `python -m tests.fuzz.worker SEED BEGIN END NAME ...`.

It says on stdout what it is about to read and how that ended, so that whoever started it knows the file that made it
hang or die. Some targets, for the tests of the fuzz itself, fail in every way that it must notice.
"""

import os
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from random import Random

from clbvh import AppearanceWarning, DeviceError, MeshError

from .readers import READERS, Reader, accepts

MEMORY_BYTES = 512 << 20  # that a worker may take beyond what it has after every reader has read its valid files


def _run_out_of_memory():
    try:
        bytearray(2 * MEMORY_BYTES)
    except MemoryError as error:
        raise MeshError("there is not enough memory") from error


def _blame_the_machine():
    raise DeviceError("this is no fault of the file")


def _make_trap(read: Callable[[], object]) -> Reader:
    return Reader([], lambda generator: generator.randbytes(1), lambda *_: accepts(read))


_TRAPS = {
    "raises": _make_trap(lambda: [][0]),
    "warns": _make_trap(lambda: warnings.warn("a value is odd", RuntimeWarning, stacklevel=2)),
    "grows": _make_trap(_run_out_of_memory),
    "blames": _make_trap(_blame_the_machine),
    "dies": _make_trap(lambda: os.kill(os.getpid(), signal.SIGKILL)),
    "hangs": _make_trap(lambda: time.sleep(1000)),
}


def make_file(reader: Reader, name: str, seed: int, index: int) -> bytes:
    """Return the damaged file of an index; it depends on nothing but the arguments."""
    return reader.make(Random(f"{seed}/{name}/{index}"))


def find_target(name: str) -> Reader:
    """Return a target by its name. Geometry needs a device, which the others' memory should not have to hold."""
    if name == "geometry":
        from .geometry import GEOMETRY

        return GEOMETRY
    return (READERS | _TRAPS)[name]


def main(seed: int, begin: int, end: int, names: list[str]) -> None:
    """Read the damaged files `begin` to `end` - 1 of each reader."""
    warnings.simplefilter("error")
    warnings.simplefilter("ignore", AppearanceWarning)  # the rest of the file is read
    targets = {name: find_target(name) for name in names}
    with tempfile.TemporaryDirectory(prefix="clbvh-fuzz-") as name:
        folder = Path(name)
        for reader, target in targets.items():
            for original in target.originals:
                assert target.read(original, folder), f"a valid file of {reader} is refused"
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + MEMORY_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        for index in range(begin, end):
            for reader, target in targets.items():
                print("begin", reader, index, flush=True)
                content = make_file(target, reader, seed, index)
                try:
                    outcome = "accepted" if target.read(content, folder) else "refused"
                except Exception as error:
                    place = traceback.extract_tb(error.__traceback__)[-1]
                    reason = " ".join(f"{type(error).__name__}: {error}".split())[:300]
                    outcome = f"failed {reason} ({place.filename}:{place.lineno})"
                print("end", outcome, flush=True)
    print("peak", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:4]), sys.argv[4:])
