"""The pages keep their word: their Python blocks and commands run, and what they name is there.

The blocks of a page run one after the other, in one namespace and in one folder. It has the mesh files that pages speak
of; what a page needs besides them, its earlier blocks make. A TOML block is a scene file: its first line is a comment
with the name, and later blocks find it there.
"""

from __future__ import annotations

import ast
import doctest
import importlib
import importlib.util
import re
import shlex
import textwrap
import warnings
from pathlib import Path

import pytest
import trimesh

import clbvh
from clbvh.cli.app import VERBS, make_app
from clbvh.files.scene_file import parse_scene_file
from tests.cli.command import run_clbvh

from .snippets import PAGES, REPOSITORY, Snippet, find_inline_commands, find_snippets, list_commands
from .test_docstrings import FLAGS

MESHES = ("part.ply", "bunny.ply", "bun_zipper.ply", "dragon_871k.ply", "scan.ply")

# Commands that other tests run, and their reasons; the names and options of all are checked.
NOT_RUN = {
    "clbvh fetch": "needs a network",
    "clbvh view": "opens a page until Ctrl-C",
    "clbvh doctor": "starts a process for each driver",
    "clbvh warmup": "compiles everything",
    "clbvh study": "measures for minutes",
}

# Pictures of the pages' commands are drawn small: of an option that is given twice, the last counts.
SMALL = {
    verb: ["--width", "48", "--height", "32", *more]
    for verb, more in {"render": ["--samples", "1"], "turntable": ["--frames", "3"], "sheet": [], "images": []}.items()
}

# Words in capitals that stand for something, as in `clbvh stats MESH|SCENE`.
PLACEHOLDERS = {"MESH|SCENE": "part.ply", "MESH": "part.ply", "SOURCE": "part.ply", "FILE": "part.ply", "DIR": "trees"}


def has_code(snippet: Snippet) -> bool:
    return snippet.language == "python" or any(line.startswith("clbvh ") for line in list_commands(snippet))


RUNNING = [page for page in PAGES if any(has_code(snippet) for snippet in find_snippets(page))]


def name(page: Path) -> str:
    return str(page.relative_to(REPOSITORY))


@pytest.fixture
def folder(session, tmp_path, monkeypatch):
    """An empty folder with meshes, in which a page's code runs."""
    for mesh in MESHES:
        trimesh.creation.icosphere(3, 0.1).apply_translation((0, 0.1, 0)).export(tmp_path / mesh)
    (tmp_path / "scenes").symlink_to(REPOSITORY / "scenes")
    (tmp_path / "out").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("page", RUNNING, ids=name)
def test_blocks_run(page, folder):
    names = {"__name__": "__main__"}
    for snippet in find_snippets(page):
        if snippet.language == "python" and snippet.reason:
            ast.parse(snippet.text)
        elif snippet.language == "python":
            run_python(snippet, names)
        elif snippet.language == "toml":
            write_scene(snippet, folder)
        elif not snippet.reason:
            for command in list_commands(snippet):
                run_command(command, snippet)


def write_scene(snippet, folder):
    """Write a scene file, and check its keys; the files that it names may come later."""
    path = folder / find_scene_name(snippet)
    path.write_text(snippet.text)
    parse_scene_file(path)


def find_scene_name(snippet):
    """Return the name that a scene file has in its first line."""
    name = re.match(r"# ([\w-]+\.toml)\b", snippet.text)
    assert name, f"{snippet}: a scene begins with its name in a comment, such as `# part.toml`"
    return name[1]


def run_python(snippet, names):
    """Run a Python block; one with prompts has its output checked."""
    if ">>> " not in snippet.text:
        # Lines of the page in tracebacks.
        exec(compile("\n" * (snippet.line - 1) + snippet.text, str(snippet.page), "exec"), names)
        return
    example = doctest.DocTestParser().get_doctest(
        snippet.text, names, str(snippet), str(snippet.page), snippet.line - 1
    )
    report: list[str] = []
    runner = doctest.DocTestRunner(verbose=False, optionflags=FLAGS)
    runner.run(example, out=report.append, clear_globs=False)
    assert runner.failures == 0, "".join(report)
    names.update(example.globs)


def run_command(command, snippet):
    """Run a command line of clbvh."""
    words = replace_placeholders(command) if command.startswith("clbvh ") else []
    if not words or " ".join(words[:2]) in NOT_RUN:
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a program's, not a test's
        answer = run_clbvh(*words[1:], *SMALL.get(words[1], ()), CLBVH_DEVICE="cpu")
    assert answer.returncode == 0, f"{snippet}: {command}\n{answer.stderr}"


def list_options(verb):
    """Return the names of a verb's options, also those that switch one off."""
    return {name for argument in make_app()[verb].assemble_argument_collection() for name in argument.names}


