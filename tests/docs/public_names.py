"""The public names: those of `clbvh`, of the integrations, and the methods of both's classes."""

from __future__ import annotations

import importlib
import inspect
import types
from collections.abc import Iterator

import clbvh

INTEGRATIONS = ("clbvh.integrations.dask", "clbvh.integrations.pyvista", "clbvh.integrations.trimesh")


def list_public_names() -> dict[str, object]:
    """Return each public class, function and method by its dotted name."""
    names = {f"clbvh.{name}": getattr(clbvh, name) for name in clbvh.__all__}
    for path in INTEGRATIONS:
        module = importlib.import_module(path)
        for name, value in vars(module).items():
            if not name.startswith("_") and callable(value) and getattr(value, "__module__", "").startswith(path):
                names[f"{path}.{name}"] = value
    found: dict[str, object] = {}
    for name, value in names.items():
        if inspect.isclass(value) or inspect.isroutine(value):
            found[name] = value
        if inspect.isclass(value):
            found.update((f"{name}.{method}", function) for method, function in _list_methods(value))
    return found


def _list_methods(owner: type) -> Iterator[tuple[str, object]]:
    """Yield the public methods that a class has from clbvh, its own and those of its bases."""
    for name in dir(owner):
        home = next(base for base in owner.__mro__ if name in vars(base))
        is_ours = home.__module__.startswith("clbvh.")
        if (
            is_ours
            and not name.startswith("_")
            and isinstance(getattr(owner, name), types.FunctionType | types.MethodType)
        ):
            yield name, getattr(owner, name)
