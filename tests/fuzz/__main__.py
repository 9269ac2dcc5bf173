"""`make fuzz`: damaged files for every reader, and hard meshes, rays and points for every layout.

Ends with 1 if one fails, and keeps its file in `out/fuzz/`; a mesh's holds the bytes that it follows from.
"""

import argparse
import random
import sys
import time
from collections import Counter
from pathlib import Path

from .campaign import Outcome, fuzz
from .readers import READERS
from .worker import find_target, make_file

_OUT = Path("out/fuzz")
_GEOMETRY = "geometry"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--files", type=int, default=100_000, help="damaged files in all")
    parser.add_argument("--meshes", type=int, default=10_000, help="meshes for the fuzz of geometry")
    parser.add_argument("--seed", type=int, default=random.randrange(2**32), help="another run; random without it")
    parser.add_argument("--readers", nargs="+", choices=READERS, default=list(READERS), help="all without it")
    options = parser.parse_args()
    count = -(-options.files // len(options.readers))
    print(f"seed {options.seed}: {count:,} files for each of {options.readers}, {options.meshes:,} meshes", flush=True)
    began = time.perf_counter()
    outcome = Outcome()
    fuzz(options.seed, count, options.readers, outcome=outcome)
    fuzz(options.seed, options.meshes, [_GEOMETRY], outcome=outcome)
    print(f"{'':9}{'accepted':>10}{'refused':>10}{'failed':>10}")
    for reader in [*options.readers, _GEOMETRY]:
        columns = "".join(f"{outcome.counts[reader, word]:>10,}" for word in ("accepted", "refused", "failed"))
        print(f"{reader:9}{columns}")
    print(f"{time.perf_counter() - began:,.0f} s, at most {outcome.peak_kib / 1024:,.0f} MiB in a process")
    reasons = Counter((failure.reader, failure.reason) for failure in outcome.failures)
    for failure in outcome.failures:
        # One file for each reason.
        if times := reasons.pop((failure.reader, failure.reason), 0):
            _OUT.mkdir(parents=True, exist_ok=True)
            path = _OUT / f"{options.seed}-{failure.index}.{failure.reader}"
            path.write_bytes(make_file(find_target(failure.reader), failure.reader, options.seed, failure.index))
            print(f"{path}, {times} times: {failure.reason}")
    return 1 if outcome.failures else 0


if __name__ == "__main__":
    sys.exit(main())
