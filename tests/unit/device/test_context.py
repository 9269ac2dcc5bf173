"""One context per device in a process: shared, thread-safe, and replaced once the driver has given up on it."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace

import numpy as np
import pyopencl as cl
import pytest

from clbvh.device.context import DeviceContext, EventTimes, Kernel
from clbvh.device.program import build_kernel
from clbvh.device.session import DeviceSession
from clbvh.errors import DeviceError, KernelBuildError

THREADS = 6


def run_in_threads(work):
    """Call a function in several threads at once; return what they raised."""
    errors = []

    def guarded():
        try:
            work()
        except Exception as error:
            errors.append(error)

    threads = [threading.Thread(target=guarded) for _ in range(THREADS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return errors


def make_error(code):
    """An error as the driver reports it; None for one that pyopencl finds itself."""
    if code is None:
        return cl.LogicError("the wrong number of arguments")
    return cl.RuntimeError(cl._cl._ErrorRecord(msg="", code=getattr(cl.status_code, code), routine="clEnqueue"))


def write_kernel(folder, name, text):
    (folder / "kernels").mkdir(exist_ok=True)
    (folder / "kernels" / f"{name}.cl").write_text(f"kernel void {name}(global int *x) {{ {text} }}\n")


def test_a_second_session_compiles_nothing(session, tmp_path, monkeypatch):
    write_kernel(tmp_path, "set_one", "x[0] = 1;")
    # All opened here: a test may have let the device's sessions have a new context since `session` was opened.
    with DeviceSession(session.info) as one, DeviceSession(session.info) as other, one.branch() as branch:
        first = build_kernel(one, "set_one", folder=tmp_path)
        monkeypatch.setattr(cl, "Program", None)
        assert build_kernel(other, "set_one", folder=tmp_path) is first
        assert build_kernel(branch, "set_one", folder=tmp_path) is first
        assert other.context is one.context
        assert len({id(queue) for queue in (one.queue, other.queue, branch.queue)}) == 3


def test_another_text_or_another_macro_is_another_kernel(session, tmp_path):
    write_kernel(tmp_path, "set_number", "x[0] = NUMBER;")
    kernels = [build_kernel(session, "set_number", {"NUMBER": number}, folder=tmp_path) for number in (1, 2)]
    write_kernel(tmp_path, "set_number", "x[0] = 2 * NUMBER;")
    kernels.append(build_kernel(session, "set_number", {"NUMBER": 2}, folder=tmp_path))
    found = []
    for kernel in kernels:
        into = np.zeros(1, np.int32)
        buffer = session.upload(into)
        session.run(kernel, (1,), (1,), x=buffer)
        session.download(buffer, into)
        session.release(buffer)
        found.append(int(into[0]))
    assert found == [1, 2, 4]


def test_a_kernel_that_does_not_compile_is_tried_again(session, tmp_path):
    write_kernel(tmp_path, "set_two", "x[0] = two;")
    for _ in range(2):
        with pytest.raises(KernelBuildError, match="two"):
            build_kernel(session, "set_two", folder=tmp_path)


def test_threads_that_need_a_kernel_at_once_compile_it_once(session):
    context, compiled = DeviceContext(session.info.cl_device), []

    def compile_slowly():
        compiled.append(1)
        time.sleep(0.05)
        return {}

    assert run_in_threads(lambda: context.kernels("key", compile_slowly)) == []
    assert len(compiled) == 1


def test_arguments_and_launch_are_one_step():
    """The driver holds the arguments of one launch, whichever thread has set them."""
    held, launched = [None], []

    def launch(queue, size, group, *arguments):
        held[0] = arguments
        time.sleep(0.001)
        launched.append((queue, held[0]))
        return SimpleNamespace(wait=lambda: None, profile=SimpleNamespace(start=0, end=0))

    launch.function_name = "launch"
    kernel = Kernel(launch, ["x"])

    def work():
        for number in range(20):
            mine = (threading.get_ident(), number)
            kernel.enqueue(mine, (1,), (1,), [mine])

    assert run_in_threads(work) == []
    assert len(launched) == 20 * THREADS
    assert all(queue == arguments[0] for queue, arguments in launched)


def test_times_of_several_threads_add_up():
    times = EventTimes()
    event = SimpleNamespace(wait=lambda: None, profile=SimpleNamespace(start=0, end=1_000_000))

    def work():
        for _ in range(3000):
            times.note("kernel", event)

    assert run_in_threads(work) == []
    assert times.sums_ms() == {"kernel": pytest.approx(3000 * THREADS)}


def test_a_command_that_failed_has_no_time():
    def fail():
        raise make_error("OUT_OF_RESOURCES")

    times = EventTimes()
    times.note("kernel", SimpleNamespace(wait=fail))
    times.note("upload", SimpleNamespace(wait=lambda: None, profile=SimpleNamespace(start=0, end=2_000_000)))
    assert times.sums_ms() == {"upload": 2.0}


@pytest.mark.parametrize(
    ("code", "is_lost"),
    [
        ("OUT_OF_RESOURCES", True),
        ("INVALID_COMMAND_QUEUE", True),
        ("MEM_OBJECT_ALLOCATION_FAILURE", False),
        (None, False),
    ],
)
def test_a_context_that_the_driver_has_given_up_is_not_shared_any_more(session, code, is_lost):
    def fail(*arguments):
        raise make_error(code)

    fail.function_name = "fail"
    with DeviceSession(session.info) as before:
        with pytest.raises(DeviceError, match="cannot run the kernel 'fail'"):
            before.run(Kernel(fail, []), (1,), (1,))
        with DeviceSession(session.info) as after:
            assert (after.shared is not before.shared) == is_lost
            # Buffers belong to a context, and so to all branches of a session.
            assert before.branch().shared is before.shared
            array = np.arange(5)
            back = np.zeros_like(array)
            after.download(after.upload(array), back)
            assert back.tolist() == array.tolist()
