"""Kernel sources: found, expanded once each, built, and named in the compiler's messages."""

import re
from dataclasses import replace

import numpy as np
import pytest

from clbvh.device.program import build_kernel, expand_source
from clbvh.errors import InternalError, KernelBuildError
from clbvh.structs import ENTRY_POINT_LAYOUTS, LAYOUTS, c_declarations
from clbvh.support.folders import find_folder


@pytest.fixture
def folder(tmp_path):
    """A folder of sources, with a function to write one."""
    root = tmp_path / "sources"
    (root / "kernels").mkdir(parents=True)

    def write(name, *lines):
        (root / name).parent.mkdir(exist_ok=True)
        (root / name).write_text("\n".join(lines) + "\n")
        return root

    write.path = root
    return write


def markers(text):
    return re.findall(r'#line (\d+ "[^"]+")', text)


def test_includes_are_expanded_once_each_in_order(folder):
    folder("b.cl", "int b;")
    folder("a.cl", '#include "b.cl"', "int a;")
    folder("kernels/k.cl", "// k", '#include "a.cl"', '#include "b.cl"', "int k;")
    lines = expand_source("kernels/k.cl", folder.path).splitlines()
    assert [line for line in lines if not line.startswith("#line")] == ["// k", "int b;", "int a;", "int k;"]


def test_files_that_include_each_other_end(folder):
    folder("a.cl", '#include "b.cl"', "int a;")
    folder("b.cl", '#include "a.cl"', "int b;")
    folder("kernels/k.cl", '#include "a.cl"')
    text = expand_source("kernels/k.cl", folder.path)
    assert text.count("int a;") == text.count("int b;") == 1


def test_every_line_knows_its_file_and_number(folder):
    folder("a.cl", "", "int a;  // sources/a.cl:2", '#include "b.cl"', "int c;  // sources/a.cl:4")
    folder("b.cl", "int b;  // sources/b.cl:1")
    folder(
        "kernels/k.cl",
        '#include "a.cl"',
        "int k;  // sources/kernels/k.cl:2",
        '#include "a.cl"',
        "int l;  // sources/kernels/k.cl:4",
    )
    name, number, seen = None, 0, 0
    for line in expand_source("kernels/k.cl", folder.path).splitlines():
        marker = re.fullmatch(r'#line (\d+) "(.+)"', line)
        if marker:
            number, name = int(marker[1]), marker[2]
            continue
        if "//" in line:
            assert line.split("// ")[1] == f"{name}:{number}"
            seen += 1
        number += 1
    assert seen == 5


def test_the_layout_is_made_from_python():
    text = expand_source("kernels/closest_hit.cl")
    assert text.count(c_declarations()) == 1
    assert '1 "cl/structs.cl"' in markers(text)
    assert "#include" not in text


def test_a_folder_comes_before_the_shipped_one(folder):
    folder("hits/crossing.cl", "int mine;")
    folder("kernels/k.cl", '#include "hits/crossing.cl"', '#include "boxes/aabb.cl"')
    text = expand_source("kernels/k.cl", folder.path)
    assert "int mine;" in text
    assert "crossing_t" not in text
    assert "meets_aabb" in text
    assert {'1 "sources/hits/crossing.cl"', '1 "cl/boxes/aabb.cl"'} <= set(markers(text))


@pytest.mark.parametrize("name", ["kernels/none.cl", "kernels/k.cl"], ids=["kernel", "include"])
def test_a_missing_file_is_our_bug(folder, name):
    folder("kernels/k.cl", '#include "none.cl"')
    with pytest.raises(InternalError, match=r"'(kernels/)?none\.cl' is missing in .*sources and .*cl"):
        expand_source(name, folder.path)


def test_a_missing_shipped_file_is_our_bug():
    with pytest.raises(InternalError, match=re.escape(str(find_folder("cl")))):
        expand_source("kernels/none.cl")


def test_a_compiler_message_names_our_file_and_line(session, folder):
    folder("broken.cl", "// fine", "float half_of(const float x)", "{", "    return x / tow;", "}")
    folder("kernels/k.cl", '#include "broken.cl"', "kernel void k(global float *x) { x[0] = half_of(x[0]); }")
    with pytest.raises(KernelBuildError) as caught:
        build_kernel(session, "k", {"TWO": 2}, folder=folder.path)
    error = caught.value
    assert "sources/broken.cl:4:" in error.log
    assert "tow" in error.log
    assert error.device == session.info.name
    assert error.options.startswith("-cl-std=CL1.2 -DTWO=2")
    assert str(error).startswith(f"the kernel does not compile on {session.info.name} with options '-cl-std=CL1.2 -D")
    assert error.log in str(error)


def test_lines_after_an_include_keep_their_numbers(session, folder):
    folder("fine.cl", "float twice(const float x)", "{", "    return 2.0f * x;", "}")
    folder("kernels/k.cl", "// one", '#include "fine.cl"', '#include "fine.cl"', "kernel void k() { nothing(); }")
    with pytest.raises(KernelBuildError, match=r"sources/kernels/k\.cl:4:"):
        build_kernel(session, "k", folder=folder.path)


def test_defines_reach_the_kernel(session, folder):
    folder("kernels/k.cl", "kernel void k(global int *x) { x[0] = FIRST; x[1] = SECOND; }")
    values = np.zeros(2, np.int32)
    for defines in ({"FIRST": 41, "SECOND": -7}, {"SECOND": 3, "FIRST": 2}):
        buffer = session.upload(values)
        kernel = build_kernel(session, "k", defines, folder=folder.path)
        session.run(kernel, (1,), (1,), **{kernel.argument_names[0]: buffer})
        session.download(buffer, values)
        session.release(buffer)
        assert dict(zip(["FIRST", "SECOND"], values.tolist(), strict=True)) == defines


def test_an_unknown_layout_is_a_build_error(session):
    with pytest.raises(KernelBuildError, match=r"cl/traversal/traverse\.cl:\d+:.*LAYOUT must be one of"):
        build_kernel(session, "closest_hit", {"LAYOUT": 99, "STACK_SIZE": 16})


@pytest.mark.parametrize("path", sorted((find_folder("cl") / "kernels").glob("*.cl")), ids=lambda path: path.stem)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_shipped_kernel_builds_in_every_layout_without_a_warning(session, path, layout):
    import pyopencl as cl

    # What the compiler says would end up on the user's screen.
    options = ["-cl-std=CL1.2", "-Werror", f"-DLAYOUT={LAYOUTS[layout]}", "-DSTACK_SIZE=4"]
    if path.stem.startswith("scene_"):
        options += ["-DLONE=0", "-DHAS_SPHERES=1", "-DTOP_STACK_SIZE=4"]
    program = cl.Program(session.context, expand_source(f"kernels/{path.stem}.cl")).build(options)
    names = {kernel.function_name for kernel in program.all_kernels()}
    assert (path.stem in names) == (layout in ENTRY_POINT_LAYOUTS or not path.stem.endswith("entry_points"))


def test_a_simulator_gets_portable_kernels_and_no_optimizer(session, folder, monkeypatch):
    folder("kernels/broken.cl", "kernel void broken(void) { return 1 }")
    monkeypatch.setattr(session, "info", replace(session.info, platform="Oclgrind"))
    with pytest.raises(KernelBuildError) as caught:
        build_kernel(session, "broken", folder=folder.path)
    assert "-DPORTABLE=1 -cl-opt-disable" in caught.value.options
