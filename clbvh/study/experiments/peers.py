"""The contest: build and queries against Open3D, embreex and trimesh's own engine."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh
from ...support.files import temporary_folder
from ..bench import Bench
from ..engines import ENGINES, Rival, Trimesh, open_engine
from ..experiment import Experiment
from ..machine import list_missing
from ..page import Axis, Figure, Part, Table
from ..samples import Case, NotMeasuredError, Results, Sample, cross
from ..scale import Scale
from ..statistics import Summary

# A closed tube, mountains, an architectural scene, clouds of overlapping parts, a sphere: unlike in size and kind.
# Each constant: of a full and of a quick study.
_SHAPES = (
    (("palace", 200_000), ("terrain", 500_000), ("blobs", 100_000), ("boxes", 50_000), ("icosphere", 20_000)),
    (("palace", 50_000), ("terrain", 50_000), ("blobs", 30_000), ("boxes", 10_000)),
)
_SCANS = ("drill", "bunny", "dragon"), ("drill", "bunny")
_PICTURE = (1280, 720), (320, 180)
_POINTS = 200_000, 20_000
# Meshes whose times the document has; the leads are there of all.
_DOCUMENTED = ("bunny", "dragon")
# Divisor of the largest mesh of a slow engine.
_SHARE = 1, 8
_SEED = 1

_OURS = "clbvh"
QUERIES = {
    "build": "build, ms",
    "coherent": "closest hit, coherent",
    "shuffled": "closest hit, shuffled",
    "scattered": "closest hit, scattered",
    "any": "any hit",
    "all": "all hits",
    "points": "closest point",
}


class Peers(Experiment):
    """The contest with the peers.

    How fast are builds and queries beside Open3D, embreex and trimesh's own engine?

    Wall time of whole Python calls, arrays in and answers out. The same mesh and the same rays come from shared files;
    each engine has a process of its own, which is idle while another is measured; between engines all rest. Engines
    take turns.
    """

    weight = 10

    def cases(self, scale: Scale) -> list[Case]:
        meshes = [*map(scale.mesh, scale.pick(*_SCANS)), *(scale.shape(*shape) for shape in scale.pick(*_SHAPES))]
        return cross(mesh=[*dict.fromkeys(meshes)][: scale.most_meshes], query=QUERIES, engine=ENGINES)

    def measure(self, bench: Bench, case: Case) -> Sample:
        name, query, mesh = case["engine"], case["query"], case["mesh"]
        engine = ENGINES[name]
        if missing := list_missing(engine.packages):
            raise NotMeasuredError(f"{missing} is not installed: run 'pip install {missing.replace(',', '')}'")
        if not engine.has(query):
            raise NotMeasuredError(f"{name} has no such query")
        limit = engine.most_triangles / bench.scale.pick(*_SHARE)
        if bench.mesh(mesh).face_count > limit:
            raise NotMeasuredError(f"{name} would take too long for a mesh of more than {limit:,.0f} triangles")
        if name == _OURS:
            _ = bench.device
        folder = bench.once(("shared", mesh), lambda: _share(bench, mesh))
        rival = bench.open(("engine", name), lambda: Rival(open_engine, name, str(folder)))
        bench.rest_before(name)
        wall_ms, (items, answers) = rival.measure(query)
        values = {"wall_ms": wall_ms, "items": items, "answers": answers}
        return Sample({quantity: value for quantity, value in values.items() if value is not None})

    def present(self, results: Results) -> Iterator[Part]:
        names = [name for name in ENGINES if results.find(engine=name)]
        engines = []
        for name, engine in ENGINES.items():
            versions = [f"{one} {results.machine.get(one, 'not installed')}" for one in engine.packages or (_OURS,)]
            engines.append((name, ", ".join(versions), engine.threads))
        yield Table("The engines.", ("engine", "version", "threads of a query"), engines, is_detail=True)
        count = results.scale.pick(*_POINTS) // results.scale.shrink
        yield self.say(results, "method", results.scale.pick(*_PICTURE), count, Trimesh.most_items)
        points = [
            (name, case["mesh"], figure_of(results, case))
            for name in names
            for case in results.find(engine=name, query="coherent")
        ]
        yield Figure("Closest hit of coherent rays.", points, Axis("million rays per second", is_log=True))
        # The README has this one.
        yield replace(list_leads(results, self.say(results, "leads")), is_detail=True)
        differences = []
        for mesh in results.distinct("mesh"):
            speeds = []
            for query, title in QUERIES.items():
                cases = results.by("engine", mesh=mesh, query=query)
                speeds.append((title, *(figure_of(results, cases.get(name)) for name in names)))
                answers = [_count_answers(results, cases.get(name)) for name in names]
                if len({answer for answer in answers if answer is not None}) > 1:
                    differences.append((mesh, title, *answers))
            yield Table(self.say(results, "speeds", mesh), ("query", *names), speeds, is_detail=mesh not in _DOCUMENTED)
        yield Table(self.say(results, "answers"), ("mesh", "query", *names), differences, is_detail=True)


def list_leads(results: Results, caption: str) -> Table:
    """Return the table of leads: queries by meshes, the smallest mesh first."""
    builds = results.by("mesh", query="build", engine=_OURS)
    triangles = {mesh: results.count(case, "items") or 0 for mesh, case in builds.items()}
    meshes = sorted(triangles, key=lambda mesh: triangles[mesh])
    rows = []
    for query, title in QUERIES.items():
        leads = [lead_of(results, results.by("engine", mesh=mesh, query=query)) for mesh in meshes]
        rows.append((title.removesuffix(", ms"), *leads))
    return Table(caption, ("", *(f"{mesh.partition('-')[0]}, {triangles[mesh]:,}" for mesh in meshes)), rows)


def _count_answers(results: Results, case: Case | None) -> int | None:
    """Return the number of answers, None of an engine that got fewer items than the others."""
    return None if case is None or case["engine"] == Trimesh.name else results.count(case, "answers")


def _share(bench: Bench, name: str) -> Path:
    """Write mesh, rays and points to files that all engines read, and return their folder."""
    folder = bench.open(("folder", name), lambda: temporary_folder(Path(tempfile.gettempdir()), "clbvh-study-"))
    mesh = bench.mesh(name)
    origins, directions = bench.rays(name, bench.scale.pick(*_PICTURE))
    generator = np.random.default_rng(_SEED)
    order = generator.permutation(len(origins))
    rays = {
        "coherent": (origins, directions),
        "shuffled": (origins[order], directions[order]),
        "scattered": scatter_rays(mesh, len(order), generator),
    }
    points = choose_points(mesh, bench.scale.pick(*_POINTS) // bench.scale.shrink, generator)
    for item, arrays in {**rays, "points": (points,)}.items():
        # Engines that take float32 get the same numbers as those that take float64.
        np.save(folder / f"{item}.npy", np.asarray(arrays, np.float32))
    np.save(folder / "vertices.npy", mesh.vertices)
    np.save(folder / "faces.npy", mesh.faces)
    return folder


def scatter_rays(mesh: Mesh, count: int, generator: np.random.Generator) -> tuple[NDArray[np.float64], ...]:
    """Return rays from all around towards the mesh's box, in no order."""
    extent = np.ptp(mesh.vertices, axis=0)
    origins = generator.normal(size=(count, 3))
    origins *= 2 * extent.max() / np.linalg.norm(origins, axis=1)[:, None]
    targets = generator.uniform(-0.5, 0.5, origins.shape) * extent
    directions = targets - origins
    return origins + mesh.origin, directions / np.linalg.norm(directions, axis=1)[:, None]


