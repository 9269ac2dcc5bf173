"""What PoCL 3.0, the wheel of PyPI, needs before it compiles a kernel: a linker, and a processor whose name it knows.

It links every kernel with the system's `ld`, gcc's libgcc and libc's development files, and aborts the process without
them; also where its cache has kernels, since each new size of work-groups is linked anew. Its compiler (LLVM 14) calls
a processor that it does not know, such as AMD's Zen 5, "generic", and then refuses that name
(https://github.com/pocl/pocl/issues/1049). There is neither an option nor a variable for the name, but PoCL keeps it as
text in the record of the device, to which the handle points: this module overwrites the text by the name of an older
processor with the same vector instructions. Nothing is written unless all of it is as expected.

To be removed with the first newer wheel.
"""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import struct
from functools import cache
from pathlib import Path
from typing import IO

from ..errors import DeviceError
from .info import DeviceInfo

# The PoCL of other packages has another version, and needs another linker or none.
_VERSION = "3.0-rc2"

# Where its compiler looks for gcc and for libraries.
_GCC_PREFIXES = ("/usr", "/usr/local", "/opt/rh/gcc-toolset-10/root/usr")
_LIBRARY_FOLDERS = ("/usr/lib/x86_64-linux-gnu", "/lib/x86_64-linux-gnu", "/usr/lib64", "/lib64", "/usr/lib", "/lib")

_UNKNOWN = b"generic\0"
_UNKNOWN_CPU = re.compile(r"PoCL.*x86_64.*linux.*-generic$")
_RECORD_BYTES = 1024  # the record is larger; the pointer stands at byte 640

# From the strongest down: names no longer than the replaced word, and the flags that LLVM 14's code for each needs.
_AVX2 = {"avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe", "rdrand"}
_AVX512 = {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "adx", "rdseed", "xsavec", "xsaves"}
_NAMES: tuple[tuple[bytes, set[str]], ...] = ((b"skx", _AVX2 | _AVX512), (b"haswell", _AVX2), (b"x86-64", set()))


def prepare_pocl_3(device: DeviceInfo) -> None:
    """Let a device of PoCL 3.0 compile kernels; all others are left alone.

    Raises
    ------
    DeviceError
        The system has no linker.
    """
    if device.driver_version != _VERSION:
        return
    if missing := _find_missing():
        raise DeviceError(
            f"PoCL 3.0 cannot compile kernels without {', '.join(missing)}: install gcc, or use the host instead"
        )
    if _UNKNOWN_CPU.search(device.version):
        _name_processor(device.cl_device.int_ptr)


@cache
def _find_missing() -> list[str]:
    programs = [os.environ.get("PATH", ""), "/usr/local/bin", *map(str, Path("/usr").glob("x86_64*linux*/bin"))]
    libraries = [*filter(None, os.environ.get("LIBRARY_PATH", "").split(os.pathsep)), *_LIBRARY_FOLDERS]
    gcc = "lib*/gcc/x86_64*linux*/*/libgcc.a"
    is_there = {
        "the linker `ld`": shutil.which("ld", path=os.pathsep.join(programs)) is not None,
        "gcc's `libgcc`": _has("libgcc.a", libraries) or any(any(Path(root).glob(gcc)) for root in _GCC_PREFIXES),
        "libc's development files": _has("libc.so", libraries),
    }
    return [name for name, found in is_there.items() if not found]


def _has(name: str, folders: list[str]) -> bool:
    return any((Path(folder) / name).is_file() for folder in folders)


def _name_processor(record: int) -> None:
    """Overwrite the name of an unknown processor in the record at this address."""
    try:
        # Reads through the file fail where a plain one would end the process.
        with Path("/proc/self/mem").open("rb", buffering=0) as memory:
            fields = _read(memory, record, _RECORD_BYTES)
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
