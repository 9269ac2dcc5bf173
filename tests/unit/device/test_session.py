"""An opened device: what goes up comes down, what cannot be done is said in one sentence, times add up."""

import time
import weakref
from types import SimpleNamespace

import numpy as np
import pytest

from clbvh.device.context import EventTimes
from clbvh.device.program import build_kernel, find_arguments
from clbvh.device.session import DeviceSession
from clbvh.errors import DeviceError, InternalError
from clbvh.structs import HIT


@pytest.fixture
def fresh(session):
    """A session of its own on the same device."""
    with DeviceSession(session.info) as opened:
        yield opened


@pytest.fixture
def double(fresh, tmp_path):
    """A kernel that doubles integers, and says how many work-items ran."""
    (tmp_path / "kernels").mkdir()
    (tmp_path / "kernels" / "double_it.cl").write_text(
        "kernel void double_it(global int *x, global int *ran, const int count) {\n"
        "    const int i = get_global_id(0); atomic_inc(ran); if (i < count) x[i] *= 2; }\n"
    )
    return build_kernel(fresh, "double_it", folder=tmp_path)


def bind(kernel, *arguments):
    """Arguments by their names."""
    return dict(zip(kernel.argument_names, arguments, strict=True))


@pytest.mark.parametrize(
    "array",
    [
        np.arange(1000, dtype=np.int32),
        np.arange(7, dtype=np.uint8),
        np.linspace(0, 1, 24, dtype=np.float32).reshape(2, 3, 4),
        np.arange(64, dtype=np.float32)[::2],
        np.ones(5, HIT),
        np.empty(0, np.float32),
        np.empty((0, 3), HIT),
    ],
    ids=["ints", "bytes", "3d", "strided", "structs", "empty", "empty-structs"],
)
def test_what_goes_up_comes_down(fresh, array):
    buffer = fresh.upload(array)
    back = np.zeros(array.shape, array.dtype)
    fresh.download(buffer, back)
    np.testing.assert_array_equal(back, array)
    assert buffer.size >= array.nbytes


def test_nothing_is_sent_for_an_empty_array(fresh):
    # Drivers disagree on copies of no bytes; some refuse them.
    empty = np.empty((0, 3), np.float32)
    fresh.download(fresh.upload(empty), empty)
    assert fresh.times.sums_ms() == {}


def test_write_and_download_touch_the_beginning(fresh):
    buffer = fresh.upload(np.arange(10, dtype=np.int32))
    fresh.write(buffer, np.array([-1, -2], np.int32))
    first = np.zeros(4, np.int32)
    fresh.download(buffer, first)
    assert first.tolist() == [-1, -2, 2, 3]


@pytest.mark.parametrize(
    ("size", "group", "ran"), [(1, 1, 1), (1, 64, 64), (64, 64, 64), (65, 64, 128), (1000, 8, 1000)]
)
def test_work_sizes_are_rounded_up_to_groups(fresh, double, size, group, ran):
    numbers, counter = fresh.upload(np.arange(size, dtype=np.int32)), fresh.upload(np.zeros(1, np.int32))
    fresh.run(double, (size,), (group,), **bind(double, numbers, counter, np.int32(size)))
    doubled, counted = np.zeros(size, np.int32), np.zeros(1, np.int32)
    fresh.download(numbers, doubled)
    fresh.download(counter, counted)
    assert doubled.tolist() == (2 * np.arange(size)).tolist()
    assert counted.tolist() == [ran]


@pytest.mark.parametrize("size", [2**50, 2**62])
def test_more_than_the_device_has_is_refused_in_one_sentence(fresh, size):
    with pytest.raises(DeviceError) as caught:
        fresh.allocate(size)
    message = str(caught.value)
    assert message.startswith(f"the device '{fresh.info.name}' cannot hold a buffer of {size / 1e6:,.1f} MB (")
    assert message.endswith("try a smaller job or another --device, and see `clbvh doctor`")
    assert "\n" not in message
    # And the session goes on.
    assert fresh.upload(np.ones(3, np.float32)).size >= 12


def test_a_transfer_that_does_not_fit_its_buffer_is_refused(fresh):
    buffer = fresh.allocate(400)
    with pytest.raises(DeviceError, match=r"cannot take 4\.0 MB"):
        fresh.write(buffer, np.zeros(1_000_000, np.int32))
    with pytest.raises(DeviceError, match=r"cannot give back 4\.0 MB"):
        fresh.download(buffer, np.zeros(1_000_000, np.int32))


def test_a_launch_that_fails_names_the_kernel(fresh, double):
    with pytest.raises(DeviceError, match="cannot run the kernel 'double_it'"):
        fresh.run(double, (64,), (2**30,), **bind(double, fresh.allocate(4), fresh.allocate(4), np.int32(1)))


def test_errors_of_other_kinds_pass(fresh, double):
    with pytest.raises(ValueError, match="zip"):
        fresh.run(double, (64, 64), (8,))


def test_arguments_are_bound_by_name(fresh, double):
    assert double.argument_names == ("x", "ran", "count")
    assert double.bind(count=3, x=1, ran=2) == [1, 2, 3]
    for wrong in ({"x": 1, "ran": 2}, {"x": 1, "ran": 2, "count": 3, "row_length": 4}):
        with pytest.raises(InternalError, match="the kernel 'double_it' takes x, ran, count: missing or unknown are"):
            double.bind(**wrong)


