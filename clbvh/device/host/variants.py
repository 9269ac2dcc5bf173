"""The table of what the library for the host holds: files of kernels, and the macros that each is compiled with.

What is a macro for the registers of a GPU is a branch here where that costs nothing, so that a few variants serve all
that callers ask for. The build, the loader and the tests work from this table.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product
from typing import NamedTuple

from ...choices import REPORT_SHADINGS, SHADINGS
from ...kinds import ALL_KINDS, KINDS, TRIANGLES, Kind
from ...support.folders import find_folder
from ...tree_layouts import LAYOUTS, TREE_LAYOUTS

# Stack sizes of every kernel of the host: a longer stack costs no time. Trees that need more are refused on
# every device: a work-item's memory holds no more. No builder's tree is deeper than 64 levels, nor is the one over
# instances.
LONGEST_STACK, TOP_STACK_SIZE = 1024, 64
FIXED = {"STACK_SIZE": LONGEST_STACK, "TOP_STACK_SIZE": TOP_STACK_SIZE}

# Parts of pictures, which few views need. Most pictures by `path` have a ground.
_PICTURE_PARTS = ("HAS_CUT", "HAS_WIREFRAME")
_SAMPLE_PARTS = (*_PICTURE_PARTS, "HAS_CUTOUTS", "HAS_NORMAL_MAPS")
_PARTS = {"render": _PICTURE_PARTS, "render_samples": _SAMPLE_PARTS}

# The host's own layout. Pictures of it without any of the parts have kernels without them, which takes 12 to 15 % less
# time; all others have one kernel with all parts, in which large functions are called, see cl/math/inlined.cl.
_OWN_LAYOUT = LAYOUTS["bvh8"].number

# A work-group is one thread, so that no kernel waits for others at a barrier.
SORT_DIGIT_BITS = 10
_UNGROUPED = {"GROUPED": 0, "GROUP_SIZE": 1}

# Levels of processor, and files of kernels that have no code of their own for them where there is a lower level: code
# for AVX-512 of those that are large, or seldom asked for, would be a fifth of a wheel.
WITHOUT_LEVEL = {"v4": ("closest_points", "count_steps", "depth", "render", "render_samples")}

# Points that walk a tree together: a vector of AVX2.
WINDING_LANES = 8

_OF_WORLDS = (
    "ambient_occlusion", "any_hit", "closest_hit", "closest_point", "closest_points", "count_hits", "count_steps",
    "depth", "first_hits", "inside", "prims_in_boxes",
)  # fmt: skip
_OF_NO_WORLD = ("add_samples", "develop", "meet_boxes", "refine_hits", "settle_tiles")


class Variant(NamedTuple):
    """A file of kernels and its macros.

    Attributes
    ----------
    name : str
        Name of the file below ``cl/kernels``, without its ending.
    macros : tuple of (str, int)
        In alphabetical order, without those of `FIXED`.
    """

    name: str
    macros: tuple[tuple[str, int], ...]

    @classmethod
    def of(cls, name: str, macros: Mapping[str, int]) -> Variant:
        """Return the variant of a file that serves those who ask for these macros."""
        chosen = {macro: value for macro, value in macros.items() if macro not in FIXED}
        if chosen.get("LONE") == 0:
            chosen["KINDS"] = ALL_KINDS
        if "LONE" in chosen:
            chosen.setdefault("EXACT", 0)
        if name in _PARTS:
            is_plain = chosen["LAYOUT"] == _OWN_LAYOUT and not chosen["EXACT"]
            is_plain = is_plain and not any(chosen.get(part, 0) for part in _PARTS[name])
            chosen |= dict.fromkeys(_PARTS[name], int(not is_plain)) | {"CALLS": int(not is_plain)}
        if name == "render_samples":
            chosen["HAS_GROUND"] = int(chosen["SHADING"] == SHADINGS["path"])
        return cls(name, tuple(sorted(chosen.items())))

    def entry(self, kernel: str) -> str:
        """Return the name of a kernel's entry in the library, without that of the processor's level."""
        return "_".join([kernel, *(f"{macro}{value}" for macro, value in self.macros)])


def block_macros(kind: Kind, width: int, has_fp64: bool) -> dict[str, int]:
    """Return the macros of the kernel that writes blocks, see cl/kernels/write_blocks.cl."""
    numbers = kind.block(1).itemsize // 4 - 1  # all but the prim_id
    return {"KINDS": kind.bit, "PRIM_NUMBERS": numbers, "BLOCK_WIDTH": width, "HAS_FP64": int(has_fp64)}


def list_loop_files() -> list[str]:
    """Return the files of loops below ``cl/host``, without their ending."""
    folder = find_folder("cl") / "host"
    files = (path.relative_to(folder).with_suffix("").as_posix() for path in folder.rglob("*.cl"))
    return sorted(name for name in files if "/" in name)


def loop_entry(name: str, loop: str) -> str:
    """Return the name of a loop's entry in the library, without that of the processor's level; `name` is its file's."""
    return f"{name.replace('/', '_')}_{loop}"


def list_variants() -> list[Variant]:
    """Return all variants, without repetitions, those first that take longest to compile."""
    return list(dict.fromkeys(_list_all()))


def _list_all() -> Iterator[Variant]:
    kinds = [*((1, kind.bit) for kind in KINDS.values()), (0, ALL_KINDS)]
    worlds = [
        {"LAYOUT": layout.number, "LONE": lone, "KINDS": bits, "EXACT": exact}
        for layout, (lone, bits), exact in product(LAYOUTS.values(), kinds, (0, 1))
    ]
    with_entry_points = {layout.number for layout in LAYOUTS.values() if layout.is_wide}
    for shading, world, has_cut in product(SHADINGS, worlds, (0, 1)):
        if shading not in REPORT_SHADINGS:
            yield Variant.of("render_samples", world | {"SHADING": SHADINGS[shading], "HAS_CUT": has_cut})
    for world in worlds:
        yield Variant.of("render", world)
        yield Variant.of("render", world | {"HAS_CUT": 1})
        for name in _OF_WORLDS:
            yield Variant.of(name, world)
        if world["LAYOUT"] in with_entry_points:
            yield Variant.of("view_entry_points", world)
        if world["LONE"]:
            yield Variant.of("closest_in_shard", world)
    widths = sorted({(LAYOUTS[name].width, LAYOUTS[name].block_width) for name in TREE_LAYOUTS})
    for (width, _), as_rows in product(widths, (0, 1)):
        if width == 2 or not as_rows:
            yield Variant.of("build_tree", {"TREE_WIDTH": width, "AS_ROWS": as_rows} | _UNGROUPED)
    for width, block_width in widths:
        yield Variant.of("refit_nodes", {"TREE_WIDTH": width})
        for kind, has_fp64 in ((TRIANGLES, True), *((kind, False) for kind in KINDS.values())):
            yield Variant.of("write_blocks", block_macros(kind, block_width, has_fp64))
    yield Variant.of("radix_sort", {"DIGIT_BITS": SORT_DIGIT_BITS, "GROUP_SIZE": 1})
    for value in (0, 1):
        yield Variant.of("take_mesh", {"IS_DOUBLE": value})
    for name in _OF_NO_WORLD:
        yield Variant.of(name, {})
    yield Variant.of("winding", {"LANES": WINDING_LANES})
