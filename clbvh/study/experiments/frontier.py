"""Leaves that the device tests by brute force: build, kernel and total by their size."""

from __future__ import annotations

from ...support.host_threads import usable_cores
from ..bench import Bench
from ..builds import build_timed
from ..case import Case, Experiment, Sample
from ..frames import draw_frame
from ..page.drawing import Axis, Series, draw_curves
from ..page.parts import Figure, Paragraph, Part, Table
from ..report import curve, published, source_of
from ..results import Results
from ..scale import Scale

_FRONTIERS = (4, 16, 64, 256, 512, 1024, 2048, 4096, 8192)
_QUICK = (4, 16, 64, 256)
_PICTURE = (800, 450)


def _cases(scale: Scale) -> list[Case]:
    mesh = scale.mesh(scale.pick("dragon", "bunny"))
    return [{"mesh": mesh, "frontier": frontier} for frontier in scale.pick(_FRONTIERS, _QUICK)]


def _measure(bench: Bench, case: Case) -> Sample:
    name = str(case["mesh"])
    bvh, values = build_timed(bench.mesh(name), bench.pool(usable_cores()), "frontier", frontier=int(case["frontier"]))
    frame = draw_frame(bench, name, bvh, bench.scale.picture(*_PICTURE), layout="bvh2")
    build_ms, kernel_ms = values["build_ms"], frame.times_ms["kernel"]
    return Sample({"build_ms": build_ms, "kernel_ms": kernel_ms, "total_ms": build_ms + kernel_ms})


def _present(results: Results) -> list[Part]:
    builds, kernels, totals = (curve(f"frontier.{quantity}") for quantity in ("build_ms", "kernel_ms", "total_ms"))
    quantities = ("build_ms", "kernel_ms", "total_ms")
    rows = []
    for case in results.cases:
        frontier = int(case["frontier"])
        rows.append((
            frontier, *(results.summary(case, quantity) for quantity in quantities),
            *(table.get(frontier) for table in (builds, kernels, totals)),
        ))  # fmt: skip
    measured = {int(case["frontier"]): total for case in results.cases if (total := results.summary(case, "total_ms"))}
    parts: list[Part] = [
        Table(
            f"{', '.join(results.distinct('mesh'))}, {results.cores} workers, layout bvh2, a picture of "
            f"{results.scale.size_of(*_PICTURE)}. "
            f"The report: {source_of('frontier')}, at 3840 x 2160.",
            ("F", "build, ms", "kernel, ms", "total, ms", "report: build", "kernel", "total"),
            rows,
        )
    ]
    if measured:
        best = min(measured, key=lambda frontier: measured[frontier].median)
        report_best = min(totals, key=lambda frontier: totals[frontier])
        parts.append(
            Paragraph(
                f"Best F here: {best:,}. The report: between {published('frontier.best_from')} and "
                f"{published('frontier.best_to')}; the least total of its table is at {report_best}."
            )
        )
        ours = [measured[frontier].scaled(1 / measured[best].median) for frontier in measured]
        theirs = [totals[frontier] / totals[report_best] for frontier in totals]
        parts.append(
            Figure(
                "Total relative to the best F. The report's picture is larger and its device faster, so only the "
                "shapes compare.",
                draw_curves(
                    Axis("F, triangles in a leaf", is_log=True, ticks=sorted({*measured, *list(totals)[::2]})),
                    Axis("relative total", is_log=True),
                    [
                        Series("clbvh", list(measured), ours),
                        Series("the report", list(totals), theirs, is_published=True),
                    ],
                ),
            )
        )
    return parts


EXPERIMENT = Experiment(
    name="frontier",
    title="Frontier",
    question="Does it pay to stop the build at large leaves and let the device test their triangles one by one?",
    method="Build: wall time. Kernel: event time.",
    cases=_cases,
    measure=_measure,
    present=_present,
    weight=8,
)
