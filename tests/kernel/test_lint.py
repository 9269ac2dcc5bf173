"""The lint of kernel sources finds what differs between devices, and what does not belong into a file."""

import importlib.util
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / ".ci" / "lint_kernels.py"

FINDINGS = {
    **{
        f"float f(float3 v, float x)\n{{\n    return {use};\n}}\n": (3, "differs between devices")
        for use in ("normalize(v)", "dot(v, v)", "native_exp (x)", "pow(x, 2.0f)", "(double)x", "atom_add(p, 1)")
    },
    "int a;\n\tint b;\n": (2, "a tab"),
    "int a;\r\n": (1, "trailing space"),
    f"int a;  // {'x' * 110}\n": (1, "121 characters"),
    '#include "none.cl"\n': (1, "'none.cl' is in none of"),
}


@pytest.fixture
def check(tmp_path):
    """A function from the text of a kernel file to its findings, as (line, message)."""
    spec = importlib.util.spec_from_file_location("lint_kernels", SCRIPT)
    lint = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(lint)

    def run(text):
        (tmp_path / "cl").mkdir(exist_ok=True)
        (tmp_path / "cl" / "a.cl").write_bytes(text.encode())
        return lint.Linter(tmp_path, "typedef struct {\n    float t;\n} hit_t;\n").check(tmp_path / "cl" / "a.cl")

    return run


def test_each_rule_finds_its_line(check):
    for text, (line, words) in FINDINGS.items():
        ((found, message),) = check(text)
        assert found == line, text
        assert words in message, text
    assert check("// dot(a, b), double\nfloat f(float x)\n{\n    return my_dot(x) + dot_product(x);\n}\n") == []
