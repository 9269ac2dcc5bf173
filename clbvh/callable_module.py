"""Packages that can be called.

`clbvh.build(mesh)` and `clbvh.render(scene)` are public functions, and `clbvh.build` and `clbvh.render` are also the
packages they live in. Importing a package binds its name in the parent, over anything else of that name; so these
packages answer a call by calling their function.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any


class _CallableModule(ModuleType):
    """A module that passes calls on to its function of the same name."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return self.__wrapped__(*args, **kwargs)

    @property
    def __wrapped__(self) -> Any:
        # `inspect.signature` follows this name and shows the function's parameters.
        return getattr(self, self.__name__.rpartition(".")[2])


def make_callable(module_name: str) -> None:
    """Let a module that is being imported be called like its function of the same name."""
    sys.modules[module_name].__class__ = _CallableModule
