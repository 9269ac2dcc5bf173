"""Every variant of the report's ladder: what each of its ideas gains."""

from __future__ import annotations

from ...builders.ladder import VARIANTS
from ...support.host_threads import usable_cores
from ..bench import Bench
from ..builds import build_timed
from ..case import Case, Experiment, Sample
from ..frames import draw_frame
from ..page.drawing import Axis, Series, draw_bars
from ..page.parts import Figure, Part, Table
from ..report import published, source_of
from ..results import Results
from ..scale import Scale
from ..statistics import Summary

_DEFAULT = "sah"
_BUILDERS = (*VARIANTS, _DEFAULT)

# Seconds each on the dragon: a quick study leaves them out there.
_SLOW = ("sequential", "naive", "range")
_LARGE = 200_000

_PICTURE = (800, 450)
# The variant before, except where the report compares with another one.
_BEFORE = {name: before for before, name in zip((*VARIANTS,), (*VARIANTS,)[1:], strict=False)}
_BEFORE["flatten"] = _BEFORE["flat"] = "bin"
_BEFORE["frontier"] = _BEFORE[_DEFAULT] = "flat"


def _cases(scale: Scale) -> list[Case]:
    meshes = dict.fromkeys(scale.mesh(name) for name in ("bunny", "dragon"))
    large = scale.mesh("dragon") if scale.most_triangles > _LARGE else None
    return [
        {"mesh": mesh, "builder": builder}
        for mesh in meshes
        for builder in _BUILDERS
        if scale.is_full or mesh != large or builder not in _SLOW
    ]


def _measure(bench: Bench, case: Case) -> Sample:
    mesh, builder = str(case["mesh"]), str(case["builder"])
    bvh, values = build_timed(bench.mesh(mesh), bench.pool(usable_cores()), builder)
    frame = draw_frame(bench, mesh, bvh, bench.scale.picture(*_PICTURE), layout="bvh2")
    return Sample({**values, "kernel_ms": frame.times_ms["kernel"]}, {"picture": frame.digest})


def _present(results: Results) -> list[Part]:
    says, speedups = published("ladder.says"), published("ladder.speedup")
    parts: list[Part] = []
    for mesh in results.distinct("mesh"):
        cases = {str(case["builder"]): case for case in results.find(mesh=mesh)}
        pictures = {name: results.fact(case, "picture") for name, case in cases.items()}
        rows = []
        for name, case in cases.items():
            before = cases.get(_BEFORE.get(name, ""))
            rows.append((
                name,
                results.summary(case, "build_ms"),
                None if before is None else results.ratio(before, case, "build_ms"),
                speedups.get(name),
                results.summary(case, "kernel_ms"),
                "yes" if pictures[name] == next(iter(pictures.values())) else "NO",
                says.get(name, "the default of clbvh"),
            ))  # fmt: skip
        parts.append(
            Table(
                f"{mesh}, {results.cores} workers, a picture of "
                f"{results.scale.size_of(*_PICTURE)}. Speed-up: over the variant before; of flatten and flat over "
                f"bin, of frontier and {_DEFAULT} over flat. The report: {source_of('ladder')}.",
                ("variant", "build, ms", "speed-up", "report's speed-up", "kernel, ms", "same picture", "report"),
                rows,
            )
        )
        parts.append(_draw(results, mesh, cases))
    return parts


def _draw(results: Results, mesh: str, cases: dict[str, Case]) -> Figure:
    names = list(cases)
    builds = [results.summary(case, "build_ms") or Summary(0, 0, 0, 0) for case in cases.values()]
    bars = draw_bars(Axis("build, ms", is_log=True), names, [Series("clbvh", range(len(names)), builds)])
    return Figure(f"Build times of the variants on {mesh}, on a logarithmic scale.", bars)


EXPERIMENT = Experiment(
    name="ladder",
    title="The ladder of builders",
    question="What does each idea of the report gain, from the sequential baseline to the final design?",
    method="Wall time of the whole build, the phase 'convert' excepted; kernel: event time of one "
    "picture with lambert shading, in the layout bvh2. All variants take turns.",
    cases=_cases,
    measure=_measure,
    present=_present,
    weight=4,
)
