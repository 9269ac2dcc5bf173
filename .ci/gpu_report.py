"""Compiles every kernel for GPUs that need not be here, and writes what the compilers say to out/gpu.md.

Clang 15 compiles for AMD's GPUs, and into PTX, from which NVIDIA's `ptxas` makes the code of its GPUs; libclc has
OpenCL's built-in functions. Sources, macros and options are those of the program. The figures are static: registers and
memory that a work-item takes. How fast a kernel is, only a GPU can tell.

``python .ci/gpu_report.py [--jobs N]``; ``--only TEXT`` prints the rows of kernels whose name has the text, and writes
nothing.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

from clbvh.builders.device.build_device import CLUSTER_GROUP
from clbvh.choices import REPORT_SHADINGS, SHADINGS
from clbvh.device.program import CORRECT_ROUNDING, GPU_OPTION, make_options
from clbvh.device.radix_sort import GPU_PLAN
from clbvh.device.sources import expand_source
from clbvh.kinds import TRIANGLES
from clbvh.support.folders import find_folder
from clbvh.trace.world.trees import pad_stack
from clbvh.trace.world.world import make_defines
from clbvh.tree_layouts import LAYOUTS, TREE_LAYOUTS

REPORT = Path(__file__).resolve().parents[1] / "out" / "gpu.md"

CLANG = "clang-15"
LIBCLC = Path("/usr/lib/clc")
INSTALL = "apt-get install clang-15 libclc-15"
NO_PTXAS = "compilers for GPUs: ptxas is missing: pip install nvidia-cuda-nvcc-cu12"

# Work-items of a work-group of kernels that do not name another number.
_GROUP_SIZE = 64

# Kernels of films, and those that pack rays and refine hits, need no tree.
_OF_NO_TREE = ("add_samples", "develop", "pack_rays", "refine_hits", "settle_tiles")

# Files of several kernels, by which trees are built and refitted; the wide layouts differ by their width alone.
_OF_BUILDS = ("build_tree", "radix_sort", "write_blocks", "refit_nodes", "take_mesh")
_LAYOUTS_OF_BUILDS = ("bvh2", "bvh8")

# Empty in scenes.
_OF_LONE_SHAPES = ("closest_in_shard",)


@dataclass(frozen=True)
class Gpu:
    """A processor, as its compiler names it.

    Attributes
    ----------
    name : str
    max_waves : int
        Most waves of a SIMD of AMD's, or warps of a multiprocessor of NVIDIA's.
    local_bytes : int
        Local memory, of a compute unit or a multiprocessor.
    wave_size : int
        Work-items of a wave.
    simds : int
        SIMDs that share the local memory.
    """

    name: str
    max_waves: int
    local_bytes: int
    wave_size: int = 32
    simds: int = 1


_KIB = 1 << 10

AMD = (
    Gpu("gfx1030", 16, 64 * _KIB, simds=2),
    Gpu("gfx90a", 8, 64 * _KIB, 64, 4),
    Gpu("gfx1100", 16, 64 * _KIB, simds=2),
)
NVIDIA = (
    Gpu("sm_75", 32, 64 * _KIB),
    Gpu("sm_80", 64, 164 * _KIB),
    # sm_89 had the same figures in every kernel (ptxas 12.9).
    Gpu("sm_86", 48, 100 * _KIB),
    Gpu("sm_90", 64, 228 * _KIB),
)

# Registers of a multiprocessor, from sm_70 on; a warp gets them in units, and warps come in fours. A work-group takes
# this much local memory besides its own.
_NVIDIA_REGISTERS = 65_536
_REGISTERS_OF_UNIT = 256
_WARPS_TOGETHER = 4
_NVIDIA_RESERVED = _KIB


@dataclass(frozen=True)
class Program:
    """A kernel file and the macros that it is compiled with."""

    kernel: str
    label: str
    layout: str
    of_scene: bool
    defines: Mapping[str, int] = field(default_factory=dict)

    @property
    def group_size(self) -> int:
        """Work-items of a work-group."""
        return self.defines.get("GROUP_SIZE", _GROUP_SIZE)

    @property
    def title(self) -> str:
        """The heading of its table."""
        if self.kernel in _OF_BUILDS:
            return "Builds"
        return f"`{self.layout}`, {'scenes' if self.of_scene else 'meshes'}" if self.layout else "No tree"


@dataclass(frozen=True)
class Figures:
    """What a compiler says of a kernel.

    Attributes
    ----------
    registers : int
        Vector registers, each of 4 bytes per work-item.
    stack_bytes : int
        Private memory of a work-item, spilled registers included.
    spilled : int
        Registers that are spilled; for NVIDIA, bytes that are stored for it.
    local_bytes : int
        Local memory of a work-group.
    waves, max_waves : int
        Waves or warps that fit at once, and the most that the processor holds.
    """

    registers: int
    stack_bytes: int
    spilled: int
    local_bytes: int
    waves: int
    max_waves: int

    def __str__(self) -> str:
        spilled = f", **{self.spilled} spilled**" if self.spilled else ""
        local = f", {self.local_bytes} B local" if self.local_bytes else ""
        return f"{self.registers}, {self.stack_bytes} B{spilled}{local}, {self.waves}/{self.max_waves}"


class ToolError(Exception):
    """A compiler is missing or refuses."""


def list_programs(layouts: Sequence[str] = TREE_LAYOUTS) -> Iterator[Program]:
    """Yield every shipped kernel in every layout, over a mesh and in a scene, with the common size of the stack."""
    for path in sorted((find_folder("cl") / "kernels").glob("*.cl")):
        kernel = path.stem
        if kernel in _OF_NO_TREE:
            yield Program(kernel, kernel, "", False)
            continue
        if kernel in _OF_BUILDS:
            continue
        for layout in layouts:
            if kernel.endswith("entry_points") and not LAYOUTS[layout].is_wide:
                continue
            stack_size = pad_stack(layout, 0)
            for is_lone in (True,) if kernel in _OF_LONE_SHAPES else (True, False):
                defines = make_defines(layout, stack_size, is_lone=is_lone, kinds={TRIANGLES})
                yield from _list_variants(kernel, layout, not is_lone, defines)


def list_build_programs() -> Iterator[Program]:
    """Yield the kernels that build and refit trees, as GPUs have them."""
    for layout in _LAYOUTS_OF_BUILDS:
        tile = {"GROUPED": 1, "GROUP_SIZE": CLUSTER_GROUP[0]}
        blocks = {"BLOCK_WIDTH": LAYOUTS[layout].block_width, "HAS_FP64": 1}
        for kernel, defines in (("build_tree", tile), ("write_blocks", blocks), ("refit_nodes", {})):
            yield Program(kernel, f", `{layout}`", layout, False, {"TREE_WIDTH": LAYOUTS[layout].width, **defines})
    sort = {"DIGIT_BITS": GPU_PLAN.digit_bits, "GROUP_SIZE": GPU_PLAN.group_size}
    yield Program("radix_sort", "", "", False, sort)
    yield Program("take_mesh", "", "", False)


def _list_variants(kernel: str, layout: str, of_scene: bool, defines: Mapping[str, int]) -> Iterator[Program]:
    if kernel != "render_samples":
        yield Program(kernel, kernel, layout, of_scene, defines)
        return
    for shading in (name for name in SHADINGS if name not in REPORT_SHADINGS):
        yield Program(kernel, f"{kernel}, {shading}", layout, of_scene, {**defines, "SHADING": SHADINGS[shading]})


def find_ptxas() -> Path | None:
    """Return NVIDIA's assembler: that of the wheel `nvidia-cuda-nvcc-cu12`, or one on the path."""
    spec = find_spec("nvidia")
    folders = list(spec.submodule_search_locations or ()) if spec else []
    for folder in folders:
        path = Path(folder) / "cuda_nvcc" / "bin" / "ptxas"
        if path.is_file():
            return path
    found = shutil.which("ptxas")
    return Path(found) if found else None


