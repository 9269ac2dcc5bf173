"""The image of the Dockerfile, where docker can build one; its commands everywhere."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from ..cli.command import run_clbvh

REPOSITORY = Path(__file__).parents[2]
TAG = "clbvh-test"


def call(*words: object) -> str:
    process = subprocess.run(list(map(str, words)), capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
    return process.stdout


def test_every_command_of_the_dockerfile_is_one_of_clbvh():
    text = (REPOSITORY / "Dockerfile").read_text()
    commands = re.findall(r"\bclbvh ([a-z]+)", "\n".join(re.findall(r"^RUN.*", text, re.MULTILINE)))
    commands += re.findall(r'^CMD \["([a-z]+)"', text, re.MULTILINE)
    assert commands
    for command in commands:
        assert run_clbvh(command, "--help").returncode == 0, command


def test_the_image_lists_a_device_and_renders_for_any_user(tmp_path):
    if shutil.which("docker") is None:
        pytest.skip("docker: not installed")
    if subprocess.run(["docker", "info"], capture_output=True, check=False).returncode:
        pytest.skip("docker: there is no daemon that this user may talk to")
    call("docker", "build", "--tag", TAG, REPOSITORY)
    assert "Portable Computing Language" in call("docker", "run", "--rm", TAG)
    tmp_path.chmod(0o777)
    run = ["docker", "run", "--rm", "--user", "12345:12345", "--volume", f"{tmp_path}:/data", TAG]
    call(*run, "render", "demo", "-o", "out.ppm")
    assert (tmp_path / "out.ppm").read_bytes().startswith(b"P6")
