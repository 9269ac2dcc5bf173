"""A compiled entry point, and the binding of its arguments by name."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from typing import Any

from ..errors import InternalError
from .compile_timer import CompileTimer

# PoCL compiles a kernel for each size of work-groups, and once more for launches of this many work-items along an axis.
_LARGE_LAUNCH = 1 << 16

_NS_PER_MS = 1e6


class Kernel:
    """A compiled entry point that takes its arguments by name, from any thread.

    Parameters
    ----------
    cl_kernel : pyopencl.Kernel
    argument_names : sequence of str
        In the order of the declaration.
    number_types : mapping of str to type, optional
        The numpy types of the arguments that are numbers. PyOpenCL takes 6 us for a number of which it knows no type.
    """

    def __init__(
        self, cl_kernel: Any, argument_names: Sequence[str], number_types: Mapping[str, type[Any]] | None = None
    ) -> None:
        self.name = str(cl_kernel.function_name)
        self.argument_names = tuple(argument_names)
        if number_types is not None:
            cl_kernel.set_scalar_arg_dtypes([number_types.get(name) for name in argument_names])
        self._cl_kernel = cl_kernel
        # The driver takes the arguments one by one, before the launch.
        self._one_launch = threading.Lock()
        self._launched: set[tuple[tuple[int, ...], bool]] = set()

    def bind(self, **arguments: Any) -> list[Any]:
        """Return arguments in the order of the declaration.

        Raises
        ------
        InternalError
            A name is missing, or the kernel has no argument of that name.
        """
        if len(arguments) != len(self.argument_names) or not all(name in arguments for name in self.argument_names):
            differing = sorted(arguments.keys() ^ set(self.argument_names))
            raise InternalError(
                f"the kernel '{self.name}' takes {', '.join(self.argument_names)}: missing or unknown are "
                f"{', '.join(differing)}"
            )
        return [arguments[name] for name in self.argument_names]

    def enqueue(self, queue: Any, work_size: tuple[int, ...], work_group: tuple[int, ...], arguments: Any) -> Any:
        """Start the kernel and return its event.

        Waits for the first launch of each kind, in which a driver may compile, to time the compilation.
        """
        kind = work_group, max(work_size) >= _LARGE_LAUNCH
        if kind in self._launched:
            return self._launch(queue, work_size, work_group, arguments)
        with CompileTimer(announces=False) as timer:
            event = self._launch(queue, work_size, work_group, arguments)
            event.wait()
            timer.run_ms = (event.profile.end - event.profile.start) / _NS_PER_MS
        self._launched.add(kind)
        return event

    def _launch(self, queue: Any, work_size: tuple[int, ...], work_group: tuple[int, ...], arguments: Any) -> Any:
        with self._one_launch:
            return self._cl_kernel(queue, work_size, work_group, *arguments)
