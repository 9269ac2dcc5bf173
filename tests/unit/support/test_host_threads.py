"""Compiled loops in several threads."""

import signal
import threading
import time

import pytest

from clbvh.support.host_threads import HostThreads, side_by_side

NAPS = [(0.05,), (0.05,), (0.05,)]


@pytest.fixture(params=[1, 2, 5])
def threads(request):
    with HostThreads(request.param) as opened:
        yield opened


@pytest.fixture
def ctrl_c():
    """Let SIGINT raise, which it does not in a process that a shell has put in the background."""
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, handler)


def test_as_many_tasks_as_threads_run_at_the_same_time():
    meeting = threading.Barrier(3)
    with HostThreads(3) as threads:
        assert sorted(threads.run(lambda: meeting.wait(timeout=30), [(), (), ()])) == [0, 1, 2]
    both = threading.Barrier(2, timeout=20)
    assert side_by_side(lambda: (both.wait(), 1)[1], lambda: (both.wait(), 2)[1]) == [1, 2]


def test_an_error_arrives_after_all_have_ended(threads):
    for bad in (0, 1, 3):
        ended = []

        def divide(number, bad=bad, ended=ended):
            result = 1 / (number - bad)
            ended.append(number)
            return result

        with pytest.raises(ZeroDivisionError):
            threads.run(divide, [(number,) for number in range(4)])
        before = len(ended)
        assert threads.run(divide, [(bad + 1,)]) == [1]
        assert len(ended) == before + 1


def list_own():
    """The threads of all pools that have not ended."""
    return [thread for thread in threading.enumerate() if thread.name.startswith("clbvh")]


def test_threads_are_shared_by_all_users_and_end_when_they_are_closed_or_garbage():
    others = list_own()
    threads = HostThreads(3)
    users = [threading.Thread(target=threads.run, args=(time.sleep, NAPS)) for _ in range(4)]
    for user in users:
        user.start()
    for user in users:
        user.join()
    assert len(list_own()) - len(others) == 2
    threads.close()
    assert list_own() == others
    threads.run(time.sleep, NAPS)
    dropped = [thread for thread in list_own() if thread not in others]
    assert len(dropped) == 2
    del threads
    for thread in dropped:
        thread.join(30)
        assert not thread.is_alive()


@pytest.mark.parametrize("is_waiting", [True, False])
def test_after_ctrl_c_no_task_is_running(ctrl_c, is_waiting):
    main_thread, is_running, ended = threading.main_thread(), threading.Event(), []

    def work(number):
        if threading.current_thread() is main_thread:
            assert is_running.wait(30)
            if not is_waiting:
                signal.raise_signal(signal.SIGINT)
            return
        is_running.set()
        time.sleep(0.1)
        if is_waiting:
            signal.pthread_kill(main_thread.ident, signal.SIGINT)
        time.sleep(0.2)
        ended.append(number)

    with HostThreads(2) as threads:
        with pytest.raises(KeyboardInterrupt):
            threads.run(work, [(0,), (1,), (2,), (3,)])
        assert len(ended) == 1
        assert threads.run(abs, [(-1,), (-2,)]) == [1, 2]


def test_where_no_thread_can_start_the_work_is_done_all_the_same(monkeypatch):
    def refuse(thread):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    with HostThreads(4) as threads:
        for _ in range(3):
            assert threads.run(lambda number: number + 1, [(number,) for number in range(10)]) == list(range(1, 11))
        assert threads._jobs.empty()
