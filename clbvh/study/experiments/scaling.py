"""Build time against the number of workers, and the serial fraction that explains it."""

from __future__ import annotations

from ..bench import Bench, worker_counts
from ..builds import PHASE, build_timed
from ..case import Case, Experiment, Sample
from ..page.drawing import Axis, Series, draw_curves
from ..page.parts import Figure, Paragraph, Part, Table
from ..report import curve, source_of
from ..results import Results
from ..scale import Scale
from ..statistics import amdahl_speedup, fit_amdahl

_BUILDERS = ("sah", "bin")
# Workers for which the fitted law is evaluated.
_PREDICTED = 8


def _cases(scale: Scale) -> list[Case]:
    mesh = scale.mesh("dragon")
    return [
        {"mesh": mesh, "builder": builder, "workers": workers} for builder in _BUILDERS for workers in worker_counts()
    ]


def _measure(bench: Bench, case: Case) -> Sample:
    pool = bench.pool(int(case["workers"]))
    _, values = build_timed(bench.mesh(str(case["mesh"])), pool, str(case["builder"]))
    return Sample(values)


def _present(results: Results) -> list[Part]:
    report = curve("scaling.build_ms")
    report_serial = fit_amdahl(report)
    rows = []
    fits = []
    series = []
    for builder in results.distinct("builder"):
        cases = {int(case["workers"]): case for case in results.find(builder=builder)}
        medians = {workers: results.median(case, "build_ms") or 0.0 for workers, case in cases.items()}
        speedups = {
            workers: ratio
            for workers, case in cases.items()
            if 1 in cases and (ratio := results.ratio(cases[1], case, "build_ms")) is not None
        }
        for workers, case in cases.items():
            speedup = speedups.get(workers)
            rows.append((
                builder, workers, results.summary(case, "build_ms"), speedup,
                None if speedup is None else speedup.scaled(1 / workers),
                report[1] / report[workers] if workers in report else None,
            ))  # fmt: skip
        serial = fit_amdahl(medians)
        fits.append((builder, serial, None if serial is None else amdahl_speedup(serial, _PREDICTED)))
        series.append(Series(builder, list(speedups), list(speedups.values())))
    fits.append(("the report", report_serial, report[1] / report[_PREDICTED]))
    series.append(Series("the report", list(report), [report[1] / ms for ms in report.values()], is_published=True))
    ticks = sorted({1, 2, 4, 8, *(int(case["workers"]) for case in results.cases)})
    return [
        Table(
            f"Build by number of workers on {', '.join(results.distinct('mesh'))}. The report: "
            f"{source_of('scaling')}, on 8 cores.",
            ("builder", "workers", "build, ms", "speed-up", "efficiency", "report's speed-up"),
            rows,
        ),
        Figure(
            "Speed-up over one worker; the report's as published.",
            draw_curves(Axis("workers", is_log=True, ticks=ticks), Axis("speed-up"), series),
        ),
        Table(
            f"Amdahl's law fitted to the medians: the serial fraction, and what it allows on {_PREDICTED} workers. "
            "The last row is fitted to the report's two times.",
            ("builder", "serial fraction", f"speed-up on {_PREDICTED}, by the law"),
            fits,
        ),
        *_list_phases(results),
        Paragraph(
            "A fit to one or two worker counts says little about more: on a machine with few cores the law is an "
            "extrapolation."
        ),
    ]


def _list_phases(results: Results) -> list[Part]:
    parts: list[Part] = []
    for builder in results.distinct("builder"):
        cases = results.find(builder=builder)
        phases = results.quantities(cases[0], PHASE)
        rows = [(int(case["workers"]), *(results.summary(case, PHASE + phase) for phase in phases)) for case in cases]
        columns = ("workers", *(f"{phase.removesuffix('_ms')}, ms" for phase in phases))
        parts.append(Table(f"Phases of {builder}. The phase convert is not counted, see the ladder.", columns, rows))
    return parts


EXPERIMENT = Experiment(
    name="scaling",
    title="Build scaling",
    question="How much faster is the build on more workers, and which part of it stays serial?",
    method="Wall time of the build with a warm pool. Efficiency: speed-up over the number of workers. The phases are "
    "metadata (boxes and centroids), top (until there are enough subtrees), subtrees, and compaction.",
    cases=_cases,
    measure=_measure,
    present=_present,
    weight=2,
)
