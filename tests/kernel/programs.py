"""Compiled kernels, built once for all tests: a compilation takes about a second on PoCL.

Shells stand in files of their own. Bundles, files of includes alone, make one program of several.
"""

from functools import cache
from pathlib import Path

from clbvh.device.program import build_kernels

HERE = Path(__file__).parent


def find_kernel(session, bundle, name, defines=None, folder=HERE):
    """The kernel of that name from ``kernels/BUNDLE.cl`` below `folder`."""
    return _build(session, bundle, tuple(sorted((defines or {}).items())), folder)[name]


@cache
def _build(session, bundle, defines, folder):
    return build_kernels(session, bundle, dict(defines), folder=folder)
