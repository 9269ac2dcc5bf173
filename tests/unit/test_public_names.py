"""The names of `clbvh` itself: complete, and enough to write down any public signature."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys

import clbvh
import clbvh.errors

# Words of annotations that are Python's, typing's or numpy's.
_OTHERS = {"None", "Any", "Self", "Callable", "Mapping", "Sequence", "Iterable", "ArrayLike", "NDArray", "PathLike"}
_OTHERS |= {"BaseException", "TracebackType", "Literal", "ClassVar", "Path"}
# Anything with a graph as a `trimesh.Scene` has one, what hits and a picture show, and what a tree is over.
_OTHERS |= {"HasGraph", "Surface", "DrawnScene", "Bounded"}
# What builders and devices see of a shape.
_OTHERS |= {"Kind", "Corners"}
# What a mesh keeps for tracers.
_OTHERS |= {"Coincidence", "CornerFaces"}
# Parts of a build, public among the modules of clbvh only.
_PARTS = {"SubtreePool.attach", "SubtreePool.hold"}


def public_callables():
    """Yield the public functions, and the public methods of the public classes."""
    for name in clbvh.__all__:
        thing = getattr(clbvh, name)
        if inspect.isfunction(thing):
            yield name, thing
        if not inspect.isclass(thing) or issubclass(thing, Warning | Exception):
            continue
        yield name, thing.__init__
        ours = [base for base in thing.__mro__ if base.__module__.startswith("clbvh.")]
        for attribute, member in {key: value for base in reversed(ours) for key, value in vars(base).items()}.items():
            function = getattr(member, "__func__", getattr(member, "fget", getattr(member, "func", member)))
            path = f"{name}.{attribute}"
            if inspect.isfunction(function) and not attribute.startswith("_") and path not in _PARTS:
                yield path, function


def test_signatures_name_only_what_can_be_imported_from_clbvh_and_help_shows_no_address():
    for name, function in public_callables():
        annotations = " ".join(map(str, getattr(function, "__annotations__", {}).values()))
        words = set(re.findall(r"(?<![\w.'\"])_?[A-Z]\w*", annotations))
        assert words <= _OTHERS | set(clbvh.__all__), name
        defaults = [one.default for one in inspect.signature(function).parameters.values()]
        assert not [default for default in defaults if inspect.isfunction(default)], name


def test_every_public_name_exists_and_is_listed_once_and_every_error_is_public():
    assert dir(clbvh) == sorted(set(clbvh.__all__)) == sorted(clbvh.__all__)
    assert all(getattr(clbvh, name) is not None for name in clbvh.__all__)
    assert {name for name, thing in vars(clbvh.errors).items() if inspect.isclass(thing)} <= set(clbvh.__all__)


def test_errors_import_nothing_else():
    script = "import sys, clbvh; clbvh.MeshError; print([m for m in ('numpy', 'pyopencl') if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
