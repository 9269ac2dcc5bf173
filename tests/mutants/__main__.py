"""`make mutants`: plant faults one by one, and see a test fail for each. Ends with 1 if one stays unnoticed."""

import argparse
import queue
import sys
import time
from concurrent.futures import ThreadPoolExecutor

from clbvh.device.host.library import open_library

from .laboratory import FAILED, PASSED, Laboratory
from .table import ROOT, Mutant, read_mutants

_OUT = ROOT / "out" / "mutants"

# The end of what pytest said, of a mutant that is not caught.
_TAIL = 600


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--only", nargs="+", default=[], help="names of mutants or tables; all without it")
    parser.add_argument("--jobs", type=int, default=1, help="mutants that are tested at a time")
    parser.add_argument("--skip-check", action="store_true", help="do not first run the tests without a fault")
    options = parser.parse_args()
    mutants = [
        mutant
        for mutant in read_mutants()
        if not options.only or {mutant.name, mutant.name.split("-")[0]} & set(options.only)
    ]
    began = time.perf_counter()
    open_library()  # compiled here where it does not fit, and not in every copy
    laboratories: queue.SimpleQueue[Laboratory] = queue.SimpleQueue()
    for number in range(options.jobs):
        laboratories.put(Laboratory(_OUT / f"copy-{number}"))

    def run(tests: tuple[str, ...], mutant: Mutant | None) -> tuple[str, str, float]:
        laboratory, since = laboratories.get(), time.perf_counter()
        try:
            return *laboratory.test(tests, mutant), time.perf_counter() - since
        finally:
            laboratories.put(laboratory)

    failures = 0
    with ThreadPoolExecutor(options.jobs) as threads:
        if not options.skip_check:
            tests = tuple(sorted({test for mutant in mutants for test in mutant.tests}))
            result, output, seconds = run(tests, None)
            print(f"{seconds:4.0f} s  {len(tests)} tests without a fault: {result}", flush=True)
            if result != PASSED:
                print(output[-_TAIL:])
                return 1
        ready = [mutant for mutant in mutants if mutant.occurrences() == 1]
        for mutant in mutants:
            if mutant not in ready:
                failures += 1
                print(f"{mutant.name}: its text occurs {mutant.occurrences()} times in {mutant.file}, not once")
        results = threads.map(lambda mutant: run(mutant.tests, mutant), ready)
        for mutant, (result, output, seconds) in zip(ready, results, strict=True):
            word = {FAILED: "caught", PASSED: "SURVIVED"}.get(result, f"NOT CAUGHT: {result}")
            print(f"{seconds:4.0f} s  {mutant.name:12} {word}: {mutant.file}, {mutant.breaks}", flush=True)
            if result != FAILED:
                failures += 1
                print(output[-_TAIL:], flush=True)
    print(f"{len(mutants) - failures} of {len(mutants)} caught, {time.perf_counter() - began:,.0f} s")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
