"""`clbvh images`: what each pixel sees, as files of numbers: depth, normals, ids and more."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ..choices import DEFAULT_CHANNELS
from ..rendering.options import RenderOptions
from . import options
from .progress import Progress
from .tables import make_table, print_report

_WITHOUT = "aperture", "focus_distance", "transparent"

# Not in the docstring of the verb, where a line would end in the middle of the help's.
_OUTPUT_HELP = (
    "One file of all channels, .exr or .npz; or .png or .ppm: out.png stands for out-depth.png and so on, and out.json "
    "with their scales and the camera. May be given several times."
)
_CHANNELS_HELP = (
    "rgb, colour, alpha, depth (along the optical axis), range (from the eye), normal, normal_camera, shading_normal, "
    "shading_normal_camera, position, instance_id, geometry_id, prim_id, barycentric, uv, motion."
)
_CHANNELS = Parameter(metavar="A,B,...", help=_CHANNELS_HELP, show_default=",".join(DEFAULT_CHANNELS))


@options.with_options(view=options.list_view_options(without=_WITHOUT), tree=options.list_tree_options())
def images(
    *sources: options.Sources,
    output: Annotated[list[Path], options.OUTPUT, Parameter(help=_OUTPUT_HELP)],
    channels: Annotated[str | None, _CHANNELS] = None,
    depth_scale: Annotated[float | None, Parameter(show_default="a round one that fits")] = None,
    camera_file: Annotated[Path | None, Parameter(metavar="FILE.json")] = None,
    next_camera_file: Annotated[Path | None, Parameter(metavar="FILE.json")] = None,
    point_radius: options.PointRadius = None,
    view: options.Given = options.NOTHING,
    tree: options.Given = options.NOTHING,
    as_json: options.AsJson = False,
) -> None:
    """Write what each pixel sees: depth, normals, positions, ids, texture coordinates, motion.

    Parameters
    ----------
    depth_scale
        Pixel values for a unit of length in PNG files, such as 1000.
    camera_file
        Camera: intrinsics, camera_to_world and size, as in the .json file beside PNG files.
    next_camera_file
        Camera of the second pose, for motion.
    """
    from ..errors import ConfigError
    from ..rendering.channels import check_channels, find_limits
    from ..rendering.images import FILES_SUFFIXES, check_images_path, read_camera
    from ..rendering.renderer import render_images

    # All input is checked before any work.
    words = DEFAULT_CHANNELS if channels is None else channels.split(",")
    names = check_channels([name.strip() for name in words if name.strip()])
    for path in output:
        check_images_path(path, names)
    pose = [f"--{name.replace('_', '-')}" for name in (*options.POSE, *options.LENS, "up", "frame") if name in view]
    if camera_file is not None and pose:
        raise ConfigError(f"--camera-file says all of the view: give it without {' and '.join(pose)}")
    if "motion" in names and next_camera_file is None:
        raise ConfigError("the channel motion needs a second pose: give --next-camera-file")
    first, second = (None if path is None else read_camera(path) for path in (camera_file, next_camera_file))
    wanted = options.make_options(RenderOptions, tree)
    changes = options.read_changes(view) | ({} if first is None else {"camera": first})
    with Progress() as progress:
        made = render_images(
            options.find_source(sources, point_radius),
            names,
            None,
            wanted,
            next_camera=second,
            **progress.callbacks,
            **changes,
        )
    made_s = progress.spent_s
    for path in output:
        made.save(path, depth_scale=depth_scale if path.suffix.lower() in FILES_SUFFIXES else None)
    write_s = progress.spent_s - made_s
    # The least and the greatest value of the hits.
    limits = {name: find_limits(name, array) for name, array in made.items()}
    rows = ((name, *((f"{value:,.6g}" for value in pair) if pair else ("no values",))) for name, pair in limits.items())
    table = make_table(("channel", "least", "greatest"), rows, numbers=("least", "greatest"))
    report = {
        "width": made.width,
        "height": made.height,
        "channels": limits,
        "files": output,
        "timings_ms": {"images": made_s * 1e3, "write": write_s * 1e3},
    }
    line = f"{made.width} x {made.height}, {made_s:.2f} s, written in {write_s:.2f} s"
    print_report(report, table, line, as_json=as_json, notes=progress.notes)
