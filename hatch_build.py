"""Metadata that is computed when a package is built: the project's addresses, and a README for a package index.

On an index there is no repository around the README. With `CLBVH_PROJECT_URL`, the address of the published repository,
its links and pictures become absolute, and the metadata names the addresses; without it, links become text and pictures
are left out, so that none is dead.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

URL_VARIABLE = "CLBVH_PROJECT_URL"

_PICTURE = re.compile(r"!\[([^\]]*)\]\(([^)\s]+)\)")
# The text of a link may go over the end of a line.
_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)\s]+)\)")


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
