"""The time for getting a kernel tells whether the driver compiled it, and a compilation is announced."""

import time
from types import SimpleNamespace

import pytest

from clbvh.device import compile_timer
from clbvh.device.compile_timer import CompileTimer
from clbvh.support import code_times


@pytest.fixture
def get(monkeypatch):
    """A function from the times of driver and kernel to the numbers of compiled, loaded and announced things."""
    told = []
    code_times.on_first_compilation(lambda: told.append(True))
    clock = cpu = iter(())
    times = SimpleNamespace(perf_counter=lambda: next(clock), process_time=lambda: next(cpu))
    monkeypatch.setattr(compile_timer, "time", times)

    def run(took_s, run_ms=0.0, *, cpu_s=None, announces=False):
        nonlocal clock, cpu
        clock = iter((100.0, 100.0 + took_s))
        cpu = iter((7.0, 7.0 + (took_s if cpu_s is None else cpu_s)))
        before = code_times.read_code_times()
        with CompileTimer(announces=announces) as getting:
            getting.run_ms = run_ms
        since = code_times.read_code_times().since(before)
        return since.compiled_count, since.loaded_count, len(told)

    yield run
    code_times.on_first_compilation(None)


@pytest.mark.parametrize("announces", [False, True])
def test_a_slow_driver_compiles_and_that_is_said(get, announces):
    assert get(0.5, announces=announces) == (1, 0, 1)


def test_a_quick_driver_loads(get):
    assert get(0.1) == (0, 1, 0)


def test_a_quick_driver_on_a_busy_machine_loads(get):
    assert get(2.0, cpu_s=0.1) == (0, 1, 0)


def test_work_of_other_threads_is_no_compilation(get):
    assert get(0.2, cpu_s=0.4) == (0, 1, 0)


def test_the_time_of_the_kernel_itself_is_no_compilation(get):
    assert get(5.0, run_ms=4900.0) == (0, 1, 0)
    assert get(5.0, run_ms=4000.0) == (1, 0, 1)


def test_a_slow_build_is_said_while_it_lasts(monkeypatch):
    told = []
    code_times.on_first_compilation(lambda: told.append(True))
    monkeypatch.setattr(compile_timer, "_LONGEST_LOAD_S", 0.0)
    with CompileTimer(announces=True):
        end_s = time.perf_counter() + 60
        while not told and time.perf_counter() < end_s:
            time.sleep(0.001)
        assert told == [True]
