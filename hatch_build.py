"""What is made when a package is built: the compiled kernels, the project's addresses, a README for a package index.

The kernels are compiled for the processor of this machine. With `CLBVH_HOST_TARGET`, a name in
clbvh/device/host/targets.py or `own`, they are compiled for all machines of that target, wherever the build runs. On
other systems than Linux a package without a target has no kernels, and needs a driver.

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
TARGET_VARIABLE = "CLBVH_HOST_TARGET"

_PICTURE = re.compile(r"!\[([^\]]*)\]\(([^)\s]+)\)")
# The text of a link may go over the end of a line.
_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)\s]+)\)")


class CustomBuildHook(BuildHookInterface):
    """Compiles the kernels for the host."""

    def dependencies(self) -> list[str]:
        """Return what brings a compiler, unless there is one."""
        if self.target_name != "wheel":
            return []
        compiler = self._compiler()
        is_lacking = compiler.find_own_target() is not None and compiler.find_compiler() is None
        return ["ziglang>=0.14"] if is_lacking or os.environ.get(TARGET_VARIABLE) else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and say what the package holds and where it runs."""
        compiler, asked = self._compiler(), os.environ.get(TARGET_VARIABLE)
        target = compiler.find_target(None if asked == "own" else asked) if asked else compiler.find_own_target()
        if target is None:
            return
        place = f"clbvh/compiled/{target.library_name}"
        if asked:
            # Not into the package: the checkout's own library stays.
            path = Path(self.root) / "out" / "targets" / target.name / target.library_name
            compiler.build_library(path, compiler.find_objects(), target=target)
            build_data["force_include"][str(path)] = place
        else:
            compiler.build_library(Path(self.root) / place, compiler.find_objects(), [compiler.find_level()])
            build_data["artifacts"].append(f"/{place}")
        build_data["tag"] = f"py3-none-{target.tag if asked else f'linux_{target.machine}'}"
        build_data["pure_python"] = False

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
