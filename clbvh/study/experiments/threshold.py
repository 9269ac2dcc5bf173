"""Build time against the task threshold: the size below which a range is one worker's task."""

from __future__ import annotations

from ...support.host_threads import usable_cores
from ..bench import Bench
from ..builds import build_timed
from ..case import Case, Experiment, Sample
from ..page.drawing import Axis, Series, draw_curves
from ..page.parts import Figure, Part, Table
from ..report import curve, source_of
from ..results import Results
from ..scale import Scale

_BUILDERS = ("sah", "bin")
_THRESHOLDS = (64, 256, 1024, 4096, 16_384, 65_536)
_QUICK = (256, 4096, 65_536)


def _cases(scale: Scale) -> list[Case]:
    mesh = scale.mesh("dragon")
    return [
        {"mesh": mesh, "builder": builder, "threshold": threshold}
        for builder in _BUILDERS
        for threshold in scale.pick(_THRESHOLDS, _QUICK)
    ]


def _measure(bench: Bench, case: Case) -> Sample:
    _, values = build_timed(
        bench.mesh(str(case["mesh"])), bench.pool(usable_cores()), str(case["builder"]),
        task_threshold=int(case["threshold"]),
    )  # fmt: skip
    return Sample({"build_ms": values["build_ms"]})


def _present(results: Results) -> list[Part]:
    report = curve("threshold.relative")
    rows = []
    series = []
    for builder in results.distinct("builder"):
        summaries = {
            int(case["threshold"]): summary
            for case in results.find(builder=builder)
            if (summary := results.summary(case, "build_ms")) is not None
        }
        best = min((summary.median for summary in summaries.values()), default=1.0)
        relative = {threshold: summary.scaled(1 / best) for threshold, summary in summaries.items()}
        rows += [
            (builder, threshold, summaries[threshold], relative[threshold], report.get(threshold))
            for threshold in summaries
        ]
        series.append(Series(builder, list(relative), list(relative.values())))
    series.append(Series("the report", list(report), list(report.values()), is_published=True))
    ticks = sorted({*_THRESHOLDS[::2], *results.distinct("threshold")} if results.cases else _THRESHOLDS)
    return [
        Table(
            f"Build on {', '.join(results.distinct('mesh'))} with {results.cores} workers, and relative to the best "
            f"threshold of the builder. The report: {source_of('threshold')}.",
            ("builder", "task threshold", "build, ms", "relative", "report's relative"),
            rows,
        ),
        Figure(
            "Build time relative to the best threshold.",
            draw_curves(Axis("task threshold, triangles", is_log=True, ticks=ticks), Axis("relative time"), series),
        ),
    ]


EXPERIMENT = Experiment(
    name="threshold",
    title="Task threshold",
    question="Does it matter at which size a range becomes one worker's task?",
    method="Wall time of the build. The tree is the same for all thresholds. A task of the report is a thread's, of "
    "clbvh a worker process's.",
    cases=_cases,
    measure=_measure,
    present=_present,
    weight=2,
)