def choose_points(mesh: Mesh, count: int, generator: np.random.Generator) -> NDArray[np.float64]:
    """Return points, half of them near the surface and half anywhere in the box."""
    extent = np.ptp(mesh.vertices, axis=0)
    half = count // 2
    near = mesh.vertices[generator.integers(0, len(mesh.vertices), half)]
    near = near + generator.normal(scale=extent.max() / 100, size=near.shape)
    return np.concatenate((near, mesh.origin + generator.uniform(-0.5, 0.5, (count - half, 3)) * extent))


def figure_of(results: Results, case: Case | None) -> Summary:
    """Return milliseconds of a build, millions of items per second of a query."""
    summary = results.summary(case, "wall_ms")
    if case is None or case["query"] == "build":
        return summary
    return summary.scaled(1e3).rate(results.summary(case, "items").median)


def lead_of(results: Results, cases: dict[str, Case]) -> Summary:
    """Return the fastest peer's time over clbvh's, round by round."""
    # A slow engine gets fewer rays.
    items = {name: results.summary(case, "items").median for name, case in cases.items()}
    times = {name: results.summary(case, "wall_ms").median / items[name] for name, case in cases.items()}
    best = min(times.keys() - {_OURS}, key=lambda name: times[name], default=_OURS)
    if best == _OURS or _OURS not in cases:
        return Summary.of([])
    return results.ratio(cases[best], cases[_OURS], "wall_ms").scaled(items[_OURS] / items[best])
