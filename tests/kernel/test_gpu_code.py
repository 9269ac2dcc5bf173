"""The code of kernels for GPUs that need not be here, see `.ci/gpu_report.py`; and the lint of kernel sources."""

import importlib.util
import re
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[2] / ".ci"


def load_script(name):
    """A script as a module."""
    spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up.
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


report, lint = load_script("gpu_report"), load_script("lint_kernels")
compiles = pytest.mark.skipif(bool(report.find_missing()), reason=report.find_missing())

# The layout of GPUs, and kernels with all that a traversal needs. `make gpu-report` compiles the others, too.
KERNELS = ("closest_hit", "first_hits", "closest_point", "ambient_occlusion")
PROGRAMS = [
    program
    for program in report.list_programs(["bvh2"])
    if program.kernel == "closest_hit" or (program.kernel in KERNELS and not program.of_scene)
]
GPUS = [gpu for gpu in report.AMD if gpu.name != "gfx1100"]  # clang 15 gives that one half of its registers

# Bytes of private memory beside the stacks: a few vectors.
ELSE = 32


def name_program(program):
    return f"{program.kernel}{', scenes' if program.of_scene else ''}"


@compiles
@pytest.mark.parametrize("program", PROGRAMS, ids=name_program)
def test_bvh2_spills_no_register_and_keeps_nothing_but_stacks_in_memory(program):
    stacks = 4 * (program.defines["STACK_SIZE"] + program.defines.get("TOP_STACK_SIZE", 0))
    for gpu in GPUS:
        figures = report.compile_for_amd(program, gpu)
        assert figures.spilled == figures.local_bytes == 0, gpu.name
        assert figures.stack_bytes <= stacks + ELSE, gpu.name
    if (ptxas := report.find_ptxas()) is not None:
        ptx = report.compile_to_ptx(program)
        assert report.assemble_for_nvidia(ptx, report.NVIDIA[-1], ptxas).spilled == 0


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


# A source, another one that it may include, and the findings in the first: each line, and a part of its message.
SHARED = (
    "#define SIZE 4\ntypedef float8 lanes_t;\nINLINED float twice(\n    const float x)\n{\n    return 2.0f * x;\n}\n"
)
FINDINGS = [
    (f"int a;  // {'x' * 109}\n", []),
    (f"int a;  // {'x' * 110}\n", [(1, "121 characters")]),
    ("int a;\n\tint b; \n", [(2, "a tab"), (2, "trailing space")]),
    ("int a;", [(1, "no newline")]),
    ("int a;\n\n", [(2, "blank line")]),
    ('#include "none.cl"\n', [(1, "'none.cl' is in none of")]),
    ("float f()\n{\n    return pow(x, 2.0f);  // dot(v, v)\n}\n", [(3, "differs between devices")]),
    ("// dot(a, b), double\nfloat f(float x)\n{\n    return my_dot(x) + dot_product(x);\n}\n", []),
    *((f'#include "b.cl"\n{use}\n', []) for use in ("int a[SIZE];", "lanes_t a;", "float a = twice(1.0f);")),
    *((f'int b;\n#include "b.cl"\n{use}\n', [(2, "")]) for use in ("int a;", "// twice", 'char *a = "SIZE";')),
    ('#include "structs.cl"\nhit_t a;\n', []),
    # A reason keeps includes to the next blank line, and a file of includes alone needs none.
    ('// keep: expanded\n// before\n#include "structs.cl"\n\n#include "b.cl"\nint a;\n', [(5, "")]),
    ('// keep:\n#include "b.cl"\nint a;\n', [(2, "")]),
    ('// All of it.\n\n#include "b.cl"\n', []),
]


def test_the_lint_finds_what_breaks_a_rule(tmp_path):
    (tmp_path / "cl").mkdir()
    (tmp_path / "cl" / "b.cl").write_text(SHARED)
    for text, expected in FINDINGS:
        (tmp_path / "cl" / "a.cl").write_text(text)
        found = lint.Linter(tmp_path, "typedef struct {\n    float t;\n} hit_t;\n").check(tmp_path / "cl" / "a.cl")
        assert [line for line, _ in found] == [line for line, _ in expected], text
        assert all(words in message for (_, message), (_, words) in zip(found, expected, strict=True)), text
