"""The mutants: one replacement of a text in one file each, and the tests of which one has to fail."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_TABLES = Path(__file__).with_name("tables")


@dataclass(frozen=True)
class Mutant:
    """A row of a table in `tables/`."""

    name: str  # the table and the row in it, from 1 on
    file: str  # from the root of the repository
    text: str  # occurs exactly once in the file
    replacement: str
    breaks: str
    tests: tuple[str, ...]  # paths or node ids

    def apply(self, root: Path) -> None:
        """Plant the fault in the copy of the repository at `root`."""
        path = root / self.file
        path.write_text(path.read_text().replace(self.text, self.replacement))

    def occurrences(self) -> int:
        """Return how often the text occurs in its file."""
        return (ROOT / self.file).read_text().count(self.text)


def read_mutants() -> list[Mutant]:
    """Return the rows of all tables."""
    return [
        Mutant(f"{path.stem}-{number}", **{**row, "tests": tuple(row["tests"])})
        for path in sorted(_TABLES.glob("*.toml"))
        for number, row in enumerate(tomllib.loads(path.read_text())["mutant"], start=1)
    ]
