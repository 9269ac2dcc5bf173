"""The platforms that the library for the host is compiled for, one record each.

The code in a library calls nothing but its system's C library, so that one wheel serves every Python there.
"""

from __future__ import annotations

import platform
import sys
from collections.abc import Mapping
from typing import NamedTuple

from ...errors import ConfigError

# The levels of each kind of processor, from the lowest up, and what the compiler calls them.
_X86_LEVELS = {"v2": "x86-64-v2", "v3": "x86-64-v3", "v4": "x86-64-v4"}
_ARM_LEVELS = {"neon": "armv8-a"}


class Target(NamedTuple):
    """A platform.

    Attributes
    ----------
    name : str
    system, machine : str
        As `sys.platform` and `find_machine` return them there.
    triple : str
        As clang names it.
    levels : mapping of str to str
        Levels of processor, from the lowest up, and what the compiler calls them.
    ending : str
        Of the library's name.
    tag : str
        Platform tags of a wheel.
    zig : str
        As `zig cc` names it, with the oldest version of the system.
    options : tuple of str
        Of compilations.
    links : tuple of str
        Options of `zig cc` when it links.
    """

    name: str
    system: str
    machine: str
    triple: str
    levels: Mapping[str, str]
    ending: str
    tag: str
    zig: str
    options: tuple[str, ...] = ()
    links: tuple[str, ...] = ()

    @property
    def library_name(self) -> str:
        """The name of the library's file."""
        return f"host-{self.machine}{self.ending}"


def _linux(machine: str, levels: Mapping[str, str]) -> Target:
    # The names libm.so.6 and libc.so.6 stand for the C library on musl, too, and versions of symbols for nothing there.
    tag = f"manylinux_2_17_{machine}.musllinux_1_1_{machine}"
    triple = f"{machine}-linux-gnu"
    return Target(f"linux-{machine}", "linux", machine, triple, levels, ".so", tag, f"{triple}.2.17")


def _macos(name: str, machine: str, levels: Mapping[str, str]) -> Target:
    triple, zig = f"{name}-apple-macosx11.0", f"{machine}-macos.11.0"
    options = ("-fno-stack-protector",)  # as on other systems
    links = (f"-Wl,-install_name,@rpath/host-{machine}.dylib",)  # not the path where it was linked
    tag = f"macosx_11_0_{name}"
    return Target(f"macos-{name}", "darwin", machine, triple, levels, ".dylib", tag, zig, options, links)


TARGETS = (
    _linux("x86_64", _X86_LEVELS),
    _linux("aarch64", _ARM_LEVELS),
    _macos("arm64", "aarch64", _ARM_LEVELS),
    # Without v4: macOS enables the registers of AVX-512 at their first use, and a processor seems to lack them before.
    _macos("x86_64", "x86_64", {level: _X86_LEVELS[level] for level in ("v2", "v3")}),
    Target(
        "windows-x86_64", "win32", "x86_64", "x86_64-w64-windows-gnu", _X86_LEVELS, ".dll", "win_amd64",
        "x86_64-windows-gnu",
        # No start files: they bring a console, locks and threads. Of the C library, which every Python has, the heap.
        links=("-nostdlib", "-lcompiler_rt", "-lucrtbase"),
    ),
)  # fmt: skip


def find_machine() -> str:
    """Return the kind of this machine's processor, as compilers name it."""
    name = platform.machine().lower()
    return {"amd64": "x86_64", "arm64": "aarch64"}.get(name, name)


def find_target(name: str | None = None) -> Target | None:
    """Return the target of a name, or this machine's, which may be None.

    Raises
    ------
    ConfigError
        There is no target of that name.
    """
    if name is None:
        here = sys.platform, find_machine()
        return next((target for target in TARGETS if (target.system, target.machine) == here), None)
    for target in TARGETS:
        if target.name == name:
            return target
    raise ConfigError(f"there is no target {name}, but {', '.join(target.name for target in TARGETS)}")
