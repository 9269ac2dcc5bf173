"""An opened device: what goes up comes down, programs are built once, and what cannot be done is one sentence."""

import re
import weakref
from types import SimpleNamespace

import numpy as np
import pyopencl as cl
import pytest

from clbvh import DeviceError, InternalError, KernelBuildError
from clbvh.device.context import OpenclKernel
from clbvh.device.open import open_device
from clbvh.device.sources import expand_source, find_arguments
from clbvh.device.times import CommandTimes
from clbvh.support.folders import find_folder
from clbvh.tree_layouts import LAYOUTS, WIDE_LAYOUTS

from ...concurrency.threads import run_in_threads

THREADS = 6


@pytest.fixture
def fresh(session):
    """A session of its own on the same device."""
    with open_device(session.info) as opened:
        yield opened


@pytest.fixture
def write(tmp_path):
    """A function that writes a source below the folder `sources`, which it returns."""

    def run(name, *lines):
        path = tmp_path / "sources" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(lines) + "\n")
        return tmp_path / "sources"

    return run


@pytest.mark.on_opencl
def test_what_cannot_be_done_is_said_in_one_sentence(fresh, write):
    folder = write("kernels/double_it.cl", "kernel void double_it(global int *x) { x[0] *= 2; }")
    double = fresh.kernel("double_it", folder=folder)
    buffer, large = fresh.allocate(400), np.zeros(1_000_000, np.int32)
    for call, words in [
        (lambda: fresh.allocate(2**62), f"the device '{re.escape(fresh.info.name)}' cannot hold a buffer of 4,.* MB"),
        (lambda: fresh.allocate(2**50), r"try a smaller job or another --device, and see `clbvh doctor`$"),
        (lambda: fresh.write(buffer, large), r"cannot take 4\.0 MB"),
        (lambda: fresh.download(buffer, large), r"cannot give back 4\.0 MB"),
        (lambda: fresh.run(double, (64,), (2**30,), x=buffer), "cannot run the kernel 'double_it'"),
        (lambda: open_device("no such board"), "no such board"),
    ]:
        with pytest.raises(DeviceError, match=words) as caught:
            call()
        assert "\n" not in str(caught.value)
    assert fresh.upload(np.ones(3, np.float32)).size >= 12
    with pytest.raises(InternalError, match="the kernel 'double_it' takes x: missing or unknown are"):
        double.in_order({"x": 1, "row_length": 4})


def test_numbers_are_passed_by_the_type_of_the_source():
    text = (
        "kernel void one(const global node_t *restrict nodes, const int count, float scale,\n"
        "    global int *x, const uint seed)\n{\n}\n"
        "kernel void two(global float *x)\n{\n}\n"
    )
    assert find_arguments(text) == {
        "one": {"nodes": None, "count": "int", "scale": "float", "x": None, "seed": "uint"},
        "two": {"x": None},
    }


@pytest.mark.on_opencl
def test_a_buffer_is_gone_when_nothing_refers_to_it_or_the_session_is_closed(session):
    with open_device(session.info) as opened:
        held, other = opened.allocate(100), opened.allocate(100)
        opened.allocate(100)
        assert opened.buffer_count == 2
        opened.release(other)
        assert opened.buffer_count == 1
    opened.close()
    assert opened.is_closed
    with pytest.raises(Exception, match=r"(?i)released|invalid|not valid"):
        held.release()


class Event:
    """A command that ran from `start` to `end`, in nanoseconds."""

    def __init__(self, start, end):
        self.profile = SimpleNamespace(start=start, end=end)

    def wait(self):
        pass


def test_times_add_up_by_label_also_in_threads_and_a_command_that_failed_has_none():
    def fail():
        raise make_error("OUT_OF_RESOURCES")

    times, seen = CommandTimes(), []
    times.note("kernel", SimpleNamespace(wait=fail))
    times.note("kernel", Event(1_000_000, 3_500_000))

    def note_many():
        for _ in range(2000):
            event = Event(0, 1_000_000)
            seen.append(weakref.ref(event))
            times.note("upload", event)

    run_in_threads(*[note_many] * THREADS)
    # A long session does not hoard events.
    assert sum(event() is not None for event in seen) < 500
    assert times.sums_ms() == {"kernel": 2.5, "upload": 2000 * THREADS, "download": 0.0}


def make_error(code):
    """An error as the driver reports it; None for one that pyopencl finds itself."""
    if code is None:
        return cl.LogicError("the wrong number of arguments")
    return cl.RuntimeError(cl._cl._ErrorRecord(msg="", code=getattr(cl.status_code, code), routine="clEnqueue"))


