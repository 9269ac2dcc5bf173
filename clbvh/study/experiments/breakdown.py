"""Where the time of one frame goes."""

from __future__ import annotations

import time

from ...support.host_threads import usable_cores
from ..bench import Bench, load_named_mesh
from ..builds import build_timed
from ..case import Case, Experiment, Sample
from ..frames import draw_frame
from ..page.drawing import Axis, Series, draw_bars
from ..page.parts import Cell, Figure, Part, Table
from ..report import published, source_of
from ..results import Results
from ..scale import Scale

_PICTURE = (3840, 2160)
_PHASES = ("load", "build", "upload", "kernel", "download")
# The report's frame begins with the build.
_FRAME = _PHASES[1:]


def _cases(scale: Scale) -> list[Case]:
    mesh = scale.mesh("dragon")
    return [{"mesh": mesh, "builder": builder} for builder in ("sah", "flat")]


def _measure(bench: Bench, case: Case) -> Sample:
    name = str(case["mesh"])
    begin = time.perf_counter()
    load_named_mesh(name)
    load_ms = (time.perf_counter() - begin) * 1e3
    bvh, values = build_timed(bench.mesh(name), bench.pool(usable_cores()), str(case["builder"]))
    frame = draw_frame(bench, name, bvh, bench.scale.picture(*_PICTURE))
    phases = {"load_ms": load_ms, "build_ms": values["build_ms"]}
    phases |= {f"{phase}_ms": frame.times_ms[phase] for phase in ("upload", "kernel", "download")}
    total_ms = sum(phases[f"{phase}_ms"] for phase in _FRAME)
    return Sample({**phases, "frame_ms": total_ms, "build_share": phases["build_ms"] / total_ms})


def _present(results: Results) -> list[Part]:
    report_ms = {**published("breakdown.ms"), "frame": published("breakdown.ms.total")}
    cases = {str(case["builder"]): case for case in results.cases}
    rows: list[tuple[Cell, ...]] = [
        (f"{phase}, ms", *(results.summary(case, f"{phase}_ms") for case in cases.values()), report_ms.get(phase))
        for phase in (*_PHASES, "frame")
    ]
    shares = [results.summary(case, "build_share") for case in cases.values()]
    percent = [None if share is None else share.scaled(100) for share in shares]
    rows.append(("build, % of the frame", *percent, 100 * published("breakdown.share.build")))
    series = [
        Series(name, range(len(_FRAME)), [results.summary(case, f"{phase}_ms") or 0.0 for phase in _FRAME])
        for name, case in cases.items()
    ]
    series.append(Series("the report", range(len(_FRAME)), [report_ms[phase] for phase in _FRAME], is_published=True))
    return [
        Table(
            f"One frame of {', '.join(results.distinct('mesh'))} at "
            f"{results.scale.size_of(*_PICTURE)}. The frame is the sum without loading. "
            f"The report: {source_of('breakdown')}.",
            ("phase", *(f"builder {name}" for name in cases), "the report"),
            rows,
        ),
        Figure("The parts of a frame.", draw_bars(Axis("ms", is_log=True), _FRAME, series)),
    ]


EXPERIMENT = Experiment(
    name="breakdown",
    title="Breakdown of a frame",
    question="Which part of a 4K frame is the build?",
    method="Load and build: wall time. Upload, kernel and download: event times. The file is in the system's cache.",
    cases=_cases,
    measure=_measure,
    present=_present,
    weight=3,
)
