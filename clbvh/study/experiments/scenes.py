"""Speed-up against the size of the scene, and growth of build and trace from 1 k to 10 M triangles."""

from __future__ import annotations

from ...builders.build import build
from ...support.host_threads import usable_cores
from ..bench import Bench
from ..builds import build_timed
from ..case import Case, Experiment, Sample
from ..frames import draw_frame
from ..page.drawing import Axis, Series, draw_curves
from ..page.parts import Figure, Part, Table
from ..report import published, source_of
from ..results import Results
from ..scale import SCANS, Scale, scan_of
from ..statistics import Summary, growth_exponent

_BUILDERS = ("sah", "flat")
_SHAPES = ("knot", "terrain")
_SIZES = (1_000, 10_000, 100_000, 1_000_000, 10_000_000)
_QUICK_SIZES = (1_000, 10_000, 100_000)
_PICTURE = (800, 450)
_SCAN, _GROWTH = "scan", "growth"


def _cases(scale: Scale) -> list[Case]:
    scans: list[Case] = [
        {"part": _SCAN, "mesh": mesh, "builder": builder}
        for mesh in dict.fromkeys(map(scale.mesh, SCANS))
        for builder in _BUILDERS
    ]
    growing: list[Case] = [
        {"part": _GROWTH, "mesh": f"{shape}-{size}", "builder": "sah"}
        for shape in scale.pick(_SHAPES, _SHAPES[:1])
        for size in scale.sizes(scale.pick(_SIZES, _QUICK_SIZES))
    ]
    return scans + growing


def _measure(bench: Bench, case: Case) -> Sample:
    name, builder = str(case["mesh"]), str(case["builder"])
    mesh = bench.mesh(name)
    if case["part"] == _SCAN:
        _, alone = build_timed(mesh, bench.pool(1), builder)
        _, shared = build_timed(mesh, bench.pool(usable_cores()), builder)
        values = {"one_worker_ms": alone["build_ms"], "all_workers_ms": shared["build_ms"]}
        return Sample({**values, "triangles": mesh.face_count})
    _, values = build_timed(mesh, bench.pool(usable_cores()), builder)
    bvh = bench.once(("first tree", name), lambda: build(mesh))
    frame = draw_frame(bench, name, bvh, bench.scale.picture(*_PICTURE))
    return Sample({"build_ms": values["build_ms"], "kernel_ms": frame.times_ms["kernel"], "triangles": mesh.face_count})


def _present(results: Results) -> list[Part]:
    said = published("scenes.says")
    scans = [
        (
            case["mesh"], case["builder"], int(results.median(case, "triangles") or 0),
            results.summary(case, "one_worker_ms"), results.summary(case, "all_workers_ms"), _speedup(results, case),
            said.get(scan_of(str(case["mesh"]))),
        )
        for case in results.find(part=_SCAN)
    ]  # fmt: skip
    return [
        Table(
            f"Build with 1 and with {results.cores} workers. The report: {source_of('scenes')}.",
            ("mesh", "builder", "triangles", "1 worker, ms", f"{results.cores} workers, ms", "speed-up", "report"),
            scans,
        ),
        *_present_growth(results),
    ]


def _speedup(results: Results, case: Case) -> Summary | None:
    pairs = zip(results.values(case, "one_worker_ms"), results.values(case, "all_workers_ms"), strict=True)
    ratios = [alone / shared for alone, shared in pairs]
    return Summary.of(ratios) if ratios else None


def _present_growth(results: Results) -> list[Part]:
    rows: list[tuple[object, ...]] = []
    exponents = []
    series = []
    for shape in dict.fromkeys(str(case["mesh"]).rpartition("-")[0] for case in results.find(part=_GROWTH)):
        cases = [case for case in results.find(part=_GROWTH) if str(case["mesh"]).rpartition("-")[0] == shape]
        sizes = [results.median(case, "triangles") or 1 for case in cases]
        measured = {
            quantity: [summary for case in cases if (summary := results.summary(case, quantity)) is not None]
            for quantity in ("build_ms", "kernel_ms")
        }
        rows += [(shape, int(size), *pair) for size, *pair in zip(sizes, *measured.values(), strict=True)]
        exponents.append((
            shape, *(growth_exponent(sizes, [one.median for one in summaries]) for summaries in measured.values())
        ))  # fmt: skip
        series += [
            Series(f"{shape}, build", sizes, measured["build_ms"]),
            Series(f"{shape}, trace", sizes, measured["kernel_ms"]),
        ]
    return [
        Table(
            "Procedural meshes: build with all workers, and the kernel of a picture of "
            f"{results.scale.size_of(*_PICTURE)}.",
            ("mesh", "triangles", "build, ms", "kernel, ms"),
            rows,  # type: ignore[arg-type]
        ),
        Figure(
            "Growth with the number of triangles.",
            draw_curves(Axis("triangles", is_log=True), Axis("ms", is_log=True), series),
        ),
        Table(
            "Growth exponent p of time = c n^p, fitted to the medians: 1 is linear, 0 is constant.",
            ("mesh", "build", "trace"),
            exponents,
        ),
    ]


EXPERIMENT = Experiment(
    name="scenes",
    title="Scenes and growth",
    question="How does the gain of more workers depend on the scene, and how do build and trace grow with it?",
    method="Wall time of builds; event time of the kernel for one picture.",
    cases=_cases,
    measure=_measure,
    present=_present,
    group=("part", "mesh"),
    weight=4,
)
