"""Memory on a device that is there as long as something holds it."""

from __future__ import annotations

import pyopencl as cl


class Buffer(cl.Buffer):
    """A buffer that sessions can refer to weakly.

    Nothing has to be given back, so nothing is lost when Ctrl-C strikes between two steps.
    """

    __slots__ = ("__weakref__",)
