"""Each engine with the scenes of `test_path.py`: functions that a process of its own calls, see `Rival`.

A picture is linear red, green and blue, drawn with the tent filter of two pixels' width; its cost is the processor time
of all threads, which neighbours on a shared machine disturb less than the time on the wall.
"""

from __future__ import annotations

import itertools
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clbvh.study.engines import Queries

Array = NDArray[Any]

# Paths of both engines end by chance from some depth on, and at the latest after this many reflections.
BOUNCES = 12

# Counts of samples whose pictures are compared.
SAMPLE_COUNTS = (4, 16, 64, 256)

# Many more, for the picture that others are compared with.
REFERENCE_SAMPLES = 1024


# Mitsuba's rays begin 9e-5 (1 + |coordinate|) from the surface, in the scene's units: at the dragon's own size, 0.2,
# that is a third of an edge, and its hollows are 0.2 % brighter.
STATUE_SIZE = 100.0


@dataclass(frozen=True)
class Part:
    """Triangles of one matte colour, in the scene's coordinates; emission counts on the front alone."""

    vertices: Array
    faces: Array
    base_colour: tuple[float, float, float]
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Stage:
    """A scene that all engines can draw: parts, a constant sky, and a square picture of `side` pixels."""

    parts: tuple[Part, ...]
    eye: tuple[float, float, float]
    look_at: tuple[float, float, float]
    fov: float
    sky: float
    side: int


def make_cornell_box(side: int) -> Stage:
    """Return the shipped scene `cornell`."""
    import clbvh

    scene, view = clbvh.open_scene("cornell")
    parts = []
    for shape, transform, material in list_objects(scene.snapshot()):
        vertices = shape.vertices @ transform[:3, :3].T + transform[:3, 3]
        # Squares face up: the lamp has to face down.
        faces = shape.faces[:, ::-1] if any(material.emission) else shape.faces
        parts.append(Part(vertices, faces, material.base_colour, material.emission))
    return Stage(tuple(parts), view.eye, view.look_at, view.fov, 0.0, side)


def list_objects(state: Any) -> list[tuple[Any, Array, Any]]:
    """Return the shape, the transform and the material of each instance."""
    return [
        (state.shapes[geometry], state.transforms[number], state.material_of(number))
        for number, geometry in enumerate(state.geometry_ids.tolist())
    ]


def make_statue(vertices: Array, faces: Array, side: int) -> Stage:
    """Return a mesh on a floor under a white sky; y points up, as the dragon has it."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices = STATUE_SIZE * (vertices - (low + high) / 2) / (high - low).max()
    low, middle, size = vertices.min(axis=0), np.zeros(3), STATUE_SIZE
    corners = np.array([[-1.0, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]]) * 4 * size
    corners += (middle[0], low[1], middle[2])
    floor = Part(corners, np.array([[0, 1, 2], [0, 2, 3]]), (0.5, 0.5, 0.5))
    eye = middle + size * np.array([0.5, 0.45, 1.5])
    statue = Part(vertices, faces, (0.73, 0.6, 0.4))
    return Stage((statue, floor), tuple(eye.tolist()), tuple(middle.tolist()), 36.0, 1.0, side)


def to_scene(stage: Stage) -> Any:
    """Return the stage as a scene of ours."""
    import clbvh

    scene = clbvh.Scene()
    for part in stage.parts:
        material = clbvh.Material(base_colour=part.base_colour, roughness=1, ior=1.0, emission=part.emission)
        scene.place(scene.add((part.vertices, part.faces)), material=material)
    return scene


def time_pictures(draw: Callable[[int, int], Array]) -> Queries:
    """Return a task for each number of samples: a new seed, the picture, and its seconds of processor time."""
    seeds = itertools.count(1)

    def measure(samples: int) -> tuple[Array, float]:
        begin = time.process_time()
        picture = draw(samples, next(seeds))
        return picture, time.process_time() - begin

    return {str(count): lambda count=count: measure(count) for count in (*SAMPLE_COUNTS, REFERENCE_SAMPLES)}


def serve_ours(stage: Stage) -> Queries:
    """Draw by our shading `path`."""
    import clbvh

    view = clbvh.View(
        eye=stage.eye, look_at=stage.look_at, up="y", fov=stage.fov, width=stage.side, height=stage.side,
        shading="path", max_bounces=BOUNCES, smooth=0.0, background=(stage.sky,) * 3,
        light=clbvh.Light(colour=(0, 0, 0)),
    )  # fmt: skip
    renderer = clbvh.Renderer(to_scene(stage), view)

    def draw(samples: int, seed: int) -> Array:
        return renderer.render(samples=samples, seed=seed, keeps_film=True).film[..., :3]

    return time_pictures(draw)


def serve_mitsuba(stage: Stage, variant: str, sampler: str) -> Queries:
    """Draw by Mitsuba 3, a variant such as ``"llvm_ad_rgb"``, with one of its samplers."""
    import mitsuba

    mitsuba.set_variant(variant)
    scene = mitsuba.load_dict(describe_for_mitsuba(mitsuba, stage, sampler))

    def draw(samples: int, seed: int) -> Array:
        return np.array(mitsuba.render(scene, spp=samples, seed=seed))

    draw(SAMPLE_COUNTS[0], 0)
    return time_pictures(draw)


def describe_for_mitsuba(mitsuba: Any, stage: Stage, sampler: str) -> dict[str, Any]:
    """Return the stage as Mitsuba's dictionary."""
    colour = {"type": "rgb"}
    camera = mitsuba.ScalarTransform4f().look_at(origin=list(stage.eye), target=list(stage.look_at), up=[0, 1, 0])
    film = {
        "type": "hdrfilm", "width": stage.side, "height": stage.side, "pixel_format": "rgb",
        "component_format": "float32", "rfilter": {"type": "tent"},
    }  # fmt: skip
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": BOUNCES + 1},
        "sensor": {
            "type": "perspective", "fov": stage.fov, "to_world": camera, "film": film, "sampler": {"type": sampler},
        },
    }  # fmt: skip
    if stage.sky > 0:
        scene["sky"] = {"type": "constant", "radiance": colour | {"value": [stage.sky] * 3}}
    for number, part in enumerate(stage.parts):
        matte = {"type": "diffuse", "reflectance": colour | {"value": list(part.base_colour)}}
        scene[f"part{number}"] = {
            "type": "ply", "filename": write_ply(mitsuba, part), "face_normals": True,
            "bsdf": {"type": "twosided", "bsdf": matte},
        }  # fmt: skip
        if any(part.emission):
            light = {"type": "area", "radiance": colour | {"value": list(part.emission)}}
            scene[f"part{number}"]["emitter"] = light
    return scene


def write_ply(mitsuba: Any, part: Part) -> str:
    """Return the path of a file of a part, which the process leaves behind in its temporary folder."""
    mesh = mitsuba.Mesh("part", len(part.vertices), len(part.faces))
    parameters = mitsuba.traverse(mesh)
    parameters["vertex_positions"] = part.vertices.astype(np.float32).ravel()
    parameters["faces"] = part.faces.astype(np.uint32).ravel()
    parameters.update()
    path = str(Path(tempfile.mkdtemp()) / "part.ply")
    mesh.write_ply(path)
    return path
