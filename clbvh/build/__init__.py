"""A mesh becomes a tree on the host, by worker processes or in the calling process."""

from typing import TYPE_CHECKING

from ..callable_module import make_callable
from ..lazy import import_on_use

if TYPE_CHECKING:
    from .builder import build
    from .options import BuildOptions
    from .pool import SubtreePool

__all__ = ["BuildOptions", "SubtreePool", "build"]

# A worker imports this package to build subtrees; it needs none of the builders.
__getattr__ = import_on_use(__name__, {"build": "builder", "BuildOptions": "options", "SubtreePool": "pool"})

make_callable(__name__)
