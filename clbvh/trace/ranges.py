"""A query on all devices of its caster: each takes the next range of rays or points when it is free.

Ranges shrink as fewer are left (Polychronopoulos and Kuck, "Guided self-scheduling", 1987), so that a slow device takes
few of them and ends with the others. Which device casts a ray changes no bit of its answer. A device that fails gives
its range back, and the others go on.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from functools import partial
from queue import SimpleQueue
from threading import Lock, Thread
from typing import TypeVar

from ..device.session import DeviceSession
from ..errors import DeviceError, DeviceMemoryError, DeviceWarning, KernelBuildError, shorten_message
from ..support.host_threads import side_by_side
from .launch import Call, Caster
from .rays.batch import RayBatch
from .rays.pieces import Progress, find_rows
from .world.world import World

_Device = TypeVar("_Device")
_Result = TypeVar("_Result")

CastRange = Callable[[Call, range, Progress | None], object]
"""A function that casts a range of a query's rays or points in a call, and writes the results."""

# Rays or points that are worth a range, and ranges that are worth several devices. A range is the rays that are left,
# divided by the number of devices and by _SHARES: of two, one of a quarter of the other's speed may take the first one,
# a fifth. Smaller ranges sort fewer rays together: with shares of 4 and ranges of 2^16, two halves of a 2-core x86-64
# server take 1.15 times the processor time of the whole for 4 million random rays at the dragon, with 2 and 2^17 1.07
# to 1.11.
LEAST_RANGE, _LEAST_RANGES, _SHARES = 1 << 17, 2, 2.5

# What a device of several may fail by.
_DEVICE_ERRORS = (DeviceError, KernelBuildError)


