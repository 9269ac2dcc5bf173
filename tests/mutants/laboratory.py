"""Copies of the repository in which mutants are planted and tested, each in a folder that stays for the next run.

Machine code is shared as far as a fault leaves it right. numba's cache looks at the file of a function alone, so
`clbvh/support/compiled.py` begins a new folder whenever any source changes, and all would be compiled again. Here the
new folder begins with the code of every module that does not import the changed one, directly or through others. The
kernels of the host are compiled when a test asks for them, where one of their files has the fault.
"""

import ast
import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

from clbvh.device.host.library import ON_DEMAND_VARIABLE
from clbvh.support.compiled import digest_sources

from .table import ROOT, Mutant

# What the tests need of the repository.
_PARTS = ("clbvh", "cl", "scenes", "tests", "pyproject.toml")

# Seconds for the tests of a mutant, far more than any takes: one that hangs is not caught by an assertion.
_LIMIT_S = 600

# The exit code of pytest if tests ran and some failed. Errors in the collection have another one.
_TESTS_FAILED = 1

# A fault that does not compile shows nothing about the tests.
_NO_CODE = ("KernelBuildError", "TypingError", "LoweringError", "SyntaxError")

PASSED, FAILED = "passed", "failed"


class Laboratory:
    """A copy of the repository in a folder, brought up to date; all copies share the folder of machine code."""

    def __init__(self, folder: Path, machine_code: Path) -> None:
        self.folder = folder
        self._machine_code = machine_code
        for part in _PARTS:
            _update(ROOT / part, folder / part)

    def test(self, tests: tuple[str, ...], mutant: Mutant | None = None) -> tuple[str, str]:
        """Run tests, with a mutant planted meanwhile; return `PASSED`, `FAILED` or why neither, and pytest's output."""
        if mutant is None:
            return self._run(tests)
        original = code = self._code_folder()
        mutant.apply(self.folder)
        try:
            if (code := self._code_folder()) != original:
                _seed(original, code, importers(mutant.file))
            return self._run(tests, of_kernels=mutant.file.startswith("cl/"))
        finally:
            _update(ROOT / mutant.file, self.folder / mutant.file)
            if code != original:
                shutil.rmtree(code, ignore_errors=True)

    def _code_folder(self) -> Path:
        return self._machine_code / digest_sources(self.folder / "clbvh")

    def _run(self, tests: tuple[str, ...], *, of_kernels: bool = False) -> tuple[str, str]:
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
        environment = os.environ | {"PYTHONPATH": str(self.folder), "NUMBA_CACHE_DIR": str(self._machine_code)}
        if of_kernels:
            environment[ON_DEMAND_VARIABLE] = "1"
        try:
            done = subprocess.run(
                command, cwd=self.folder, env=environment, text=True, timeout=_LIMIT_S,
                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return f"not finished after {_LIMIT_S} s", ""
        if done.returncode == 0:
            return PASSED, done.stdout
        if done.returncode != _TESTS_FAILED:
            return f"pytest ended with {done.returncode}", done.stdout
        for word in _NO_CODE:
            if word in done.stdout:
                return f"the code does not compile ({word})", done.stdout
        return FAILED, done.stdout


def _update(source: Path, target: Path) -> None:
    """Make a copy of a file or folder; files that are alike are left alone, others come with their times."""
    if source.is_file():
        target.parent.mkdir(parents=True, exist_ok=True)
        if not target.is_file() or source.read_bytes() != target.read_bytes():
            shutil.copy2(source, target)
        # numba looks at the time.
        shutil.copystat(source, target)
        return
    names = {path.name for path in source.iterdir() if path.name != "__pycache__"}
    for old in target.iterdir() if target.is_dir() else ():
        if old.name not in names | {"__pycache__"}:
            shutil.rmtree(old) if old.is_dir() else old.unlink()
    for name in names:
        _update(source / name, target / name)


def _seed(original: Path, code: Path, changed: frozenset[str]) -> None:
    """Begin a folder of machine code with that of all modules but the changed ones."""
    for source in original.rglob("*"):
        # The files of a function begin with its module and its name.
        if source.is_file() and source.name.split(".")[0] not in changed:
            target = code / source.relative_to(original)
            target.parent.mkdir(parents=True, exist_ok=True)
            os.link(source, target)


@cache
def importers(file: str) -> frozenset[str]:
    """Return the last names of the modules whose machine code depends on one, directly or through others, and its own.

    Modules of the same name count together: too much may be compiled again, never too little.
    """
    found = {".".join(Path(file).with_suffix("").parts).removesuffix(".__init__")}
    while True:
        more = found | {module for module, needed in _needs().items() if needed & found}
        if more == found:
            return frozenset(module.rpartition(".")[2] for module in found)
        found = more


@cache
def _needs() -> dict[str, frozenset[str]]:
    """Return the modules of whose names each module makes constants, classes and compiled functions."""
    trees = {}
    for path in (ROOT / "clbvh").rglob("*.py"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        is_package = parts[-1] == "__init__"
        module = ".".join(parts[:-1] if is_package else parts)
        trees[module] = ast.parse(path.read_text()), module if is_package else module.rpartition(".")[0]
    origins = {module: _find_origins(tree, package) for module, (tree, package) in trees.items()}

    def resolve(module: str, name: str) -> set[str]:
        """Return the modules in which a name of a module is defined, which may be one itself."""
        if f"{module}.{name}" in trees:
            return {f"{module}.{name}"}
        return {module} | (resolve(*origins[module][name]) if name in origins.get(module, {}) else set())

    return {
        module: frozenset().union(*(resolve(*origins[module][name]) for name in _list_used(tree) & {*origins[module]}))
        for module, (tree, _) in trees.items()
    }


def _find_origins(tree: ast.Module, package: str) -> dict[str, tuple[str, str]]:
    """Return the module and the name there of each name that a module imports from others of clbvh."""
    origins = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.level or (node.module or "").startswith("clbvh")):
            above = package.split(".")[: len(package.split(".")) + 1 - node.level] if node.level else []
            module = ".".join([*above, *([node.module] if node.module else [])])
            origins.update({alias.asname or alias.name: (module, alias.name) for alias in node.names})
    return origins


def _list_used(tree: ast.Module) -> set[str]:
    """Return the names used by a module's compiled functions, and outside of functions."""
    used: set[str] = set()
    nodes: list[ast.AST] = [tree]
    while nodes:
        for node in ast.iter_child_nodes(nodes.pop()):
            if isinstance(node, ast.FunctionDef):
                decorators = {
                    name.id for each in node.decorator_list for name in ast.walk(each) if isinstance(name, ast.Name)
                }
                if decorators:
                    used |= {name.id for name in ast.walk(node) if isinstance(name, ast.Name)}
            elif isinstance(node, ast.Name):
                used.add(node.id)
            else:
                nodes.append(node)
    return used
