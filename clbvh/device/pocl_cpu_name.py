"""A name that PoCL's compiler knows, for a processor that is newer than it is.

The PoCL of PyPI (3.0, LLVM 14) calls a processor that it does not know, such as AMD's Zen 5, "generic". Its compiler
refuses that name, so that no kernel can be built (https://github.com/pocl/pocl/issues/1049). This version has neither a
build option nor a variable for the name. It keeps the name as text in the record of the device, to which the handle
points; this module overwrites the text by the name of an older processor with the same vector instructions.

Nothing is written unless all of it is as expected: Linux on x86-64, a device of PoCL 3.0 whose version ends in
"generic", and just one pointer to that word within its record.
"""

from __future__ import annotations

import ctypes
import re
import struct
from pathlib import Path
from typing import IO

from .info import DeviceInfo

_UNKNOWN = b"generic\0"
_UNKNOWN_CPU = re.compile(r"PoCL.*x86_64.*linux.*-generic$")

# The record's size in PoCL 3.0 is above 1 KiB; the pointer stands at byte 640.
_RECORD_BYTES = 1024

_AVX2 = {"avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe", "rdrand"}
_AVX512 = {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "adx", "rdseed", "xsavec", "xsaves"}

# From the strongest down: what a processor must have to run the code that LLVM 14 makes for the name. No name is longer
# than the word that it replaces.
_NAMES: tuple[tuple[bytes, set[str]], ...] = (
    (b"skx", _AVX2 | _AVX512),
    (b"haswell", _AVX2),
    (b"x86-64", set()),
)


# Records that have been looked at, so that a process reads its memory once for each device.
_seen: set[int] = set()


def name_unknown_cpu(device: DeviceInfo) -> None:
    """Give a device of PoCL 3.0 whose compiler does not know the processor the name of a similar one.

    Without effect on any other device, and on one that has been given a name.
    """
    if not (device.driver_version.startswith("3.0") and _UNKNOWN_CPU.search(device.version)):
        return
    record = device.cl_device.int_ptr
    if record in _seen:
        return
    address = _find_name(record)
    if address is not None:
        ctypes.memmove(address, choose_name(_read_flags()) + b"\0", len(_UNKNOWN))
    _seen.add(record)


def choose_name(flags: set[str]) -> bytes:
    """Return the name for a processor with these flags of /proc/cpuinfo, padded to the length of "generic"."""
    name = next(name for name, needed in _NAMES if needed <= flags)
    return name.ljust(len(_UNKNOWN) - 1, b"\0")


def _find_name(record: int) -> int | None:
    """Return the address of the word "generic" in the record of a device; None if it is not there just once."""
    try:
        # Reads through the file fail where a plain one would end the process.
        with Path("/proc/self/mem").open("rb", buffering=0) as memory:
            fields = _read(memory, record, _RECORD_BYTES)
            pointers = struct.unpack_from(f"<{len(fields) // 8}Q", fields)
            found = {pointer for pointer in pointers if _read(memory, pointer, len(_UNKNOWN)) == _UNKNOWN}
    except OSError:
        return None
    return found.pop() if len(found) == 1 else None


def _read(memory: IO[bytes], address: int, size: int) -> bytes:
    """Return some of this process's memory; nothing where there is none."""
    try:
        memory.seek(address)
        return memory.read(size)
    except (OSError, OverflowError):
        return b""


def _read_flags() -> set[str]:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return set()
    return next((set(line.split(":")[1].split()) for line in lines if line.startswith("flags")), set())
