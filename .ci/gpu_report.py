"""Compiles every kernel for GPUs that need not be here, and writes what the compilers say into docs/internals/gpu.md.

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

from clbvh.choices import REPORT_SHADINGS, SHADINGS
from clbvh.device.program import CORRECT_ROUNDING, GPU_OPTION, expand_source, make_options
from clbvh.structs import ENTRY_POINT_LAYOUTS, LAYOUT_WIDTHS
from clbvh.support.folders import find_folder
from clbvh.trace.world.trees import pad_stack
from clbvh.trace.world.world import make_defines

PAGE = Path(__file__).resolve().parents[1] / "docs" / "internals" / "gpu.md"
# The tables stand between these lines of the page.
BEGIN, END = "<!-- figures: begin -->", "<!-- figures: end -->"

CLANG = "clang-15"
LIBCLC = Path("/usr/lib/clc")
INSTALL = "apt-get install clang-15 libclc-15"
NO_PTXAS = "compilers for GPUs: ptxas is missing: pip install nvidia-cuda-nvcc-cu12"

# Kernels of films need no tree.
_OF_NO_TREE = ("develop", "join_cells")


@dataclass(frozen=True)
class AmdGpu:
    """A processor of AMD, as clang names it; `max_waves` is the most waves of a SIMD."""

    name: str
    max_waves: int


@dataclass(frozen=True)
class NvidiaGpu:
    """A processor of NVIDIA, as ptxas names it; `max_waves` is the most warps of a multiprocessor."""

    name: str
    max_waves: int


AMD = (AmdGpu("gfx1030", 16), AmdGpu("gfx90a", 8), AmdGpu("gfx1100", 16))
NVIDIA = (NvidiaGpu("sm_75", 32), NvidiaGpu("sm_80", 64), NvidiaGpu("sm_86", 48), NvidiaGpu("sm_90", 64))

# Registers of a multiprocessor, from sm_70 on; a warp gets them in units, and warps come in fours.
_NVIDIA_REGISTERS = 65_536
_REGISTERS_OF_UNIT = 256
_WARP = 32
_WARPS_TOGETHER = 4


@dataclass(frozen=True)
class Program:
    """A kernel file and the macros that it is compiled with."""

    kernel: str
    label: str
    layout: str
    of_scene: bool
    defines: Mapping[str, int] = field(default_factory=dict)


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
        Local memory that the compiler itself takes, per work-group.
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


def list_programs(layouts: Sequence[str] = tuple(LAYOUT_WIDTHS)) -> Iterator[Program]:
    """Yield every shipped kernel in every layout, over a mesh and in a scene, with the common size of the stack."""
    for path in sorted((find_folder("cl") / "kernels").glob("*.cl")):
        kernel = path.stem
        if kernel in _OF_NO_TREE:
            yield Program(kernel, kernel, "", False)
            continue
        for layout in layouts:
            if kernel.endswith("entry_points") and layout not in ENTRY_POINT_LAYOUTS:
                continue
            stack_size = pad_stack(layout, 0, 0)
            for is_lone in (True, False):
                defines = make_defines(layout, stack_size, is_lone=is_lone, has_spheres=False)
                yield from _list_variants(kernel, layout, not is_lone, defines)


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


def compile_for_amd(program: Program, gpu: AmdGpu) -> Figures:
    """Return the figures at the end of the assembly."""
    text = _compile(program, "amdgcn--amdhsa", "amdgcn--amdhsa.bc", (f"-mcpu={gpu.name}", "-nogpulib"))
    # Those of functions that the kernel calls have no occupancy; the kernel's own include them.
    fact = {name: int(value) for name, value in re.findall(r"^; (\w+): (\d+)", text, re.MULTILINE)}
    meta = {name: int(value) for name, value in re.findall(r"^ +\.(\w+): +(\d+)$", text, re.MULTILINE)}
    return Figures(
        meta["vgpr_count"], meta["private_segment_fixed_size"], meta["vgpr_spill_count"], fact["LDSByteSize"],
        fact["Occupancy"], gpu.max_waves,
    )  # fmt: skip


def compile_to_ptx(program: Program) -> str:
    """Return NVIDIA's portable assembly."""
    return _compile(program, "nvptx64-nvidia-nvcl", "nvptx64--nvidiacl.bc", ("-Wno-linker-warnings",))


def count_loads(ptx: str) -> tuple[int, int]:
    """Return the loads from global memory in the code, and the 4-byte words that they load."""
    widths = re.findall(r"\bld\.global(?:\.nc)?(?:\.v(\d))?\.", ptx)
    return len(widths), sum(int(width or 1) for width in widths)


def assemble_for_nvidia(ptx: str, gpu: NvidiaGpu, ptxas: Path) -> Figures:
    """Return what ptxas says; occupancy is by registers."""
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "kernel.ptx"
        source.write_text(ptx, encoding="utf-8")
        text = _run([str(ptxas), "-v", f"-arch={gpu.name}", "-o", os.devnull, str(source)]).stderr
    registers = int(re.findall(r"Used (\d+) registers", text)[0])
    stack, stores, _ = re.findall(r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill loads", text)[
        0
    ]
    units = -(-registers * _WARP // _REGISTERS_OF_UNIT)
    warps = _NVIDIA_REGISTERS // (units * _REGISTERS_OF_UNIT) // _WARPS_TOGETHER * _WARPS_TOGETHER
    return Figures(registers, int(stack), int(stores), 0, min(warps, gpu.max_waves), gpu.max_waves)


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


def make_row(program: Program, ptxas: Path) -> str:
    """Return a program's row of a table."""
    ptx = compile_to_ptx(program)
    loads, words = count_loads(ptx)
    cells = [str(compile_for_amd(program, gpu)) for gpu in AMD]
    cells += [str(assemble_for_nvidia(ptx, gpu, ptxas)) for gpu in NVIDIA]
    return " | ".join(("| " + program.label, *cells, f"{loads} of {words} |"))


def write_tables(programs: Sequence[Program], rows: Sequence[str], ptxas: Path) -> str:
    """Return the tables, one for each layout and kind of tree, under the versions of the compilers."""
    release = re.search(r"release ([\d.]+, V[\d.]+)", _run([str(ptxas), "--version"]).stdout)
    version = _run([CLANG, "--version"]).stdout.splitlines()[0]
    lines = [f"Compilers: {version}; libclc 15; ptxas {release[1] if release else ''}."]
    titles = dict.fromkeys((program.layout, program.of_scene) for program in programs)
    for layout, of_scene in sorted(titles):
        title = f"`{layout}`, {'scenes' if of_scene else 'meshes'}" if layout else "No tree"
        names = " | ".join(gpu.name for gpu in (*AMD, *NVIDIA))
        lines += ["", f"### {title}", "", f"| kernel | {names} | loads |", "|---|" + "---|" * (len(AMD + NVIDIA) + 1)]
        lines += [row for program, row in zip(programs, rows, strict=True)
                  if (program.layout, program.of_scene) == (layout, of_scene)]  # fmt: skip
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
    programs = [program for program in list_programs() if arguments.only in program.label]
    with ThreadPoolExecutor(arguments.jobs) as threads:
        rows = list(threads.map(lambda program: make_row(program, ptxas), programs))
    tables = write_tables(programs, rows, ptxas)
    if arguments.only:
        print(tables)
        return 0
    page = PAGE.read_text(encoding="utf-8")
    before, after = page.split(BEGIN)[0], page.split(END)[1]
    PAGE.write_text(f"{before}{BEGIN}\n{tables}\n{END}{after}", encoding="utf-8")
    print(f"{len(programs)} kernels: {PAGE}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
