"""The code of kernels for GPUs that need not be here, see `.ci/gpu_report.py`."""

import importlib.util
import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from clbvh.structs import MAX_DEPTH

SPEC = importlib.util.spec_from_file_location("gpu_report", Path(__file__).parents[2] / ".ci/gpu_report.py")
report = importlib.util.module_from_spec(SPEC)
# Dataclasses look their module up.
sys.modules["gpu_report"] = report
SPEC.loader.exec_module(report)

compiles = pytest.mark.skipif(bool(report.find_missing()), reason=report.find_missing())

# The layout of GPUs, and kernels with all that a traversal needs. `make gpu-report` compiles the others, too.
KERNELS = ("closest_hit", "first_hits", "closest_point", "ambient_occlusion")
PROGRAMS = [
    program
    for program in report.list_programs(["bvh2"])
    if program.kernel == "closest_hit" or (program.kernel in KERNELS and not program.of_scene)
]
# And where float64 decides, see cl/exact/ray.cl.
EXACT = [replace(each, defines={**each.defines, "EXACT": 1}) for each in PROGRAMS if each.kernel == "closest_hit"]
GPUS = [gpu for gpu in report.AMD if gpu.name != "gfx1100"]  # clang 15 gives that one half of its registers

# Bytes of private memory beside the stacks: a few vectors.
ELSE = 32


def name_program(program):
    exact = ", exact" if "EXACT" in program.defines else ""
    return f"{program.kernel}{', scenes' if program.of_scene else ''}{exact}"


@compiles
@pytest.mark.parametrize("program", PROGRAMS + EXACT, ids=name_program)
def test_bvh2_spills_no_register_and_keeps_nothing_but_stacks_in_memory(program):
    stacks = 4 * (program.defines["STACK_SIZE"] + program.defines.get("TOP_STACK_SIZE", 0))
    for gpu in GPUS:
        figures = report.compile_for_amd(program, gpu)[program.kernel]
        assert figures.spilled == figures.local_bytes == 0, gpu.name
        assert figures.stack_bytes <= stacks + ELSE, gpu.name
    if (ptxas := report.find_ptxas()) is not None:
        ptx = report.compile_to_ptx(program)
        assert report.assemble_for_nvidia(program, ptx, report.NVIDIA[-1], ptxas)[program.kernel].spilled == 0


# Private memory of kernels that build trees: of those that walk below a node, a stack and the node's children.
WALKS = {"place_first", "place_tiles", "visit_tiles"}
STACK = 4 * MAX_DEPTH + ELSE


@compiles
@pytest.mark.parametrize("program", [*report.list_build_programs()], ids=lambda program: program.kernel + program.label)
def test_builds_spill_no_register_and_keep_clusters_out_of_private_memory(program):
    found = [report.compile_for_amd(program, gpu) for gpu in GPUS]
    ptx = report.compile_to_ptx(program)
    if (ptxas := report.find_ptxas()) is not None:
        found.append(report.assemble_for_nvidia(program, ptx, report.NVIDIA[-1], ptxas))
    for kernel, figures in (item for of_gpu in found for item in of_gpu.items()):
        assert figures.spilled == 0, kernel
        if kernel != "write_blocks":  # an array of the corners of eight triangles
            assert figures.stack_bytes <= (STACK if kernel in WALKS else 0), kernel
        # Three work-groups fit beside each other.
        assert 3 * figures.local_bytes <= 1 << 16, kernel
    # An operation that does not say how it rounds may be fused with the next one.
    operations = re.findall(r"\b(?:add|sub|mul|fma)\.[a-z.]*f(?:32|64)\b", ptx)
    assert all(re.fullmatch(r"[a-z]+\.rn\.f(?:32|64)", operation) for operation in operations), operations


@compiles
@pytest.mark.parametrize("kernel", ["pack_rays", "refine_hits"])
def test_kernels_of_rays_in_arrays_spill_nothing_and_round_each_step(kernel):
    (program,) = (each for each in report.list_programs([]) if each.kernel == kernel)
    for gpu in GPUS:
        figures = report.compile_for_amd(program, gpu)[kernel]
        assert figures.spilled == figures.stack_bytes == 0, gpu.name
        assert kernel != "pack_rays" or figures.waves == figures.max_waves, gpu.name
    # The bits of the host: no product and sum in one, no approximation.
    operations = re.findall(r"\b(?:add|sub|mul|fma|div)\.[a-z.]*f64\b", report.compile_to_ptx(program))
    assert {"add.rn.f64", "mul.rn.f64", "div.rn.f64"} <= set(operations) <= {
        "add.rn.f64", "sub.rn.f64", "mul.rn.f64", "div.rn.f64",
    }  # fmt: skip


@compiles
@pytest.mark.parametrize("program", PROGRAMS, ids=name_program)
def test_arithmetic_is_that_of_every_device_and_nodes_are_loaded_in_long_words(program):
    ptx = report.compile_to_ptx(program)
    # An operation that does not say how it rounds may be fused with the next one, or be an approximation.
    operations = set(re.findall(r"\b(?:add|sub|mul|fma|div|sqrt|rcp)\.[a-z.]*f(?:32|64)\b", ptx))
    assert operations
    assert all(re.fullmatch(r"[a-z]+\.rn\.f32", operation) for operation in operations), operations
    if name_program(program) == "closest_hit":
        # The boxes of two children are twelve words, what follows them four.
        assert ptx.count("ld.global.v4") >= 4
        loads, words = report.count_loads(ptx)
        assert words > 2 * loads
