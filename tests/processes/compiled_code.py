"""Says which machine code a program needed: a process that runs commands or Python code, and lists the versions.

    python -m tests.processes.compiled_code LIST.json < TASKS.json

The tasks are lists: the words of a `clbvh` command, or one text, Python code. The list has, as text, each version of a
compiled function that Python called, and apart those that numba compiled because its cache did not have them.
"""

import json
import sys
from pathlib import Path


def run_all(tasks: list[list[str] | str]) -> None:
    """Run commands and code, one after the other."""
    from clbvh.cli.app import run

    for task in tasks:
        if isinstance(task, str):
            exec(compile(task, "<task>", "exec"), {"__name__": "__main__"})
            continue
        try:
            run(task)
        except SystemExit as ended:
            if ended.code:
                raise


def list_code() -> dict[str, list[str]]:
    """Return the versions of functions in this process, and what was compiled."""
    from clbvh.support import compiled as room

    versions, compiled = [], []
    for function in room._dispatchers.values():
        name = f"{function.py_func.__module__}.{function.__name__}"
        hits, misses = function.stats.cache_hits, function.stats.cache_misses
        versions += [f"{name}{types}" for types in [*hits, *misses]]
        compiled += [f"{name}{types}" for types in misses]
    return {"versions": versions, "compiled": compiled}


if __name__ == "__main__":
    target = Path(sys.argv[1]).absolute()  # a task may change both
    run_all(json.load(sys.stdin))
    target.write_text(json.dumps(list_code()))
