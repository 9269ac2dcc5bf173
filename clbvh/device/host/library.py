"""The library of compiled kernels: found, checked against its sources, and its entries.

A wheel carries it. A checkout compiles it when it is installed; there it may be older than the kernels, and is then
compiled anew, if a compiler is at hand.
"""

from __future__ import annotations

import ctypes
import os
import platform
import struct
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError, DeviceError, InternalError
from ...support.folders import find_folder, is_writable
from ...support.forks import make_lock
from ...support.say_once import say_compiling
from ..kernel import Kernel
from ..sources import expand_for_host, find_arguments
from .targets import find_machine, find_target
from .variants import FIXED, Variant, loop_entry

LEVEL_VARIABLE = "CLBVH_HOST_LEVEL"
LIBRARY_VARIABLE = "CLBVH_HOST_LIBRARY"
# If set, kernels are compiled when they are asked for, and the library's are ignored: for faults that are planted in
# files that many include.
ON_DEMAND_VARIABLE = "CLBVH_HOST_ON_DEMAND"

_PACKAGE = Path(__file__).resolve().parents[2]
_REBUILD = "`pip install --editable .` in the checkout, or `python -m clbvh.device.host`"

# Most bytes of the facts that the library states about itself, see device/host/compile.py.
_MOST_FACT_BYTES = 256

# The slot of an argument by its C type; a buffer is its address.
_SLOTS = {"int": "i4x", "uint": "I4x", "float": "f4x", "double": "d", None: "Q"}

_Entry = Any


def library_path() -> Path:
    """Return where the library is, or would be: `CLBVH_HOST_LIBRARY`, or the package's own."""
    if path := os.environ.get(LIBRARY_VARIABLE):
        return Path(path)
    target = find_target()
    return _PACKAGE / "compiled" / (target.library_name if target else "host")


class HostBuffer:
    """Memory of the host device.

    Attributes
    ----------
    array : (size,) uint8, or None
        None once it was given back.
    address : int or None
    size : int
        In bytes.
    """

    __slots__ = ("__weakref__", "address", "array", "size")

    def __init__(self, array: NDArray[np.uint8]) -> None:
        self.size = array.nbytes
        self.array: Any = array
        self.address: int | None = array.ctypes.data


class HostKernel(Kernel):
    """An entry of the library.

    Parameters
    ----------
    name : str
    arguments : mapping of str to str or None
        The C types of those that are numbers.
    entry : function
        ``entry(launch, first_group, end_group)``, see host/compile.py.
    """

    def __init__(self, name: str, arguments: Mapping[str, str | None], entry: _Entry) -> None:
        super().__init__(name, arguments)
        self.entry = entry
        self._kinds = [*arguments.values()]
        self._are_addresses = tuple(kind is None for kind in self._kinds)
        self._pack = struct.Struct("<" + "".join(_SLOTS[kind] for kind in self._kinds)).pack
        self._first = b""
        self._buffers: list[HostBuffer] = []

    def with_first(self, first: Mapping[str, Any]) -> HostKernel:
        """Return the kernel without its first arguments, which are packed once for many launches."""
        kinds = [*zip(self.argument_names, self._kinds, strict=True)]
        rest = HostKernel(self.name, dict(kinds[len(first) :]), self.entry)
        rest._first = HostKernel(self.name, dict(kinds[: len(first)]), None)._bind_all(first)
        rest._buffers = [value for value in first.values() if value.__class__ is HostBuffer]
        return rest

    def hold(self) -> list[Any]:
        """Return the arrays of the first arguments' buffers, to be kept during a launch.

        Raises
        ------
        InternalError
            One was given back.
        """
        arrays = []
        for buffer in self._buffers:
            if (array := buffer.array) is None:
                raise InternalError(f"a buffer that the kernel '{self.name}' is told of was given back")
            arrays.append(array)
        return arrays

    def bind(self, shape: tuple[int, int, int, int], arguments: Mapping[str, Any]) -> bytes:
        """Return the launch that the entry reads: shape and arguments.

        Raises
        ------
        InternalError
            As `in_order`, or an argument is of another kind.
        """
        return _pack_shape(*shape) + self._first + self._bind_all(arguments)

    def bind_numbers(self, shape: tuple[int, int, int, int], numbers: Iterable[float]) -> bytes:
        """Return the same of arguments in their order, where addresses stand for arrays; in a third of the time.

        Raises
        ------
        InternalError
            There are more or fewer arguments, or one is of another kind.
        """
        try:
            return _pack_shape(*shape) + self._first + self._pack(*numbers)
        except struct.error as error:
            raise InternalError(f"the kernel '{self.name}' does not take an argument: {error}") from error

    def _bind_all(self, arguments: Mapping[str, Any]) -> bytes:
        values = zip(self.in_order(arguments), self._are_addresses, strict=True)
        try:
            return self._pack(*[_as_address(value) if is_address else value for value, is_address in values])
        except (TypeError, struct.error) as error:
            raise InternalError(f"the kernel '{self.name}' does not take an argument: {error}") from error


