"""Whole frames, build and traversal together: scenes of all sizes, resolutions, breakdown, frontier, and gallery."""

from __future__ import annotations

import time

from ...rendering.heat_map import draw_heat_map_of
from ...support.host_threads import HostThreads, usable_cores
from ...trace.oracle.visits import HostTraversal
from ..bench import Bench
from ..drawing import REPORT, Axis, Point
from ..experiment import Experiment, curve, published, source_of
from ..page import Figure, Paragraph, Part, Picture, Rows, Table
from ..samples import Case, Results, Sample
from ..scale import SCANS, Scale, load_named_mesh, scan_of
from ..statistics import Summary, growth_exponent

_PICTURE = (800, 450)
_LARGE_PICTURE = (3840, 2160)
_BUILDERS = ("sah", "flat")

_SHAPES = ("knot", "terrain")
_SIZES = (1_000, 10_000, 100_000, 1_000_000, 10_000_000)
_QUICK_SIZES = (1_000, 10_000, 100_000)
_SCAN, _GROWTH = "scan", "growth"

_PICTURES = {"800 x 450": _PICTURE, "1080p": (1920, 1080), "4K": _LARGE_PICTURE}
_ONE, _ALL, _DEVICE = "host, 1 core", "host, all cores", "device"

_PHASES = ("load", "build", "upload", "kernel", "download")
# The report's frame begins with the build.
_FRAME = _PHASES[1:]

_FRONTIERS = (4, 16, 64, 256, 512, 1024, 2048, 4096, 8192)
_QUICK_FRONTIERS = (4, 16, 64, 256)
_FRONTIER_TIMES = ("build_ms", "kernel_ms", "total_ms")

_SHADINGS = {"drill": "lambert", "bunny": "lambert+shadow", "dragon": "lambert+shadow"}
_HEAT_MAP = "heat map"


class Scenes(Experiment):
    """Scenes and growth.

    How does the gain of more workers depend on the scene, and how do build and trace grow with it?

    Wall time of builds; event time of the kernel for one picture.
    """

    name = "scenes"
    group = ("part", "mesh")
    weight = 4

    def cases(self, scale: Scale) -> list[Case]:
        scans = [
            {"part": _SCAN, "mesh": mesh, "builder": builder}
            for mesh in dict.fromkeys(map(scale.mesh, SCANS))
            for builder in _BUILDERS
        ]
        growing = [
            {"part": _GROWTH, "mesh": f"{shape}-{size}", "builder": "sah"}
            for shape in scale.pick(_SHAPES, _SHAPES[:1])
            for size in scale.sizes(scale.pick(_SIZES, _QUICK_SIZES))
        ]
        return [*scans, *growing]

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

    def present(self, results: Results) -> list[Part]:
        says = published("scenes.says")
        scans: Rows = []
        for case in results.find(part=_SCAN):
            times = [results.values(case, f"{workers}_ms") for workers in ("one_worker", "all_workers")]
            speedup = Summary.of([alone / shared for alone, shared in zip(*times, strict=True)])
            names = case["mesh"], case["builder"], results.count(case, "triangles")
            scans.append((*names, *map(Summary.of, times), speedup, says.get(scan_of(case["mesh"]))))
        rows = [
            (
                case["mesh"].partition("-")[0], results.count(case, "triangles") or 1,
                results.expect(case, "build_ms"), results.expect(case, "kernel_ms"),
            )
            for case in results.find(part=_GROWTH)
        ]  # fmt: skip
        points: list[Point] = []
        exponents: Rows = []
        for shape in dict.fromkeys(shape for shape, *_ in rows):
            sizes, builds, kernels = zip(*(row[1:] for row in rows if row[0] == shape), strict=True)
            points += [(f"{shape}, build", *point) for point in zip(sizes, builds, strict=True)]
            points += [(f"{shape}, trace", *point) for point in zip(sizes, kernels, strict=True)]
            medians = ([summary.median for summary in summaries] for summaries in (builds, kernels))
            exponents.append((shape, *(growth_exponent(sizes, times) for times in medians)))
        return [
            Table(
                f"Build with 1 and with {results.cores} workers. The report: {source_of('scenes')}.",
                ("mesh", "builder", "triangles", "1 worker, ms", f"{results.cores} workers, ms", "speed-up", "report"),
                scans,
            ),
            Table(
                self.say(results, "growth", _PICTURE),
                ("mesh", "triangles", "build, ms", "kernel, ms"),
                rows,
            ),
            Figure(
                "Growth with the number of triangles.", points, Axis("ms", is_log=True), Axis("triangles", is_log=True)
            ),
            Table(
                "Growth exponent p of time = c n^p, fitted to the medians: 1 is linear, 0 is constant.",
                ("mesh", "build", "trace"),
                exponents,
            ),
        ]


