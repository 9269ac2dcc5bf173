"""`clbvh study`: a tiny study on one page, and Ctrl-C."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from clbvh.study import scale

from .command import TIMEOUT_S, make_environment, run_clbvh

# The command with a tiny study in place of the quick one. Where the tests run in the background, their children ignore
# Ctrl-C unless told so.
TINY = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
import clbvh.study.scale as s
s.QUICK = s.TINY
from clbvh.cli import main
main()
"""


@pytest.mark.usefixtures("_opened_device")
def test_experiments_join_on_one_page(tmp_path, monkeypatch):
    monkeypatch.setattr(scale, "QUICK", scale.TINY)
    answer = run_clbvh("study", "threshold", "--quick", "-o", tmp_path)
    assert answer.returncode == 0, answer.stderr
    names = ("index.html", "samples.jsonl", "samples.csv")
    assert answer.stdout.splitlines() == [str(tmp_path / name) for name in names]
    page = (tmp_path / "index.html").read_text()
    assert '<section id="threshold">' in page
    assert '<section id="ladder">' not in page
    assert run_clbvh("study", "divergence", "--quick", "-o", tmp_path).returncode == 0
    page = (tmp_path / "index.html").read_text()
    assert page.index('<section id="threshold">') < page.index('<section id="divergence">')


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C is another event there")
def test_ctrl_c_keeps_the_samples_and_the_next_run_goes_on(tmp_path):
    command = [sys.executable, "-c", TINY, "study", "ladder", "--quick", "-o", str(tmp_path)]
    samples = tmp_path / "samples.jsonl"
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                               env=make_environment(), start_new_session=True)  # fmt: skip
    deadline = time.monotonic() + TIMEOUT_S
    while not (samples.is_file() and samples.read_bytes().count(b"\n") >= 3) and process.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 130, errors
    assert errors.splitlines()[-1].endswith("clbvh: interrupted")
    kept = samples.read_bytes()
    assert not (tmp_path / "index.html").exists()
    again = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, env=make_environment())
    assert again.returncode == 0, again.stderr
    assert samples.read_bytes().startswith(kept[: kept.rindex(b"\n") + 1])
    assert (tmp_path / "index.html").is_file()
