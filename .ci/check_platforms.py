"""Checks that every package clbvh needs has a wheel for each platform and Python, and prints a table for docs.

`pip download --only-binary=:all:` resolves what pyproject.toml asks for, as on that platform. An extra is checked only
if it is named: `check_platforms.py --extra fast-ply`. Exit code 1 if a wheel is missing.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from packaging.requirements import Requirement

PROJECT = Path(__file__).resolve().parents[1]
PYTHONS = ("3.11", "3.12", "3.13", "3.14")


@dataclass(frozen=True)
class Target:
    """A platform as pip names it, and as the markers of requirements do."""

    name: str
    tags: tuple[str, ...]
    sys_platform: str
    machine: str


def _manylinux(machine: str) -> tuple[str, ...]:
    # pip takes each tag literally: all that a system with glibc 2.28 accepts.
    return (*(f"manylinux_2_{minor}_{machine}" for minor in range(28, 16, -1)), f"manylinux2014_{machine}")


TARGETS = (
    Target("Linux x86-64", _manylinux("x86_64"), "linux", "x86_64"),
    Target("Linux aarch64", _manylinux("aarch64"), "linux", "aarch64"),
    Target("macOS arm64", tuple(f"macosx_{major}_0_arm64" for major in range(14, 10, -1)), "darwin", "arm64"),
    Target("Windows x86-64", ("win_amd64",), "win32", "AMD64"),
)


def read_requirements(target: Target, python: str, extras: Sequence[str], pyproject: Path) -> list[str]:
    """Return what the project needs on a platform: pip evaluates markers for the machine that it runs on."""
    project = tomllib.loads(pyproject.read_text())["project"]
    texts = [*project["dependencies"], *(text for extra in extras for text in project["optional-dependencies"][extra])]
    environment = {
        "sys_platform": target.sys_platform,
        "platform_machine": target.machine,
        "platform_system": {"linux": "Linux", "darwin": "Darwin", "win32": "Windows"}[target.sys_platform],
        "python_version": python,
        "python_full_version": f"{python}.0",
        "implementation_name": "cpython",
    }
    return [
        f"{requirement.name}{requirement.specifier}"
        for requirement in map(Requirement, texts)
        if requirement.marker is None or requirement.marker.evaluate(environment)
    ]


def check(target: Target, python: str, requirements: Sequence[str]) -> str:
    """Download the wheels; return pip's reason if one is missing."""
    platforms = [word for tag in target.tags for word in ("--platform", tag)]
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
        command += ["--only-binary=:all:", "--python-version", python, "--implementation", "cp", *platforms]
        done = subprocess.run([*command, "--dest", folder, *requirements], capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return ""
    errors = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
    missing = re.search(r"No matching distribution found for (\S+)", done.stderr)
    return f"no wheel of {missing[1]}" if missing else errors[-1] if errors else "pip failed"


def main(arguments: Sequence[str] | None = None) -> int:
    """Check all platforms, print the table, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--extra", action="append", default=[], help="check this extra's packages, too")
    parser.add_argument("--python", action="append", default=[], help=f"one of {', '.join(PYTHONS)}; all without it")
    parser.add_argument("--pyproject", type=Path, default=PROJECT / "pyproject.toml")
    options = parser.parse_args(arguments)
    pythons = options.python or PYTHONS
    print("| |" + "".join(f" {python} |" for python in pythons))
    print("|---|" + "---|" * len(pythons))
    is_complete = True
    for target in TARGETS:
        answers = []
        for python in pythons:
            reason = check(target, python, read_requirements(target, python, options.extra, options.pyproject))
            is_complete &= not reason
            answers.append(reason or "yes")
        print(f"| {target.name} | " + " | ".join(answers) + " |", flush=True)
    return 0 if is_complete else 1


if __name__ == "__main__":
    sys.exit(main())
