"""The live viewer in headless Chromium at 960 x 540: ``python bench/viewer.py MESH [--seconds 10]`` of each drag.

Prints the time of the first picture after the command, the frames per second of an orbit, and the time from a move of
the mouse to the picture that shows it: a clicked point stays under the cursor while it pans, so that the place of its
mark tells which move a picture shows. With ``--picture FILE`` it only takes a picture of the page, after two clicks.
Needs playwright, and Chromium in the path.
"""

import argparse
import shutil
import subprocess
import sys
import time

import numpy as np
from playwright.sync_api import sync_playwright

PANEL_PX, WIDTH, HEIGHT = 248, 960, 540
START = 480, 270
RATE = 60.0
PATIENCE_MS = 60_000
SETTLED = "canvas.picture[data-settled=true]"
ARGUMENTS = "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"

# Notes the times of moves and of drawn pictures, and where each picture shows the mark.
WATCH = """
const moves = [], drawn = {}, shown = [];
let index = 0;
addEventListener("pointermove", (event) => moves.push([event.clientX, event.clientY, event.timeStamp]), true);
window.WebSocket = class extends WebSocket {
  constructor(address) {
    super(address);
    this.addEventListener("message", ({ data }) => {
      const message = typeof data === "string" ? JSON.parse(data) : {};
      if (message.type === "frame") index = message.index;
      const [mark] = message.marks ?? [];
      if (mark) shown.push([mark.x, mark.y, index]);
    });
  }
  send(text) {
    const event = JSON.parse(text);
    if (event.event_type === "frame_feedback") drawn[event.index] = performance.now();
    super.send(text);
  }
};
window.take = () => ({ moves: moves.splice(0), drawn: { ...drawn }, shown: shown.splice(0) });
"""


def drag(page, button, seconds):
    """Move the mouse along a spiral, so that no two moves have the same place."""
    page.mouse.move(*START)
    page.mouse.down(button=button)
    for step in range(int(seconds * RATE)):
        due = time.perf_counter() + 1 / RATE
        radius, angle = 40 + step / 10, step / 10
        page.mouse.move(START[0] + radius * np.sin(angle), START[1] + radius * (np.cos(angle) - 1))
        time.sleep(max(0.0, due - time.perf_counter()))
    page.mouse.up(button=button)


def measure_latency_ms(found):
    """Return the time from each move to the first picture that shows it or a later one."""
    moves, shown = np.array(found["moves"]), np.array(found["shown"])
    last = np.linalg.norm(moves[None, :, :2] - shown[:, None, :2], axis=2).argmin(axis=1)
    drawn = np.array([found["drawn"][str(int(index))] for index in shown[:, 2]])
    first = np.searchsorted(np.maximum.accumulate(last), np.arange(len(moves)))
    is_shown = first < len(shown)
    return drawn[first[is_shown]] - moves[is_shown, 2]


def measure(page, server, begin, seconds):
    """Print what one run finds."""
    page.goto(server.stdout.readline().strip())
    answered = time.perf_counter() - begin
    page.wait_for_selector("canvas.picture[data-index]", timeout=PATIENCE_MS)
    print(f"page {answered:.2f} s, first picture {time.perf_counter() - begin:.2f} s after the command")
    page.wait_for_selector(SETTLED, timeout=PATIENCE_MS)
    print(f"settled {time.perf_counter() - begin:.2f} s after the command")
    page.evaluate("take()")
    drag(page, "left", seconds)
    found = page.evaluate("take()")
    times = np.array(sorted(found["drawn"].values()))
    during = times[times > found["moves"][0][2]]
    print(f"orbit: {len(during) / seconds:.1f} frames per second, slowest {np.diff(during).max():.0f} ms")
    page.wait_for_selector(SETTLED, timeout=PATIENCE_MS)
    page.mouse.click(*START)
    page.wait_for_selector("th:text('face')")
    page.evaluate("take()")
    drag(page, "right", seconds)
    latency = measure_latency_ms(page.evaluate("take()"))
    p50, p95 = np.percentile(latency, [50, 95])
    print(f"pan: a move is seen after {p50:.0f} ms (median), {p95:.0f} ms (95 %), of {len(latency)} moves")


def photograph(page, server, file):
    """Click two points, and save what is seen."""
    page.goto(server.stdout.readline().strip())
    page.wait_for_selector(SETTLED, timeout=PATIENCE_MS)
    for x, y in ((0.46, 0.55), (0.69, 0.62)):
        page.mouse.click(WIDTH * x, HEIGHT * y)
    page.wait_for_selector("th:text('measured')")
    page.screenshot(path=file)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mesh")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--picture")
    given = parser.parse_args()
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
        page = browser.new_page(viewport={"width": WIDTH + PANEL_PX, "height": HEIGHT})
        page.add_init_script(WATCH)
        command = [sys.executable, "-m", "clbvh", "view", given.mesh, "--no-browser"]
        begin = time.perf_counter()
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
            try:
                if given.picture:
                    photograph(page, server, given.picture)
                else:
                    measure(page, server, begin, given.seconds)
            finally:
                server.terminate()
        browser.close()


if __name__ == "__main__":
    main()
