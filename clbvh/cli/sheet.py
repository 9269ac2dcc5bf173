"""`clbvh sheet`: the standard views of meshes or of a scene in one picture."""

from __future__ import annotations

from ..choices import SHEET_HEIGHT, SHEET_WIDTH
from ..rendering.options import RenderOptions
from . import options
from .progress import Progress
from .tables import print_json, print_notes

# Of one picture, and of one camera.
_WITHOUT = (
    "eye", "look_at", "side", "fov", "projection", "aperture", "focus_distance", "transparent",
)  # fmt: skip

_SHOWN = {"width": f"{SHEET_WIDTH}, of each view", "height": f"{SHEET_HEIGHT}, of each view", "ground": "none"}


@options.with_options(
    changes=options.list_view_options(without=_WITHOUT, shown=_SHOWN), tree=options.list_tree_options()
)
def sheet(
    *sources: options.Sources,
    output: options.Outputs,
    changes: options.Given = options.NOTHING,
    tree: options.Given = options.NOTHING,
    as_json: options.AsJson = False,
) -> None:
    """Write the standard views of meshes or a scene, at one scale, as one picture."""
    from ..rendering.contact_sheet import contact_sheet
    from ..rendering.image_files import check_picture_path

    # All input is checked before any work.
    for path in output:
        check_picture_path(path)
    wanted = options.make_options(RenderOptions, tree)
    with Progress() as progress:
        made = contact_sheet(
            list(sources), None, wanted, on_phase=progress.enter, on_note=progress.notes.append,
            **options.read_changes(changes),
        )  # fmt: skip
    for path in output:
        made.save(path)
    rows, columns, _ = made.rgb.shape
    report = {
        "width": columns,
        "height": rows,
        "views": list(made.pictures),
        "pixel_size": made.pixel_size,
        "files": [str(path) for path in output],
        "timings_ms": {"total": progress.spent_s * 1e3},
    }
    facts = f"{len(made.pictures)} views, {columns} x {rows}, made in {progress.spent_s:,.1f} s"
    if as_json:
        print_json(report)
    else:
        print("\n".join(f"{path}: {facts}" for path in output))
    print_notes(progress.notes)
