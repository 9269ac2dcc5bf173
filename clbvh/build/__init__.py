"""A mesh becomes a tree on the host, by worker processes or in the calling process."""

from ..callable_module import make_callable
from .builder import build
from .options import BuildOptions
from .pool import SubtreePool

__all__ = ["BuildOptions", "SubtreePool", "build"]

make_callable(__name__)
