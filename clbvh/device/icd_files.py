"""The files that register OpenCL drivers (`*.icd`), read by the rules of the loader.

An OpenCL program loads `libOpenCL`, the loader. The loader reads small files, `*.icd`, each of which names the
library of one driver. No library is loaded here.

The rules are those of ocl-icd, the loader inside the wheels of pyopencl (manual page libOpenCL(7)). That copy
also reads `pyopencl/.libs`, where the package `pocl-binary-distribution` puts PoCL, unless `OCL_ICD_VENDORS`
names a single driver instead of a folder (seen with pyopencl 2026.1.4, by OCL_ICD_DEBUG=15).
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

SYSTEM_VENDORS = Path("/etc/OpenCL/vendors")

# In the order in which the loader reads them.
VENDOR_VARIABLES = ("OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH")


@dataclass(frozen=True)
class LoaderRule:
    """The places that the loader reads.

    Attributes
    ----------
    folders : tuple of Path
        Their `*.icd` files are read. They need not exist.
    single : str
        The only driver, a `.icd` file or a library, if `OCL_ICD_VENDORS` names one; else empty.
    variable : str
        The environment variable that decides, or empty.
    bundled : Path or None
        The folder inside the `pyopencl` package, if the wheel brought a loader.
    registered : Path or None
        The folder that clbvh itself offers to the loader (`registered_drivers.py`), if no variable forbids it.
    """

    folders: tuple[Path, ...]
    single: str = ""
    variable: str = ""
    bundled: Path | None = None
    registered: Path | None = None


@dataclass(frozen=True)
class IcdFile:
    """A file that registers a driver; `library` is the name in it, empty if it cannot be read."""

    path: Path
    library: str

    def loadable_name(self, rule: LoaderRule) -> str:
        """Return the name under which the loader opens the library."""
        beside = self.path.parent / self.library
        # Only the bundled loader finds its neighbours, by its run path.
        if self.path.parent == rule.bundled and "/" not in self.library and beside.is_file():
            return str(beside)
        return self.library


def find_bundled_folder() -> Path | None:
    """Return `pyopencl/.libs` if the installed pyopencl has its own loader there; imports nothing."""
    spec = find_spec("pyopencl")
    if spec is None or spec.origin is None:
        return None
    folder = Path(spec.origin).parent / ".libs"
    return folder if any(folder.glob("libOpenCL*")) else None


def read_loader_rule(
    environment: Mapping[str, str] = os.environ,
    bundled: Path | None = None,
    prefix: str = sys.prefix,
    registered: Path | None = None,
) -> LoaderRule:
    """Return where the loader looks for drivers.

    Parameters
    ----------
    environment : mapping
        The environment variables.
    bundled : Path, optional
        The result of `find_bundled_folder`.
    prefix : str
        Root of the Python environment: the loader of a conda environment looks there instead of in `/etc`.
    registered : Path, optional
        The folder of the drivers that are registered for clbvh.
    """
    default = SYSTEM_VENDORS
    if bundled is None and (Path(prefix) / "conda-meta").is_dir():
        default = Path(prefix) / "etc/OpenCL/vendors"
    bundled_folders = () if bundled is None else (bundled,)

    vendors, vendor_path = (environment.get(variable, "") for variable in VENDOR_VARIABLES)
    if vendors and not Path(vendors).is_dir():
        return LoaderRule((), vendors, VENDOR_VARIABLES[0], bundled)
    if vendors:
        return LoaderRule((Path(vendors), *bundled_folders), "", VENDOR_VARIABLES[0], bundled)
    if vendor_path:
        return LoaderRule((Path(vendor_path), *bundled_folders), "", VENDOR_VARIABLES[1], bundled)
    registered_folders = () if registered is None else (registered,)
    return LoaderRule((default, *registered_folders, *bundled_folders), "", "", bundled, registered)


def find_icd_files(rule: LoaderRule) -> list[IcdFile]:
    """Return the `.icd` files that the loader reads, in alphabetical order."""
    if rule.single:
        path = Path(rule.single)
        if path.suffix != ".icd":
            return [IcdFile(path, rule.single)]
        # A bare name is searched among the system's files first.
        in_system = SYSTEM_VENDORS / path
        return [_read_icd(in_system if "/" not in rule.single and in_system.exists() else path)]
    return [_read_icd(path) for folder in rule.folders for path in sorted(folder.glob("*.icd"))]


def _read_icd(path: Path) -> IcdFile:
    try:
        text = path.read_bytes().decode(errors="replace")
    except OSError:
        return IcdFile(path, "")
    # Like the loader, cut off only the end of the line: to it a stray blank is part of the name.
    return IcdFile(path, text.split("\n", 1)[0])
