"""The description of one device: the host, or one of OpenCL."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

# The platform of the host.
HOST_PLATFORM = "host"


@dataclass(frozen=True, repr=False)
class DeviceInfo:
    """One device: the host, or one of OpenCL as its driver describes it.

    Attributes
    ----------
    number : int
        Index in `list_devices`, and the number for ``--device``.
    platform, platform_version : str
        The driver the device belongs to; ``"host"`` for the host.
    name, vendor, version, driver_version : str
        As the driver reports them; `version` is the OpenCL version of the device, or the level of processor that the
        host's kernels are compiled for, as in ``"level v3"``.
    kind : str
        ``"gpu"``, ``"accelerator"``, ``"cpu"`` or ``"other"``.
    memory_bytes, max_allocation_bytes : int
        The device's whole memory, and its largest single buffer.
    compute_units : int
        Cores of a CPU, multiprocessors of a GPU.
    has_fp64 : bool
        True if kernels can use double precision.
    has_unified_memory : bool
        True if the device shares the host's memory: a CPU, or a GPU in the same chip.
    is_available : bool
        False if the driver reports that the device or its compiler cannot be used.
    cl_device : pyopencl.Device
        The handle; None for the host, and in descriptions that were copied, pickled, or came from another process.

    Examples
    --------
    >>> import clbvh
    >>> device = clbvh.choose_device()
    >>> device.kind in ("gpu", "accelerator", "cpu") and device.compute_units > 0
    True
    """

    number: int
    platform: str
    platform_version: str
    name: str
    vendor: str
    version: str
    driver_version: str
    kind: str
    memory_bytes: int
    max_allocation_bytes: int
    compute_units: int
    has_fp64: bool
    has_unified_memory: bool = False
    is_available: bool = True
    cl_device: Any = field(default=None, compare=False)

    @property
    def is_host(self) -> bool:
        """True for the host itself, whose kernels were compiled ahead of time; it needs no driver."""
        return self.platform == HOST_PLATFORM

    @property
    def is_simulator(self) -> bool:
        """True if the device simulates kernels to check them, as Oclgrind does."""
        return self.platform == "Oclgrind"

    @property
    def is_emulated(self) -> bool:
        """True if the device is emulated: a simulator, or Intel's emulator of FPGA boards.

        The emulator calls itself an accelerator, and is slower than the CPU that it runs on.
        """
        return self.is_simulator or "emulation" in self.name.lower()

    @property
    def cuts_loops(self) -> bool:
        """True if kernels with long loops end before their time, without an error.

        Mesa's llvmpipe ends the loops of eight work-items after 65,535 steps in all (Mesa 22.3.6).
        """
        return self.name.startswith("llvmpipe")

    @property
    def layout(self) -> str:
        """The tree layout that suits this kind of device."""
        # A CPU's vector unit works within a work-item, a GPU's across work-items.
        return "bvh8" if self.kind == "cpu" else "bvh2"

    def as_dict(self) -> dict[str, Any]:
        """Return all fields that JSON can hold, and `layout`.

        Examples
        --------
        >>> import json
        >>> import clbvh
        >>> json.loads(json.dumps(clbvh.choose_device(0).as_dict()))["number"]
        0
        """
        # `dataclasses.asdict` would try to copy the handle, which belongs to the driver.
        facts = {name: value for name, value in vars(self).items() if name != "cl_device"}
        return facts | {"layout": self.layout}

    def __repr__(self) -> str:
        units = "cores" if self.kind == "cpu" else "compute units"
        size = f"{self.compute_units} {units}, {self.memory_bytes / 1e9:.1f} GB"
        return f"DeviceInfo({self.number}, {self.name!r}, {self.kind} of {self.platform}, {size})"

    def __getstate__(self) -> dict[str, Any]:
        # The handle belongs to this process; a session finds the device again.
        return vars(self) | {"cl_device": None}

    def __str__(self) -> str:
        return f"{self.number}: {self.name} ({self.platform})"
