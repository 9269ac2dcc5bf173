"""What the command refuses, in one line; and its help."""

import importlib

import pytest
import trimesh

from clbvh.cli import app

from .command import refuses, run_clbvh

# The words of a command, and words of its answer. `mesh.ply` and `scene.toml` are there, `scene.toml` has two objects.
PARSED = {
    "rendr mesh.ply": 'unknown command "rendr". Did you mean "render"? Available commands: render, ',
    "render mesh.ply -o a.png --widht 3": "unknown option: --widht. Did you mean --width?",
    "render mesh.ply -o a.png --width": "--width requires an argument",
    "render mesh.ply": "--output requires an argument",
    "devices cpu": "unexpected argument 'cpu'",
}
OPTIONS = {
    "--up w": "up must be a direction, an axis",
    "--projection fisheye --fov 40": "fov",
    "--cache-dir mesh.ply": "trees cannot be kept in this folder",
    "--hits hits.csv": ".npz",
    "--time 0": "time limit",
    "--heatmap nodes --builder brute": "brute",
}
VERBS = {
    "render gone.ply -o a.png": "gone.ply: no such file",
    "render mesh.ply -o a.gif": ".png, .jpg, .jpeg, .ppm",
    "render mesh.ply scene.toml -o a.png": "draw a scene file alone",
    "render wrong.toml -o a.png": "object 1",
    "render bunny -o a.png": "clbvh fetch bunny",
    "turntable mesh.ply -o a.avi": ".gif, .mp4",
    "turntable mesh.ply -o a.gif --projection panorama": "panorama",
    "images mesh.ply -o a.png --channels motion": "--next-camera-file",
    "images mesh.ply -o a.png --camera-file gone.json": "gone.json: no such file",
    "images mesh.ply -o a.png --camera-file gone.json --fov 30": "--camera-file says all of the view",
    "stats mesh.ply --plot a.pdf": ".png",
    "stats scene.toml --exact": "several objects",
    "stats mesh.ply --device cpu": "--device needs --quality fast",
    "stats scene.toml --plot a.png": "several objects",
    "shard mesh.ply -o .": "not an empty folder",
    "shard gone.ply -o parts": "gone.ply: no such file",
    "doctor --device cpu": "need --conformance",
    "doctor --conformance --mesh bunny": "'bunny' is no mesh",
    "doctor --fix --conformance": "give one of them",
    "study ladders -o .": "'ladders'",
    "study threshold -o mesh.ply": "this folder cannot be created",
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    trimesh.creation.box().export(tmp_path / "mesh.ply")
    objects = '[[object]]\nshape = "icosphere"\ntriangles = 20\n'
    (tmp_path / "scene.toml").write_text(2 * objects)
    (tmp_path / "bare.toml").write_text(f"{objects}[view]\ntransparent = true\n")
    (tmp_path / "wrong.toml").write_text(f"{objects}scale = [1, 2]\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_what_is_refused_is_one_line_and_nothing_is_written(folder):
    before = sorted(folder.iterdir())
    environment = {"CLBVH_MESHES": str(folder), "CLBVH_CACHE": str(folder / "cache")}
    of_render = {f"render mesh.ply -o a.png {words}": said for words, said in OPTIONS.items()}
    for words, said in (PARSED | VERBS | of_render).items():
        answer = run_clbvh(*words.split(), **environment)
        assert said in answer.stderr, words
        refuses(answer, 2)
        assert sorted(folder.iterdir()) == before, words


def test_a_file_without_alpha_is_refused_before_any_work(folder, monkeypatch):
    fail = lambda *_, **__: pytest.fail("no work before the check")  # noqa: E731
    with monkeypatch.context() as patch:
        patch.setattr("clbvh.rendering.renderer.render", fail)
        refuses(run_clbvh("render", "mesh.ply", "-o", "a.ppm", "--transparent"), 2, ".png")
        refuses(run_clbvh("render", "bare.toml", "-o", "a.ppm"), 2, ".png")
    words = ("render", "bare.toml", "-o", "a.ppm", "--width", 40, "--samples", 1)
    assert run_clbvh(*words, "--no-transparent").returncode == 0


def test_an_unknown_device_is_exit_code_3(folder):
    for words in ("render mesh.ply -o a.png", "warmup", "study -o ."):
        refuses(run_clbvh(*words.split(), "--device", "no such card"), 3, "no such card")


def test_no_words_are_wrong_usage_and_get_the_help():
    answer = run_clbvh()
    assert (answer.returncode, answer.stderr) == (2, "")
    assert answer.stdout == run_clbvh("--help").stdout == run_clbvh("-h").stdout


def test_each_verb_has_the_first_line_of_its_help_and_its_arguments():
    for verb, (arguments, line) in app.VERBS.items():
        verb_function = getattr(importlib.import_module(f"clbvh.cli.{verb}"), verb)
        assert verb_function.__doc__.splitlines()[0] == line
        words = set(arguments.replace("...", "").strip("[]").split())
        options = app.make_app()[verb].assemble_argument_collection()
        wanted = [option.names for option in options if option.required or option.name[0] not in "-*"]
        assert [names for names in wanted if not words.intersection(names)] == []