def find_missing() -> str:
    """Return what clang and libclc need, or nothing if they are here."""
    if shutil.which(CLANG) is None or not (LIBCLC / "amdgcn--amdhsa.bc").is_file():
        return f"compilers for GPUs: clang 15 or libclc 15 is missing: {INSTALL}"
    return ""


def compile_for_amd(program: Program, gpu: Gpu) -> dict[str, Figures]:
    """Return the figures of each kernel of a program, from the assembly."""
    text = _compile(program, "amdgcn--amdhsa", "amdgcn--amdhsa.bc", (f"-mcpu={gpu.name}", "-nogpulib"))
    # Functions that a kernel calls have no occupancy; the kernel's own figures include theirs.
    waves = [int(count) for count in re.findall(r"^; Occupancy: (\d+)", text, re.MULTILINE)]
    kernels = text.partition("amdhsa.kernels:")[2].partition("\namdhsa")[0].split("\n  - ")[1:]
    figures = {}
    for kernel, by_registers in zip(kernels, waves, strict=True):
        fact = dict(re.findall(r"^    \.(\w+): +(\w+)$", kernel, re.MULTILINE))
        registers, stack, spilled, local = (
            int(fact[name])
            for name in ("vgpr_count", "private_segment_fixed_size", "vgpr_spill_count", "group_segment_fixed_size")
        )
        most = min(by_registers, _count_waves(program, gpu, local))
        figures[fact["name"]] = Figures(registers, stack, spilled, local, most, gpu.max_waves)
    return figures


