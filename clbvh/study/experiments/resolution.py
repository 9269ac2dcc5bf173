"""Host build and host traversal against host build and device traversal, at three sizes of the picture."""

from __future__ import annotations

import time

from ...bvh import Bvh
from ...support.host_threads import usable_cores
from ...trace.oracle.visits import HostTraversal
from ..bench import Bench
from ..builds import build_timed
from ..case import Case, Experiment, Sample
from ..frames import draw_frame
from ..page.drawing import Axis, Series, draw_bars
from ..page.parts import Figure, Paragraph, Part, Table
from ..report import published, source_of
from ..results import Results
from ..scale import Scale
from ..statistics import Summary

_PICTURES = {"800 x 450": (800, 450), "1080p": (1920, 1080), "4K": (3840, 2160)}
_ONE, _ALL, _DEVICE = "host, 1 core", "host, all cores", "device"


def _cases(scale: Scale) -> list[Case]:
    mesh = scale.mesh(scale.pick("dragon", "bunny"))
    return [
        {"mesh": mesh, "picture": picture, "traversal": traversal}
        for picture in scale.pick(tuple(_PICTURES), tuple(_PICTURES)[:2])
        for traversal in (_ONE, _ALL, _DEVICE)
    ]


def _measure(bench: Bench, case: Case) -> Sample:
    name = str(case["mesh"])
    width, height = bench.scale.picture(*_PICTURES[str(case["picture"])])
    bvh, values = build_timed(bench.mesh(name), bench.pool(usable_cores()), "sah")
    if case["traversal"] == _DEVICE:
        begin = time.perf_counter()
        frame = draw_frame(bench, name, bvh, (width, height))
        wall_ms = (time.perf_counter() - begin) * 1e3
        trace_ms = sum(frame.times_ms.values())
        values = {"build_ms": values["build_ms"], "trace_ms": trace_ms, "kernel_ms": frame.times_ms["kernel"],
                  "trace_wall_ms": wall_ms}  # fmt: skip
    else:
        trace_ms = _trace_on_host(bench, name, bvh, (width, height), 1 if case["traversal"] == _ONE else usable_cores())
        values = {"build_ms": values["build_ms"], "trace_ms": trace_ms, "kernel_ms": trace_ms}
    return Sample({**values, "total_ms": values["build_ms"] + values["trace_ms"], "rays": width * height})


def _trace_on_host(bench: Bench, name: str, bvh: Bvh, size: tuple[int, int], threads: int) -> float:
    """Return the milliseconds of the closest hits of a picture on the host; rays and tree are ready before."""
    rays = bench.picture_rays(name, *size)
    traversal = bench.once(("host traversal", name), lambda: HostTraversal(bvh))
    begin = time.perf_counter()
    traversal.count_visits(*rays, threads=bench.threads(threads))
    return (time.perf_counter() - begin) * 1e3


def _present(results: Results) -> list[Part]:
    rows = []
    gains = []
    pictures = results.distinct("picture")
    totals: dict[str, list[Summary]] = {}
    for picture in pictures:
        cases = {str(case["traversal"]): case for case in results.find(picture=picture)}
        for traversal, case in cases.items():
            total = results.summary(case, "total_ms")
            rows.append((
                picture, traversal, int(results.median(case, "rays") or 0), results.summary(case, "build_ms"),
                results.summary(case, "trace_ms"), total,
            ))  # fmt: skip
            if total is not None:
                totals.setdefault(traversal, []).append(total)
        if _DEVICE in cases:
            for host in (_ONE, _ALL):
                if host in cases:
                    is_reports = picture == "4K" and host == _ONE
                    gains.append((
                        picture, host, results.ratio(cases[host], cases[_DEVICE], "total_ms"),
                        published("resolution.speedup") if is_reports else None,
                        results.ratio(cases[host], cases[_DEVICE], "kernel_ms"),
                        published("resolution.traversal_speedup") if is_reports else None,
                    ))  # fmt: skip
    bars = [Series(name, range(len(summaries)), summaries) for name, summaries in totals.items()]
    kind = results.machine.get("device kind", "missing")
    device = {"cpu": "the same processor, with its vector units", "gpu": "a graphics card"}.get(kind, kind)
    return [
        Paragraph(
            "The host traversal is the compiled one by which clbvh counts node steps (clbvh.trace.oracle.visits): "
            "one ray at a time through the binary tree, near child first, step for step the device's layout bvh2, "
            "without vector instructions. It also counts, which takes a little time. The device here is "
            f"{device}."
        ),
        Table(
            f"{', '.join(results.distinct('mesh'))}: build with {results.cores} workers, and traversal. On the "
            "device, traversal is upload, kernel and download by its own clock.",
            ("picture", "traversal", "rays", "build, ms", "traversal, ms", "total, ms"),
            rows,
        ),
        Figure("Build and traversal together.", draw_bars(Axis("total, ms", is_log=True), pictures, bars)),
        Table(
            f"The host's time over the device's. The report: {source_of('resolution')}, and kernel against CPU "
            "traversal.",
            ("picture", "host", "total", "report's", "traversal alone", "report's"),
            gains,
        ),
    ]


EXPERIMENT = Experiment(
    name="resolution",
    title="Resolution: host against device",
    question="When does traversal on the device pay?",
    method="Host traversal: wall time, rays made before. Device: event times. Opening the device and compiling are not "
    "counted.",
    cases=_cases,
    measure=_measure,
    present=_present,
    group=("mesh", "picture"),
    weight=5,
)
