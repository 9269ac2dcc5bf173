"""Registers drivers for clbvh that are installed without a driver file: `clbvh doctor --fix`.

Each driver is tried first, in a process whose only driver it is. Files are written and removed in the folder of
`registered_drivers.py` alone; removing a file undoes its registration.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ...errors import ConfigError
from ...support.atomic_file import write_atomically
from ..icd_files import VENDOR_VARIABLES, IcdFile, LoaderRule, find_icd_files
from ..registered_drivers import KHRONOS_VARIABLE, find_registered_folder, read_rule
from . import drivers
from .drivers import FoundLibrary
from .probe import run_probe

# Libraries of Intel's compiler, which the package of Intel's runtime does not require.
_NEEDS = dict.fromkeys(
    ("libimf", "libsvml", "libirng", "libintlc"), ": it comes with `pip install intel-cmplr-lib-rt`, beside the driver"
)

Action = Literal["write", "remove", "leave"]


@dataclass(frozen=True)
class Step:
    """One file to write or to remove, or a driver that is left alone.

    Attributes
    ----------
    action : {"write", "remove", "leave"}
    path : Path
        The driver file.
    library : str
        The library that it names.
    reason : str
        The devices that work with it, or why it is removed or left alone.
    """

    action: Action
    path: Path
    library: str
    reason: str

    def as_dict(self) -> dict[str, Any]:
        """Return the step as JSON has it."""
        return {"action": self.action, "path": str(self.path), "library": self.library, "reason": self.reason}


def plan_registrations(timeout_s: float) -> list[Step]:
    """Find the drivers of this machine that no driver file names, and try them; nothing is written.

    Parameters
    ----------
    timeout_s : float
        Time limit for each answer of a driver.

    Raises
    ------
    ConfigError
        A variable names the drivers of this process, so clbvh's own folder is not read.
    """
    rule = read_rule()
    if rule.variable:
        raise ConfigError(
            f"{rule.variable} is set, so no driver that is registered for clbvh is read: unset it, then run "
            "`clbvh doctor --fix` again"
        )
    icd_files = find_icd_files(rule)
    libraries = drivers.find_libraries(drivers.usual_folders(), drivers.read_library_cache())
    found = plan_removals(icd_files, rule)
    return found + [_plan(library, timeout_s) for library in find_unregistered(libraries, icd_files, found)]


def find_unregistered(
    libraries: Sequence[FoundLibrary], icd_files: Sequence[IcdFile], removed: Sequence[Step] = ()
) -> list[FoundLibrary]:
    """Return the drivers that no driver file names, not counting the files that will be removed."""
    gone = {step.path for step in removed}
    kept = [icd for icd in icd_files if icd.path not in gone]
    named = {driver.stem for icd in kept if (driver := drivers.match_driver(icd.library)) is not None}
    paths = {icd.library for icd in kept}
    return [library for library in libraries if library.driver.stem not in named and str(library.path) not in paths]


def plan_removals(icd_files: Sequence[IcdFile], rule: LoaderRule) -> list[Step]:
    """Return the files in clbvh's own folder whose library is gone."""
    own = [icd for icd in icd_files if icd.path.parent == rule.registered]
    return [
        Step("remove", icd.path, icd.library, "its library is not there any more")
        for icd in own
        if not Path(icd.library).is_file()
    ]


def carry_out(steps: Sequence[Step]) -> None:
    """Write and remove the files of a plan.

    Raises
    ------
    ConfigError
        The folder cannot be written to.
    """
    for step in steps:
        try:
            if step.action == "write":
                step.path.parent.mkdir(parents=True, exist_ok=True)
                text = f"{step.library}\n".encode()
                write_atomically(step.path, lambda file, text=text: file.write(text))  # type: ignore[misc]
            elif step.action == "remove":
                step.path.unlink(missing_ok=True)
        except OSError as error:
            raise ConfigError(
                f"{step.path}: cannot be written ({error.strerror or error}): check the folder"
            ) from error


def _plan(library: FoundLibrary, timeout_s: float) -> Step:
    """Try a driver, alone; register it if one of its devices computes correctly."""
    path = find_registered_folder() / library.driver.icd_name
    working, failure = try_library(str(library.path), timeout_s)
    if working:
        return Step("write", path, str(library.path), ", ".join(working))
    return Step("leave", path, str(library.path), failure)


def try_library(library: str, timeout_s: float) -> tuple[list[str], str]:
    """Return the names of the devices of a driver that compute correctly, and the first failure."""
    if "\n" in library:
        return [], "a driver file cannot hold a line break"
    if failure := run_probe("load", library, timeout_s=timeout_s).failure:
        return [], failure + next((hint for name, hint in _NEEDS.items() if name in failure), "")
    with tempfile.TemporaryDirectory(prefix="clbvh-drivers-") as folder:
        icd = Path(folder) / "only.icd"
        icd.write_text(f"{library}\n")
        # A file, not its folder: the loader takes it for the only driver, and skips those beside its own library.
        environment = {VENDOR_VARIABLES[0]: str(icd)}
        known: list[dict[str, Any]] = []
        if sys.platform == "win32":
            # The loader of Khronos adds it to the drivers of the registry, whose devices are left out below.
            environment = {KHRONOS_VARIABLE: library}
            known = run_probe("list", timeout_s=timeout_s).answer.get("devices", [])
        listing = run_probe("list", timeout_s=timeout_s, environment=environment)
        failure = listing.failure or "; ".join(listing.answer.get("problems", ())) or "it offers no device"
        working = []
        names = [(device["platform"], device["name"]) for device in known]
        for device in listing.answer.get("devices", ()):
            if (device["platform"], device["name"]) in names:
                continue
            result = run_probe("try", str(device["number"]), timeout_s=timeout_s, environment=environment)
            if result.failure:
                failure = f"{device['name']}: {result.failure}"
            else:
                working.append(device["name"])
    return working, failure
