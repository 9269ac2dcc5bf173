"""`clbvh shard`: cut a mesh that is larger than the memory into shards."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ..choices import DEFAULT_SHARD_TRIANGLES
from . import options


def shard(
    source: Annotated[str, Parameter(name="MESH")],
    /,
    *,
    output: Annotated[Path, Parameter(name=("--output", "-o"), metavar="FOLDER")],
    triangles: Annotated[
        int, Parameter(converter=options.read_whole, metavar="N", show_default=True)
    ] = DEFAULT_SHARD_TRIANGLES,
    as_json: options.AsJson = False,
) -> None:
    """Cut a mesh into shards, of which clbvh.ShardedTracer has one at a time in memory.

    Parameters
    ----------
    source
        A mesh file (PLY, OBJ, STL, OFF, GLB, glTF). A binary little-endian PLY file of triangles may be larger than
        the memory.
    output
        A new folder, or an empty one.
    triangles
        Triangles of a shard, about; tracing takes about 200 bytes for each.
    """
    from ..geometry.shards import shard_mesh
    from .tables import make_table, print_report

    shards = shard_mesh(source, output, triangles=triangles)
    report = {"folder": str(output), "shards": [{"file": s.path.name, "triangles": s.triangle_count} for s in shards]}
    rows = [(s.path.name, f"{s.triangle_count:,}") for s in shards]
    print_report(report, make_table(("shard", "triangles"), rows, numbers=["triangles"]), as_json=as_json)
