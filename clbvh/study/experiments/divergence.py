"""Node steps and triangle tests of each ray of a picture, and the lane use that they imply."""

from __future__ import annotations

import numpy as np

from ...rendering.heat_map import QUANTITIES, count_picture, draw_heat_map
from ..bench import Bench
from ..case import Case, Experiment, Sample
from ..page.drawing import Axis, Series, draw_bars
from ..page.parts import Cell, Figure, Paragraph, Part, Picture, Table
from ..report import published, source_of
from ..results import Results
from ..scale import Scale
from ..statistics import lane_use

_PICTURE = (800, 450)
_WIDTHS = (8, 16, 32)
# Neighbouring work-items form a group along a row, or as a tile of this many rows.
_SHAPES = {"row": 1, "tile": 4}


def _cases(scale: Scale) -> list[Case]:
    meshes = dict.fromkeys(scale.mesh(name) for name in ("bunny", "dragon"))
    return [{"mesh": mesh, "builder": builder} for mesh in meshes for builder in ("sah", "flat")]


def _measure(bench: Bench, case: Case) -> Sample:
    mesh, builder = str(case["mesh"]), str(case["builder"])
    width, height = bench.scale.picture(*_PICTURE)
    visits = count_picture(bench.tree(mesh, builder), bench.camera(mesh, width, height), width, height)
    counts = {
        "nodes": visits.node_steps.reshape(height, width),
        "triangles": visits.triangle_tests.reshape(height, width),
    }
    values: dict[str, float] = {}
    facts: dict[str, str] = {}
    for quantity, of_pixel in counts.items():
        values[f"{quantity}_mean"] = float(of_pixel.mean())
        values[f"{quantity}_most"] = int(of_pixel.max())
        if builder == "sah":
            name = f"heat-{mesh}-{quantity}"
            facts[quantity] = bench.keep_picture(name, draw_heat_map(of_pixel, quantity))
    work = np.add(*counts.values())
    for shape, rows in _SHAPES.items():
        for lanes in _WIDTHS:
            values[f"{shape}_{lanes}"] = lane_use(work, lanes, rows=rows)
    return Sample(values, facts)


def _present(results: Results) -> list[Part]:
    rows: list[tuple[Cell, ...]] = []
    series = []
    report_width = published("divergence.width")
    for case in results.cases:
        uses = {
            (shape, lanes): 100 * (results.median(case, f"{shape}_{lanes}") or 0.0)
            for shape in _SHAPES for lanes in _WIDTHS
        }  # fmt: skip
        rows.append((case["mesh"], case["builder"], *uses.values()))
        label = f"{case['mesh']}, {case['builder']}"
        series.append(Series(label, range(len(_WIDTHS)), [uses["tile", lanes] for lanes in _WIDTHS]))
    report = [100 * published("divergence.lane_use") if lanes == report_width else None for lanes in _WIDTHS]
    rows.append(("the report, by hardware counter", "flat", *report, None, None, None))
    at = [index for index, value in enumerate(report) if value is not None]
    series.append(Series("the report", at, [value for value in report if value is not None], is_published=True))
    pictures: list[Part] = [
        Picture(
            f"{case['mesh']}: {QUANTITIES[quantity].lower()} per ray.",
            (results.pictures / name).read_bytes(),
        )
        for case in results.cases
        for quantity in QUANTITIES
        if (name := results.fact(case, quantity)) is not None and (results.pictures / name).is_file()
    ]
    return [
        Table(
            f"Steps per ray of a picture of {results.scale.size_of(*_PICTURE)}, binary tree.",
            ("mesh", "builder", "node steps, mean", "most", "triangle tests, mean", "most"),
            [
                (case["mesh"], case["builder"], results.median(case, "nodes_mean"),
                 _whole(results.median(case, "nodes_most")), results.median(case, "triangles_mean"),
                 _whole(results.median(case, "triangles_most")))
                for case in results.cases
            ],
        ),
        Table(
            "Lane use in %, for groups of 8, 16 and 32 neighbouring pixels: along a row, and as tiles of 4 rows. "
            f"The report: {source_of('divergence')}, {published('divergence.active_threads')} of {report_width} "
            "threads.",
            ("mesh", "builder", *(f"{shape} {lanes}" for shape in _SHAPES for lanes in _WIDTHS)),
            rows,
        ),
        Figure(
            "Lane use of tiles.",
            draw_bars(Axis("lane use, %"), [f"{lanes} lanes" for lanes in _WIDTHS], series),
        ),
        *pictures,
        Paragraph(
            "Lane use: node steps plus triangle tests of all rays, over the lanes' time if each group takes as long as "
            "its longest ray. It leaves out that lanes can do different things at the same step, so a device's own "
            "counter shows less."
        ),
    ]  # fmt: skip


def _whole(value: float | None) -> int | None:
    return None if value is None else int(value)


EXPERIMENT = Experiment(
    name="divergence",
    title="Divergence",
    question="How different is the work of neighbouring rays, and how many lanes of a device does that leave idle?",
    method="Counted on the host, step for step as the layout bvh2 does it; nothing here is timed, so the figures are "
    "the same on every machine.",
    cases=_cases,
    measure=_measure,
    present=_present,
    weight=1,
    counts=True,
)
