"""Threads whose exceptions are raised where they are joined."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

PATIENCE_S = 120.0


def run_in_threads(*works):
    """Call each function in a thread of its own, all at once, and return the results in their order."""
    with ThreadPoolExecutor(len(works)) as threads:
        futures = [threads.submit(work) for work in works]
        return [future.result(timeout=PATIENCE_S) for future in futures]
