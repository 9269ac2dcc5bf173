"""Descriptions such as drivers give, for machines that are made up."""

from clbvh import DeviceInfo


def make_device(name, kind, platform, number=-1, **facts):
    """A description such as a driver would give; `number` is set by `number_devices`."""
    given = {
        "platform_version": "OpenCL 3.0",
        "vendor": "",
        "version": "OpenCL 3.0",
        "driver_version": "1.0",
        "memory_bytes": 8 << 30,
        "max_allocation_bytes": 2 << 30,
        "compute_units": 8,
        "has_fp64": True,
        "has_unified_memory": kind == "cpu",
    }
    return DeviceInfo(number=number, platform=platform, name=name, kind=kind, **(given | facts))


POCL = "Portable Computing Language"

HOST = make_device("AMD EPYC", "cpu", "host", version="level v4", vendor="AuthenticAMD", memory_bytes=64 << 30)
GEFORCE = make_device("NVIDIA GeForce RTX 4090", "gpu", "NVIDIA CUDA", memory_bytes=24 << 30)
RADEON = make_device("gfx1030", "gpu", "AMD Accelerated Parallel Processing", memory_bytes=16 << 30)
RADEON_OF_MESA = make_device("AMD Radeon RX 6800 (radeonsi, navi21, LLVM 17.0.6)", "gpu", "rusticl")
IRIS = make_device("Intel(R) Iris(R) Xe Graphics", "gpu", "Intel(R) OpenCL Graphics", has_unified_memory=True)
UHD = make_device("Intel(R) UHD Graphics 770", "gpu", "Intel(R) OpenCL Graphics", has_unified_memory=True)
APPLE = make_device("Apple M2 Pro", "gpu", "Apple", has_unified_memory=True)
EMULATOR = make_device(
    "Intel(R) FPGA Emulation Device", "accelerator", "Intel(R) FPGA Emulation Platform for OpenCL(TM)"
)
BOARD = make_device("Alveo U250", "accelerator", "Xilinx")
INTEL_CPU = make_device("AMD EPYC", "cpu", "Intel(R) OpenCL")
INTEL_XEON = make_device("Intel(R) Xeon(R) CPU E5-2680 v4 @ 2.40GHz", "cpu", "Intel(R) OpenCL")
LLVMPIPE = make_device("llvmpipe (LLVM 15.0.6, 256 bits)", "cpu", "rusticl")
OCLGRIND = make_device("Oclgrind Simulator", "cpu", "Oclgrind")
POCL_3 = make_device(
    "pthread-AMD EPYC", "cpu", POCL, platform_version="OpenCL 3.0 PoCL 3.0-rc2", driver_version="3.0-rc2"
)
POCL_6 = make_device(
    "cpu-znver4-AMD EPYC",
    "cpu",
    POCL,
    platform_version="OpenCL 3.0 PoCL 6.0",
    driver_version="6.0",
    vendor="AuthenticAMD",
)
POCL_XEON = make_device("cpu-sapphirerapids-Intel(R) Xeon(R) Platinum 8481C", "cpu", POCL, vendor="GenuineIntel")
POCL_M2 = make_device("cpu-apple-m2-Apple M2 Pro", "cpu", POCL)
POCL_ARM = make_device("cpu-neoverse-n1-ARM Neoverse-N1", "cpu", POCL)