@pytest.mark.on_opencl
@pytest.mark.parametrize("code", ["OUT_OF_RESOURCES", "INVALID_COMMAND_QUEUE", "MEM_OBJECT_ALLOCATION_FAILURE", None])
def test_a_context_that_the_driver_has_given_up_is_not_shared_any_more(session, code):
    def fail(*arguments):
        raise make_error(code)

    fail.function_name = "fail"
    with open_device(session.info) as before:
        with pytest.raises(DeviceError, match="cannot run the kernel 'fail'"):
            before.run(OpenclKernel(fail, []), (1,), (1,))
        with open_device(session.info) as after:
            assert (after.shared is not before.shared) == (code in ("OUT_OF_RESOURCES", "INVALID_COMMAND_QUEUE"))
            # Buffers belong to a context, and so to all branches of a session.
            assert before.branch().shared is before.shared
            back = np.zeros(5)
            after.download(after.upload(np.arange(5.0)), back)
            assert back.tolist() == [0, 1, 2, 3, 4]


@pytest.mark.on_both
def test_a_compiler_message_names_our_file_and_line_also_behind_includes(session, write):
    write("a.cl", '#include "b.cl"', "float third_of(const float x)", "{", "    return x / there;", "}")
    write("b.cl", '#include "a.cl"', "float half_of(const float x)", "{", "    return x / tow;", "}")
    # A folder comes before the shipped one, and a file is expanded once.
    write("hits/crossing.cl", "int mine;")
    includes = [f'#include "{name}"' for name in ("a.cl", "b.cl", "hits/crossing.cl")]
    folder = write("kernels/k.cl", *includes, "kernel void k(global int *x) { x[0] = mine + nothing; }")
    for _ in range(2):
        with pytest.raises(KernelBuildError) as caught:
            session.kernel("k", {"TWO": 2}, folder=folder)
    messages = re.findall(r"sources/([\w/.]+):(\d+):.*'(\w+)'", caught.value.log)
    assert messages == [("b.cl", "4", "tow"), ("a.cl", "4", "there"), ("kernels/k.cl", "4", "nothing")]
    assert caught.value.device == ("host" if session.info.is_host else session.info.name)
    assert "-cl-std=CL1.2" in caught.value.options
    assert "-DTWO=2" in caught.value.options
    assert caught.value.log in str(caught.value)
    folder = write("kernels/l.cl", '#include "none.cl"')
    with pytest.raises(InternalError, match=r"'none\.cl' is missing in .*sources and .*cl"):
        expand_source("kernels/l.cl", folder)


@pytest.mark.on_opencl
def test_another_text_or_another_macro_is_another_kernel_and_the_same_is_compiled_once(session, write, monkeypatch):
    # All opened here: a test may have let the device's sessions have a new context since `session` was opened.
    with open_device(session.info) as one, open_device(session.info) as other, one.branch() as branch:

        def run(text, number):
            folder = write("kernels/set_number.cl", f"kernel void set_number(global int *x) {{ x[0] = {text}; }}")
            kernel, into = one.kernel("set_number", {"NUMBER": number}, folder=folder), np.zeros(1, np.int32)
            buffer = one.upload(into)
            one.run(kernel, (1,), (1,), x=buffer)
            one.download(buffer, into)
            return int(into[0]), folder

        assert [run("NUMBER", 1)[0], run("NUMBER", 2)[0], run("2 * NUMBER", 2)[0]] == [1, 2, 4]
        monkeypatch.setattr(cl, "Program", None)
        _, folder = run("2 * NUMBER", 2)
        kernels = {each.kernel("set_number", {"NUMBER": 2}, folder=folder) for each in (one, other, branch)}
        assert len(kernels) == 1
        assert len({id(each.queue) for each in (one, other, branch)}) == 3


@pytest.mark.on_opencl
@pytest.mark.parametrize("layout", ["bvh2", "bvh8"])
def test_every_shipped_kernel_builds_without_a_warning(session, layout):
    # What the compiler says would end up on the user's screen.
    options = ["-cl-std=CL1.2", "-Werror", f"-DLAYOUT={LAYOUTS[layout].number}", "-DSTACK_SIZE=4"]
    for path in sorted((find_folder("cl") / "kernels").glob("*.cl")):
        program = cl.Program(session.context, expand_source(f"kernels/{path.name}")).build(options)
        assert bool(program.all_kernels()) == (layout in WIDE_LAYOUTS or not path.stem.endswith("entry_points"))