def test_numbers_are_passed_by_the_type_of_the_source():
    text = (
        "kernel void one(const global node_t *restrict nodes, const int count, float scale,\n"
        "    global int *x, const uint seed)\n{\n}\n"
        "kernel void two(global float *x)\n{\n}\n"
    )
    assert find_arguments(text) == {
        "one": {"nodes": None, "count": np.int32, "scale": np.float32, "x": None, "seed": np.uint32},
        "two": {"x": None},
    }


def test_a_buffer_that_the_host_keeps_seeing(fresh):
    expected = np.arange(1000, dtype=np.int32)
    numbers = fresh.upload(expected)
    seen = fresh.hold_mapped(numbers, expected.nbytes)
    assert seen.view(np.int32).tolist() == expected.tolist()
    fresh.end_mapping(seen)
    fresh.end_mapping(seen)
    fresh.write(numbers, expected + 1)
    seen = fresh.hold_mapped(numbers, expected.nbytes)
    assert seen.view(np.int32).tolist() == (expected + 1).tolist()


def test_closing_twice_is_allowed_and_releases_everything(session):
    opened = DeviceSession(session.info)
    buffers = [opened.upload(np.zeros(10, np.float32)) for _ in range(3)]
    assert not opened.is_closed
    opened.release(buffers.pop())
    opened.close()
    opened.close()
    assert opened.is_closed
    for buffer in buffers:
        with pytest.raises(Exception, match=r"(?i)released|invalid|not valid"):
            buffer.release()


def test_a_buffer_that_nothing_refers_to_is_gone(fresh):
    held = fresh.allocate(100)
    fresh.allocate(100)
    assert fresh.buffer_count == 1
    assert held in fresh.list_handles()
    fresh.release(held)
    assert fresh.buffer_count == 0
    assert held not in fresh.list_handles()


def test_ctrl_c_before_a_buffer_has_its_place_leaves_none(fresh, monkeypatch):
    def strike(self, buffer, array):
        raise KeyboardInterrupt

    monkeypatch.setattr(DeviceSession, "write", strike)
    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            fresh.upload(np.zeros(100))
    assert fresh.buffer_count == 0


def test_leaving_the_block_closes(session):
    with pytest.raises(ZeroDivisionError), DeviceSession(session.info) as opened:
        raise ZeroDivisionError
    assert opened.is_closed


def test_the_device_can_be_named(session):
    with DeviceSession(session.info.number) as by_number, DeviceSession(session.info.name) as by_name:
        assert by_number.info.name == by_name.info.name == session.info.name


def test_there_is_no_such_device():
    with pytest.raises(DeviceError, match="no such board"):
        DeviceSession("no such board")


def test_an_error_names_the_kernel_that_is_not_finished_yet(fresh, double):
    numbers, counter = fresh.upload(np.zeros(64, np.int32)), fresh.upload(np.zeros(1, np.int32))
    too_much = np.zeros(1000, np.int32)
    fresh.run(double, (64,), (64,), **bind(double, numbers, counter, np.int32(64)))
    with pytest.raises(DeviceError, match=r"cannot finish the kernel 'double_it' and give back 0\.0 MB"):
        fresh.download(counter, too_much)
    fresh.download(counter, too_much[:1])
    with pytest.raises(DeviceError, match=r"cannot give back 0\.0 MB"):
        fresh.download(counter, too_much)


def test_times_are_those_of_the_events(fresh, double):
    assert fresh.times.sums_ms() == {}
    numbers, counter = fresh.upload(np.zeros(1 << 20, np.int32)), fresh.upload(np.zeros(1, np.int32))
    fresh.download(counter, np.zeros(1, np.int32))
    assert set(fresh.times.sums_ms()) == {"upload", "download"}

    begin = time.perf_counter()
    for _ in range(20):
        fresh.run(double, (1 << 20,), (64,), **bind(double, numbers, counter, np.int32(1 << 20)))
    sums = fresh.times.sums_ms()
    wall_ms = 1e3 * (time.perf_counter() - begin)
    assert 0 < sums["kernel"] <= wall_ms
    assert fresh.times.sums_ms() == sums


class FakeEvent:
    """A command that ran from `start` to `end`, in nanoseconds."""

    def __init__(self, start, end):
        self.profile = SimpleNamespace(start=start, end=end)
        self.waits = 0

    def wait(self):
        self.waits += 1


def test_times_add_up_by_label():
    times = EventTimes()
    events = [FakeEvent(1_000_000, 3_500_000), FakeEvent(5_000_000, 5_250_000), FakeEvent(0, 4_000_000)]
    for label, event in zip(["kernel", "upload", "kernel"], events, strict=True):
        times.note(label, event)
    assert [event.waits for event in events] == [0, 0, 0]
    assert times.sums_ms() == {"kernel": 6.5, "upload": 0.25}
    assert [event.waits for event in events] == [1, 1, 1]
    times.note("upload", FakeEvent(0, 750_000))
    assert times.sums_ms() == {"kernel": 6.5, "upload": 1.0}


def test_the_sums_are_a_copy():
    times = EventTimes()
    times.note("kernel", FakeEvent(0, 1_000_000))
    times.sums_ms()["kernel"] = 0
    assert times.sums_ms() == {"kernel": 1.0}


def test_a_long_session_does_not_hoard_events():
    times = EventTimes()
    events = []
    for _ in range(5000):
        event = FakeEvent(0, 1_000_000)
        events.append(weakref.ref(event))
        times.note("kernel", event)
        del event
    assert sum(event() is not None for event in events) < 500
    assert times.sums_ms() == {"kernel": pytest.approx(5000)}
