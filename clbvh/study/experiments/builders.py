"""The builders of the report: its ladder, more workers, the task threshold, and the work that a processor counts."""

from __future__ import annotations

from ...builders.ladder.variants import VARIANTS
from ...support.host_threads import usable_cores
from ..bench import PHASE, Bench
from ..drawing import REPORT, Axis, Point
from ..experiment import Experiment, curve, published, source_of
from ..ladder_work import count_ladder_work
from ..machine import EVENTS, count_build, find_counter_problem
from ..page import Figure, Paragraph, Part, Rows, Table
from ..samples import Case, Results, Sample
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

_THRESHOLDS = (64, 256, 1024, 4096, 16_384, 65_536)
_QUICK_THRESHOLDS = (256, 4096, 65_536)

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

    name = "ladder"
    weight = 4

    def cases(self, scale: Scale) -> list[Case]:
        dragon = scale.mesh("dragon")
        leaves_out = not scale.is_full and scale.most_triangles > _LARGE
        return [
            {"mesh": mesh, "builder": builder}
            for mesh in dict.fromkeys((scale.mesh("bunny"), dragon))
            for builder in (*VARIANTS, _DEFAULT)
            if not (leaves_out and mesh == dragon and builder in _SLOW)
        ]

    def measure(self, bench: Bench, case: Case) -> Sample:
        bvh, values = bench.build(case["mesh"], case["builder"])
        frame = bench.draw(case["mesh"], bvh, _PICTURE, layout="bvh2")
        return Sample({**values, "kernel_ms": frame.times_ms["kernel"]}, {"picture": frame.digest})

    def present(self, results: Results) -> list[Part]:
        says, speedups = published("ladder.says"), published("ladder.speedup")
        parts: list[Part] = []
        for mesh in results.distinct("mesh"):
            cases = results.by("builder", mesh=mesh)
            rows = [
                (
                    name, results.expect(case, "build_ms"),
                    results.ratio(cases.get(_BEFORE.get(name)), case, "build_ms"), speedups.get(name),
                    results.summary(case, "kernel_ms"), results.agree(cases.values(), case, "picture"),
                    says.get(name, "the default of clbvh"),
                )
                for name, case in cases.items()
            ]  # fmt: skip
            text = self.say(results, "table", mesh, _PICTURE, _DEFAULT)
            columns = ("variant", "build, ms", "speed-up", "report's speed-up", "kernel, ms", "same picture", "report")
            points = [("clbvh", name, build_ms) for name, build_ms, *_ in rows]
            caption = f"Build times of the variants on {mesh}, on a logarithmic scale."
            parts += [Table(text, columns, rows), Figure(caption, points, Axis("build, ms", is_log=True))]
        return parts


class Scaling(Experiment):
    """Build scaling.

    How much faster is the build on more workers, and which part of it stays serial?

    Wall time of the build with a warm pool. Efficiency: speed-up over the number of workers. The phases are metadata
    (boxes and centroids), top (until there are enough subtrees), subtrees, and compaction.
    """

    name = "scaling"
    weight = 2

    def cases(self, scale: Scale) -> list[Case]:
        cores, mesh = usable_cores(), scale.mesh("dragon")
        # 1, 2, 4, 8 ... and all.
        counts = [*(1 << power for power in range((cores - 1).bit_length())), cores]
        return [{"mesh": mesh, "builder": builder, "workers": workers} for builder in _BUILDERS for workers in counts]

    def measure(self, bench: Bench, case: Case) -> Sample:
        return Sample(bench.build(case["mesh"], case["builder"], workers=case["workers"])[1])

    def present(self, results: Results) -> list[Part]:
        report = {workers: curve("scaling.build_ms")[1] / ms for workers, ms in curve("scaling.build_ms").items()}
        rows: Rows = []
        fits: Rows = []
        phases: list[Part] = []
        points: list[Point] = []
        for builder in results.distinct("builder"):
            cases = results.by("workers", builder=builder)
            for workers, case in cases.items():
                speedup = results.ratio(cases.get(1), case, "build_ms")
                efficiency = speedup and speedup.scaled(1 / workers)
                build_ms = results.expect(case, "build_ms")
                rows.append((builder, workers, build_ms, speedup, efficiency, report.get(workers)))
                points.append((builder, workers, speedup))
            serial = fit_amdahl({workers: results.expect(case, "build_ms").median for workers, case in cases.items()})
            fits.append((builder, serial, None if serial is None else amdahl_speedup(serial, _PREDICTED)))
            names = results.quantities(next(iter(cases.values())), PHASE)
            phases.append(
                Table(
                    f"Phases of {builder}. The phase convert is not counted, see the ladder.",
                    ("workers", *(f"{phase.removesuffix('_ms')}, ms" for phase in names)),
                    [(workers, *results.summaries(case, *(PHASE + name for name in names)))
                     for workers, case in cases.items()],
                )
            )  # fmt: skip
        fits.append((REPORT, fit_amdahl(curve("scaling.build_ms")), report[_PREDICTED]))
        points += [(REPORT, *point) for point in report.items()]
        ticks = sorted({1, 2, 4, 8, *results.distinct("workers")})
        return [
            Table(
                f"Build by number of workers on {results.meshes}. The report: {source_of('scaling')}, on 8 cores.",
                ("builder", "workers", "build, ms", "speed-up", "efficiency", "report's speed-up"),
                rows,
            ),
            Figure(
                "Speed-up over one worker; the report's as published.",
                points, Axis("speed-up"), Axis("workers", is_log=True, ticks=ticks),
            ),
            Table(
                self.say(results, "fits", _PREDICTED),
                ("builder", "serial fraction", f"speed-up on {_PREDICTED}, by the law"),
                fits,
            ),
            *phases,
            Paragraph(self.say(results, "limits")),
        ]  # fmt: skip


