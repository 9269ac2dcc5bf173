"""A name that PoCL's compiler knows, for a processor newer than it. Goes with the first newer wheel of PoCL on PyPI.

PoCL 3.0 (LLVM 14) calls a processor that it does not know, such as AMD's Zen 5, "generic", and its compiler refuses
that name (https://github.com/pocl/pocl/issues/1049). It has neither an option nor a variable for the name, but keeps it
as text in the record of the device, to which the handle points: this module overwrites the text by the name of an older
processor with the same vector instructions. Nothing is written unless all of it is as expected.
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
_RECORD_BYTES = 1024  # the record is larger; the pointer stands at byte 640

# From the strongest down: names no longer than the replaced word, and the flags that LLVM 14's code for each needs.
_AVX2 = {"avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe", "rdrand"}
_AVX512 = {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "adx", "rdseed", "xsavec", "xsaves"}
_NAMES: tuple[tuple[bytes, set[str]], ...] = ((b"skx", _AVX2 | _AVX512), (b"haswell", _AVX2), (b"x86-64", set()))


def name_unknown_cpu(device: DeviceInfo) -> None:
    """Give a device of PoCL 3.0 whose compiler does not know the processor the name of a similar one."""
    if not (device.driver_version.startswith("3.0") and _UNKNOWN_CPU.search(device.version)):
        return
    try:
        # Reads through the file fail where a plain one would end the process.
        with Path("/proc/self/mem").open("rb", buffering=0) as memory:
            fields = _read(memory, device.cl_device.int_ptr, _RECORD_BYTES)
            pointers = struct.unpack_from(f"<{len(fields) // 8}Q", fields)
            found = {pointer for pointer in pointers if _read(memory, pointer, len(_UNKNOWN)) == _UNKNOWN}
        flags = re.search(r"^flags\s*:(.*)$", Path("/proc/cpuinfo").read_text(errors="replace"), re.MULTILINE)
    except OSError:
        return
    if len(found) == 1:
        ctypes.memmove(found.pop(), choose_name(set(flags[1].split()) if flags else set()) + b"\0", len(_UNKNOWN))


def choose_name(flags: set[str]) -> bytes:
    """Return the name for a processor with these flags of /proc/cpuinfo, padded to the length of "generic"."""
    return next(name for name, needed in _NAMES if needed <= flags).ljust(len(_UNKNOWN) - 1, b"\0")


def _read(memory: IO[bytes], address: int, size: int) -> bytes:
    try:
        memory.seek(address)
        return memory.read(size)
    except (OSError, OverflowError):
        return b""
