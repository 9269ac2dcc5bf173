"""How large a study is: its meshes and their names, the sizes of its pictures, and the number of samples.

The experiments ask a scale for their cases; so a quick study is the same experiments with fewer and smaller cases, and
a test's study is a tiny one.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

from ..errors import ClbvhError
from ..geometry import Mesh, load_mesh
from ..geometry.fetch import find_known_mesh
from ..geometry.shapes.make_shape import make_shape

_Choice = TypeVar("_Choice")

# The scans of the report, and their numbers of triangles in the files that `clbvh fetch` brings.
SCANS = {"drill": 1_288, "bunny": 69_451, "dragon": 871_306}

# The procedural mesh in place of a scan.
_STAND_IN = "knot"
# Every procedural mesh of a study is the same each time.
_SEED = 1


@dataclass(frozen=True)
class Scale:
    """The size of a study.

    Attributes
    ----------
    name : str
    rounds : int
        Samples of each case, one in each round.
    least_rounds : int
        Samples that are taken even if a group takes long.
    group_s : float
        Seconds after which a group of cases begins no further round beyond `least_rounds`.
    idle_gap_s : float
        Seconds of rest before another engine is measured, so that the threads of the one before have gone to sleep.
    most_triangles : int
        Larger meshes are replaced by procedural ones of this size.
    shrink : int
        Divisor of the sides of pictures.
    most_meshes : int
        Meshes of a contest of many.
    is_full : bool
        Whether experiments use their whole tables of cases.
    """

    name: str
    rounds: int
    least_rounds: int
    group_s: float
    idle_gap_s: float
    most_triangles: int = 10_000_000
    shrink: int = 1
    most_meshes: int = 100
    is_full: bool = False

    def pick(self, full: _Choice, quick: _Choice) -> _Choice:
        """Return the full or the quick one of two tables."""
        return full if self.is_full else quick

    def picture(self, width: int, height: int) -> tuple[int, int]:
        """Return the size of a picture at this scale."""
        return max(32, width // self.shrink), max(18, height // self.shrink)

    def size_of(self, width: int, height: int) -> str:
        """Return the size of a picture at this scale as text."""
        return " x ".join(map(str, self.picture(width, height)))

    def mesh(self, name: str) -> str:
        """Return the name of a scan, or of the procedural mesh of its size if the scan is missing or too large."""
        if SCANS[name] <= self.most_triangles:
            with suppress(ClbvhError):
                find_known_mesh(name)
                return name
        return self.shape(_STAND_IN, SCANS[name])

    def shape(self, shape: str, triangles: int) -> str:
        """Return the name of a procedural mesh, no larger than this scale has them."""
        return f"{shape}-{min(triangles, self.most_triangles)}"


def scan_of(mesh: str) -> str:
    """Return the scan that a mesh is, or stands for; any other name as it is."""
    stand_ins = {f"{_STAND_IN}-{triangles}": name for name, triangles in SCANS.items()}
    return stand_ins.get(mesh, mesh)


def load_named_mesh(name: str) -> Mesh:
    """Return a mesh by the name that a `Scale` gives it."""
    if name in SCANS:
        return load_mesh(find_known_mesh(name))
    shape, _, triangles = name.rpartition("-")
    return make_shape(shape, triangles=int(triangles), seed=_SEED)


FULL = Scale("full", rounds=9, least_rounds=3, group_s=60, idle_gap_s=0.5, is_full=True)
QUICK = Scale("quick", rounds=5, least_rounds=2, group_s=4, idle_gap_s=0.1)
# For tests: all experiments within seconds.
TINY = Scale("tiny", rounds=2, least_rounds=2, group_s=0, idle_gap_s=0.0, most_triangles=1_500, shrink=16,
             most_meshes=1)  # fmt: skip