def _count_waves(program: Program, gpu: Gpu, local_bytes: int) -> int:
    """Return the waves that local memory leaves room for."""
    if local_bytes == 0:
        return gpu.max_waves
    groups = gpu.local_bytes // local_bytes
    return max(1, groups * -(-program.group_size // gpu.wave_size) // gpu.simds)


def compile_to_ptx(program: Program) -> str:
    """Return NVIDIA's portable assembly."""
    return _compile(program, "nvptx64-nvidia-nvcl", "nvptx64--nvidiacl.bc", ("-Wno-linker-warnings",))


def count_loads(ptx: str) -> tuple[int, int]:
    """Return the loads from global memory in the code, and the 4-byte words that they load."""
    widths = re.findall(r"\bld\.global(?:\.nc)?(?:\.v(\d))?\.", ptx)
    return len(widths), sum(int(width or 1) for width in widths)


def assemble_for_nvidia(program: Program, ptx: str, gpu: Gpu, ptxas: Path) -> dict[str, Figures]:
    """Return the figures of each kernel of a program, from what ptxas says."""
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "kernel.ptx"
        source.write_text(ptx, encoding="utf-8")
        text = _run([str(ptxas), "-v", f"-arch={gpu.name}", "-o", os.devnull, str(source)]).stderr
    figures = {}
    for kernel, (registers, stack, stores, local) in read_ptxas(text).items():
        units = -(-registers * gpu.wave_size // _REGISTERS_OF_UNIT)
        by_registers = _NVIDIA_REGISTERS // (units * _REGISTERS_OF_UNIT) // _WARPS_TOGETHER * _WARPS_TOGETHER
        by_memory = _count_waves(program, gpu, local and local + _NVIDIA_RESERVED)
        waves = min(by_registers, by_memory, gpu.max_waves)
        figures[kernel] = Figures(registers, stack, stores, local, waves, gpu.max_waves)
    return figures


def read_ptxas(text: str) -> dict[str, tuple[int, ...]]:
    """Return registers, and bytes of stack, spill stores and local memory of each kernel that ptxas tells of."""
    patterns = r"Used (\d+) registers", r"(\d+) bytes stack", r"(\d+) bytes spill st", r"(\d+) bytes smem"
    kernels = (kernel.partition("'") for kernel in text.split("Compiling entry function '")[1:])
    return {
        name: tuple(int(match[1]) if (match := re.search(pattern, said)) else 0 for pattern in patterns)
        for name, _, said in kernels
    }


def _compile(program: Program, target: str, library: str, more: Sequence[str]) -> str:
    """Return the assembly of a program for a target of clang."""
    source = expand_source(f"kernels/{program.kernel}.cl")
    options = (*make_options(program.defines), GPU_OPTION, CORRECT_ROUNDING)
    linked = ("-Xclang", "-mlink-builtin-bitcode", "-Xclang", str(LIBCLC / library))
    command = [CLANG, "-x", "cl", "-target", target, *more, "-O3", "-S", *options, *linked, "-o", "-", "-"]
    return _run(command, source).stdout


def _run(command: Sequence[str], text: str | None = None) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ToolError(f"{' '.join(command)}\n{done.stderr}")
    return done


def make_rows(program: Program, ptxas: Path) -> list[list[str]]:
    """Return the cells of a table for the kernels of a program: the label, a cell for each GPU, the loads."""
    ptx = compile_to_ptx(program)
    of_gpus = [compile_for_amd(program, gpu) for gpu in AMD]
    of_gpus += [assemble_for_nvidia(program, ptx, gpu, ptxas) for gpu in NVIDIA]
    rows = []
    for kernel in of_gpus[0]:
        loads, words = count_loads(ptx.partition(f".entry {kernel}(")[2].partition(".entry")[0])
        label = kernel + program.label if program.kernel in _OF_BUILDS else program.label
        rows.append([label, *(str(figures[kernel]) for figures in of_gpus), f"{loads} of {words}"])
    return rows


_LEGEND = (
    "A cell: vector registers of a work-item; bytes of private memory; spilled registers (bytes for NVIDIA);\n"
    "local memory of a work-group; waves or warps that fit at once, of those that the processor holds.\n"
    "loads: instructions that load from global memory in the code for NVIDIA, and the words of 4 bytes that they load."
)
_HEAD = ["kernel", *(gpu.name for gpu in (*AMD, *NVIDIA)), "loads"]


def write_tables(programs: Sequence[Program], rows: Sequence[Sequence[Sequence[str]]], ptxas: Path) -> str:
    """Return the tables, one for each layout and kind of tree, under the versions of the compilers."""
    release = re.search(r"release ([\d.]+, V[\d.]+)", _run([str(ptxas), "--version"]).stdout)
    version = _run([CLANG, "--version"]).stdout.splitlines()[0]
    lines = ["# Kernels on GPUs", "", _LEGEND]
    lines += ["", f"Compilers: {version}; libclc 15; ptxas {release[1] if release else ''}."]
    tables: dict[str, list[Sequence[str]]] = {}
    for program, found in zip(programs, rows, strict=True):
        tables.setdefault(program.title, []).extend(found)
    for title, table in sorted(tables.items()):
        lines += ["", f"## {title}", "", f"| {' | '.join(_HEAD)} |", "|---" * len(_HEAD) + "|"]
        lines += [f"| {' | '.join(cells)} |" for cells in table]
    return "\n".join(lines)


def main() -> int:  # noqa: D103
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--only", default="")
    arguments = parser.parse_args()
    ptxas = find_ptxas()
    missing = find_missing() or ("" if ptxas else NO_PTXAS)
    if missing or ptxas is None:
        print(missing, file=sys.stderr)
        return 1
    everything = (*list_programs(), *list_build_programs())
    programs = [program for program in everything if arguments.only in program.kernel + program.label]
    with ThreadPoolExecutor(arguments.jobs) as threads:
        rows = list(threads.map(lambda program: make_rows(program, ptxas), programs))
    if arguments.only:
        print(write_tables(programs, rows, ptxas))
        return 0
    REPORT.parent.mkdir(exist_ok=True)
    REPORT.write_text(write_tables(programs, rows, ptxas) + "\n", encoding="utf-8")
    print(f"{len(programs)} kernels: {REPORT}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
