"""Writes the list of clbvh's folders into CONTRIBUTING.md.

The order is that of the import contract in pyproject.toml, from the lowest layer up; the texts are the first sentences
of the packages' docstrings. ``python .ci/list_folders.py`` writes the list, and a test compares it.
"""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
PAGE = REPOSITORY / "CONTRIBUTING.md"
# The list stands between these lines of the page.
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


def write_page() -> str:
    """Return the text of the page with its list."""
    folders = list_folders()
    width = max(map(len, folders)) + 2
    lines = [f"{path:<{width}}{sentence}" for path, sentence in folders.items()]
    text = PAGE.read_text("utf-8")
    return "\n".join([text.split(BEGIN)[0] + BEGIN, "```text", *lines, "```", END + text.split(END)[1]])


if __name__ == "__main__":
    PAGE.write_text(write_page(), "utf-8")
