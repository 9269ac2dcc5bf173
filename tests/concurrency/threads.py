"""Threads whose exceptions are raised where they are joined."""

import threading
from concurrent.futures import Future

PATIENCE_S = 120.0


def run_in_threads(*works):
    """Call each function in a thread of its own, all at once, and return the results in their order.

    Threads that hang are left behind after `PATIENCE_S`, with a `TimeoutError`.
    """
    futures = [Future() for _ in works]
    for work, future in zip(works, futures, strict=True):
        threading.Thread(target=_fulfil, args=(future, work), daemon=True).start()
    return [future.result(timeout=PATIENCE_S) for future in futures]


def _fulfil(future, work):
    try:
        future.set_result(work())
    except BaseException as error:
        future.set_exception(error)
