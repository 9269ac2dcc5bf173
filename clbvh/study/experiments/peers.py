"""The contest: build and queries against Open3D, embreex and trimesh's own engine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh
from ...support.temporary_folder import TemporaryFolder
from ..bench import Bench
from ..case import Case, Experiment, NotMeasuredError, Sample
from ..machine import find_version
from ..page.drawing import Axis, Series, draw_bars
from ..page.parts import Figure, Paragraph, Part, Table
from ..peers.engines import ENGINES, Trimesh
from ..peers.process import EngineProcess
from ..results import Results
from ..scale import Scale
from ..statistics import Summary

# A closed tube, mountains, an architectural scene, clouds of overlapping parts, a sphere: unlike in size and kind.
_SHAPES = (("palace", 200_000), ("terrain", 500_000), ("blobs", 100_000), ("boxes", 50_000), ("icosphere", 20_000))
_QUICK_SHAPES = (("palace", 50_000), ("terrain", 50_000), ("blobs", 30_000), ("boxes", 10_000))
_SCANS = ("drill", "bunny", "dragon")
_QUICK_SCANS = ("drill", "bunny")

_PICTURE = (1280, 720)
_QUICK_PICTURE = (320, 180)
_POINTS = 200_000
_QUICK_POINTS = 20_000
# A quick study gives slow engines meshes that are smaller by this factor.
_QUICK_SHARE = 8
_SEED = 1

QUERIES = {
    "build": "build, ms",
    "coherent": "closest hit, coherent",
    "shuffled": "closest hit, shuffled",
    "scattered": "closest hit, scattered",
    "any": "any hit",
    "all": "all hits",
    "points": "closest point",
}


def _cases(scale: Scale) -> list[Case]:
    meshes = [scale.mesh(name) for name in scale.pick(_SCANS, _QUICK_SCANS)]
    meshes += [scale.shape(*shape) for shape in scale.pick(_SHAPES, _QUICK_SHAPES)]
    return [
        {"mesh": mesh, "query": query, "engine": engine}
        for mesh in list(dict.fromkeys(meshes))[: scale.most_meshes]
        for query in QUERIES
        for engine in ENGINES
    ]


def _measure(bench: Bench, case: Case) -> Sample:
    name, query, mesh_name = str(case["engine"]), str(case["query"]), str(case["mesh"])
    engine = ENGINES[name]
    missing = [package for package in engine.packages if find_version(package) is None]
    if missing:
        raise NotMeasuredError(f"{', '.join(missing)} is not installed: run 'pip install {' '.join(missing)}'")
    if query not in engine.queries:
        raise NotMeasuredError(f"{name} has no such query")
    mesh = bench.mesh(mesh_name)
    limit = engine.most_triangles and bench.scale.pick(engine.most_triangles, engine.most_triangles // _QUICK_SHARE)
    if limit is not None and mesh.face_count > limit:
        raise NotMeasuredError(f"{name} would take too long for a mesh of more than {limit:,} triangles")
    if name == "clbvh":
        _ = bench.device
    folder = bench.once(("shared", mesh_name), lambda: _share(bench, mesh_name))
    process = bench.open(("engine", name), lambda: EngineProcess(name, str(folder)))
    bench.rest_before(name)
    return Sample(process.measure(query))


def _share(bench: Bench, name: str) -> Path:
    """Write mesh, rays and points to files that all engines read, and return their folder."""
    import tempfile

    folder = bench.open(("folder", name), lambda: TemporaryFolder(Path(tempfile.gettempdir()), "clbvh-study-")).path
    mesh = bench.mesh(name)
    for item, array in (("vertices", mesh.vertices), ("faces", mesh.faces)):
        np.save(folder / f"{item}.npy", array)
    size = bench.scale.picture(*bench.scale.pick(_PICTURE, _QUICK_PICTURE))
    coherent = bench.picture_rays(name, *size)
    generator = np.random.default_rng(_SEED)
    order = generator.permutation(len(coherent[0]))
    rays = {
        "coherent": coherent,
        "shuffled": (coherent[0][order], coherent[1][order]),
        "scattered": _scatter(mesh, len(order), generator),
    }
    for kind, (origins, directions) in rays.items():
        # Engines that take float32 get the same numbers as those that take float64.
        np.save(folder / f"{kind}-origins.npy", origins.astype(np.float32))
        np.save(folder / f"{kind}-directions.npy", directions.astype(np.float32))
    count = bench.scale.pick(_POINTS, _QUICK_POINTS) // bench.scale.shrink
    np.save(folder / "points.npy", _choose_points(mesh, count, generator).astype(np.float32))
    return folder


def _scatter(mesh: Mesh, count: int, generator: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return rays from all around towards the mesh's box, in no order."""
    extent = np.ptp(mesh.vertices, axis=0)
    origins = generator.normal(size=(count, 3))
    origins *= 2 * extent.max() / np.linalg.norm(origins, axis=1)[:, None]
    targets = generator.uniform(-0.5, 0.5, origins.shape) * extent
    directions = targets - origins
    return origins + mesh.origin, directions / np.linalg.norm(directions, axis=1)[:, None]