class Resolution(Experiment):
    """Resolution: host against device.

    When does traversal on the device pay?

    Host traversal: wall time, rays made before. Device: event times. Opening the device and compiling are not counted.
    """

    name = "resolution"
    group = ("mesh", "picture")
    weight = 5

    def cases(self, scale: Scale) -> list[Case]:
        mesh = scale.mesh(scale.pick("dragon", "bunny"))
        return [
            {"mesh": mesh, "picture": picture, "traversal": traversal}
            for picture in scale.pick([*_PICTURES], [*_PICTURES][:2])
            for traversal in (_ONE, _ALL, _DEVICE)
        ]

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
            # Rays, tree and threads are ready before.
            count = 1 if case["traversal"] == _ONE else usable_cores()
            threads = bench.open(("threads", count), lambda: HostThreads(count))
            traversal = bench.once(("host traversal", name), lambda: HostTraversal(bvh))
            begin = time.perf_counter()
            traversal.count_visits(*rays, threads=threads)
            trace_ms = kernel_ms = trace_wall_ms = (time.perf_counter() - begin) * 1e3
        times = {"build_ms": values["build_ms"], "trace_ms": trace_ms, "total_ms": values["build_ms"] + trace_ms}
        return Sample({**times, "kernel_ms": kernel_ms, "trace_wall_ms": trace_wall_ms, "rays": len(rays[0])})

    def present(self, results: Results) -> list[Part]:
        rows: Rows = []
        gains: Rows = []
        for picture in results.distinct("picture"):
            cases = results.by("traversal", picture=picture)
            for name, case in cases.items():
                times = results.summaries(case, "build_ms", "trace_ms", "total_ms")
                rows.append((picture, name, results.count(case, "rays"), *times))
            for host in (_ONE, _ALL):
                if host in cases and _DEVICE in cases:
                    report = [published(f"resolution.{gain}") if (picture, host) == ("4K", _ONE) else None
                              for gain in ("speedup", "traversal_speedup")]  # fmt: skip
                    total, trace = (results.ratio(cases[host], cases[_DEVICE], f"{part}_ms")
                                    for part in ("total", "kernel"))  # fmt: skip
                    gains.append((picture, host, total, report[0], trace, report[1]))
        return [
            Paragraph(self.say(results, "method")),
            Table(
                self.say(results, "table"),
                ("picture", "traversal", "rays", "build, ms", "traversal, ms", "total, ms"),
                rows,
            ),
            Figure(
                "Build and traversal together.",
                [(str(row[1]), row[0], row[-1]) for row in rows],  # type: ignore[misc]
                Axis("total, ms", is_log=True),
            ),
            Table(
                self.say(results, "gains"),
                ("picture", "host", "total", "report's", "traversal alone", "report's"),
                gains,
            ),
        ]


class Breakdown(Experiment):
    """Breakdown of a frame.

    Which part of a 4K frame is the build?

    Load and build: wall time. Upload, kernel and download: event times. The file is in the system's cache.
    """

    name = "breakdown"
    weight = 3

    def cases(self, scale: Scale) -> list[Case]:
        return [{"mesh": scale.mesh("dragon"), "builder": builder} for builder in _BUILDERS]

    def measure(self, bench: Bench, case: Case) -> Sample:
        begin = time.perf_counter()
        load_named_mesh(case["mesh"])
        load_ms = (time.perf_counter() - begin) * 1e3
        bvh, values = bench.build(case["mesh"], case["builder"])
        frame = bench.draw(case["mesh"], bvh, _LARGE_PICTURE)
        build_ms = values["build_ms"]
        phases = {"build_ms": build_ms, **{f"{phase}_ms": frame.times_ms[phase] for phase in _FRAME[1:]}}
        frame_ms = sum(phases.values())
        return Sample({"load_ms": load_ms, **phases, "frame_ms": frame_ms, "build_share": build_ms / frame_ms})

    def present(self, results: Results) -> list[Part]:
        report_ms = {**published("breakdown.ms"), "frame": published("breakdown.ms.total")}
        cases = results.by("builder")
        rows: Rows = [
            (f"{phase}, ms", *(results.summary(case, f"{phase}_ms") for case in cases.values()), report_ms.get(phase))
            for phase in (*_PHASES, "frame")
        ]
        shares = [results.expect(case, "build_share").scaled(100) for case in cases.values()]
        rows.append(("build, % of the frame", *shares, 100 * published("breakdown.share.build")))
        points: list[Point] = [
            (builder, phase, results.summary(case, f"{phase}_ms"))
            for builder, case in cases.items()
            for phase in _FRAME
        ]
        points += [(REPORT, phase, report_ms[phase]) for phase in _FRAME]
        return [
            Table(
                self.say(results, "table", _LARGE_PICTURE),
                ("phase", *(f"builder {name}" for name in cases), REPORT),
                rows,
            ),
            Figure("The parts of a frame.", points, Axis("ms", is_log=True)),
        ]


