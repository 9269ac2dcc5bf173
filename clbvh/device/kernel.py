"""A compiled entry point, and the binding of its arguments by name."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from typing import Any

from ..errors import InternalError


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
        """Start the kernel and return its event."""
        with self._one_launch:
            return self._cl_kernel(queue, work_size, work_group, *arguments)
