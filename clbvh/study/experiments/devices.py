"""The trace table of every OpenCL device of the machine."""

from __future__ import annotations

import numpy as np

from ...device.select import survey_devices
from ...errors import DeviceError
from ...structs import LAYOUT_WIDTHS
from ...trace.tracer import Tracer
from ..bench import Bench
from ..case import Case, Experiment, NotMeasuredError, Sample
from ..page.drawing import Axis, Series, draw_bars
from ..page.parts import Figure, Paragraph, Part, Table
from ..results import Results
from ..scale import Scale
from ..statistics import Summary

_PICTURE = (1280, 720)
_SEED = 1
_NAME_LENGTH = 28
_COHERENT, _SHUFFLED, _ANY = "closest hit", "closest hit, shuffled", "any hit"
_QUERIES = (_COHERENT, _SHUFFLED, _ANY)


def _cases(scale: Scale) -> list[Case]:
    mesh = scale.mesh(scale.pick("dragon", "bunny"))
    try:
        devices = [info for info in survey_devices().devices if info.is_available and not info.is_simulator]
    except DeviceError:
        devices = []
    return [
        {"mesh": mesh, "device": f"{info.name}, {info.platform}", "number": info.number, "layout": layout}
        for info in devices
        for layout in LAYOUT_WIDTHS
    ]


def _measure(bench: Bench, case: Case) -> Sample:
    info = next((one for one in bench.machine.devices if one.number == case["number"]), None)
    if info is None:
        raise NotMeasuredError(f"the device {case['device']} is gone")
    mesh, layout = str(case["mesh"]), str(case["layout"])
    bench.rest_before(str(case["device"]))
    tracer = bench.open(("tracer", info.number, layout), lambda: Tracer(bench.tree(mesh), device=info, layout=layout))
    origins, directions = bench.picture_rays(mesh, *bench.scale.picture(*_PICTURE))
    order = bench.once("order", lambda: np.random.default_rng(_SEED).permutation(len(origins)))
    shuffled = bench.once("shuffled", lambda: (origins[order], directions[order]))
    values: dict[str, float] = {"rays": len(origins)}
    for query, method, rays in (
        (_COHERENT, tracer.closest_prim, (origins, directions)),
        (_SHUFFLED, tracer.closest_prim, shuffled),
        (_ANY, tracer.any_hit, (origins, directions)),
    ):
        before = tracer.timings_ms.get("kernel", 0.0)
        method(*rays)
        values[f"{query}_kernel_ms"] = tracer.timings_ms["kernel"] - before
    return Sample(values)


def _present(results: Results) -> list[Part]:
    if not results.cases:
        return [Table("No device.", ("device", "layout", *_QUERIES), []), Paragraph("There is no OpenCL device here.")]
    speeds = {query: [_rays_per_second(results, case, query) for case in results.cases] for query in _QUERIES}
    rows = [
        (case["device"], case["layout"], *of_case)
        for case, *of_case in zip(results.cases, *speeds.values(), strict=True)
    ]
    # Drivers put clocks and features behind the name.
    names = [f"{str(case['device']).partition(',')[0][:_NAME_LENGTH]}, {case['layout']}" for case in results.cases]
    series = [Series(query, range(len(names)), of_query) for query, of_query in speeds.items()]
    return [
        Table(
            f"{', '.join(results.distinct('mesh'))}, rays of a picture of "
            f"{results.scale.size_of(*_PICTURE)}: million rays per second, by the "
            "kernel's event time. Shuffled rays are sorted on the host before, which is not in this time.",
            ("device", "layout", *(f"{query}, Mray/s" for query in _QUERIES)),
            rows,
        ),
        Figure("Rays per second.", draw_bars(Axis("million rays per second"), names, series)),
    ]


def _rays_per_second(results: Results, case: Case, query: str) -> Summary:
    """Return millions of rays per second."""
    milliseconds = Summary.of(results.values(case, f"{query}_kernel_ms"))
    return milliseconds.scaled(1e3).rate(results.median(case, "rays") or 0.0)


EXPERIMENT = Experiment(
    name="devices",
    title="Devices",
    question="How fast are the layouts and queries on each OpenCL device of this machine?",
    method="Event time of the kernels. Two drivers for one processor are two devices.",
    cases=_cases,
    measure=_measure,
    present=_present,
    weight=2,
)
