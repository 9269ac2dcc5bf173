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
from functools import cache
from types import CodeType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import InternalError
from ...structs import BOX_LANES, DEVICE_CONSTANTS, DEVICE_STRUCTS, EXACT_STRUCTS, alignment_of
from ...support.folders import find_folder
from ..sources import find_loops
from .library import open_library

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
    """What C takes for one thing: numpy's dtype, if any will not do, how many of it, and the alignment in bytes."""

    dtype: np.dtype[Any] | None
    size: int
    alignment: int


_ROWS = {name: _Row(np.dtype(dtype), 1, np.dtype(dtype).itemsize) for name, (dtype, _) in _NUMBERS.items()}
_ROWS |= {name: _Row(dtype, 1, alignment_of(dtype)) for name, dtype in (DEVICE_STRUCTS | EXACT_STRUCTS).items()}
_ROWS["void"] = _Row(None, 1, 1)
_ROWS["box_row_t"] = _Row(np.dtype(np.float32), BOX_LANES, np.dtype(np.float32).itemsize)

_PARAMETER = re.compile(r"(const )?(\w+) (\*?)(?:restrict )?(\w+)((?:\[[^\]]+\])*)")
_DIMENSION = re.compile(r"\[([^\]]+)\]")


class Loops:
    """The loops of one file, each a method.

    Parameters
    ----------
    name : str
        Of the file below ``cl/host``, without its ending.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Loop:
        path = f"host/{self._name}.cl"
        declared = find_loops((find_folder("cl") / path).read_text(encoding="utf-8"))
        if name not in declared:
            raise AttributeError(f"cl/{path} has no loop '{name}'")
        loop = Loop(name, *declared[name], open_library().loop(self._name, name))
        setattr(self, name, loop)
        return loop


class Loop:
    """A function of the library.

    Parameters
    ----------
    name : str
    result, parameters : str
        Of its declaration.
    function : function of the library

    Raises
    ------
    InternalError
        When it is called: the number of arguments, the dtype, length or alignment of an array; or one that is not
        contiguous, or not writable where it is to be written.
    """

    def __init__(self, name: str, result: str, parameters: str, function: Any) -> None:
        self._name, self._function = name, function
        declared = [_read_parameter(each) for each in parameters.split(",")]
        self._names = [each.name for each in declared]
        self._arrays = [each for each in declared if isinstance(each, _Array)]
        # The array that tells each length, and the numbers in a row of it.
        tellers = {each.size: each for each in reversed(self._arrays) if each.size in self._names}
        self._tellers = [(length, array.name, array.row.size) for length, array in tellers.items()]
        self._passed = [name for name in self._names if name not in tellers]
        function.argtypes = [each.type for each in declared]
        function.restype = None if result == "void" else _NUMBERS[result][1]

    def __call__(self, *arguments: Any) -> Any:
        """Return what it returns, once it has run."""
        if len(arguments) != len(self._passed):
            raise InternalError(f"the loop '{self._name}' takes {len(self._passed)} arguments, not {len(arguments)}")
        values = dict(zip(self._passed, arguments, strict=True))
        for length, name, row_size in self._tellers:
            values[length] = getattr(values[name], "size", 0) // row_size
        # Written out for speed: a call with one ray spends a tenth of its time here.
        for name, (dtype, row_size, alignment), size, is_const, _ in self._arrays:
            array = values[name]
            if array is None and not size:
                continue
            wrong = ""
            if not isinstance(array, np.ndarray) or (dtype is not None and array.dtype != dtype):
                wrong = f"no array of {dtype}"
            elif size and array.size != _count(size, values) * row_size:
                wrong = f"{array.size} numbers, not {size} times {row_size}"
            elif not (flags := array.flags).c_contiguous or not (is_const or flags.writeable):
                wrong = "not contiguous, or not writable"
            elif (address := _read_address(id(array) + _HEAD_BYTES).value) % alignment:
                wrong = "not aligned"
            if wrong:
                raise InternalError(f"the loop '{self._name}' does not take its '{name}': {wrong}")
            values[name] = address
        return self._function(*[values[name] for name in self._names])


# By numpy's C interface, an array begins as every object does, and then comes the address of its items. It is read from
# there since `array.ctypes.data` takes ten times as long.
_HEAD_BYTES = object.__basicsize__
_read_address = ctypes.c_size_t.from_address


def _count(size: str, values: dict[str, Any]) -> int:
    return int(values[size] if size in values else eval(_compile(size), {}, values))


@cache
def _compile(size: str) -> CodeType:
    return compile(size, "<size>", "eval")


def pack_struct(*fields: NDArray[Any] | float) -> NDArray[np.uint64]:
    """Return a struct for loops: of pointers to arrays, which have to be kept as long as it, longs and doubles."""
    return np.array([_pack_field(field) for field in fields], np.uint64)


def _pack_field(field: Any) -> Any:
    if not isinstance(field, np.ndarray):
        return np.float64(field).view(np.uint64) if isinstance(field, float) else field
    if not field.flags.c_contiguous:
        raise InternalError(f"an array of {field.shape} in a struct is not contiguous")
    return _read_address(id(field) + _HEAD_BYTES).value


class _Parameter(NamedTuple):
    """A number."""

    name: str
    type: Any


class _Array(NamedTuple):
    """An array.

    Attributes
    ----------
    name : str
    row : _Row
    size : str
        How many rows it has, in C; empty if any number will do, or None instead of the array.
    is_const : bool
        Whether it is only read.
    """

    name: str
    row: _Row
    size: str
    is_const: bool
    type: Any = ctypes.c_void_p


def _read_parameter(declaration: str) -> _Parameter | _Array:
    found = _PARAMETER.fullmatch(" ".join(declaration.split()))
    if found is None or found[2] not in _ROWS:
        raise InternalError(f"a loop declares '{declaration}'")
    const, kind, star, name, dimensions = found.groups()
    if not star and not dimensions:
        return _Parameter(name, _NUMBERS[kind][1])
    size, *others = _DIMENSION.findall(dimensions) or [""]
    row = _ROWS[kind]
    count = math.prod(int(each) if each.isdecimal() else int(DEVICE_CONSTANTS[each]) for each in others)
    return _Array(name, row._replace(size=row.size * count), size, bool(const))
