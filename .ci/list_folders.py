"""Writes the lists of clbvh's folders into CONTRIBUTING.md and docs/architecture.md.

The order is that of the import contract in pyproject.toml, from the lowest layer up; the texts are the first sentences
of the packages' docstrings. ``python .ci/list_folders.py`` writes both lists, and a test compares them.
"""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
# The lists stand between these lines of the pages.
BEGIN, END = "<!-- folders: begin -->", "<!-- folders: end -->"

_CONTRACT = "Data flows one way through the house"


def list_folders() -> dict[str, str]:
    """Return the first sentence of each folder and module of the contract, by its path, from the lowest layer up."""
    settings = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    layers = next(contract["layers"] for contract in contracts if contract["name"] == _CONTRACT)
    modules = [module for layer in reversed(layers) for module in layer.split(" | ")]
    return dict(_describe(module) for module in modules)


def _describe(module: str) -> tuple[str, str]:
    """Return the path of a module and the first sentence of its docstring."""
    path = REPOSITORY.joinpath(*module.split("."))
    is_folder = path.is_dir()
    source = path / "__init__.py" if is_folder else path.with_suffix(".py")
    docstring = ast.get_docstring(ast.parse(source.read_text("utf-8"))) or ""
    sentence = docstring.split("\n\n")[0].replace("\n", " ").split(". ")[0].removesuffix(".")
    return module.replace(".", "/") + ("/" if is_folder else ".py"), sentence


def write_pages() -> dict[Path, str]:
    """Return the text of each page with its list."""
    folders = list_folders()
    width = max(map(len, folders)) + 2
    lines = [f"{path:<{width}}{sentence}" for path, sentence in folders.items()]
    rows = [f"| `{path}` | {sentence} |" for path, sentence in folders.items()]
    lists = {
        "CONTRIBUTING.md": ["```text", *lines, "```"],
        "docs/architecture.md": ["| folder | contents |", "|---|---|", *rows],
    }
    pages = {}
    for name, block in lists.items():
        page = REPOSITORY / name
        text = page.read_text("utf-8")
        pages[page] = "\n".join([text.split(BEGIN)[0] + BEGIN, *block, END + text.split(END)[1]])
    return pages


if __name__ == "__main__":
    for page, text in write_pages().items():
        page.write_text(text, "utf-8")
