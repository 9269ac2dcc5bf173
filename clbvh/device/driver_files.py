"""The files of OpenCL drivers: those that register them, and the folder in which PoCL compiles.

The loader reads small files, `*.icd`, each of which names the library of one driver, by the rules of ocl-icd, the
loader in the wheels of pyopencl (manual page libOpenCL(7)); that copy also reads `pyopencl/.libs`, where PoCL is. Users
register further drivers for clbvh alone (`clbvh doctor --fix`): at its first call, the only one at which the loader
reads its environment, it is led to a temporary folder with the system's files and theirs. No library is loaded here.
"""

from __future__ import annotations

import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from platformdirs import user_cache_dir, user_config_dir

from ..support.folders import find_cache, find_users_folder, is_writable, say_unusable

SYSTEM_VENDORS = Path("/etc/OpenCL/vendors")
DRIVERS_VARIABLE = "CLBVH_DRIVERS"
POCL_VARIABLE = "POCL_CACHE_DIR"

# Variables that name the drivers of a process, in the order in which the loader reads them.
VENDOR_VARIABLES = ("OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH")

_first_call = threading.RLock()
_callers: list[bool] = []  # one item, once the loader has read its environment
_temporary: list[tempfile.TemporaryDirectory[str]] = []  # one item at most, which is removed when this process ends


@dataclass(frozen=True)
class DriverFile:
    """A file that registers a driver; `library` is the name under which it is loaded, empty if it cannot be read."""

    path: Path
    library: str

    @property
    def names(self) -> set[str]:
        """The file names of the library and of what it links to."""
        return {Path(self.library).name, Path(self.library).resolve().name}


def find_registered_folder() -> Path:
    """Return the folder of the drivers that are registered for clbvh, or `CLBVH_DRIVERS`; it need not exist."""
    if folder := os.environ.get(DRIVERS_VARIABLE):
        return Path(folder)
    return (find_users_folder(user_config_dir) or find_cache()) / "drivers"


def find_bundled_folder() -> Path | None:
    """Return `pyopencl/.libs` if the installed pyopencl has its own loader there; imports nothing."""
    spec = find_spec("pyopencl")
    folder = Path(spec.origin).parent / ".libs" if spec is not None and spec.origin else None
    return folder if folder is not None and any(folder.glob("libOpenCL*")) else None


def find_naming_variable() -> str:
    """Return the environment variable that names the drivers of this process; empty without one."""
    return next((variable for variable in VENDOR_VARIABLES if os.environ.get(variable)), "")


def find_folders() -> list[Path]:
    """Return the folders whose driver files are read; they need not exist."""
    bundled = find_bundled_folder()
    if variable := find_naming_variable():
        folders = [Path(os.environ[variable])]
        if variable == VENDOR_VARIABLES[0] and not folders[0].is_dir():
            return []  # the loader takes it for the only driver
    else:
        # The loader of a conda environment looks there.
        system = SYSTEM_VENDORS if bundled else Path(sys.prefix) / "etc/OpenCL/vendors"
        folders = [system if system.is_dir() else SYSTEM_VENDORS, find_registered_folder()]
    return [*folders, bundled] if bundled else folders


def read_driver_files() -> list[DriverFile]:
    """Return the driver files that are read, folder after folder, in alphabetical order."""
    folders = find_folders()
    if not folders:
        only = Path(os.environ[VENDOR_VARIABLES[0]])
        return [_read(only) if only.suffix == ".icd" else DriverFile(only, str(only))]
    return [_read(path) for folder in folders for path in sorted(folder.glob("*.icd"))]


# Drivers that serve CPUs alone. Mesa's are not listed: distributions choose the GPUs that they serve.
_OF_PROCESSORS = ("libpocl", "libintelocl", "liboclgrind")


def may_serve_gpus() -> bool:
    """Return whether a driver is registered that may serve something else than the processor; no library is loaded."""
    if sys.platform != "linux":  # loaders find drivers without files
        return find_spec("pyopencl") is not None
    libraries = (Path(file.library).name for file in read_driver_files() if file.library)
    return any(not name.startswith(_OF_PROCESSORS) for name in libraries)


def _read(path: Path) -> DriverFile:
    try:
        # Like the loader, cut off only the end of the line: to it a stray blank is part of the name.
        library = path.read_bytes().decode(errors="replace").split("\n", 1)[0]
    except OSError:
        return DriverFile(path, "")
    # The bundled loader finds its neighbours.
    is_beside = bool(library) and path.parent == find_bundled_folder() and (path.parent / library).is_file()
    return DriverFile(path, str(path.parent / library) if is_beside else library)


def find_added() -> list[DriverFile]:
    """Return the drivers registered for clbvh that exist and that the loader does not find by itself."""
    own = find_registered_folder()
    if find_naming_variable() or not any(own.glob("*.icd")):
        return []
    files = read_driver_files()
    known = {name for file in files if file.path.parent != own for name in file.names}
    added = []
    for file in files:
        is_there = Path(file.library).is_absolute() and Path(file.library).is_file()
        if file.path.parent == own and is_there and not file.names & known:
            known |= file.names
            added.append(file)
    return added


@contextmanager
def added_drivers() -> Iterator[None]:
    """Make the loader find the drivers registered for clbvh, if its first call is inside this context."""
    with _first_call, ExitStack() as stack:
        # If a file cannot be read or the folder cannot be made, the loader still has the drivers of the system.
        with suppress(OSError):
            if not _callers and (added := find_added()):
                folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="clbvh-drivers-"))
                beside = (find_registered_folder(), find_bundled_folder())
                system = [file for file in read_driver_files() if file.path.parent not in beside]
                for number, file in enumerate([*system, *added]):
                    # The number keeps the order, and keeps two files of one name apart.
                    (Path(folder) / f"{number:03}-{file.path.name}").write_text(f"{file.library}\n")
                # It is empty or not set: `find_added` finds nothing where it names drivers.
                os.environ[VENDOR_VARIABLES[0]] = folder
                stack.callback(os.environ.pop, VENDOR_VARIABLES[0])
        yield
        _callers[:] = [True]


@cache
def prepare_pocl_folder() -> None:
    """Give PoCL a folder if its own cannot be written to: in clbvh's cache, or else one that lives with this process.

    PoCL compiles in its cache and offers no device without one. It reads the environment when it is loaded.
    """
    if os.environ.get(POCL_VARIABLE) == "":
        del os.environ[POCL_VARIABLE]  # PoCL would take it for a name
    if find_users_folder(user_cache_dir) is None:
        # PyOpenCL keeps launchers of kernels there, too, and fails without.
        os.environ["XDG_CACHE_HOME"] = str(find_cache())
    # A folder that the user has named is the user's business, also where it is wrong: `clbvh doctor` finds that.
    home = os.environ.get("XDG_CACHE_HOME") or (os.environ.get("HOME") and f"{os.environ['HOME']}/.cache")
    if os.environ.get(POCL_VARIABLE) or (home and is_writable(Path(home) / "pocl")):
        return
    folder = find_cache()
    with suppress(OSError):  # without any folder the driver says what it lacks
        if not is_writable(folder):
            say_unusable(folder)
            _temporary.append(tempfile.TemporaryDirectory(prefix="clbvh-"))
            folder = Path(_temporary[0].name)
            # PyOpenCL keeps launchers of kernels there, and warns where it cannot.
            os.environ["XDG_CACHE_HOME"] = str(folder)
        (folder / "pocl").mkdir(exist_ok=True)
        os.environ[POCL_VARIABLE] = str(folder / "pocl")