def list_lines(page):
    """Return the lines of a page that are commands of a shell."""
    return [line for snippet in find_snippets(page) for line in list_commands(snippet)]


def test_commands_have_these_options():
    options = {verb: list_options(verb) | {"--help"} for verb in VERBS}
    for page in PAGES:
        lines = [line for line in list_lines(page) if line.startswith("clbvh ")] + find_inline_commands(page)
        for line in lines:
            words = replace_placeholders(line)[1:]
            if not words or words[0].startswith("-"):
                known = {"--help", "-h", "--version", "--debug"}
            else:
                assert words[0] in VERBS, f"{name(page)}: there is no `{line}`"
                known = options[words[0]]
            for word in words:
                if word.startswith("--") or re.fullmatch("-[a-zA-Z]", word):
                    assert word.split("=")[0] in known, f"{name(page)}: `{line}` has no such option"


def test_make_has_these_targets():
    targets = set(re.findall(r"^([a-z-]+):", (REPOSITORY / "Makefile").read_text(), re.MULTILINE))
    for page in PAGES:
        for command in [*list_lines(page), *re.findall(r"`(make [^`]+)`", page.read_text())]:
            if re.match(r"make [a-z]", command):
                assert command.split()[1] in targets, f"{name(page)}: {command}"


def test_pictures_have_their_command():
    pages = "\n".join(page.read_text() for page in PAGES)
    for picture in sorted((REPOSITORY / "docs" / "pictures").glob("*.png")):
        assert re.search(rf"pictures/{picture.name}\)", pages), picture.name
        assert re.search(rf"`(clbvh|python)[^`]*{picture.stem}", pages), picture.name


def test_pictures_are_small():
    sizes = [path.stat().st_size for path in (REPOSITORY / "docs" / "pictures").iterdir()]
    assert sum(sizes) < 1_500_000


def test_recipes_quote_their_scripts():
    quotes = [
        (snippet, snippet.reason.removeprefix("from "))
        for page in PAGES
        for snippet in find_snippets(page)
        if (snippet.reason or "").startswith("from ")
    ]
    assert {path for _, path in quotes} >= {f"examples/{name}.py" for name in ("lidar_scan", "sky_view", "turntable")}
    for snippet, path in quotes:
        script = (REPOSITORY / path).read_text()
        assert snippet.text in script or textwrap.indent(snippet.text, "    ") in script, f"{snippet}: not in {path}"


def test_the_architecture_names_files_and_lists_that_exist():
    page = (REPOSITORY / "docs" / "architecture.md").read_text()
    drawing = (REPOSITORY / "docs" / "pictures" / "architecture.svg").read_text()
    paths = re.findall(r"\b(?:clbvh|cl)/[\w./]*\w", page + drawing)
    assert len(paths) > 40
    assert [path for path in paths if not (REPOSITORY / path).exists()] == []
    lists = re.findall(r"`(\w+)` in `([\w/.]+)` \|$", page, re.MULTILINE)
    assert len(lists) > 8
    for word, path in lists:
        assert re.search(rf"^(class )?{word}\b", (REPOSITORY / path).read_text(), re.MULTILINE), f"{word} in {path}"


def replace_placeholders(command: str) -> list[str]:
    """Return the words of a command line, with a file in place of what stands for one."""
    return [PLACEHOLDERS.get(word, word) for word in shlex.split(command)]


def test_the_list_of_folders_is_that_of_the_import_contract():
    script = REPOSITORY / ".ci" / "list_folders.py"
    spec = importlib.util.spec_from_file_location("list_folders", script)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    folders = module.list_folders()
    assert {path for path in folders if path.endswith("/")} == {
        f"clbvh/{path.parent.name}/" for path in (REPOSITORY / "clbvh").glob("*/__init__.py")
    }
    assert all(folders.values())
    assert module.PAGE.read_text("utf-8") == module.write_page(), "the list is old: run `python .ci/list_folders.py`"


def test_benchmarks_that_pages_name_can_be_imported():
    for path in sorted((REPOSITORY / "bench").glob("[a-z]*.py")):
        importlib.import_module(f"bench.{path.stem}")
    named = {file for page in PAGES for file in re.findall(r"\bbench/\w+\.py", page.read_text())}
    assert named
    assert [file for file in sorted(named) if not (REPOSITORY / file).is_file()] == []


@pytest.mark.parametrize(
    ("path", "line"),
    [("CITATION.cff", "version: {}"), ("recipe/recipe.yaml", '  version: "{}"'), ("CHANGELOG.md", "## {} - 20")],
)
def test_every_file_has_the_version(path, line):
    assert f"\n{line.format(clbvh.__version__)}" in (REPOSITORY / path).read_text()
