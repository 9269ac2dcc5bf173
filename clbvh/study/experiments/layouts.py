"""The layouts of the tree on the device: kernel, bytes and node visits."""

from __future__ import annotations

from ...layouts.device_arrays import measure_device_bytes
from ...structs import LAYOUT_WIDTHS
from ...support.host_threads import usable_cores
from ...trace.oracle.visits import HostTraversal, count_wide_visits
from ..bench import Bench
from ..builds import build_timed
from ..case import Case, Experiment, Sample
from ..frames import draw_frame
from ..page.drawing import Axis, Series, draw_bars
from ..page.parts import Figure, Part, Table
from ..report import published, source_of
from ..results import Results
from ..scale import Scale

_VARIANTS = ("flatten", "flat")
_PICTURE = (800, 450)
# Visits are counted on a picture of this size: their means hardly depend on it.
_COUNTED_PICTURE = (320, 180)


def _cases(scale: Scale) -> list[Case]:
    return [
        {"part": part, "mesh": mesh, choice: name}
        for mesh in dict.fromkeys(scale.mesh(scan) for scan in scale.pick(("bunny", "dragon"), ("dragon",)))
        for part, choice, names in (("builder", "builder", _VARIANTS), ("layout", "layout", tuple(LAYOUT_WIDTHS)))
        for name in names
    ]


def _measure(bench: Bench, case: Case) -> Sample:
    name = str(case["mesh"])
    if case["part"] == "builder":
        bvh, values = build_timed(bench.mesh(name), bench.pool(usable_cores()), str(case["builder"]))
        return Sample({"build_ms": values["build_ms"], "last_pass_ms": _last_pass_ms(values)})
    layout = str(case["layout"])
    bvh = bench.tree(name)
    frame = draw_frame(bench, name, bvh, bench.scale.picture(*_PICTURE), layout=layout)
    counted = bench.once(("counts", name, layout), lambda: _count(bench, name, layout))
    return Sample({"kernel_ms": frame.times_ms["kernel"], **counted}, {"picture": frame.digest})


def _last_pass_ms(values: dict[str, float]) -> float:
    """Return the milliseconds of the pass that brings the nodes into their final order."""
    return values.get("phase.flatten_ms", 0.0) + values.get("phase.compact_ms", 0.0)


def _count(bench: Bench, name: str, layout: str) -> dict[str, float]:
    bvh = bench.tree(name)
    rays = bench.picture_rays(name, *bench.scale.picture(*_COUNTED_PICTURE))
    width = LAYOUT_WIDTHS[layout]
    visits = HostTraversal(bvh).count_visits(*rays) if width == 2 else count_wide_visits(bvh, width, *rays)
    return {
        "bytes_per_triangle": measure_device_bytes(bvh, layout) / bvh.mesh.face_count,
        "node_visits": visits.node_steps_per_ray,
        "leaf_visits": visits.leaf_visits_per_ray,
        "triangle_tests": visits.triangle_tests_per_ray,
    }


def _present(results: Results) -> list[Part]:
    builders = []
    layouts = []
    for mesh in results.distinct("mesh"):
        cases = {str(case["builder"]): case for case in results.find(mesh=mesh, part="builder")}
        for name, case in cases.items():
            ratio = results.ratio(cases[_VARIANTS[0]], case, "build_ms") if _VARIANTS[0] in cases else None
            builders.append((
                mesh, name, results.summary(case, "build_ms"), results.summary(case, "last_pass_ms"),
                None if name == _VARIANTS[0] else ratio, published("ladder.says")[name],
            ))  # fmt: skip
        of_layout = results.find(mesh=mesh, part="layout")
        layouts += [
            (
                mesh, case["layout"], results.summary(case, "kernel_ms"),
                results.median(case, "bytes_per_triangle"), results.median(case, "node_visits"),
                results.median(case, "leaf_visits"), results.median(case, "triangle_tests"),
                "yes" if results.fact(case, "picture") == results.fact(of_layout[0], "picture") else "NO",
            )
            for case in of_layout
        ]  # fmt: skip
    names = [f"{case['mesh']}, {case['layout']}" for case in results.find(part="layout")]
    kernels = [results.summary(case, "kernel_ms") or 0.0 for case in results.find(part="layout")]
    return [
        Table(
            f"A separate pass that flattens, against writing the flat array at once; {results.cores} workers. "
            f"The report: {source_of('ladder')}.",
            ("mesh", "variant", "build, ms", "last pass, ms", "speed-up over flatten", "report"),
            builders,
        ),
        Table(
            f"Layouts of the default tree: kernel of a picture of "
            f"{results.scale.size_of(*_PICTURE)}, size on the device with the triangles, and "
            "means per ray.",
            ("mesh", "layout", "kernel, ms", "bytes a triangle", "node visits", "leaf visits", "triangle tests",
             "same picture"),
            layouts,
        ),
        Figure("Kernel times of the layouts.", draw_bars(Axis("kernel, ms"), names,
                                                         [Series("clbvh", range(len(names)), kernels)])),
    ]  # fmt: skip


EXPERIMENT = Experiment(
    name="layouts",
    title="Layouts",
    question="What does the flat array gain over flattening, and which width of the tree suits the device?",
    method="Build: wall time. Kernel: event time. Visits are counted on the host, from the root: neighbouring rays "
    "of a picture begin deeper on the device where the layout has entry points. One visit of bvh4 or bvh8 tests the "
    "boxes of all children, one leaf visit a block of up to 4 or 8 triangles.",
    cases=_cases,
    measure=_measure,
    present=_present,
    group=("part", "mesh"),
    weight=2,
)
