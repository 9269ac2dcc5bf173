"""Words of the command line that cannot be parsed are one line; options stand anywhere, and the last one counts."""

from __future__ import annotations

import json

import trimesh

from .command import refuses, run_clbvh

REFUSED = {
    "rendr a.ply": 'unknown command "rendr". Did you mean "render"? Available commands: render, ',
    "render a.ply -o a.png --widht 3": "unknown option: --widht. Did you mean --width?",
    "render a.ply -o a.png --width 3.5": "value for --width: '3.5' is not a whole number",
    "turntable a.ply -o a.gif --frames 1.5": "--frames",
    "render a.ply -o a.png --fov wide": "--fov",
    "render a.ply -o a.png --width": "--width requires an argument",
    "render a.ply": "--output requires an argument",
    "render -o a.png": "MESH|SCENE requires an argument",
    "devices cpu": "unexpected argument 'cpu'",
    "stats a.ply b.ply": "unexpected argument 'b.ply'",
    "--nonsense": "--nonsense",
}


def test_words_that_cannot_be_parsed_are_one_line():
    for words, said in REFUSED.items():
        refuses(run_clbvh(*words.split()), 2, said)


def test_no_words_are_wrong_usage_and_get_the_help():
    answer = run_clbvh()
    assert (answer.returncode, answer.stderr) == (2, "")
    assert answer.stdout == run_clbvh("--help").stdout == run_clbvh("-h").stdout


def test_options_may_stand_between_sources_and_the_last_counts(tmp_path):
    mesh, picture = tmp_path / "box.off", tmp_path / "a.ppm"
    trimesh.creation.box().export(mesh)
    answer = run_clbvh("render", mesh, "-o", picture, "--width", 40, mesh, "--height", 9, "--json", "--width", 16)
    assert json.loads(answer.stdout)["instances"] == 2
    assert picture.read_bytes().startswith(b"P6\n16 9\n")
