"""Asks a device about every case in every layout, and compares its answers with the stored ones, byte by byte.

Answers are named arrays with one row per ray, point or pixel, or per node of a tree. `make conformance-refresh`, which
is `python -m clbvh.conformance.check`, stores them anew, where answers change on purpose; it refuses unless all layouts
agree. Then look at the other runtimes, with `make conformance`, before the file is committed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..builders.build import build
from ..builders.options import FAST_QUALITY
from ..bvh import Bvh
from ..choices import REPORT_SHADINGS
from ..device.info import DeviceInfo
from ..device.select import choose_device
from ..errors import ConfigError, ValidationError
from ..rendering.options import RenderOptions
from ..rendering.renderer import Renderer
from ..trace.hits.hits import AllHits, Hits
from ..trace.tracer import Tracer
from ..trace.world.trees import BRUTE
from ..tree_layouts import TREE_LAYOUTS
from ..views.cameras.camera import Camera
from ..views.view import View
from .cases import Case, make_cases
from .expected import EXPECTED_PATH, Expected, ExpectedAnswers, digest_of, load_expected, store_expected

# An answer: parts by name, each (n, ...).
Answer = dict[str, NDArray]

# Every layout answers; the one without a tree only in pictures.
ALL_LAYOUTS = (*TREE_LAYOUTS, BRUTE)

# Crossings of a ray of which all are compared; of the others only the number.
_COMPARED_HITS = 12

# Boxes at points, in shares of the mesh.
_BOX_SHARE = 8

# Pixels of a picture: more than one tile each way, and no multiple of it.
_PICTURE_WIDTH, _PICTURE_HEIGHT = 22, 13

# The camera looks along an axis, at a point beside the middle, so that its axes are exact: in sizes of the mesh.
_EYE_ASIDE, _EYE_AWAY = (0.125, 0.0625), 2.25


def answer_rays(case: Case, bvh: Bvh, layout: str, device: DeviceInfo) -> Iterator[tuple[str, Answer]]:
    """Yield each query about rays and points, and its answer."""
    rays = case.rays._asdict()
    with Tracer(bvh, device=device, layout=layout) as tracer:
        hits = tracer.closest_hit(**rays)
        boxed = tracer.prims_in_boxes(case.points, case.points + np.ptp(case.vertices, axis=0) / _BOX_SHARE)
        answers: dict[str, Answer] = {
            "closest_hit": _describe_hits(hits),
            "closest_hit of backs": _describe_hits(tracer.closest_hit(**rays, side="back", exclude=hits)),
            "prims_in_boxes": {"count": boxed.counts, "prim_id": boxed.prim_id},
            "any_hit": {"is_hit": tracer.any_hit(**rays)},
            "count_hits": {"count": tracer.count_hits(**rays)},
            "all_hits": _describe_all_hits(tracer.all_hits(**rays)),
            "closest_point": dict(tracer.closest_point(case.points)._asdict()),
            "winding_number": {"winding": tracer.winding_number(case.points)},
        }
        if case.is_closed:
            answers["contains"] = {"is_inside": tracer.contains(case.points)}
    yield from answers.items()


def answer_pictures(case: Case, bvh: Bvh, layout: str, device: DeviceInfo) -> Iterator[tuple[str, Answer]]:
    """Yield each shading, and the picture in it."""
    extent = np.ptp(case.vertices, axis=0)
    size = extent.max()
    aside = case.vertices.min(axis=0) + extent / 2 + size * np.array([*_EYE_ASIDE, 0.0])
    eye = aside + size * np.array([0.0, 0.0, _EYE_AWAY])
    camera = Camera(tuple(eye), tuple(aside))
    is_brute = layout == BRUTE
    options = RenderOptions(device=device, builder=BRUTE) if is_brute else RenderOptions(device=device, layout=layout)
    # Opened for one of these shadings: that of every other renderer takes seconds to compile, and none is drawn of it.
    view = View(shading=REPORT_SHADINGS[0])
    with Renderer(case.mesh if is_brute else bvh, view, options=options) as renderer:
        for shading in REPORT_SHADINGS:
            picture = renderer.render(camera=camera, shading=shading, width=_PICTURE_WIDTH, height=_PICTURE_HEIGHT)
            colours = np.dstack((picture.rgb, picture.alpha)).reshape(-1, 4)
            yield f"picture {shading}", _describe_hits(picture.hits) | {"colour": colours}


def answer_tree(case: Case, device: DeviceInfo) -> Answer:
    """Return the tree that a device builds, nodes as the words that they consist of."""
    bvh = build(case.mesh, quality=FAST_QUALITY, device=device)
    return {"nodes": bvh.nodes.view(np.int32).reshape(len(bvh.nodes), -1), "prim_ids": bvh.prim_ids}


def _describe_hits(hits: Hits) -> Answer:
    return {
        "prim_id": hits.prim_id.reshape(-1),
        "tuv": np.stack((hits.t.reshape(-1), hits.u.reshape(-1), hits.v.reshape(-1)), axis=1),
    }


def _describe_all_hits(hits: AllHits) -> Answer:
    """Return the first crossings of each ray; where it has fewer, prim_id is -1 and the rest 0."""
    ray_count = len(hits.offsets) - 1
    prim_id = np.full((ray_count, _COMPARED_HITS), -1, np.int32)
    tuv = np.zeros((ray_count, _COMPARED_HITS, 3))
    depth = np.arange(len(hits)) - np.repeat(hits.offsets[:-1], hits.counts)
    is_compared = depth < _COMPARED_HITS
    at = hits.ray_id[is_compared], depth[is_compared]
    prim_id[at] = hits.prim_id[is_compared]
    tuv[at] = np.stack((hits.t, hits.u, hits.v), axis=1)[is_compared]
    return {"count": hits.counts, "prim_id": prim_id, "tuv": tuv}


@dataclass(frozen=True)
class Difference:
    """A part of an answer that differs from what is stored.

    Attributes
    ----------
    layout, query, mesh, part : str
    row : int
        The first ray, point, pixel or node that differs; -1 if it cannot be told.
    value : str
        The device's answer there.
    """

    layout: str
    query: str
    mesh: str
    part: str
    row: int
    value: str

    def __str__(self) -> str:
        where = f"first in row {self.row}, where it is {self.value}" if self.value else "in a row that cannot be told"
        return f"{self.layout}, {self.query}, mesh '{self.mesh}': {self.part} differs, {where}"


@dataclass(frozen=True)
class Conformance:
    """The result of a check.

    Attributes
    ----------
    device : DeviceInfo
    compared : dict of (layout, query) to int
        Number of parts that were compared.
    differences : tuple of Difference
    unusable : tuple of str
        Meshes whose rays or points have other bytes on this machine than where the answers were stored: nothing about
        them was compared.
    """

    device: DeviceInfo
    compared: dict[tuple[str, str], int]
    differences: tuple[Difference, ...]
    unusable: tuple[str, ...]

    @property
    def is_equal(self) -> bool:
        """Whether everything could be compared, and was equal."""
        return not self.differences and not self.unusable

    def as_dict(self) -> dict[str, Any]:
        """Return the result as JSON has it."""
        compared = [{"layout": key[0], "query": key[1], "parts": count} for key, count in self.compared.items()]
        differences = [vars(difference) for difference in self.differences]
        return {"is_equal": self.is_equal, "compared": compared, "differences": differences, "unusable": self.unusable}


def check_device(
    device: DeviceInfo, *, layouts: Sequence[str] = ALL_LAYOUTS, meshes: Sequence[str] = ()
) -> Conformance:
    """Compare all answers of a device with the stored ones.

    Parameters
    ----------
    device : DeviceInfo
    layouts : sequence of str, optional
        Among `ALL_LAYOUTS`. The tree that the device builds is compared in any case.
    meshes : sequence of str, optional
        Names of cases; all without it.

    Raises
    ------
    DeviceError, KernelBuildError
        The device fails.
    ConfigError
        An unknown mesh.
    InternalError
        The stored answers are missing.
    """
    digests, expected = load_expected()
    unknown = sorted(set(meshes) - set(digests))
    if unknown:
        raise ConfigError(f"'{unknown[0]}' is no mesh of the conformance check: there are {', '.join(digests)}")
    compared: Counter[tuple[str, str]] = Counter()
    differences: list[Difference] = []
    cases = [case for case in make_cases() if not meshes or case.name in meshes]
    usable = [case for case in cases if digests.get(case.name) == digest_of(case)]
    for case in usable:
        for layout, query, answer in answer_case(case, device, layouts):
            compared[layout, query] += len(answer)
            differences += compare_answer(layout, query, case.name, answer, expected[case.name][query])
    unusable = tuple(case.name for case in cases if case not in usable)
    return Conformance(device, compared, tuple(differences), unusable)


def answer_case(case: Case, device: DeviceInfo, layouts: Sequence[str]) -> Iterator[tuple[str, str, Answer]]:
    """Yield layout, query and answer of everything that is asked about a case; the quality of a tree is its layout."""
    yield FAST_QUALITY, "tree", answer_tree(case, device)
    bvh = build(case.mesh)
    for layout in layouts:
        for ask in (answer_pictures,) if layout == BRUTE else (answer_rays, answer_pictures):
            for query, answer in ask(case, bvh, layout, device):
                yield layout, query, answer


def compare_answer(layout: str, query: str, mesh: str, answer: Answer, stored: dict[str, Expected]) -> list[Difference]:
    """Return the parts of an answer that are not the stored ones."""
    differences = []
    for part, values in answer.items():
        row = stored[part].find_difference(values)
        if row is not None:
            differences.append(Difference(layout, query, mesh, part, row, _show(values, row)))
    return differences


def collect_expected(cases: Sequence[Case], device: DeviceInfo) -> ExpectedAnswers:
    """Return what is to be stored, on which all layouts of a device must agree.

    Raises
    ------
    ValidationError
        Two layouts disagree.
    """
    answers: ExpectedAnswers = {}
    for case in cases:
        of_case = answers[case.name] = {}
        for layout, query, answer in answer_case(case, device, ALL_LAYOUTS):
            stored = of_case.setdefault(query, {part: Expected.of(values) for part, values in answer.items()})
            differences = compare_answer(layout, query, case.name, answer, stored)
            if differences:
                raise ValidationError(f"the layouts disagree, so nothing is stored: {differences[0]}")
    return answers


def _show(values: NDArray, row: int) -> str:
    """Return a row for a message, floats with all their digits."""
    return "" if row < 0 else np.array2string(values[row], precision=17, separator=", ", max_line_width=10_000)


def main() -> None:
    """Replace the stored answers by those of the default device."""
    device = choose_device()
    cases = make_cases()
    store_expected(cases, collect_expected(cases, device))
    print(f"{EXPECTED_PATH.name} has the answers of {device.name} ({device.platform})")


if __name__ == "__main__":
    main()
