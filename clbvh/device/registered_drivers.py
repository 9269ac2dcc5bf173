"""Drivers that the user has registered for clbvh, and how the loader finds them.

The loader reads one folder of `.icd` files: the system's, or the one that a variable names. A user without write access
to the system's folder registers a driver in clbvh's own (`clbvh doctor --fix`). For the first call of the loader, clbvh
sets that variable to a temporary folder with the files of both, and resets it after the call: the loader reads its
environment only once. Other programs and child processes never see the variable.
"""

from __future__ import annotations

import os
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import ClassVar

from platformdirs import user_config_dir

from .icd_files import VENDOR_VARIABLES, IcdFile, LoaderRule, find_bundled_folder, find_icd_files, read_loader_rule

DRIVERS_VARIABLE = "CLBVH_DRIVERS"

# The loader of Khronos, which is used on Windows, reads more libraries from this variable.
KHRONOS_VARIABLE = "OCL_ICD_FILENAMES"


class _Loader:
    """Whether the loader has been called; one thread at a time changes the environment."""

    is_called: ClassVar[bool] = False
    lock: ClassVar[threading.RLock] = threading.RLock()


def find_registered_folder() -> Path:
    """Return the folder of the drivers that are registered for clbvh, or `CLBVH_DRIVERS`; it need not exist."""
    if folder := os.environ.get(DRIVERS_VARIABLE):
        return Path(folder)
    return Path(user_config_dir("clbvh", appauthor=False)) / "drivers"


def read_rule() -> LoaderRule:
    """Return where clbvh's loader looks for drivers in this environment."""
    return read_loader_rule(os.environ, find_bundled_folder(), registered=find_registered_folder())


def find_offered(rule: LoaderRule) -> list[IcdFile]:
    """Return the registered drivers that clbvh offers to the loader.

    Only those whose library exists and that the loader does not find by itself: it would list their devices twice.
    """
    if rule.registered is None:
        return []
    found = find_icd_files(rule)
    # A name without a folder, as in Debian's files, can be compared with the end of a path only.
    known = {_resolve(icd.loadable_name(rule)) for icd in found if icd.path.parent != rule.registered}
    offered = []
    for icd in found:
        library = Path(icd.library)
        names = {str(library.resolve()), library.name, library.resolve().name}
        if icd.path.parent == rule.registered and library.is_absolute() and library.is_file() and not names & known:
            known.add(str(library.resolve()))
            offered.append(icd)
    return offered


@contextmanager
def registered_drivers() -> Iterator[None]:
    """Make the loader find the registered drivers, if its first call is inside this context."""
    if _Loader.is_called:
        yield
        return
    with _Loader.lock, ExitStack() as stack:
        # If a file cannot be read or the folder cannot be made, the loader still has the drivers of the system.
        with suppress(OSError):
            rule = read_rule()
            offered = find_offered(rule)
            if offered and sys.platform == "win32":
                value = _join(os.environ.get(KHRONOS_VARIABLE, ""), offered)
                stack.enter_context(_variable(KHRONOS_VARIABLE, value))
            elif offered:
                folder = stack.enter_context(_merged_folder(rule, offered))
                stack.enter_context(_variable(VENDOR_VARIABLES[0], folder))
        yield


def note_loader_call() -> None:
    """Note that the loader has read its environment: it will not do so again."""
    _Loader.is_called = True


def _resolve(library: str) -> str:
    return str(Path(library).resolve()) if "/" in library else library


def _join(named: str, offered: Sequence[IcdFile]) -> str:
    return os.pathsep.join(filter(None, [named, *(icd.library for icd in offered)]))


@contextmanager
def _merged_folder(rule: LoaderRule, offered: Sequence[IcdFile]) -> Iterator[str]:
    """Make a temporary folder with the driver files of the system and the offered ones."""
    own = (rule.registered, rule.bundled)
    files = [icd for icd in find_icd_files(rule) if icd.path.parent not in own]
    with tempfile.TemporaryDirectory(prefix="clbvh-drivers-") as folder:
        for number, icd in enumerate([*files, *offered]):
            # The number keeps the order, and keeps two files of one name apart.
            (Path(folder) / f"{number:03}-{icd.path.name}").write_text(f"{icd.library}\n")
        yield folder


@contextmanager
def _variable(name: str, value: str) -> Iterator[None]:
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = before
