"""A script in a session of its own, so that a test sees every process that it leaves behind (Linux)."""

import os
import subprocess
import sys
import time
from pathlib import Path

PATIENCE_S = 20.0


def start_script(arguments, folder, **options):
    """Start Python as the leader of a new session, with `folder` for its temporary files."""
    environment = {**os.environ, "TMPDIR": str(folder), "PYTHONUNBUFFERED": "1"}
    return subprocess.Popen(
        [sys.executable, *arguments],
        start_new_session=True,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def list_session(leader):
    """Return the ids of the living processes of the session that process `leader` began."""
    found = []
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit():
            continue
        try:
            state, _, _, session = (folder / "stat").read_text().rpartition(")")[2].split()[:4]
        except (FileNotFoundError, ProcessLookupError):
            continue  # it ended meanwhile
        if int(session) == leader and state != "Z":
            found.append(int(folder.name))
    return found


def wait_until(condition, patience_s=PATIENCE_S):
    """Return whether the condition came true in time."""
    deadline = time.monotonic() + patience_s
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True