class Frontier(Experiment):
    """Frontier.

    Does it pay to stop the build at large leaves and let the device test their triangles one by one?

    Build: wall time. Kernel: event time.
    """

    name = "frontier"
    weight = 8

    def cases(self, scale: Scale) -> list[Case]:
        mesh = scale.mesh(scale.pick("dragon", "bunny"))
        return [{"mesh": mesh, "frontier": frontier} for frontier in scale.pick(_FRONTIERS, _QUICK_FRONTIERS)]

    def measure(self, bench: Bench, case: Case) -> Sample:
        bvh, values = bench.build(case["mesh"], "frontier", frontier=case["frontier"])
        frame = bench.draw(case["mesh"], bvh, _PICTURE, layout="bvh2")
        build_ms, kernel_ms = values["build_ms"], frame.times_ms["kernel"]
        return Sample({"build_ms": build_ms, "kernel_ms": kernel_ms, "total_ms": build_ms + kernel_ms})

    def present(self, results: Results) -> list[Part]:
        report = [curve(f"frontier.{quantity}") for quantity in _FRONTIER_TIMES]
        theirs = report[-1]
        cases = results.by("frontier")
        ours = {size: results.expect(case, "total_ms") for size, case in cases.items()}
        best = min(ours, key=lambda size: ours[size].median)
        their_best = min(theirs, key=lambda size: theirs[size])
        points: list[Point] = [("clbvh", size, total.scaled(1 / ours[best].median)) for size, total in ours.items()]
        points += [(REPORT, size, total / theirs[their_best]) for size, total in theirs.items()]
        ticks = sorted({*ours, *[*theirs][::2]})
        return [
            Table(
                self.say(results, "table", _PICTURE),
                ("F", "build, ms", "kernel, ms", "total, ms", "report: build", "kernel", "total"),
                [
                    (size, *results.summaries(case, *_FRONTIER_TIMES), *(table.get(size) for table in report))
                    for size, case in cases.items()
                ],
            ),
            Paragraph(self.say(results, "best", best, their_best)),
            Figure(
                self.say(results, "totals"),
                points, Axis("relative total", is_log=True), Axis("F, triangles in a leaf", is_log=True, ticks=ticks),
            ),
        ]  # fmt: skip


class Gallery(Experiment):
    """Gallery.

    The report's three pictures, made by this machine.

    More heat maps stand under Divergence.
    """

    name = "gallery"

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
            steps = bench.once(_HEAT_MAP, lambda: draw_heat_map_of(bvh, camera, *size, "nodes"))
            return Sample(triangles, {"file": bench.keep_picture(f"gallery-heat-{mesh}", steps)})
        frame = bench.draw(mesh, bvh, _PICTURE, shading=shading)
        name = bench.keep_picture(f"picture-{mesh}", frame.rgb)
        return Sample({"kernel_ms": frame.times_ms["kernel"], **triangles}, {"picture": frame.digest, "file": name})

    def present(self, results: Results) -> list[Part]:
        rows = [
            (case["mesh"], case["shading"], results.count(case, "triangles"), results.summary(case, "kernel_ms"))
            for case in results.cases
        ]
        text = f"Pictures of {results.scale.size_of(*_PICTURE)}; trees by {results.cores} workers."
        pictures = [
            Picture(f"{case['mesh']}, {case['shading']}.", png)
            for case in results.cases
            for png in results.picture(case, "file")
        ]
        return [Table(text, ("mesh", "shading", "triangles", "kernel, ms"), rows), *pictures]