def _choose_points(mesh: Mesh, count: int, generator: np.random.Generator) -> NDArray[np.float64]:
    """Return points, half of them near the surface and half anywhere in the box."""
    extent = np.ptp(mesh.vertices, axis=0)
    half = count // 2
    near = mesh.vertices[generator.integers(0, len(mesh.vertices), half)]
    near = near + generator.normal(scale=extent.max() / 100, size=near.shape)
    return np.concatenate((near, mesh.origin + generator.uniform(-0.5, 0.5, (count - half, 3)) * extent))


def _present(results: Results) -> list[Part]:
    size = results.scale.size_of(*results.scale.pick(_PICTURE, _QUICK_PICTURE))
    count = results.scale.pick(_POINTS, _QUICK_POINTS) // results.scale.shrink
    parts: list[Part] = [
        _list_engines(results),
        Paragraph(
            f"Coherent rays are those of a picture of {size}; shuffled ones are the same in random order; scattered "
            f"ones come from all around the mesh, in no order. any hit and all hits get the coherent rays. {count:,} "
            "points, half of them near the surface. trimesh's own engine gets every n-th ray or point, about "
            f"{Trimesh.most_items:,} of each."
        ),
    ]
    names = [name for name in ENGINES if results.find(engine=name)]
    for mesh in results.distinct("mesh"):
        rows = []
        answers = []
        for query, title in QUERIES.items():
            cases = {str(case["engine"]): case for case in results.find(mesh=mesh, query=query)}
            if not cases:
                continue
            rows.append(
                (title, *(figure_of(results, cases.get(name), query) for name in names), lead_of(results, cases))
            )
            counts = {name: results.median(case, "answers") for name, case in cases.items()}
            items = {name: int(results.median(case, "items") or 0) for name, case in cases.items()}
            answers.append((title, *(_describe_answers(counts.get(name), items.get(name)) for name in names)))
        parts.append(
            Table(
                f"{mesh}: build in ms, queries in millions of rays or points per second, whole calls. Last column: "
                "the fastest other engine's time over clbvh's; above 1 clbvh is faster.",
                ("query", *names, "clbvh's lead"),
                rows,
            )
        )
        parts.append(Table(f"{mesh}: answers of items, by which engines agree.", ("query", *names), answers[1:]))
    parts.insert(2, _draw(results, names))
    return parts


def _list_engines(results: Results) -> Table:
    rows = []
    for name, engine in ENGINES.items():
        packages = engine.packages or ("clbvh",)
        versions = [f"{package} {results.machine.get(package, 'not installed')}" for package in packages]
        rows.append((name, ", ".join(versions), engine.threads))
    return Table("The engines.", ("engine", "version", "threads of a query"), rows)


def figure_of(results: Results, case: Case | None, query: str) -> Summary | None:
    """Return milliseconds of a build, millions of items per second of a query."""
    summary = None if case is None else results.summary(case, "wall_ms")
    if case is None or summary is None or query == "build":
        return summary
    return summary.scaled(1e3).rate(results.median(case, "items") or 0.0)


def _time_per_item(results: Results, case: Case) -> float:
    return (results.median(case, "wall_ms") or 0.0) / max(1.0, results.median(case, "items") or 1.0)


def lead_of(results: Results, cases: dict[str, Case]) -> Summary | None:
    """Return the fastest peer's time over clbvh's, round by round; None without either."""
    others = [case for name, case in cases.items() if name != "clbvh"]
    if "clbvh" not in cases or not others:
        return None
    best = min(others, key=lambda case: _time_per_item(results, case))
    ratio = results.ratio(best, cases["clbvh"], "wall_ms")
    # A slow engine gets fewer rays.
    ours, theirs = (results.median(case, "items") or 1.0 for case in (cases["clbvh"], best))
    return None if ratio is None else ratio.scaled(ours / theirs)


def _describe_answers(count: float | None, items: int | None) -> str | None:
    return None if count is None or items is None else f"{int(count):,} of {items:,}"


def _draw(results: Results, names: list[str]) -> Part:
    meshes = results.distinct("mesh")
    if len(names) < 2:
        return Paragraph("No other engine is installed here.")
    series = []
    for name in names:
        found = [
            (index, figure_of(results, cases[0], "coherent"))
            for index, mesh in enumerate(meshes)
            if (cases := results.find(mesh=mesh, query="coherent", engine=name))
        ]
        shown = [(index, value) for index, value in found if value is not None]
        series.append(Series(name, [index for index, _ in shown], [value for _, value in shown]))
    return Figure(
        "Closest hit of coherent rays.",
        draw_bars(Axis("million rays per second", is_log=True), meshes, series),
    )


EXPERIMENT = Experiment(
    name="peers",
    title="The contest with the peers",
    question="How fast are builds and queries beside Open3D, embreex and trimesh's own engine?",
    method="Wall time of whole Python calls, arrays in and answers out. The same mesh and the same rays come from "
    "shared files; each engine has a process of its own, which is idle while another is measured; between engines all "
    "rest. Engines take turns.",
    cases=_cases,
    measure=_measure,
    present=_present,
    weight=10,
)
