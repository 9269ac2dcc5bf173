"""How trees suit devices: layouts, the divergence of neighbouring rays, and each OpenCL device of the machine."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...device.select import choose_device, list_devices
from ...errors import DeviceError
from ...layouts.device_arrays import make_device_arrays
from ...rendering.heat_map import FIELDS, QUANTITIES, count_picture, draw_heat_map, mean_steps, open_counter
from ...trace.hits.closest import count_steps
from ...trace.tracer import Tracer
from ...tree_layouts import TREE_LAYOUTS
from ..bench import Bench
from ..experiment import Experiment, published
from ..page import REPORT, Axis, Figure, Part, Picture, Table
from ..samples import Case, Results, Sample, cross
from ..scale import Scale
from ..statistics import lane_use

_PICTURE = (800, 450)
# Steps are counted on a picture of this size: their means hardly depend on it.
_COUNTED_PICTURE = (320, 180)
_FLATTENING = ("flatten", "flat")
# Quantities by their headings.
_COUNTS = {
    "bytes a triangle": "bytes_per_triangle",
    "node visits": "node_visits",
    "leaf visits": "leaf_visits",
    "triangle tests": "triangle_tests",
}

# Lanes that run in lockstep: neighbouring work-items along a row, or as a tile of this many rows.
_LANES = (8, 16, 32)
_GROUPS = {(shape, lanes): rows for shape, rows in (("row", 1), ("tile", 4)) for lanes in _LANES}

_DEVICE_PICTURE = (1280, 720)
_SEED = 1
_NAME_LENGTH = 28
_QUERIES = ("closest hit", "closest hit, shuffled", "any hit")


class Layouts(Experiment):
    """Layouts.

    What does the flat array gain over flattening, and which width of the tree suits the device?

    Build: wall time. Kernel: event time. Visits are counted from the root: where the layout has entry points,
    neighbouring rays of a picture begin deeper. One visit of bvh4 or bvh8 tests the boxes of all
    children, one leaf visit a block of up to 4 or 8 triangles.
    """

    group = ("part", "mesh")
    weight = 2

    def cases(self, scale: Scale) -> list[Case]:
        meshes = dict.fromkeys(map(scale.mesh, scale.pick(("bunny", "dragon"), ("dragon",))))
        parts = [("builder", name) for name in _FLATTENING] + [("layout", name) for name in TREE_LAYOUTS]
        return [{"part": part, "mesh": mesh, part: name} for mesh in meshes for part, name in parts]

    def measure(self, bench: Bench, case: Case) -> Sample:
        name = case["mesh"]
        if case["part"] == "builder":
            _, values = bench.build(name, case["builder"])
            # The pass that brings the nodes into their final order.
            last_pass_ms = values.get("phase.flatten_ms", 0.0) + values.get("phase.compact_ms", 0.0)
            return Sample({"build_ms": values["build_ms"], "last_pass_ms": last_pass_ms})
        layout = case["layout"]
        frame = bench.draw(name, bench.tree(name), _PICTURE, layout=layout)
        counted = bench.once(("counts", name, layout), lambda: self._count(bench, name, layout))
        return Sample({"kernel_ms": frame.times_ms["kernel"], **counted}, {"picture": frame.digest})

    def _count(self, bench: Bench, name: str, layout: str) -> dict[str, float]:
        bvh = bench.tree(name)
        with open_counter(bvh, bench.device, layout) as caster:
            means = mean_steps(count_steps(caster, *bench.rays(name, _COUNTED_PICTURE)))
        bytes_per_triangle = make_device_arrays(bvh, layout).byte_count / bvh.mesh.face_count
        return dict(zip(_COUNTS.values(), (bytes_per_triangle, *means.values()), strict=False))

    def present(self, results: Results) -> Iterator[Part]:
        builders, layouts, points = [], [], []
        for mesh in results.distinct("mesh"):
            cases = results.by("builder", mesh=mesh, part="builder")
            for name, case in cases.items():
                gain = None if name == _FLATTENING[0] else results.ratio(cases.get(_FLATTENING[0]), case, "build_ms")
                times = results.summaries(case, "build_ms", "last_pass_ms")
                builders.append((mesh, name, *times, gain, published("ladder.says")[name]))
            cases = results.by("layout", mesh=mesh, part="layout")
            for name, case in cases.items():
                kernel_ms = results.summary(case, "kernel_ms")
                counts = [results.summary(case, quantity).median for quantity in _COUNTS.values()]
                layouts.append((mesh, name, kernel_ms, *counts, results.agree(cases.values(), case, "picture")))
                points.append(("clbvh", f"{mesh}, {name}", kernel_ms))
        columns: tuple[str, ...] = ("mesh", "variant", "build, ms", "last pass, ms", "speed-up over flatten", "report")
        yield Table(self.say(results, "flattening", published("ladder.source")), columns, builders, is_detail=True)
        columns = ("mesh", "layout", "kernel, ms", *_COUNTS, "same picture")
        yield Table(self.say(results, "table", _PICTURE), columns, layouts)
        yield Figure("Kernel times of the layouts.", points, Axis("kernel, ms"))


class Divergence(Experiment):
    """Divergence.

    How different is the work of neighbouring rays, and how many lanes of a device does that leave idle?

    Counted by the kernel of the layout bvh2; nothing here is timed, so the figures are the same on every machine.
    """

    counts = True

    def cases(self, scale: Scale) -> list[Case]:
        return cross(mesh=map(scale.mesh, ("bunny", "dragon")), builder=("sah", "flat"))

    def measure(self, bench: Bench, case: Case) -> Sample:
        mesh, builder = case["mesh"], case["builder"]
        width, height = bench.scale.picture(*_PICTURE)
        steps = count_picture(bench.tree(mesh, builder), bench.camera(mesh, _PICTURE), width, height, bench.device)
        values: dict[str, float] = {}
        facts: dict[str, str] = {}
        for quantity, field in FIELDS.items():
            of_pixel = steps[field]
            values |= {f"{quantity}_mean": float(of_pixel.mean()), f"{quantity}_most": int(of_pixel.max())}
            if builder == "sah":
                facts[quantity] = bench.keep_picture(f"heat-{mesh}-{quantity}", draw_heat_map(of_pixel, quantity))
        for (shape, lanes), rows in _GROUPS.items():
            values[f"{shape}_{lanes}"] = lane_use(steps["node_steps"] + steps["prim_tests"], lanes, rows=rows)
        return Sample(values, facts)

    def present(self, results: Results) -> Iterator[Part]:
        report_lanes, report_use = published("divergence.width"), 100 * published("divergence.lane_use")
        steps, rows, points = [], [], []
        for case in results.cases:
            names = case["mesh"], case["builder"]
            means = [results.summary(case, f"{quantity}_mean").median for quantity in QUANTITIES]
            most = [results.count(case, f"{quantity}_most") for quantity in QUANTITIES]
            steps.append((*names, means[0], most[0], means[1], most[1]))
            uses = {group: 100 * results.summary(case, "{}_{}".format(*group)).median for group in _GROUPS}
            rows.append((*names, *uses.values()))
            points += [(", ".join(names), f"{lanes} lanes", uses["tile", lanes]) for lanes in _LANES]
        report = [report_use if group == ("row", report_lanes) else None for group in _GROUPS]
        rows.append(("the report, by hardware counter", "flat", *report))
        points.append((REPORT, f"{report_lanes} lanes", report_use))
        caption = f"Steps per ray of a picture of {results.scale.size_of(*_PICTURE)}, binary tree."
        titles = ("mesh", "builder", "node steps, mean", "most", "triangle tests, mean", "most")
        yield Table(caption, titles, steps, is_detail=True)
        columns = ("mesh", "builder", *(f"{shape} {lanes}" for shape, lanes in _GROUPS))
        yield Table(self.say(results, "lanes"), columns, rows)
        yield Figure("Lane use of tiles.", points, Axis("lane use, %"))
        for case in results.cases:
            for quantity, title in QUANTITIES.items():
                for png in results.picture(case, quantity):
                    yield Picture(f"{case['mesh']}: {title.lower()} per ray.", png)
        yield self.say(results, "method")


class Devices(Experiment):
    """Devices.

    How fast are the layouts and queries on each OpenCL device of this machine?

    Event time of the kernels. Two drivers for one processor are two devices.
    """

    weight = 2

    def cases(self, scale: Scale) -> list[Case]:
        mesh = scale.mesh(scale.pick("dragon", "bunny"))
        try:
            devices = [info for info in list_devices() if info.is_available and not info.is_simulator]
        except DeviceError:
            devices = []
        return [
            {"mesh": mesh, "device": f"{info.name}, {info.platform}", "number": info.number, "layout": layout}
            for info in devices
            for layout in TREE_LAYOUTS
        ]

    def measure(self, bench: Bench, case: Case) -> Sample:
        info = choose_device(case["number"])
        mesh, layout = case["mesh"], case["layout"]
        bench.rest_before(case["device"])
        key = ("tracer", info.number, layout)
        tracer = bench.open(key, lambda: Tracer(bench.tree(mesh), device=info, layout=layout))
        coherent = bench.rays(mesh, _DEVICE_PICTURE)
        order = np.random.default_rng(_SEED).permutation(len(coherent[0]))
        shuffled = bench.once("shuffled", lambda: [of_ray[order] for of_ray in coherent])
        methods = (tracer.closest_prim, tracer.closest_prim, tracer.any_hit)
        values: dict[str, float] = {"rays": len(order)}
        for query, method, rays in zip(_QUERIES, methods, (coherent, shuffled, coherent), strict=True):
            before = tracer.timings_ms.get("kernel", 0.0)
            method(*rays)
            values[f"{query}_kernel_ms"] = tracer.timings_ms["kernel"] - before
        return Sample(values)

    def present(self, results: Results) -> Iterator[Part]:
        rows, points = [], []
        for case in results.cases:
            times = [results.summary(case, f"{query}_kernel_ms").scaled(1e3) for query in _QUERIES]
            speeds = [summary.rate(results.summary(case, "rays").median) for summary in times]
            rows.append((case["device"], case["layout"], *speeds))
            # Drivers put clocks and features behind the name.
            name = f"{case['device'].partition(',')[0][:_NAME_LENGTH]}, {case['layout']}"
            points += [(query, name, speed) for query, speed in zip(_QUERIES, speeds, strict=True)]
        columns = ("device", "layout", *(f"{query}, Mray/s" for query in _QUERIES))
        yield Table(self.say(results, "table", _DEVICE_PICTURE), columns, rows)
        yield Figure("Rays per second.", points, Axis("million rays per second"))
