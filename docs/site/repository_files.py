"""The repository's files outside docs/ as pages of the site: a hook of mkdocs.

Pages link to README, CHANGELOG, CONTRIBUTING and the examples by their paths in the repository, so that the links work
there. Here these files become pages, and the links lead to them. A paragraph that is nothing but the link to a script
becomes the script, and `<!-- settings of View -->` the tables of all settings. The search finds guides first.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

from clbvh.support.settings import list_settings
from clbvh.views.view import View

_REPOSITORY = Path(__file__).parents[2]
_DOCS = "docs/"

# The page of each file, or folder, outside docs/.
_PAGES = {
    "README.md": "overview.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "examples": "recipes/README.md",
    **{f"examples/{path.name}": f"examples/{path.stem}.md" for path in sorted(_REPOSITORY.glob("examples/*.py"))},
}
_FILES = {page: file for file, page in _PAGES.items() if "." in file}

# How much a page counts in the search, by the beginning of its path; guides are all others.
_BOOSTS = {
    **dict.fromkeys(("internals/", "changelog", "results", "study", "conformance", "reliability", "credits"), 0.2),
    **dict.fromkeys(("reference/", "overview", "contributing", "examples/", "README", "ladder", "architecture"), 1.0),
}
_GUIDE_BOOST = 2.0

_FENCED = re.compile(r"^(```|~~~).*?^\1[ ]*$", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"(\]\()([^)\s#:]+)((?:#[^)\s]*)?\))")
_SETTINGS = "<!-- settings of View -->"
_LONE_SCRIPT = re.compile(r"^\[`?(examples/\w+\.py)`?\]\([./]*examples/\w+\.py\)$", re.MULTILINE)


def on_files(files: Files, config: Any) -> Files:
    """Add the pages of files that are outside docs/."""
    for page, file in _FILES.items():
        text = (_REPOSITORY / file).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=text if file.endswith(".md") else _show_script(file)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Show scripts, lead links to pages of the site, and say how much the page counts in the search."""
    source = page.file.src_uri
    boost = next((boost for begin, boost in _BOOSTS.items() if source.startswith(begin)), _GUIDE_BOOST)
    page.meta.setdefault("search", {})["boost"] = boost
    markdown = _LONE_SCRIPT.sub(lambda match: _fence_script(match[1]), markdown)
    markdown = markdown.replace(_SETTINGS, _tabulate_settings())
    folder = posixpath.dirname(_FILES.get(source, _DOCS + source))
    pieces, end = [], 0
    for fenced in _FENCED.finditer(markdown):
        pieces += [_lead_links(markdown[end : fenced.start()], folder, source), fenced[0]]
        end = fenced.end()
    return "".join([*pieces, _lead_links(markdown[end:], folder, source)])


def _lead_links(text: str, folder: str, source: str) -> str:
    """Replace paths from a folder of the repository by paths from a page; leave others as they are."""

    def lead(match: re.Match[str]) -> str:
        path = posixpath.normpath(posixpath.join(folder, match[2]))
        page = _PAGES.get(path, path.removeprefix(_DOCS) if path.startswith(_DOCS) else None)
        if page is None:
            return match[0]
        return match[1] + posixpath.relpath(page, posixpath.dirname(source) or ".") + match[3]

    return _LINK.sub(lead, text)


def _show_script(file: str) -> str:
    return f"# {file}\n\n{_fence_script(file)}\n"


def _fence_script(file: str) -> str:
    return f'```python title="{file}"\n{(_REPOSITORY / file).read_text(encoding="utf-8")}```'


def _tabulate_settings() -> str:
    """Return one table of settings for each panel of the command line's help, from the fields of `View`."""
    tables: dict[str, list[str]] = {}
    for each in list_settings(View):
        name = f"`{each.name}`" if each.is_option else f"`{each.name}`, no option"
        cells = (name, each.help, f"{each.kind.text}; default: {each.shown or f'`{each.default}`'}")
        row = " | ".join(cell.replace("|", r"\|") for cell in cells)
        tables.setdefault(each.panel, []).append(f"| {row} |")
    head = "| setting | | must be |\n|---|---|---|\n"
    return "\n\n".join(f"## {panel}\n\n{head}" + "\n".join(rows) for panel, rows in tables.items())