class Threshold(Experiment):
    """Task threshold.

    Does it matter at which size a range becomes one worker's task?

    Wall time of the build. The tree is the same for all thresholds. A task of the report is a thread's, of clbvh a
    worker process's.
    """

    name = "threshold"
    weight = 2

    def cases(self, scale: Scale) -> list[Case]:
        return [
            {"mesh": scale.mesh("dragon"), "builder": builder, "threshold": threshold}
            for builder in _BUILDERS
            for threshold in scale.pick(_THRESHOLDS, _QUICK_THRESHOLDS)
        ]

    def measure(self, bench: Bench, case: Case) -> Sample:
        _, values = bench.build(case["mesh"], case["builder"], task_threshold=case["threshold"])
        return Sample({"build_ms": values["build_ms"]})

    def present(self, results: Results) -> list[Part]:
        report = curve("threshold.relative")
        rows = []
        for builder in results.distinct("builder"):
            cases = results.by("threshold", builder=builder)
            times = {threshold: results.expect(case, "build_ms") for threshold, case in cases.items()}
            best = min(summary.median for summary in times.values())
            rows += [(builder, size, ms, ms.scaled(1 / best), report.get(size)) for size, ms in times.items()]
        points = [(builder, size, relative) for builder, size, _, relative, _ in rows]
        ticks = sorted({*_THRESHOLDS[::2], *results.distinct("threshold")})
        return [
            Table(
                self.say(results, "table"),
                ("builder", "task threshold", "build, ms", "relative", "report's relative"),
                rows,
            ),
            Figure(
                "Build time relative to the best threshold.",
                [*points, *((REPORT, *point) for point in report.items())],
                Axis("relative time"), Axis("task threshold, triangles", is_log=True, ticks=ticks),
            ),
        ]  # fmt: skip


class Counters(Experiment):
    """Counters.

    How much less work does each variant of the ladder make?

    Hardware counters: perf stat around a process that builds one tree, and around one that builds three; half the
    difference. Counted work: the variants' own compiled steps, run on arrays that count.
    """

    name = "counters"
    weight = 2
    counts = True

    def cases(self, scale: Scale) -> list[Case]:
        mesh = scale.mesh(scale.pick("dragon", "bunny"))
        return [{"mesh": mesh, "builder": builder} for builder in VARIANTS]

    def measure(self, bench: Bench, case: Case) -> Sample:
        work = count_ladder_work(bench.mesh(case["mesh"]), case["builder"])
        values = {quantity: float(count) for quantity, count in work._asdict().items()}
        problem = find_counter_problem()
        if problem:
            return Sample(values, {_PROBLEM: problem})
        return Sample(values | count_build(case["mesh"], case["builder"]))

    def present(self, results: Results) -> list[Part]:
        cases = results.by("builder")
        points = [
            (_WORK[quantity], builder, results.count(case, quantity) or None)
            for quantity in _DRAWN_WORK
            for builder, case in cases.items()
        ]
        return [
            self._present_events(results, cases),
            Table(
                f"Counted work of one build of {results.meshes}.",
                ("variant", *_WORK.values()),
                [(name, *(results.count(case, quantity) for quantity in _WORK)) for name, case in cases.items()],
            ),
            Figure("Counted work.", points, Axis("times in one build", is_log=True)),
            Paragraph(self.say(results, "report")),
        ]

    def _present_events(self, results: Results, cases: dict[str, Case]) -> Part:
        measured = {name: case for name, case in cases.items() if results.quantities(case, "instructions")}
        if not measured:
            return Paragraph(self.say(results, "missing", results.fact(results.cases[0], _PROBLEM)))
        first = next(iter(measured))
        ratios = {name: [results.ratio(measured[first], case, event) for event in EVENTS.values()]
                  for name, case in measured.items()}  # fmt: skip
        return Table(
            f"Hardware counters of one build of {results.meshes} in one process.",
            ("variant", *EVENTS, *(f"{event}: {first} over this" for event in EVENTS)),
            [(name, *results.summaries(case, *EVENTS.values()), *ratios[name]) for name, case in measured.items()],
        )
