"""Names of a package that are imported when they are first used.

`import clbvh` is to cost nothing, and a worker process is to load no more than it runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def import_on_use(package: str, home_of: Mapping[str, str]) -> Callable[[str], Any]:
    """Return a `__getattr__` for a package (PEP 562).

    Parameters
    ----------
    package : str
    home_of : mapping of str to str
        Which module of the package each name is in.
    """

    def get(name: str) -> Any:
        if name not in home_of:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        return getattr(import_module(f".{home_of[name]}", package), name)

    return get
