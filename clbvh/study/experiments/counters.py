"""Instructions and cache misses of each variant; counted work where the machine has no such counters."""

from __future__ import annotations

from ...builders.ladder import VARIANTS
from ...stats.ladder_work import count_ladder_work
from ..bench import Bench
from ..case import Case, Experiment, Sample
from ..hardware_counters import EVENTS, count_build, find_problem
from ..page.drawing import Axis, Series, draw_bars
from ..page.parts import Figure, Paragraph, Part, Table
from ..report import published, source_of
from ..results import Results
from ..scale import Scale

# The fact that says why there are no hardware counters.
_PROBLEM = "no_counters"

# Named after the quantities of `LadderWork`.
_WORK = {
    "comparisons": "comparisons",
    "bin_lookups": "bin look-ups",
    "boxes": "boxes computed",
    "moves": "record moves",
    "allocations": "allocations",
}


def _cases(scale: Scale) -> list[Case]:
    mesh = scale.mesh(scale.pick("dragon", "bunny"))
    return [{"mesh": mesh, "builder": builder} for builder in VARIANTS]


def _measure(bench: Bench, case: Case) -> Sample:
    name, builder = str(case["mesh"]), str(case["builder"])
    work = count_ladder_work(bench.mesh(name), builder)
    values = {quantity: float(getattr(work, quantity)) for quantity in _WORK}
    problem = find_problem()
    if problem:
        return Sample(values, {_PROBLEM: problem})
    return Sample(values | count_build(name, builder))


def _present(results: Results) -> list[Part]:
    cases = {str(case["builder"]): case for case in results.cases}
    mesh = ", ".join(results.distinct("mesh"))
    rows = [
        (builder, *(_whole(results.median(case, quantity)) for quantity in _WORK)) for builder, case in cases.items()
    ]
    parts: list[Part] = []
    measured = {builder: case for builder, case in cases.items() if results.quantities(case, "instructions")}
    if measured:
        parts += [_list_events(results, mesh, measured)]
    else:
        parts.append(
            Paragraph(
                f"No hardware counters here: {results.fact(results.cases[0], _PROBLEM)}. The table below is counted "
                "work, not what a processor counts: how often the variants' own code compares, looks up, computes, "
                "moves and allocates."
            )
        )
    parts.append(Table(f"Counted work of one build of {mesh}.", ("variant", *_WORK.values()), rows))
    series = [
        Series(title, [index for index, row in enumerate(rows) if row[1 + number]],
               [float(row[1 + number] or 0) for row in rows if row[1 + number]])
        for number, title in enumerate(_WORK.values()) if title in ("comparisons", "boxes computed", "record moves")
    ]  # fmt: skip
    parts.append(Figure("Counted work.", draw_bars(Axis("times in one build", is_log=True), list(cases), series)))
    ratios = ", ".join(
        f"{published(f'counters.{quantity}')} times fewer {event.replace('-', ' ')}"
        for event, quantity in EVENTS.items()
    )
    more = ", ".join(
        f"{published(f'counters.atomic.{quantity}')} times the {event.replace('-', ' ')}"
        for event, quantity in EVENTS.items()
    )
    parts.append(
        Paragraph(f"The report ({source_of('counters')}): bin has {ratios} than sequential; atomic has {more} of bin.")
    )
    return parts


def _list_events(results: Results, mesh: str, cases: dict[str, Case]) -> Table:
    first = next(iter(cases))
    return Table(
        f"Hardware counters of one build of {mesh} in one process.",
        ("variant", *EVENTS, *(f"{event}: {first} over this" for event in EVENTS)),
        [
            (
                builder,
                *(results.summary(case, name) for name in EVENTS.values()),
                *(results.ratio(cases[first], case, name) for name in EVENTS.values()),
            )
            for builder, case in cases.items()
        ],
    )


def _whole(value: float | None) -> int | None:
    return None if value is None else int(value)


EXPERIMENT = Experiment(
    name="counters",
    title="Counters",
    question="How much less work does each variant of the ladder make?",
    method="Hardware counters: perf stat around a process that builds one tree, and around one that builds three; "
    "half the difference. Counted work: the variants' own compiled steps, run on arrays that count.",
    cases=_cases,
    measure=_measure,
    present=_present,
    weight=2,
    counts=True,
)
