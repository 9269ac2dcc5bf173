"""Temporary files and folders are removed exactly when their owner is gone."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from clbvh.support import run_folder
from clbvh.support.files import replacing
from clbvh.support.orphans import FILE_PREFIX, FILE_SUFFIX, remove_orphan_folders, remove_orphans

# Begins a file and a folder, says so, and waits.
OWNER = """
import sys, time
from pathlib import Path
from clbvh.support.files import replacing
from clbvh.support.run_folder import get_run_folder
with replacing(Path(sys.argv[1])) as file:
    file.write(b"half")
    (get_run_folder() / "inner").mkdir()
    print("begun", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def owner(short_path):
    """A process that has begun a file and a folder, which lies in `short_path`, too."""
    with subprocess.Popen(
        [sys.executable, "-c", OWNER, short_path / "a"],
        env=os.environ | {"TMPDIR": str(short_path)},
        stdout=subprocess.PIPE,
    ) as process:
        assert process.stdout.readline() == b"begun\n"
        yield process
        process.kill()


def sweep(folder):
    remove_orphans(folder)
    remove_orphan_folders(folder, "clbvh-")


def test_what_a_living_process_has_begun_stays(owner, short_path):
    begun = set(short_path.iterdir())
    assert len(begun) == 2
    sweep(short_path)
    assert set(short_path.iterdir()) == begun


def test_what_a_killed_process_has_begun_goes(owner, short_path):
    owner.send_signal(signal.SIGKILL)
    owner.wait()
    assert len(list(short_path.iterdir())) == 2
    sweep(short_path)
    assert list(short_path.iterdir()) == []


def test_the_next_file_in_the_folder_sweeps_it(owner, short_path):
    owner.kill()
    owner.wait()
    with replacing(short_path / "b") as file:
        file.write(b"whole")
    assert {path.name[:6] for path in short_path.iterdir()} == {"b", "clbvh-"}


def test_only_files_with_our_names_and_of_the_right_kind_go(short_path):
    kept = [short_path / ".clbvh-without-suffix", short_path / "no-prefix.tmp", short_path / "clbvh-file"]
    for path in kept:
        path.touch()
    kept += [short_path / f"{FILE_PREFIX}folder{FILE_SUFFIX}", short_path / f"{FILE_PREFIX}fifo{FILE_SUFFIX}"]
    kept[-2].mkdir()
    os.mkfifo(kept[-1])
    (short_path / "target").touch()
    kept += [short_path / "target", short_path / f"{FILE_PREFIX}link{FILE_SUFFIX}"]
    kept[-1].symlink_to(short_path / "target")
    sweep(short_path)
    assert set(short_path.iterdir()) == set(kept)


def test_a_missing_folder_is_no_error(short_path):
    sweep(short_path / "gone")


def test_the_run_folder_is_private_and_the_same_each_time():
    folder = run_folder.get_run_folder()
    assert folder.stat().st_mode & 0o777 == 0o700
    assert run_folder.get_run_folder() == folder
