"""Clicks: the face that is hit and its part or instance, the distance of two points, the highlighted pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..files.image_files import encode_picture
from ..geometry import Mesh
from ..rendering.picture import Picture
from ..scene.state import SceneState
from ..structs import NO_PRIM
from ..trace.hits.hits import Hits
from ..views.cameras.camera import Camera


@dataclass(frozen=True)
class Picked:
    """One point of a surface.

    Attributes
    ----------
    location : (3,) float
        In the scene's coordinates.
    lines : list of (str, str)
        For a person: face, part, instance, location, normal, distance.
    instance_id : int
    faces : range or None
        Those of the part that was hit.
    """

    location: tuple[float, float, float]
    lines: list[tuple[str, str]]
    instance_id: int
    faces: range | None

    def covers(self, found: NDArray[np.void]) -> NDArray[np.bool_]:
        """Return the pixels, (height, width) bool, that show the same part, or else the same instance."""
        is_same = found["prim_id"] != NO_PRIM
        if "instance_id" in (found.dtype.names or ()):
            is_same &= found["instance_id"] == self.instance_id
        if self.faces is not None:
            is_same &= (found["prim_id"] >= self.faces.start) & (found["prim_id"] < self.faces.stop)
        return is_same


def describe_hit(hit: Hits, state: SceneState) -> Picked | None:
    """Return what a ray hits, for a person; None on a miss."""
    if not hit.is_hit:
        return None
    instance_id, geometry_id, prim_id = int(hit.instance_id), int(hit.geometry_id), int(hit.prim_id)
    shape, location = state.shapes[geometry_id], hit.locations
    lines = [("face" if isinstance(shape, Mesh) else shape.kind.prim, f"{prim_id:,}")]
    faces = None
    if isinstance(shape, Mesh) and shape.parts:
        part = shape.parts[int(hit.part_id)]
        faces = range(part.begin, part.end)
        lines.append(("part", part.name))
    if state.instance_count > 1:
        lines.append(("instance", f"{state.instance_names[instance_id]} ({instance_id})"))
    lines += [
        ("location", _show(location)),
        ("normal", _show(hit.normals)),
        ("distance", f"{float(hit.t):.7g}"),
    ]
    x, y, z = location.tolist()
    return Picked((x, y, z), lines, instance_id, faces)


def _show(vector: NDArray[np.float64]) -> str:
    return ", ".join(f"{part:.6g}" for part in vector.tolist())


def place_marks(points: list[Picked], camera: Camera, size: tuple[int, int], ratio: float) -> dict[str, Any]:
    """Return where points appear, in CSS pixels (null behind the camera), and the distance of two of them."""
    if not points:
        return {"marks": []}
    pixels, _ = camera.project([each.location for each in points], *size)
    seen = (pixels / ratio).tolist()
    marks: dict[str, Any] = {"marks": [{"x": x, "y": y} if math.isfinite(x + y) else None for x, y in seen]}
    if len(points) == 2:
        marks["measure"] = f"{math.dist(points[0].location, points[1].location):.6g}"
    return marks


def encode_mask(picked: Picked | None, picture: Picture) -> bytes:
    """Return a PNG, white where a picture shows the same part or instance; nothing where that is everything."""
    if picked is None or (not picked.faces and picture.scene.state.instance_count == 1):
        return b""
    return encode_picture(picked.covers(picture.found), ".png")
