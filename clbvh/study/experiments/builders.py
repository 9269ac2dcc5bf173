"""The builders of the report: its ladder, more workers, the task threshold, and the work that a processor counts."""

from __future__ import annotations

from collections.abc import Iterator

from ...builders.ladder.variants import VARIANTS
from ...builders.options import FAST_QUALITY
from ...stats import measure_tree
from ...support.host_threads import usable_cores
from ..bench import PHASE, Bench
from ..experiment import Experiment, curve, published
from ..ladder_work import count_ladder_work
from ..machine import EVENTS, count_build, find_counter_problem
from ..page import REPORT, Axis, Figure, Part, Point, Table
from ..samples import Case, Results, Sample, cross
from ..scale import Scale
from ..statistics import amdahl_speedup, fit_amdahl

_PICTURE = (800, 450)
_DEFAULT = "sah"
# Builders whose workers and thresholds vary.
_BUILDERS = (_DEFAULT, "bin")

# The variant before, except where the report compares with another one.
_BEFORE = dict(zip((*VARIANTS,)[1:], VARIANTS, strict=False))
_BEFORE |= {"flatten": "bin", "flat": "bin", "frontier": "flat", _DEFAULT: "flat"}
# Seconds each on the dragon: a quick study leaves them out there.
_SLOW = ("sequential", "naive", "range")
_LARGE = 200_000

# Workers for which the fitted law is evaluated.
_PREDICTED = 8

# Of a full and of a quick study.
_THRESHOLDS = (64, 256, 1024, 4096, 16_384, 65_536), (256, 4096, 65_536)

# The fact that says why there are no hardware counters.
_PROBLEM = "no_counters"
# Headings of the quantities of `LadderWork`.
_WORK = {
    "comparisons": "comparisons",
    "bin_lookups": "bin look-ups",
    "boxes": "boxes computed",
    "moves": "record moves",
    "allocations": "allocations",
}
_DRAWN_WORK = ("comparisons", "boxes", "moves")


class Ladder(Experiment):
    """The ladder of builders.

    What does each idea of the report gain, from the sequential baseline to the final design?

    Wall time of the whole build, the phase 'convert' excepted; kernel: event time of one picture with lambert shading,
    in the layout bvh2. All variants take turns.
    """

    weight = 4

    def cases(self, scale: Scale) -> list[Case]:
        dragon = scale.mesh("dragon")
        left_out = _SLOW if not scale.is_full and scale.most_triangles > _LARGE else ()
        cases = cross(mesh=(scale.mesh("bunny"), dragon), builder=(*VARIANTS, _DEFAULT))
        return [case for case in cases if case["mesh"] != dragon or case["builder"] not in left_out]

    def measure(self, bench: Bench, case: Case) -> Sample:
        bvh, values = bench.build(case["mesh"], case["builder"])
        frame = bench.draw(case["mesh"], bvh, _PICTURE, layout="bvh2")
        return Sample({**values, "kernel_ms": frame.times_ms["kernel"]}, {"picture": frame.digest})

    def present(self, results: Results) -> Iterator[Part]:
        says, gains = published("ladder.says"), published("ladder.speedup")
        columns = ("variant", "build, ms", "speed-up", "report's speed-up", "kernel, ms", "same picture", "report")
        for mesh in results.distinct("mesh"):
            cases = results.by("builder", mesh=mesh)
            rows = []
            for name, case in cases.items():
                build_ms, kernel_ms = results.summaries(case, "build_ms", "kernel_ms")
                speedup = results.ratio(cases.get(_BEFORE.get(name)), case, "build_ms")
                same = results.agree(cases.values(), case, "picture")
                said = says.get(name, "the default of clbvh")
                rows.append((name, build_ms, speedup, gains.get(name), kernel_ms, same, said))
            # The document has the largest mesh.
            is_detail = mesh != results.distinct("mesh")[-1]
            yield Table(self.say(results, "table", mesh, _PICTURE, _DEFAULT), columns, rows, is_detail)
            caption = f"Build times of the variants on {mesh}, on a logarithmic scale."
            points = [("clbvh", name, build_ms) for name, build_ms, *_ in rows]
            yield Figure(caption, points, Axis("build, ms", is_log=True))


