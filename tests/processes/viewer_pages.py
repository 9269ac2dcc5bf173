"""Pages of `clbvh view` in a browser: what a test does with them, and reads from them."""

import base64
import signal
import subprocess
import sys
import time

import numpy as np

from ..cli.command import make_environment

# Python ignores Ctrl-C where the shell that started the tests does, as it does for a job in the background.
LAUNCHER = """import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from clbvh.cli import main
main()
"""
SCENE = '[[object]]\nshape = "knot"\ntriangles = 1800\n[view]\nup = "y"\nsamples = 4\n'

SHOWN = "document.querySelector('canvas.picture').dataset"
READ = """() => {
  const canvas = document.querySelector("canvas.picture");
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let text = "";
  for (let i = 0; i < data.length; i += 8192) text += String.fromCharCode(...data.subarray(i, i + 8192));
  return btoa(text);
}"""


def start_viewer(folder):
    """Start the server as a process, and return it with the page's address."""
    (folder / "scene.toml").write_text(SCENE)
    process = subprocess.Popen(
        [sys.executable, "-c", LAUNCHER, "view", str(folder / "scene.toml"), "--no-browser"],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=make_environment(),
    )  # fmt: skip
    return process, process.stdout.readline().strip()


def interrupt(process):
    """Press Ctrl-C, and return the exit code."""
    process.send_signal(signal.SIGINT)
    try:
        return process.wait(30)
    finally:
        process.kill()
        process.stdout.close()


def settle(page, after):
    """Wait for a settled picture that is newer than a frame."""
    page.wait_for_function(f"after => {SHOWN}.settled === 'true' && Number({SHOWN}.index) > after", arg=after)


def frame_index(page):
    return int(page.evaluate(f"{SHOWN}.index ?? 0"))


def drag(page, seconds=0.0, button="left"):
    """Drag in a circle, and return how many frames came meanwhile."""
    first, begin = frame_index(page), time.monotonic()
    page.mouse.move(200, 150)
    page.mouse.down(button=button)
    for angle in np.arange(0.0, 1e6, 0.1):
        page.mouse.move(200 + 60 * np.sin(angle), 150 + 40 * (1 - np.cos(angle)))
        if angle > 0.3 and time.monotonic() > begin + seconds:
            break
    frames = frame_index(page) - first
    page.mouse.up(button=button)
    return frames


def read_pixels(page):
    return base64.b64decode(page.evaluate(READ))


def copy_text(page, what):
    page.get_by_role("button", name=f"copy {what}").click()
    page.wait_for_selector(f"textarea[aria-label='{what.capitalize()}']")
    return page.locator("textarea").input_value()
