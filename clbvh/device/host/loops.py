"""Loops that only the host runs: C functions of `cl/host/`, called with numpy arrays.

A loop says in its declaration what it is called with. Lengths are not passed: they are those of the arrays::

    loop long find_first(const long count, const float values[count][3], const float limit, int found[count])

is ``loops.find_first(values, limit, found)``. An array without `const` is written; ``*name`` instead of ``name[count]``
is an array of any length, or None, and `void` says nothing of its dtype. Other threads of Python run meanwhile.
"""

from __future__ import annotations

import ctypes
import math
import re
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from ...errors import InternalError
from ...structs import BOX_LANES, DEVICE_CONSTANTS, DEVICE_STRUCTS, EXACT_STRUCTS
from ...support.folders import find_folder
from ..sources import find_loops
from .library import find_address, open_library

# The number types of C: of arrays, and of single values.
_NUMBERS: dict[str, tuple[Any, Any]] = {
    "bool": (np.bool_, ctypes.c_bool),
    "uchar": (np.uint8, ctypes.c_uint8),
    "int": (np.int32, ctypes.c_int32),
    "uint": (np.uint32, ctypes.c_uint32),
    "long": (np.int64, ctypes.c_int64),
    "ulong": (np.uint64, ctypes.c_uint64),
    "float": (np.float32, ctypes.c_float),
    "double": (np.float64, ctypes.c_double),
}


class _Row(NamedTuple):
    """An item of an array in C: its numpy dtype, or None if any will do, and the number of its values."""

    dtype: np.dtype[Any] | None
    size: int = 1


_ROWS = {name: _Row(np.dtype(dtype)) for name, (dtype, _) in _NUMBERS.items()}
_ROWS |= {name: _Row(dtype) for name, dtype in (DEVICE_STRUCTS | EXACT_STRUCTS).items()}
_ROWS |= {"void": _Row(None), "box_row_t": _Row(np.dtype(np.float32), BOX_LANES)}

_PARAMETER = re.compile(r"(const )?(\w+) (\*?)(?:restrict )?(\w+)((?:\[[^\]]+\])*)")
_DIMENSION = re.compile(r"\[([^\]]+)\]")


class Loops:
    """The loops of one file, each a method.

    Parameters
    ----------
    name : str
        Name of the file below ``cl/host``, without its ending.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Callable[..., Any]:
        path = f"host/{self._name}.cl"
        declared = find_loops((find_folder("cl") / path).read_text(encoding="utf-8"))
        if name not in declared:
            raise AttributeError(f"cl/{path} has no loop '{name}'")
        loop = make_loop(name, *declared[name], open_library().loop(self._name, name))
        setattr(self, name, loop)
        return loop


def make_loop(name: str, result: str, parameters: str, function: Any) -> Callable[..., Any]:
    """Return a Python function that checks its arguments and calls a function of the library.

    It raises `InternalError` for an array of another dtype or length, for one that is not contiguous, and for one that
    is to be written and cannot be.

    Parameters
    ----------
    name : str
    result, parameters : str
        Parts of the loop's declaration.
    function : function of the library
    """
    declared = [_read_parameter(each) for each in parameters.split(",")]
    function.argtypes = [each.type for each in declared]
    function.restype = None if result == "void" else _NUMBERS[result][1]
    names, arrays = [each.name for each in declared], [each for each in declared if isinstance(each, _Array)]
    # The array that tells each length.
    tellers = {each.size: each for each in reversed(arrays) if each.size in names}

    # A text of its own, since every call passes here: a loop over the parameters takes three times as long.
    text = [f"def {name}({', '.join(each for each in names if each not in tellers)}):"]
    text += [f"    {length} = getattr({each.name}, 'size', 0) // {each.row.size}" for length, each in tellers.items()]
    text += [f"    {each.name}_address = {each.as_check()}" for each in arrays]
    text.append(f"    return function({', '.join(f'{each.name}{each.suffix}' for each in declared)})")
    scope: dict[str, Any] = {f"{each.name}_dtype": each.row.dtype for each in arrays}
    scope |= {"ndarray": np.ndarray, "find_address": find_address, "refuse": partial(_refuse, name)}
    scope["function"] = function
    exec("\n".join(text), scope)
    return scope[name]


def _refuse(loop: str, name: str, array: Any, wanted: str) -> NoReturn:
    found = f"{array.dtype}, {array.size} items" if isinstance(array, np.ndarray) else type(array).__name__
    raise InternalError(f"the loop '{loop}' does not take its '{name}': {found}, where {wanted} are wanted")


def pack_struct(*fields: NDArray[Any] | float) -> NDArray[np.uint64]:
    """Return a struct for loops: of pointers to arrays, which have to be kept as long as it, longs and doubles."""
    return np.array([_pack_field(field) for field in fields], np.uint64)


def _pack_field(field: Any) -> Any:
    if not isinstance(field, np.ndarray):
        return np.float64(field).view(np.uint64) if isinstance(field, float) else field
    if not field.flags.c_contiguous:
        raise InternalError(f"an array of {field.shape} in a struct is not contiguous")
    return find_address(field)


class _Number(NamedTuple):
    """A number, which is passed as it is."""

    name: str
    type: Any
    suffix: str = ""


class _Array(NamedTuple):
    """An array.

    Attributes
    ----------
    name : str
    row : _Row
    size : str
        Number of rows, as C text; empty if any number will do, or None in place of the array.
    is_const : bool
        True if it is only read.
    """

    name: str
    row: _Row
    size: str
    is_const: bool
    type: Any = ctypes.c_void_p
    suffix: str = "_address"

    def as_check(self) -> str:
        """Return the text of an expression that is the array's address, or refuses it."""
        tests = [f"isinstance({self.name}, ndarray)"]
        tests += [] if self.row.dtype is None else [f"{self.name}.dtype == {self.name}_dtype"]
        tests += [f"{self.name}.size == ({self.size}) * {self.row.size}"] if self.size else []
        tests += [f"(flags := {self.name}.flags).c_contiguous", *([] if self.is_const else ["flags.writeable"])]
        wanted = f"contiguous {'' if self.is_const else 'and writable '}{self.row.dtype or 'items'}"
        wanted += f", {self.size} times {self.row.size}," if self.size else ""
        checked = (
            f"find_address({self.name}) if {' and '.join(tests)} else refuse({self.name!r}, {self.name}, {wanted!r})"
        )
        return checked if self.size else f"None if {self.name} is None else {checked}"


def _read_parameter(declaration: str) -> _Number | _Array:
    found = _PARAMETER.fullmatch(" ".join(declaration.split()))
    if found is None or found[2] not in _ROWS:
        raise InternalError(f"a loop declares '{declaration}'")
    const, kind, star, name, dimensions = found.groups()
    if not star and not dimensions:
        return _Number(name, _NUMBERS[kind][1])
    size, *others = _DIMENSION.findall(dimensions) or [""]
    row = _ROWS[kind]
    count = math.prod(int(each) if each.isdecimal() else int(DEVICE_CONSTANTS[each]) for each in others)
    return _Array(name, row._replace(size=row.size * count), size, bool(const))