class Trees(Experiment):
    """Trees of the host and of the device.

    What does a tree cost that is built on the device, along a curve, and how long do rays take through it?

    Wall time of the build; from and to the host's memory on the device. SAH cost and EPO (end-point overlap) of the
    tree; kernel: event time of one picture with lambert shading, in the layout bvh2.
    """

    def cases(self, scale: Scale) -> list[Case]:
        return cross(mesh=map(scale.mesh, ("bunny", "dragon")), builder=("flat", _DEFAULT, FAST_QUALITY))

    def measure(self, bench: Bench, case: Case) -> Sample:
        bvh, values = bench.build(case["mesh"], case["builder"])
        measured = bench.once(("measured", *case.values()), lambda: measure_tree(bvh))
        frame = bench.draw(case["mesh"], bvh, _PICTURE, layout="bvh2")
        values |= {"sah_cost": measured.sah_cost, "epo": measured.epo, "kernel_ms": frame.times_ms["kernel"]}
        return Sample(values, {"picture": frame.digest})

    def present(self, results: Results) -> Iterator[Part]:
        columns = ("builder", "build, ms", "SAH cost", "EPO", "kernel, ms", "same picture")
        for mesh in results.distinct("mesh"):
            cases = results.by("builder", mesh=mesh)
            rows = [
                (
                    name,
                    results.summary(case, "build_ms"),
                    *(results.summary(case, quantity).median for quantity in ("sah_cost", "epo")),
                    results.summary(case, "kernel_ms"),
                    results.agree(cases.values(), case, "picture"),
                )
                for name, case in cases.items()
            ]
            yield Table(self.say(results, "table", mesh, _PICTURE), columns, rows)


class Scaling(Experiment):
    """Build scaling.

    How much faster is the build on more workers, and which part of it stays serial?

    Wall time of the build with a warm pool. Efficiency: speed-up over the number of workers. The phases are metadata
    (boxes and centroids), top (until there are enough subtrees), subtrees, and compaction.
    """

    weight = 2

    def cases(self, scale: Scale) -> list[Case]:
        cores = usable_cores()
        # 1, 2, 4, 8 ... and all.
        counts = [*(1 << power for power in range((cores - 1).bit_length())), cores]
        return cross(mesh=[scale.mesh("dragon")], builder=_BUILDERS, workers=counts)

    def measure(self, bench: Bench, case: Case) -> Sample:
        return Sample(bench.build(case["mesh"], case["builder"], workers=case["workers"])[1])

    def present(self, results: Results) -> Iterator[Part]:
        report_ms = curve("scaling.build_ms")
        report = {workers: report_ms[1] / ms for workers, ms in report_ms.items()}
        rows, fits, phases = [], [], []
        for builder in results.distinct("builder"):
            cases = results.by("workers", builder=builder)
            times = {workers: results.summary(case, "build_ms") for workers, case in cases.items()}
            for workers, case in cases.items():
                speedup = results.ratio(cases.get(1), case, "build_ms")
                efficiency = speedup.scaled(1 / workers)
                rows.append((builder, workers, times[workers], speedup, efficiency, report.get(workers)))
            serial = fit_amdahl({workers: build_ms.median for workers, build_ms in times.items()})
            fits.append((builder, serial, amdahl_speedup(serial, _PREDICTED)))
            names = results.quantities(next(iter(cases.values())), PHASE)
            columns = ("workers", *(f"{phase.removesuffix('_ms')}, ms" for phase in names))
            quantities = [PHASE + name for name in names]
            of_phases = [(workers, *results.summaries(case, *quantities)) for workers, case in cases.items()]
            caption = f"Phases of {builder}. The phase convert is not counted, see the ladder."
            phases.append(Table(caption, columns, of_phases, is_detail=True))
        fits.append((REPORT, fit_amdahl(report_ms), report[_PREDICTED]))
        source = published("scaling.source")
        caption = f"Build by number of workers on {results.meshes}. The report: {source}, on 8 cores."
        yield Table(caption, ("builder", "workers", "build, ms", "speed-up", "efficiency", "report's speed-up"), rows)
        points: list[Point] = [(builder, workers, speedup) for builder, workers, _, speedup, *_ in rows]
        points += [(REPORT, *point) for point in report.items()]
        x = Axis("workers", is_log=True, ticks=sorted({1, 2, 4, 8, *results.distinct("workers")}))
        yield Figure("Speed-up over one worker; the report's as published.", points, Axis("speed-up"), x)
        columns = ("builder", "serial fraction", f"speed-up on {_PREDICTED}, by the law")
        yield Table(self.say(results, "fits", _PREDICTED), columns, fits)
        yield from phases
        yield self.say(results, "limits")


