"""What is made when a package is built: the compiled kernels, the project's addresses, a README for a package index.

The kernels are compiled for the processor of this machine; with `CLBVH_HOST_LEVELS=all`, for all
levels, as a wheel for others needs them. On other systems than Linux the package has none, and needs a driver.

On an index there is no repository around the README. With `CLBVH_PROJECT_URL`, the address of the published repository,
its links and pictures become absolute, and the metadata names the addresses; without it, links become text and pictures
are left out, so that none is dead.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

URL_VARIABLE = "CLBVH_PROJECT_URL"
LEVELS_VARIABLE = "CLBVH_HOST_LEVELS"

_PICTURE = re.compile(r"!\[([^\]]*)\]\(([^)\s]+)\)")
# The text of a link may go over the end of a line.
_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)\s]+)\)")


class CustomBuildHook(BuildHookInterface):
    """Compiles the kernels for the host."""

    def dependencies(self) -> list[str]:
        """Return what brings a compiler, unless there is one."""
        return [] if not self._is_for_here() or self._compiler().find_compiler() else ["ziglang>=0.14"]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and say what the package holds and where it runs."""
        if not self._is_for_here():
            return
        compiler = self._compiler()
        from clbvh.device.host.variants import library_name

        has_all = os.environ.get(LEVELS_VARIABLE) == "all"
        levels = [*compiler.LEVELS[compiler.machine()]] if has_all else [compiler.find_level()]
        path = f"clbvh/compiled/{library_name()}"
        compiler.build_library(Path(self.root) / path, compiler.find_objects(), levels)
        # Code for all processors of the kind runs on every Linux, since it calls no library; other code runs here.
        system = "manylinux_2_17" if has_all else "linux"
        build_data["tag"] = f"py3-none-{system}_{compiler.machine()}"
        build_data["pure_python"] = False
        build_data["artifacts"].append(f"/{path}")

    def _is_for_here(self) -> bool:
        return self.target_name == "wheel" and sys.platform == "linux" and self._compiler().is_known_machine()

    def _compiler(self) -> Any:
        if self.root not in sys.path:
            sys.path.insert(0, self.root)
        from clbvh.device.host import compile as compiler

        return compiler


class CustomMetadataHook(MetadataHookInterface):
    """Fills in the dynamic fields of pyproject.toml."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set `readme` and `urls`."""
        url = os.environ.get(URL_VARIABLE, "").rstrip("/")
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": make_readable(text, url)}
        metadata["urls"] = make_urls(url)


def make_urls(url: str) -> dict[str, str]:
    """Return the project's addresses; none without that of the repository."""
    if not url:
        return {}
    return {
        "Homepage": url,
        "Documentation": f"{url}/blob/main/docs/README.md",
        "Changelog": f"{url}/blob/main/CHANGELOG.md",
        "Issues": f"{url}/issues",
    }


def make_readable(text: str, url: str) -> str:
    """Return the README as it reads without the repository around it."""

    def picture(found: re.Match[str]) -> str:
        if _is_absolute(found[2]):
            return found[0]
        return f"![{found[1]}]({url}/raw/main/{found[2]})" if url else ""

    def link(found: re.Match[str]) -> str:
        if _is_absolute(found[2]):
            return found[0]
        return f"[{found[1]}]({url}/blob/main/{found[2]})" if url else found[1]

    return re.sub(r"\n{3,}", "\n\n", _LINK.sub(link, _PICTURE.sub(picture, text)))


def _is_absolute(address: str) -> bool:
    return re.match(r"[a-z]+:|#", address) is not None
