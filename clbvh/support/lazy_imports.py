"""Names of a package that are imported on first use.

So `import clbvh` takes no time, and a worker process loads only the modules that it runs.
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
        The module of the package that holds each name.
    """

    def get(name: str) -> Any:
        if name not in home_of:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        return getattr(import_module(f".{home_of[name]}", package), name)

    return get