class Threshold(Experiment):
    """Task threshold.

    Does it matter at which size a range becomes one worker's task?

    Wall time of the build. The tree is the same for all thresholds. A task of the report is a thread's, of clbvh a
    worker process's.
    """

    weight = 2

    def cases(self, scale: Scale) -> list[Case]:
        return cross(mesh=[scale.mesh("dragon")], builder=_BUILDERS, threshold=scale.pick(*_THRESHOLDS))

    def measure(self, bench: Bench, case: Case) -> Sample:
        _, values = bench.build(case["mesh"], case["builder"], task_threshold=case["threshold"])
        return Sample({"build_ms": values["build_ms"]})

    def present(self, results: Results) -> Iterator[Part]:
        report = curve("threshold.relative")
        rows = []
        for builder in results.distinct("builder"):
            cases = results.by("threshold", builder=builder)
            times = {threshold: results.summary(case, "build_ms") for threshold, case in cases.items()}
            best = min(summary.median for summary in times.values())
            rows += [(builder, size, ms, ms.scaled(1 / best), report.get(size)) for size, ms in times.items()]
        columns = ("builder", "task threshold", "build, ms", "relative", "report's relative")
        yield Table(self.say(results, "table"), columns, rows)
        points: list[Point] = [(builder, size, relative) for builder, size, _, relative, _ in rows]
        points += [(REPORT, *point) for point in report.items()]
        ticks = sorted({*_THRESHOLDS[0][::2], *results.distinct("threshold")})
        x = Axis("task threshold, triangles", is_log=True, ticks=ticks)
        yield Figure("Build time relative to the best threshold.", points, Axis("relative time"), x)


class Counters(Experiment):
    """Counters.

    How much less work does each variant of the ladder make?

    Hardware counters: perf stat around a process that builds one tree, and around one that builds three; half the
    difference. Counted work: the variants' own compiled steps, run on arrays that count.
    """

    weight = 2
    counts = True

    def cases(self, scale: Scale) -> list[Case]:
        return cross(mesh=[scale.mesh(scale.pick("dragon", "bunny"))], builder=VARIANTS)

    def measure(self, bench: Bench, case: Case) -> Sample:
        work = count_ladder_work(bench.mesh(case["mesh"]), case["builder"])
        values = {quantity: float(count) for quantity, count in work._asdict().items()}
        if problem := find_counter_problem():
            return Sample(values, {_PROBLEM: problem})
        return Sample(values | count_build(case["mesh"], case["builder"]))

    def present(self, results: Results) -> Iterator[Part]:
        cases = results.by("builder")
        measured = {name: case for name, case in cases.items() if results.quantities(case, "instructions")}
        if first := next(iter(measured), ""):
            columns = ("variant", *EVENTS, *(f"{event}: {first} over this" for event in EVENTS))
            rows = []
            for name, case in measured.items():
                ratios = [results.ratio(measured[first], case, event) for event in EVENTS.values()]
                rows.append((name, *results.summaries(case, *EVENTS.values()), *ratios))
            yield Table(f"Hardware counters of one build of {results.meshes} in one process.", columns, rows)
        else:
            yield self.say(results, "missing", results.fact(results.cases[0], _PROBLEM))
        counts = {name: [results.count(case, quantity) for quantity in _WORK] for name, case in cases.items()}
        caption = f"Counted work of one build of {results.meshes}."
        yield Table(caption, ("variant", *_WORK.values()), [(name, *row) for name, row in counts.items()])
        points = [
            (_WORK[quantity], builder, results.count(case, quantity) or None)
            for quantity in _DRAWN_WORK
            for builder, case in cases.items()
        ]
        yield Figure("Counted work.", points, Axis("times in one build", is_log=True))
        yield self.say(results, "report")