class Ranges:
    """The ranges of one query, for the threads of several devices.

    Parameters
    ----------
    count : int
        Rays or points.
    device_count : int
    least : int
        Of a range.
    step : int
        Ranges begin at multiples of it.

    Attributes
    ----------
    events : queue
        What the calling thread is told: the beginning of a range and how far it is, or None, when a device ends.
    failed : dict of Caster to Exception
    errors : dict of int to Exception
        Those that are no device's, by the beginning of the range: no further ranges are taken.
    is_stopped : bool
        Whether all threads are to end before their next launch.
    """

    def __init__(self, count: int, device_count: int, least: int, step: int) -> None:
        self.count, self._share, self._least, self._step = count, _SHARES * device_count, least, step
        self._begin, self.is_stopped, self._lock = 0, False, Lock()
        self.returned: list[range] = []
        self.events: SimpleQueue[tuple[int, int] | None] = SimpleQueue()
        self.failed: dict[Caster, Exception] = {}
        self.errors: dict[int, Exception] = {}

    def take(self) -> range | None:
        """Return the next range, or None."""
        with self._lock:
            if self.is_stopped or self.errors or not self.are_left:
                return None
            if self.returned:
                return self.returned.pop()
            begin, left = self._begin, self.count - self._begin
            size = -(-max(self._least, int(left / self._share)) // self._step) * self._step
            self._begin += left if left - size < self._least else size
            return range(begin, self._begin)

    @property
    def are_left(self) -> bool:
        """Whether there are ranges to take."""
        return self._begin < self.count or bool(self.returned)

    def raise_errors(self, device_count: int) -> None:
        """Raise the error of the first range that has one, or of the last device, where all have failed."""
        errors = [self.errors[begin] for begin in sorted(self.errors)]
        if len(self.failed) == device_count:
            errors.append([*self.failed.values()][-1])
        if errors:
            error = errors[0]
            # Its traceback holds this object and this frame: a cycle, which would keep arrays alive.
            for held in (errors, self.errors, self.failed):
                held.clear()
            try:
                raise error
            finally:
                del error

    def check_stopped(self) -> None:
        """Raise in a thread that is to end."""
        if self.is_stopped:
            raise InterruptedError


def cast_ranges(
    caster: Caster, count: int, cast: CastRange, progress: Progress | None = None, *, least: int = 0,
    find_step: Callable[[], int] = lambda: 1,
) -> None:  # fmt: skip
    """Cast a query's rays or points on the devices of a caster; few of them on the first device.

    Parameters
    ----------
    caster : Caster
    count : int
    cast : function
        Called with a call on a device, a range of the rays, and the user's progress function or one in its place; from
        several threads. A range may be cast twice: where a device failed, or did not hold it.
    progress : function, optional
        Called in this thread.
    least : int
        Rays or points that are worth a range; by default LEAST_RANGE.
    find_step : function
        Returns the number of which ranges begin at multiples, if there are several.

    Warns
    -----
    DeviceWarning
        A device has failed, and others did its work.
    """
    devices, least = caster.working, least or LEAST_RANGE
    if len(devices) == 1:
        _run_while_it_fits(devices[0], lambda call: cast(call, range(count), progress))
        return
    is_small = count < _LEAST_RANGES * least
    ranges = Ranges(count, len(devices), least, 1 if is_small else find_step())
    is_done = False
    while not is_done:
        working = [each for each in devices if each not in ranges.failed]
        _cast_side_by_side(working[:1] if is_small else working, cast, ranges, progress)
        ranges.raise_errors(len(devices))
        is_done = not ranges.are_left
    leave_out(caster, ranges.failed)


def cast_rays(caster: Caster, batch: RayBatch, cast: CastRange, progress: Progress | None) -> None:
    """Cast a batch of rays, see `cast_ranges`; a picture is cut between rows of tiles."""

    def find_step() -> int:
        return (find_rows(batch) or 1) * max(each.session.settings.tile[1] for each in caster.working)

    cast_ranges(caster, batch.ray_count, cast, progress, find_step=find_step)


def _cast_side_by_side(devices: Sequence[Caster], cast: CastRange, ranges: Ranges, progress: Progress | None) -> None:
    """Let each device take ranges until none is left, several in threads; tell the user here how far they are."""
    works = [partial(_take_ranges, each, cast, ranges) for each in devices]
    threads = [Thread(target=work, name="clbvh", daemon=True) for work in works if len(works) > 1]
    running, shown, done = len(works), 0, dict[int, int]()
    try:
        for thread in threads:
            thread.start()
        if not threads:
            works[0]()
        while running:
            if (event := ranges.events.get()) is None:
                running -= 1
                continue
            done[event[0]] = event[1] - event[0]
            # A range that is cast again counts again.
            if progress is not None and sum(done.values()) > shown:
                shown = sum(done.values())
                progress(shown, ranges.count)
                for each in devices:  # a child that was forked there has no threads
                    each.session.check_process()
    except BaseException:
        ranges.is_stopped = True
        raise
    finally:
        for thread in threads:
            if thread.ident is not None:
                thread.join()


def _take_ranges(device: Caster, cast: CastRange, ranges: Ranges) -> None:
    """Cast ranges on one device until none is left. One call holds the device all the time."""
    part: range | None = None

    def take(call: Call) -> None:
        nonlocal part
        call.check_stopped = ranges.check_stopped
        while (part := part or ranges.take()) is not None:
            begin = part.start
            cast(call, part, lambda end, _, begin=begin: ranges.events.put((begin, end)))  # type: ignore[misc]
            part = None

    try:
        _run_while_it_fits(device, take)
    except _DEVICE_ERRORS as error:
        ranges.failed[device] = error
        ranges.returned += [] if part is None else [part]
    except Exception as error:
        ranges.errors[0 if part is None else part.start] = error
    finally:
        ranges.events.put(None)


def _run_while_it_fits(device: Caster, work: Callable[[Call], object]) -> None:
    """Run the work of a call, which begins again, with pieces of half the size, while they do not fit the device.

    Whether a batch fits is known only when the driver refuses it: other programs use the same memory. The pieces stay
    small for later queries of the caster. The user's progress begins again, too.
    """
    fits = False
    while not fits:
        tried = device.halvings
        try:
            with device.open_call() as call:
                work(call)
            fits = True
        except DeviceMemoryError:
            if not device.cut_smaller(tried):
                raise


def leave_out(caster: Caster, failed: dict[Caster, Exception]) -> None:
    """Let later queries do without devices that have failed, and tell the user once."""
    for device, error in failed.items():
        if device.session not in caster.lost:
            caster.lost.add(device.session)
            warn_of_failure(device.session.info.name, error)
    failed.clear()  # tracebacks hold what holds this


def warn_of_failure(name: str, error: Exception) -> None:
    """Say that a device is left out."""
    text = f"the device '{name}' has failed, and other devices do its work from now on: {shorten_message(error)}"
    warnings.warn(text, DeviceWarning, stacklevel=6)


def try_devices(
    devices: Sequence[_Device], step: Callable[[_Device], _Result]
) -> tuple[list[_Result], list[tuple[_Device, Exception]]]:
    """Return the results of a step for each device, side by side, and the devices that fail with their errors.

    Raises
    ------
    DeviceError, KernelBuildError
        Of the last device, where all fail.
    """
    if len(devices) == 1:
        return [step(devices[0])], []
    found: dict[int, _Result] = {}
    failed: list[tuple[_Device, Exception]] = []

    def attempt(index: int) -> None:
        try:
            found[index] = step(devices[index])
        except _DEVICE_ERRORS as error:
            failed.append((devices[index], error))

    side_by_side(*(partial(attempt, index) for index in range(len(devices))))
    if not found:
        raise failed[-1][1]
    return [found[index] for index in sorted(found)], failed


def move_worlds(
    before: Caster, call: Call, move: Callable[[Caster, DeviceSession], World]
) -> tuple[Caster, list[tuple[Caster, World]], dict[Caster, Exception]]:
    """Change the world of each device, side by side.

    Parameters
    ----------
    before : Caster
    call : Call
        On the first device.
    move : function
        Returns the new world of a device; called with the device and a session for the calling thread.

    Returns
    -------
    after : Caster
        At the new worlds.
    moved : list of (Caster, World)
        The devices with their new worlds.
    failed : dict of Caster to Exception
        For `leave_out`, once queries see the new worlds.
    """

    def step(device: Caster) -> tuple[Caster, World]:
        with nullcontext(call) if device.session is call.caster.session else device.open_call() as own:
            return device, move(device, own.session)

    moved, failed = try_devices(before.working, step)
    lost = [each for each in before.all if each not in [device for device, _ in moved]]
    first, *others = [device.at(world) for device, world in moved]
    return first.beside([*others, *lost]), moved, dict(failed)
