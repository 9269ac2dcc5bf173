"""The lint of kernel sources: each rule on a small project of its own, and the shipped sources are clean."""

import importlib.util
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / ".ci" / "lint_kernels.py"
STRUCTS = "typedef struct {\n    float t;\n} hit_t;\n"


@pytest.fixture(scope="module")
def lint():
    """The script as a module."""
    spec = importlib.util.spec_from_file_location("lint_kernels", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def check(lint, tmp_path):
    """A function from the texts of files below cl/ to the findings in `a.cl`, as (line, message)."""

    def run(**texts):
        (tmp_path / "cl").mkdir()
        for name, text in texts.items():
            (tmp_path / "cl" / f"{name}.cl").write_text(text, encoding="utf-8")
        return lint.Linter(tmp_path, STRUCTS).check(tmp_path / "cl" / "a.cl")

    return run


def test_the_shipped_sources_are_clean(lint, capsys):
    assert lint.main([]) == 0, capsys.readouterr().out


@pytest.mark.parametrize(
    "use", ["normalize(v)", "dot(v, v)", "native_exp (x)", "pow(x, 2.0f)", "(double)x", "atom_add(p, 1)"]
)
def test_what_differs_between_devices_is_found(check, use):
    findings = check(a=f"float f(float3 v, float x)\n{{\n    return {use};  // dot(v, v)\n}}\n")
    assert [line for line, _ in findings] == [3]
    assert "differs between devices" in findings[0][1]


def test_words_in_comments_and_longer_names_are_no_built_in_functions(check):
    assert check(a="// dot(a, b), double\nfloat f(float x)\n{\n    return my_dot(x) + dot_product(x);\n}\n") == []


def test_a_finding_names_file_and_line_and_fails(lint, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(lint, "PROJECT", tmp_path)
    (tmp_path / "cl").mkdir()
    (tmp_path / "cl" / "a.cl").write_text("int a;\nint b; \n")
    assert lint.main(["cl"]) == 1
    assert capsys.readouterr().out == "cl/a.cl:2: trailing space\n"


@pytest.mark.parametrize(
    ("text", "findings"),
    [
        ("int a;\n", []),
        (f"int a;  // {'x' * 109}\n", []),
        (f"int a;  // {'x' * 110}\n", [(1, "121 characters")]),
        ("int a;\n\tint b; \n", [(2, "a tab"), (2, "trailing space")]),
        ("int a;\r\n", [(1, "trailing space")]),
        ("int a;", [(1, "no newline")]),
        ("int a;\n\n", [(2, "blank line")]),
        ('  #include "structs.cl"  // why\nhit_t a;\n', [(1, "an include is a line of its own")]),
        ('#include "none.cl"\n', [(1, "'none.cl' is in none of")]),
    ],
)
def test_text(check, text, findings):
    found = check(a=text)
    assert [line for line, _ in found] == [line for line, _ in findings]
    for (_, message), (_, start) in zip(found, findings, strict=True):
        assert message.startswith(start)


# Definitions of every kind.
LIBRARY = """#define SIZE 4
typedef float8 lanes_t;
typedef struct {
    float x;
} point_t;
INLINED float twice(
    const float x)
{
    return 2.0f * x;
}
"""


@pytest.mark.parametrize("use", ["int a[SIZE];", "lanes_t a;", "const point_t a;", "float a = twice(1.0f);"])
def test_an_include_is_used_by_any_of_its_identifiers(check, use):
    assert check(a=f'#include "b.cl"\n{use}\n', b=LIBRARY) == []


@pytest.mark.parametrize("use", ["int a;", "// twice", "/* SIZE\nlanes_t */", 'char *a = "SIZE";', "float x;"])
def test_words_in_comments_and_strings_are_no_uses(check, use):
    assert [line for line, _ in check(a=f'int b;\n#include "b.cl"\n{use}\n', b=LIBRARY)] == [2]


def test_structs_of_the_host_count_as_an_include(check):
    assert check(a='#include "structs.cl"\nhit_t a;\n') == []


def test_structs_that_are_not_used_are_found(check):
    assert [line for line, _ in check(a='#include "structs.cl"\nint a;\n')] == [1]


def test_what_an_include_brings_counts_if_no_other_include_brings_it(check):
    texts = {"b": '#include "c.cl"\nint b;\n', "c": "#define SIZE 4\n", "d": "#define OTHER 1\n"}
    assert check(a='#include "b.cl"\n#include "d.cl"\nint a[SIZE + OTHER];\n', **texts) == []


def test_what_two_includes_bring_counts_for_the_one_that_defines_it(check):
    texts = {"b": '#include "c.cl"\nint b;\n', "c": "#define SIZE 4\n"}
    assert [line for line, _ in check(a='#include "b.cl"\n#include "c.cl"\nint a[SIZE];\n', **texts)] == [1]


def test_includes_in_a_circle_end(check):
    assert check(a='#include "b.cl"\nint a[SIZE];\n', b='#include "a.cl"\n#define SIZE 4\n') == []


def test_keep_exempts_includes_to_the_next_blank_line(check):
    text = '// keep: expanded\n// before\n#include "b.cl"\n#if 1\n#include "c.cl"\n#endif\n\n#include "d.cl"\nint a;\n'
    assert [line for line, _ in check(a=text, b="int b;\n", c="int c;\n", d="int d;\n")] == [8]


def test_keep_needs_a_reason(check):
    assert [line for line, _ in check(a='// keep:\n#include "b.cl"\nint a;\n', b="int b;\n")] == [2]


def test_a_file_of_includes_alone_is_a_bundle(check):
    assert check(a='// All of it.\n\n#include "b.cl"\n', b="int b;\n") == []
