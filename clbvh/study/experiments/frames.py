"""Whole frames, build and traversal together: scenes of all sizes, resolutions, breakdown, frontier, and gallery."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from ...bvh import Bvh
from ...device.host.info import describe_host
from ...device.host.session import HostSession
from ...geometry import Mesh
from ...rendering.heat_map import draw_heat_map_of
from ...scene.scene import Scene
from ...support.context_manager import ContextManager
from ...support.host_threads import usable_cores
from ...trace.hits.closest import find_closest_prims
from ...trace.launch import Caster
from ...trace.rays.batch import read_rays
from ...trace.world.world import open_world
from ..bench import FRAME_PHASES, Bench
from ..experiment import Experiment, curve, published
from ..page import REPORT, Axis, Figure, Part, Picture, Point, Table
from ..samples import Case, Results, Sample, cross
from ..scale import SCANS, Scale, load_named_mesh, scan_of
from ..statistics import Summary, growth_exponent

_PICTURE = (800, 450)
_LARGE_PICTURE = (3840, 2160)
_BUILDERS = ("sah", "flat")

# Of a full and of a quick study.
_SHAPES = ("knot", "terrain"), ("knot",)
_SIZES = (1_000, 10_000, 100_000, 1_000_000, 10_000_000), (1_000, 10_000, 100_000)
_FRONTIERS = (4, 16, 64, 256, 512, 1024, 2048, 4096, 8192), (4, 16, 64, 256)
# A curve needs two.
_LEAST_SIZES = 2
_SCAN, _GROWTH = "scan", "growth"

_PICTURES = {"800 x 450": _PICTURE, "1080p": (1920, 1080), "4K": _LARGE_PICTURE}
_ONE, _ALL, _DEVICE = "host, 1 core", "host, all cores", "device"

# The report's frame begins with the build.
_FRAME = ("build", *FRAME_PHASES)

_FRONTIER_TIMES = ("build_ms", "kernel_ms", "total_ms")

_SHADINGS = {"drill": "lambert", "bunny": "lambert+shadow", "dragon": "lambert+shadow"}
_HEAT_MAP = "heat map"


class Scenes(Experiment):
    """Scenes and growth.

    How does the gain of more workers depend on the scene, and how do build and trace grow with it?

    Wall time of builds; event time of the kernel for one picture.
    """

    group = ("part", "mesh")
    weight = 4

    def cases(self, scale: Scale) -> list[Case]:
        scans = cross(part=[_SCAN], mesh=map(scale.mesh, SCANS), builder=_BUILDERS)
        growing = [
            f"{shape}-{size}"
            for shape in scale.pick(*_SHAPES)
            for number, size in enumerate(scale.pick(*_SIZES))
            if number < _LEAST_SIZES or size <= scale.most_triangles
        ]
        return [*scans, *cross(part=[_GROWTH], mesh=growing, builder=["sah"])]

    def measure(self, bench: Bench, case: Case) -> Sample:
        name = case["mesh"]
        triangles = {"triangles": float(bench.mesh(name).face_count)}
        if case["part"] == _SCAN:
            _, alone = bench.build(name, case["builder"], workers=1)
            _, shared = bench.build(name, case["builder"])
            return Sample({"one_worker_ms": alone["build_ms"], "all_workers_ms": shared["build_ms"], **triangles})
        bvh, values = bench.build(name, case["builder"])
        frame = bench.draw(name, bvh, _PICTURE)
        return Sample({"build_ms": values["build_ms"], "kernel_ms": frame.times_ms["kernel"], **triangles})

    def present(self, results: Results) -> Iterator[Part]:
        says, times = published("scenes.says"), ("one_worker_ms", "all_workers_ms")
        rows = []
        for case in results.find(part=_SCAN):
            one, every = (results.values(case, quantity) for quantity in times)
            speedup = Summary.of([alone / shared for alone, shared in zip(one, every, strict=True)])
            names = case["mesh"], case["builder"], results.count(case, "triangles")
            rows.append((*names, *results.summaries(case, *times), speedup, says.get(scan_of(case["mesh"]))))
        caption = f"Build with 1 and with {results.cores} workers. The report: {published('scenes.source')}."
        columns = ("mesh", "builder", "triangles", "1 worker, ms", f"{results.cores} workers, ms", "speed-up", "report")
        yield Table(caption, columns, rows)
        growth = []
        for case in results.find(part=_GROWTH):
            build_and_trace = results.summaries(case, "build_ms", "kernel_ms")
            growth.append((case["mesh"].partition("-")[0], results.count(case, "triangles") or 1, *build_and_trace))
        titles = ("mesh", "triangles", "build, ms", "kernel, ms")
        yield Table(self.say(results, "growth", _PICTURE), titles, growth, is_detail=True)
        points, exponents = [], []
        for shape in dict.fromkeys(shape for shape, *_ in growth):
            sizes, *of_work = zip(*(row[1:] for row in growth if row[0] == shape), strict=True)
            for work, summaries in zip(("build", "trace"), of_work, strict=True):
                points += [(f"{shape}, {work}", *point) for point in zip(sizes, summaries, strict=True)]
            exponents.append((shape, *(growth_exponent(sizes, [ms.median for ms in times]) for times in of_work)))
        x = Axis("triangles", is_log=True)
        yield Figure("Growth with the number of triangles.", points, Axis("ms", is_log=True), x)
        caption = "Growth exponent p of time = c n^p, fitted to the medians: 1 is linear, 0 is constant."
        yield Table(caption, ("mesh", "build", "trace"), exponents)


class Resolution(Experiment):
    """Resolution: host against device.

    When does traversal on the device pay?

    Host traversal: wall time, rays made before. Device: event times. Opening the device and compiling are not counted.
    """

    group = ("mesh", "picture")
    weight = 5

    def cases(self, scale: Scale) -> list[Case]:
        mesh, pictures = scale.mesh(scale.pick("dragon", "bunny")), scale.pick([*_PICTURES], [*_PICTURES][:2])
        return cross(mesh=[mesh], picture=pictures, traversal=(_ONE, _ALL, _DEVICE))

    def measure(self, bench: Bench, case: Case) -> Sample:
        name, size = case["mesh"], _PICTURES[case["picture"]]
        bvh, values = bench.build(name, "sah")
        rays = bench.rays(name, size)
        if case["traversal"] == _DEVICE:
            begin = time.perf_counter()
            frame = bench.draw(name, bvh, size)
            trace_wall_ms = (time.perf_counter() - begin) * 1e3
            trace_ms, kernel_ms = sum(frame.times_ms.values()), frame.times_ms["kernel"]
        else:
            # Rays and tree are ready before.
            count = 1 if case["traversal"] == _ONE else usable_cores()
            host = bench.open(("host", name, count), lambda: _HostTracer(bvh, count))
            begin = time.perf_counter()
            find_closest_prims(host.caster, read_rays(*rays, 0.0, np.inf), None)
            trace_ms = kernel_ms = trace_wall_ms = (time.perf_counter() - begin) * 1e3
        times = {"build_ms": values["build_ms"], "trace_ms": trace_ms, "total_ms": values["build_ms"] + trace_ms}
        return Sample({**times, "kernel_ms": kernel_ms, "trace_wall_ms": trace_wall_ms, "rays": len(rays[0])})

    def present(self, results: Results) -> Iterator[Part]:
        rows, gains = [], []
        for picture in results.distinct("picture"):
            cases = results.by("traversal", picture=picture)
            for name, case in cases.items():
                times = results.summaries(case, "build_ms", "trace_ms", "total_ms")
                rows.append((picture, name, results.count(case, "rays"), *times))
            for host in [host for host in (_ONE, _ALL) if {host, _DEVICE} <= cases.keys()]:
                report = published("resolution") if (picture, host) == ("4K", _ONE) else {}
                total, trace = (results.ratio(cases[host], cases[_DEVICE], name) for name in ("total_ms", "kernel_ms"))
                gains.append((picture, host, total, report.get("speedup"), trace, report.get("traversal_speedup")))
        yield self.say(results, "method")
        columns = ("picture", "traversal", "rays", "build, ms", "traversal, ms", "total, ms")
        yield Table(self.say(results, "table"), columns, rows)
        points = [(name, picture, total_ms) for picture, name, *_, total_ms in rows]
        yield Figure("Build and traversal together.", points, Axis("total, ms", is_log=True))
        columns = ("picture", "host", "total", "report's", "traversal alone", "report's")
        yield Table(self.say(results, "gains"), columns, gains)


class _HostTracer(ContextManager):
    """A tree on the host device, whose rays a number of threads casts."""

    def __init__(self, bvh: Bvh, thread_count: int) -> None:
        session = HostSession(describe_host(), thread_count=thread_count)
        assert isinstance(bvh.shape, Mesh)
        self.caster = Caster(session, open_world(session, Scene(bvh.shape).snapshot(), [bvh]))

    def close(self) -> None:
        self.caster.close()


class Breakdown(Experiment):
    """Breakdown of a frame.

    Which part of a 4K frame is the build?

    Load and build: wall time. Upload, kernel and download: event times. The file is in the system's cache.
    """

    weight = 3

    def cases(self, scale: Scale) -> list[Case]:
        return cross(mesh=[scale.mesh("dragon")], builder=_BUILDERS)

    def measure(self, bench: Bench, case: Case) -> Sample:
        begin = time.perf_counter()
        load_named_mesh(case["mesh"])
        load_ms = (time.perf_counter() - begin) * 1e3
        bvh, values = bench.build(case["mesh"], case["builder"])
        frame = bench.draw(case["mesh"], bvh, _LARGE_PICTURE)
        build_ms = values["build_ms"]
        phases = {"build_ms": build_ms, **{f"{phase}_ms": ms for phase, ms in frame.times_ms.items()}}
        frame_ms = sum(phases.values())
        return Sample({"load_ms": load_ms, **phases, "frame_ms": frame_ms, "build_share": build_ms / frame_ms})

    def present(self, results: Results) -> Iterator[Part]:
        report_ms, cases = published("breakdown.ms"), results.by("builder")
        times = {
            phase: [*(results.summary(case, f"{phase}_ms") for case in cases.values()), report_ms.get(phase)]
            for phase in ("load", *_FRAME, "frame")
        }
        rows = [(f"{phase}, ms", *of_phase) for phase, of_phase in times.items()]
        shares = [results.summary(case, "build_share").scaled(100) for case in cases.values()]
        rows.append(("build, % of the frame", *shares, 100 * published("breakdown.share.build")))
        columns = ("phase", *(f"builder {name}" for name in cases), REPORT)
        yield Table(self.say(results, "table", _LARGE_PICTURE), columns, rows)
        series = (*cases, REPORT)
        points = [(name, phase, times[phase][column]) for column, name in enumerate(series) for phase in _FRAME]
        yield Figure("The parts of a frame.", points, Axis("ms", is_log=True))


class Frontier(Experiment):
    """Frontier.

    Does it pay to stop the build at large leaves and let the device test their triangles one by one?

    Build: wall time. Kernel: event time.
    """

    weight = 8

    def cases(self, scale: Scale) -> list[Case]:
        return cross(mesh=[scale.mesh(scale.pick("dragon", "bunny"))], frontier=scale.pick(*_FRONTIERS))

    def measure(self, bench: Bench, case: Case) -> Sample:
        bvh, values = bench.build(case["mesh"], "frontier", frontier=case["frontier"])
        frame = bench.draw(case["mesh"], bvh, _PICTURE, layout="bvh2")
        build_ms, kernel_ms = values["build_ms"], frame.times_ms["kernel"]
        return Sample({"build_ms": build_ms, "kernel_ms": kernel_ms, "total_ms": build_ms + kernel_ms})

    def present(self, results: Results) -> Iterator[Part]:
        report = [curve(f"frontier.{quantity}") for quantity in _FRONTIER_TIMES]
        cases = results.by("frontier")
        times = {size: results.summaries(case, *_FRONTIER_TIMES) for size, case in cases.items()}
        columns = ("F", "build, ms", "kernel, ms", "total, ms", "report: build", "kernel", "total")
        rows = [(size, *of_size, *(table.get(size) for table in report)) for size, of_size in times.items()]
        yield Table(self.say(results, "table", _PICTURE), columns, rows)
        ours, theirs = {size: total for size, (*_, total) in times.items()}, report[-1]
        best, their_best = min(ours, key=lambda size: ours[size].median), min(theirs, key=lambda size: theirs[size])
        yield self.say(results, "best", best, their_best)
        points: list[Point] = [("clbvh", size, total.scaled(1 / ours[best].median)) for size, total in ours.items()]
        points += [(REPORT, size, total / theirs[their_best]) for size, total in theirs.items()]
        x = Axis("F, triangles in a leaf", is_log=True, ticks=sorted({*ours, *[*theirs][::2]}))
        yield Figure(self.say(results, "totals"), points, Axis("relative total", is_log=True), x)


class Gallery(Experiment):
    """Gallery.

    The report's three pictures, made by this machine.

    More heat maps stand under Divergence.
    """

    def cases(self, scale: Scale) -> list[Case]:
        meshes = {scale.mesh(name): shading for name, shading in _SHADINGS.items()}
        cases = [{"mesh": mesh, "shading": shading} for mesh, shading in meshes.items()]
        return [*cases, {"mesh": scale.mesh("dragon"), "shading": _HEAT_MAP}]

    def measure(self, bench: Bench, case: Case) -> Sample:
        mesh, shading = case["mesh"], case["shading"]
        bvh = bench.tree(mesh)
        triangles = {"triangles": float(bvh.mesh.face_count)}
        if shading == _HEAT_MAP:
            camera, size = bench.camera(mesh, _PICTURE), bench.scale.picture(*_PICTURE)
            steps = bench.once(_HEAT_MAP, lambda: draw_heat_map_of(bvh, camera, *size, "nodes", bench.device))
            return Sample(triangles, {"file": bench.keep_picture(f"gallery-heat-{mesh}", steps)})
        frame = bench.draw(mesh, bvh, _PICTURE, shading=shading)
        name = bench.keep_picture(f"picture-{mesh}", frame.rgb)
        return Sample({"kernel_ms": frame.times_ms["kernel"], **triangles}, {"picture": frame.digest, "file": name})

    def present(self, results: Results) -> Iterator[Part]:
        text = f"Pictures of {results.scale.size_of(*_PICTURE)}; trees by {results.cores} workers."
        rows = [
            (case["mesh"], case["shading"], results.count(case, "triangles"), results.summary(case, "kernel_ms"))
            for case in results.cases
        ]
        yield Table(text, ("mesh", "shading", "triangles", "kernel, ms"), rows, is_detail=True)
        for case in results.cases:
            for png in results.picture(case, "file"):
                yield Picture(f"{case['mesh']}, {case['shading']}.", png)