_pack_shape = struct.Struct("<4i").pack


def _as_address(value: Any) -> Any:
    """Return the address of a buffer or an array; 0 for none."""
    if value.__class__ is HostBuffer:
        if value.address is None:
            raise TypeError("a buffer that was given back")
        return value.address
    if value is None:
        return 0
    if not isinstance(value, np.ndarray):
        raise TypeError(f"no buffer, but {value!r}")
    if not value.flags.c_contiguous:
        raise TypeError("an array that is not contiguous")
    return find_address(value)


# By numpy's C interface, an array begins as every object does, and then comes the address of its items. It is read from
# there since `array.ctypes.data` takes ten times as long.
_HEAD_BYTES = object.__basicsize__
_read_address = ctypes.c_size_t.from_address


def find_address(array: NDArray[Any]) -> int:
    """Return where the items of an array begin, which may have any strides."""
    return _read_address(id(array) + _HEAD_BYTES).value


def find_addresses(arrays: Iterable[NDArray[Any] | None]) -> list[int]:
    """Return the same of several arrays, 0 for none; all at once, in half of the time."""
    return [0 if array is None else _read_address(id(array) + _HEAD_BYTES).value for array in arrays]


class HostLibrary:
    """The opened library.

    Attributes
    ----------
    path : Path
    levels : tuple of str
        The levels of processors that it has code for, from the lowest up.
    level : str
        The one that runs here.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._library = ctypes.CDLL(str(path))
            facts = (ctypes.c_char * _MOST_FACT_BYTES).in_dll(self._library, "clbvh_facts").value.decode()
        except (OSError, ValueError) as error:  # no library, or one of something else
            raise DeviceError(
                f"the compiled kernels cannot be loaded ({error}): reinstall clbvh, or {_REBUILD}"
            ) from error
        self.digest, *levels = facts.split()
        self.path, self.levels = path, tuple(levels)
        self.level = self._choose_level(int(self._library.clbvh_level()))
        self._kernels: dict[Variant, dict[str, HostKernel]] = {}
        self._programs: dict[tuple[str, tuple[tuple[str, int], ...]], dict[str, HostKernel]] = {}

    def _choose_level(self, processor: int) -> str:
        usable = [level for level in self.levels if not level[1:].isdecimal() or int(level[1:]) <= processor]
        if asked := os.environ.get(LEVEL_VARIABLE):
            if asked not in usable:
                raise ConfigError(
                    f"{LEVEL_VARIABLE}={asked}: this processor and this library have {', '.join(usable) or 'none'}"
                )
            return asked
        if not usable:
            raise DeviceError(
                f"this processor is older than the compiled kernels, which need x86-64-{self.levels[0]}: {_REBUILD} "
                "compiles them for it"
            )
        return usable[-1]

    def kernels(self, name: str, macros: Mapping[str, int]) -> dict[str, HostKernel]:
        """Return the kernels of a file by their names.

        Raises
        ------
        InternalError
            The table of variants has no such macros.
        """
        variant = Variant.of(name, macros)
        if os.environ.get(ON_DEMAND_VARIABLE):
            return self.compile(expand_for_host(f"kernels/{name}.cl"), FIXED | dict(variant.macros))
        if variant not in self._kernels:
            arguments = find_arguments(expand_for_host(f"kernels/{name}.cl"))
            self._kernels[variant] = {
                kernel: HostKernel(kernel, arguments[kernel], self._find_kernel(variant.entry(kernel)))
                for kernel in arguments
            }
        return self._kernels[variant]

    def _find_kernel(self, entry: str) -> _Entry:
        """Return the entry of a kernel at the level that runs, or at the next lower one that has it."""
        levels = self.levels[: self.levels.index(self.level) + 1]
        names = [f"{level}_{entry}" for level in reversed(levels)]
        return _find_entry(self._library, next((name for name in names if hasattr(self._library, name)), names[0]))

    def loop(self, name: str, loop: str) -> Any:
        """Return the function of a loop, see host/loops.py; `name` is that of its file below ``cl/host``."""
        library = self._library
        if os.environ.get(ON_DEMAND_VARIABLE):
            from .compile import build_loops, find_objects

            library = ctypes.CDLL(str(build_loops(find_objects(), name, self.level)))
        return _find(library, f"{self.level}_{loop_entry(name, loop)}")

    def compile(self, source: str, macros: Mapping[str, int]) -> dict[str, HostKernel]:
        """Return the kernels of an expanded source that does not ship with clbvh, compiled for the same processor.

        Raises
        ------
        DeviceError
            There is no compiler.
        KernelBuildError
            It refuses.
        """
        from .compile import build_program, find_objects

        key = source, tuple(sorted(macros.items()))
        if key not in self._programs:
            library = ctypes.CDLL(str(build_program(find_objects(), source, dict(key[1]), self.level)))
            self._programs[key] = {
                kernel: HostKernel(kernel, arguments, _find_entry(library, f"{self.level}_{kernel}"))
                for kernel, arguments in find_arguments(source).items()
            }
        return self._programs[key]


def _find(library: ctypes.CDLL, entry: str) -> Any:
    try:
        return library[entry]
    except AttributeError:
        raise InternalError(f"the library for the host has no entry {entry}: see host/variants.py") from None


def _find_entry(library: ctypes.CDLL, entry: str) -> _Entry:
    function = _find(library, entry)
    function.argtypes = (ctypes.c_char_p, ctypes.c_int64, ctypes.c_int64)
    function.restype = None
    return function


_opening = make_lock()
_opened: dict[Path, HostLibrary] = {}


def open_library() -> HostLibrary:
    """Return the library, compiled first where a checkout has none that fits its kernels.

    Raises
    ------
    DeviceError
        There is none, and it cannot be compiled; or this processor is too old.
    KernelBuildError
        The compiler refuses.
    """
    with _opening:
        path = library_path()
        if path not in _opened:
            # A library that a variable names, or that a wheel brought, is taken as it is.
            is_own = _is_checkout() and not any(map(os.environ.get, (LIBRARY_VARIABLE, ON_DEMAND_VARIABLE)))
            # Checked without loading it: the system would return the old library again for the same path.
            if not (path.is_file() and (not is_own or fits_sources(path))):
                _rebuild(path)
            _opened[path] = HostLibrary(path)
        return _opened[path]


def fits_sources(path: Path) -> bool:
    """Return whether a library was made of the sources that are here."""
    from .compile import find_digest

    return find_digest().encode() in path.read_bytes()


def _is_checkout() -> bool:
    return find_folder("cl").parent != _PACKAGE


def _rebuild(path: Path) -> None:
    """Compile the library of a checkout for this processor, in one process at a time."""
    from .compile import build_library, find_compiler, find_level, find_objects, find_own_target

    if find_own_target() is None:
        wheel = "a wheel of clbvh has it, or " if find_target() else ""
        raise DeviceError(
            f"there is no host device for {platform.system()} on {find_machine()}: {wheel}an OpenCL driver may serve"
        )
    if not _is_checkout() or find_compiler() is None or not is_writable(path.parent):
        what = "do not fit their sources" if path.is_file() else "are missing"
        raise DeviceError(f"the compiled kernels of the host {what}: {_REBUILD} compiles them")
    import fcntl

    find_objects().mkdir(parents=True, exist_ok=True)
    with (find_objects() / "compiling.lock").open("w") as lock:
        fcntl.lockf(lock, fcntl.LOCK_EX)  # not `flock`, which a forked child would hold as well
        # Another process may have compiled it meanwhile.
        if not (path.is_file() and fits_sources(path)):
            say_compiling("compiling the kernels for this processor, which takes a minute")
            build_library(path, find_objects(), [find_level()])
