"""Stores the answers anew: `python -m clbvh.conformance.refresh`, or `make conformance-refresh`.

Needed where answers change on purpose. Refuses unless all layouts agree. Then look at the other runtimes, with
`make conformance`, before the file is committed.
"""

from __future__ import annotations

from ..device.select import choose_device
from .cases import make_cases
from .check import collect_expected
from .expected import EXPECTED_PATH, store_expected


def main() -> None:
    """Replace the stored answers by those of the default device."""
    device = choose_device()
    cases = make_cases()
    store_expected(cases, collect_expected(cases, device))
    print(f"{EXPECTED_PATH.name} has the answers of {device.name} ({device.platform})")


if __name__ == "__main__":
    main()
