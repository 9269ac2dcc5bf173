"""The report's three pictures, made here, and the heat map of the largest."""

from __future__ import annotations

from ...rendering.heat_map import draw_heat_map_of
from ..bench import Bench
from ..case import Case, Experiment, Sample
from ..frames import draw_frame
from ..page.parts import Part, Picture, Table
from ..results import Results
from ..scale import Scale

_PICTURE = (800, 450)
_SHADINGS = {"drill": "lambert", "bunny": "lambert+shadow", "dragon": "lambert+shadow"}
_HEAT_MAP = "heat map"


def _cases(scale: Scale) -> list[Case]:
    meshes = {scale.mesh(name): shading for name, shading in _SHADINGS.items()}
    cases: list[Case] = [{"mesh": mesh, "shading": shading} for mesh, shading in meshes.items()]
    return [*cases, {"mesh": scale.mesh("dragon"), "shading": _HEAT_MAP}]


def _measure(bench: Bench, case: Case) -> Sample:
    mesh, shading = str(case["mesh"]), str(case["shading"])
    bvh, size = bench.tree(mesh), bench.scale.picture(*_PICTURE)
    if shading == _HEAT_MAP:
        steps = bench.once("heat map", lambda: draw_heat_map_of(bvh, bench.camera(mesh, *size), *size, "nodes"))
        return Sample({"triangles": bvh.mesh.face_count}, {"file": bench.keep_picture(f"gallery-heat-{mesh}", steps)})
    frame = draw_frame(bench, mesh, bvh, size, shading=shading)
    name = bench.keep_picture(f"picture-{mesh}", frame.rgb)
    values = {"kernel_ms": frame.times_ms["kernel"], "triangles": bvh.mesh.face_count}
    return Sample(values, {"picture": frame.digest, "file": name})


def _present(results: Results) -> list[Part]:
    pictures: list[Part] = [
        Picture(f"{case['mesh']}, {case['shading']}.", (results.pictures / name).read_bytes())
        for case in results.cases
        if (name := results.fact(case, "file")) is not None and (results.pictures / name).is_file()
    ]
    table = Table(
        f"Pictures of {results.scale.size_of(*_PICTURE)}; trees by {results.cores} workers.",
        ("mesh", "shading", "triangles", "kernel, ms"),
        [
            (case["mesh"], case["shading"], int(results.median(case, "triangles") or 0),
             results.summary(case, "kernel_ms"))
            for case in results.cases
        ],
    )  # fmt: skip
    return [table, *pictures]


EXPERIMENT = Experiment(
    name="gallery",
    title="Gallery",
    question="The report's three pictures, made by this machine.",
    method="More heat maps stand under Divergence.",
    cases=_cases,
    measure=_measure,
    present=_present,
    weight=1,
)
