"""The code of kernels for GPUs that need not be here, see `.ci/gpu_report.py`."""

import importlib.util
import re
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / ".ci" / "gpu_report.py"


def load_report():
    """The script as a module."""
    spec = importlib.util.spec_from_file_location("gpu_report", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up.
    sys.modules["gpu_report"] = module
    spec.loader.exec_module(module)
    return module


report = load_report()
compiles = pytest.mark.skipif(bool(report.find_missing()), reason=report.find_missing())

# The layout of GPUs, and kernels with all that a traversal needs. `make gpu-report` compiles the others, too.
KERNELS = ("closest_hit", "first_hits", "closest_point", "ambient_occlusion")
PROGRAMS = [
    program
    for program in report.list_programs(["bvh2"])
    if program.kernel == "closest_hit" or (program.kernel in KERNELS and not program.of_scene)
]
GPUS = [gpu for gpu in report.AMD if gpu.name != "gfx1100"]  # clang 15 gives that one half of its registers


def name_program(program):
    return f"{program.kernel}{', scenes' if program.of_scene else ''}"


# Bytes of private memory beside the stacks: a few vectors.
ELSE = 32


@compiles
@pytest.mark.parametrize("gpu", GPUS, ids=lambda gpu: gpu.name)
@pytest.mark.parametrize("program", PROGRAMS, ids=name_program)
def test_bvh2_spills_no_register_and_keeps_nothing_but_stacks_in_memory(program, gpu):
    figures = report.compile_for_amd(program, gpu)
    stacks = 4 * (program.defines["STACK_SIZE"] + program.defines.get("TOP_STACK_SIZE", 0))
    assert figures.spilled == figures.local_bytes == 0
    assert figures.stack_bytes <= stacks + ELSE


@compiles
@pytest.mark.skipif(report.find_ptxas() is None, reason=report.NO_PTXAS)
@pytest.mark.parametrize("program", PROGRAMS, ids=name_program)
def test_bvh2_spills_no_register_of_nvidia(program):
    ptx = report.compile_to_ptx(program)
    figures = report.assemble_for_nvidia(ptx, report.NVIDIA[-1], report.find_ptxas())
    assert figures.spilled == 0


@compiles
def test_nodes_are_loaded_in_long_words():
    (closest_hit,) = [program for program in PROGRAMS if name_program(program) == "closest_hit"]
    ptx = report.compile_to_ptx(closest_hit)
    # The boxes of two children are twelve words, what follows them four.
    assert ptx.count("ld.global.v4") >= 4
    loads, words = report.count_loads(ptx)
    assert words > 2 * loads


@compiles
@pytest.mark.parametrize("program", PROGRAMS, ids=name_program)
def test_arithmetic_is_that_of_every_device(program):
    ptx = report.compile_to_ptx(program)
    # An operation that does not say how it rounds may be fused with the next one, or be an approximation.
    operations = set(re.findall(r"\b(?:add|sub|mul|fma|div|sqrt|rcp)\.[a-z.]*f(?:32|64)\b", ptx))
    assert operations
    assert all(re.fullmatch(r"[a-z]+\.rn\.f32", operation) for operation in operations), operations


def test_loads_are_counted_in_words():
    ptx = (
        "ld.global.v4.f32 {a, b, c, d}, [e];\nld.global.nc.v2.u32 {a, b}, [e];\nld.global.u32 a, [e];\nld.local.u32 a;"
    )
    assert report.count_loads(ptx) == (3, 7)


def test_every_kernel_is_compiled_in_every_layout():
    programs = list(report.list_programs())
    folder = report.find_folder("cl") / "kernels"
    assert {program.kernel for program in programs} == {path.stem for path in folder.glob("*.cl")}
    for of_scene in (False, True):
        layouts = {each.layout for each in programs if each.kernel == "closest_hit" and each.of_scene == of_scene}
        assert layouts == {"bvh2", "bvh4", "bvh8"}
