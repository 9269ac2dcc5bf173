"""The linker that PoCL 3.0 of PyPI needs for every kernel: `ld`, with gcc's libgcc and libc's development files.

Without them that driver aborts the process at the first kernel, so its device counts as unavailable, and is refused
when it is opened; also where PoCL's cache has kernels, since each new size of work-groups is linked anew. Goes with the
first newer wheel, which links by itself. `make demo` runs this file before anything is installed: it imports no other.
"""

from __future__ import annotations

import os
import platform
import shutil
import sys
from functools import cache
from pathlib import Path

# The PoCL of other packages has another version, and needs another linker or none.
_POCL_OF_PYPI = "3.0-rc2"

# Prefixes and folders in which the compiler inside PoCL (clang 14) looks for gcc and for libraries.
_GCC_PREFIXES = ("/usr", "/usr/local", "/opt/rh/gcc-toolset-10/root/usr")
_LIBRARY_FOLDERS = ("/usr/lib/x86_64-linux-gnu", "/lib/x86_64-linux-gnu", "/usr/lib64", "/lib64", "/usr/lib", "/lib")

REMEDY = (
    "`apt-get install binutils libc6-dev libgcc-12-dev` (or `gcc`), `dnf install gcc` or `apk add gcc musl-dev`; or "
    "install a driver that needs no linker: `pip install intel-opencl-rt intel-cmplr-lib-rt && clbvh doctor --fix`"
)


def explain_missing_linker(driver_version: str = _POCL_OF_PYPI) -> str:
    """Return one sentence if a driver of this version cannot link kernels on this machine; otherwise nothing."""
    missing = _find_missing() if driver_version == _POCL_OF_PYPI else []
    if not missing:
        return ""
    return f"PoCL 3.0 cannot compile kernels without {', '.join(missing)}: install what is missing, {REMEDY}"


@cache
def _find_missing() -> list[str]:
    programs = [*_split("PATH"), "/usr/local/bin", *map(str, Path("/usr").glob("x86_64*/bin"))]
    libraries = [*_split("LIBRARY_PATH"), *_LIBRARY_FOLDERS]
    gcc = "lib*/gcc/x86_64*linux*/*/libgcc.a"
    is_there = {
        "the linker `ld`": shutil.which("ld", path=os.pathsep.join(programs)) is not None,
        "gcc's `libgcc`": _has("libgcc.a", libraries) or any(any(Path(root).glob(gcc)) for root in _GCC_PREFIXES),
        "libc's development files": _has("libc.so", libraries),
    }
    return [name for name, found in is_there.items() if not found]


def _split(variable: str) -> list[str]:
    return [folder for folder in os.environ.get(variable, "").split(os.pathsep) if folder]


def _has(name: str, folders: list[str]) -> bool:
    return any((Path(folder) / name).is_file() for folder in folders)


if __name__ == "__main__":
    # Another driver, if there is one, needs no linker; on other platforms there is no PoCL of PyPI.
    is_needed = sys.platform == "linux" and platform.machine() == "x86_64"
    if is_needed and not any(Path("/etc/OpenCL/vendors").glob("*.icd")):
        sys.exit(explain_missing_linker() or 0)
