"""The pieces of code on the pages: Python blocks, commands of blocks, and commands in the text.

A block is left alone where an HTML comment before it says why: `<!-- not run: needs a network -->`.
"""

import re
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
PAGES = sorted(
    [REPOSITORY / "README.md", REPOSITORY / "CONTRIBUTING.md", *(REPOSITORY / "docs").rglob("*.md")],
    key=lambda path: path.relative_to(REPOSITORY).as_posix(),
)

_FENCED = re.compile(
    r"(?P<reason><!-- not run: (?P<why>[^>]+) -->\n)?^```(?P<language>\w*)[^\n]*\n(?P<text>.*?)^```[ ]*$",
    re.MULTILINE | re.DOTALL,
)
_INDENTED = re.compile(r"(?<=\n\n)((?: {4}[^\n]*\n)+)")
_INLINE = re.compile(r"`(clbvh(?:\s[^`]+)?)`")
_SHELLS = ("", "console", "sh", "bash")


@dataclass(frozen=True)
class Snippet:
    """A block of a page."""

    page: Path
    line: int
    language: str
    text: str
    reason: str | None

    def __str__(self) -> str:
        return f"{self.page.relative_to(REPOSITORY)}:{self.line}"


def find_snippets(page: Path) -> list[Snippet]:
    """Return the blocks of a page, in order: fenced ones, and indented ones, which are commands."""
    text = page.read_text(encoding="utf-8")
    found = [
        Snippet(page, _line(text, match.start("language")) + 1, match["language"], match["text"], match["why"])
        for match in _FENCED.finditer(text)
    ]
    # Lines stay where they are, so that numbers are right.
    rest = _FENCED.sub(lambda match: "\n" * match[0].count("\n"), text)
    found += [
        Snippet(page, _line(rest, match.start()), "", re.sub("^    ", "", match[1], flags=re.MULTILINE), None)
        for match in _INDENTED.finditer(rest)
    ]
    return sorted(found, key=lambda snippet: snippet.line)


def list_commands(snippet: Snippet) -> list[str]:
    """Return the commands of a block, without prompt and comment."""
    if snippet.language not in _SHELLS:
        return []
    lines = snippet.text.replace("\\\n", " ").splitlines()
    return [re.sub(r"\s+#.*", "", line.removeprefix("$ ")).strip() for line in lines]


def find_inline_commands(page: Path) -> list[str]:
    """Return the commands `clbvh ...` in the text of a page."""
    text = _FENCED.sub("", page.read_text(encoding="utf-8"))
    return [re.sub(r"\s+", " ", command) for command in _INLINE.findall(text)]


def _line(text: str, position: int) -> int:
    return text.count("\n", 0, position) + 1
