"""`clbvh sheet`: the standard views of meshes or of a scene in one picture."""

from __future__ import annotations

from ..choices import SHEET_HEIGHT, SHEET_WIDTH
from ..rendering.options import RenderOptions
from . import options
from .progress import Progress
from .tables import print_report

_WITHOUT = (*options.POSE, *options.LENS, "transparent")
_SHOWN = {"width": f"{SHEET_WIDTH}, of each view", "height": f"{SHEET_HEIGHT}, of each view", "ground": "none"}


@options.with_options(view=options.list_view_options(without=_WITHOUT, shown=_SHOWN), tree=options.list_tree_options())
def sheet(
    *sources: options.Sources,
    output: options.Outputs,
    point_radius: options.PointRadius = None,
    view: options.Given = options.NOTHING,
    tree: options.Given = options.NOTHING,
    as_json: options.AsJson = False,
) -> None:
    """Write the standard views of meshes or a scene, at one scale, as one picture."""
    from ..files.image_files import check_picture_path
    from ..rendering.series import contact_sheet

    # All input is checked before any work.
    for path in output:
        check_picture_path(path)
    wanted = options.make_options(RenderOptions, tree)
    changes = options.read_changes(view)
    with Progress() as progress:
        made = contact_sheet(options.find_source(sources, point_radius), None, wanted, **progress.callbacks, **changes)
    for path in output:
        made.save(path)
    rows, columns, _ = made.rgb.shape
    facts = f"{len(made.pictures)} views, {columns} x {rows}, made in {progress.spent_s:,.1f} s"
    report = {
        "width": columns,
        "height": rows,
        "views": list(made.pictures),
        "pixel_size": made.pixel_size,
        "files": output,
        "timings_ms": {"total": progress.spent_s * 1e3},
    }
    print_report(report, "\n".join(f"{path}: {facts}" for path in output), as_json=as_json, notes=progress.notes)
