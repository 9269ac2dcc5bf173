"""The page of `clbvh view` in a real browser: pictures byte for byte, clicks, tabs, memory, refusals, Ctrl-C."""

import base64
import hashlib
import http.client
import os
import shlex
import shutil
import sys
import time
from urllib.parse import urlsplit

import imageio.v3 as imageio
import numpy as np
import psutil
import pytest

import clbvh

from ..cli.command import run_clbvh
from ..profiles import is_long
from .sessions import wait_until
from .viewer_pages import SHOWN, copy_text, drag, frame_index, interrupt, read_pixels, settle, start_viewer

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C by a signal")

CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
ARGUMENTS = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip
PATIENCE_MS = 180_000  # kernels are compiled for the first picture
SIZE = {"width": 640, "height": 300}
PHONE, SMALL_PHONE, DESKTOP = (390, 844), (360, 640), (1280, 720)
DRAGGING_S = 60 if is_long() or os.environ.get("CLBVH_LONG") else 10

WATCH_PAUSES = """() => {
  let before = performance.now();
  window.longest = 0;
  const tick = (now) => {
    window.longest = Math.max(window.longest, now - before);
    before = now;
    requestAnimationFrame(tick);
  };
  requestAnimationFrame(tick);
}"""
IS_REACHABLE = """(node) => {
  node.scrollIntoView({ block: "center" });
  const { left, right, top, bottom } = node.getBoundingClientRect();
  const seen = document.elementFromPoint((left + right) / 2, (top + bottom) / 2);
  return left >= 0 && right <= innerWidth && (node.contains(seen) || seen?.contains(node));
}"""


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="browser: playwright is not installed")
    path = next(filter(None, map(shutil.which, CHROMIUM)), None)
    if path is None:
        pytest.skip("browser: there is no Chromium")
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=path, args=ARGUMENTS)
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def viewer(tmp_path_factory):
    process, address = start_viewer(tmp_path_factory.mktemp("viewer"))
    yield process, address
    interrupt(process)


@pytest.fixture
def open_page(browser):
    """A function from an address to a page that has its settled picture; all errors of pages fail the test."""
    contexts, errors = [], []

    def open_one(address, **options):
        contexts.append(browser.new_context(**{"viewport": SIZE} | options))
        page = contexts[-1].new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.on("pageerror", lambda error: errors.append(error))
        page.goto(address)
        settle(page, 0)
        return page

    yield open_one
    for context in contexts:
        context.close()
    assert not errors


def test_the_settled_picture_is_that_of_the_copied_command(viewer, open_page, tmp_path):
    page = open_page(viewer[1])
    page.get_by_label("Axis of the cut").select_option("x")
    drag(page)
    settle(page, frame_index(page))
    words = shlex.split(copy_text(page, "command"))
    assert words[:2] + words[-2:-1] == ["clbvh", "render", "-o"]
    assert run_clbvh(*words[1:-1], tmp_path / "picture.png").returncode == 0
    expected = imageio.imread(tmp_path / "picture.png", mode="RGBA")
    assert page.evaluate("[innerWidth - 248, innerHeight]") == [expected.shape[1], expected.shape[0]]
    assert hashlib.sha256(read_pixels(page)).digest() == hashlib.sha256(expected.tobytes()).digest()


def test_a_click_shows_the_closest_hit_of_its_pixel(viewer, open_page):
    page = open_page(viewer[1], device_scale_factor=2)
    names = {"clbvh": clbvh}
    exec(copy_text(page, "Python").splitlines()[0], names)
    view, mesh = names["view"], clbvh.make_shape("knot", triangles=1800)
    picture = clbvh.render(mesh, view)
    places = np.argwhere(picture.hits.is_hit[::2, ::2])[:, ::-1]
    point = places[len(places) // 2].tolist()
    page.mouse.click(*point)
    page.wait_for_selector("th:text('face')")
    shown = dict(row.split("\t") for row in page.locator("section table").inner_text().splitlines())
    with clbvh.Tracer(mesh) as tracer:
        hit = tracer.closest_hit(*picture.camera.rays_at(np.multiply(point, 2), view.width, view.height))
    assert (shown["face"], shown["distance"]) == (f"{int(hit.prim_id):,}", f"{float(hit.t):.7g}")


def test_dragging_shows_frames_and_the_page_stays_responsive(viewer, open_page):
    page = open_page(viewer[1])
    page.evaluate(WATCH_PAUSES)
    assert drag(page, seconds=2) >= 10
    assert page.evaluate("window.longest") < 500


def test_each_tab_has_its_own_camera(viewer, open_page):
    pages = [open_page(viewer[1]) for _ in range(2)]
    before = [read_pixels(page) for page in pages]
    assert before[0] == before[1]
    drag(pages[0])
    pages[1].get_by_role("button", name="top").click()
    for page in pages:
        settle(page, 1)
    page.wait_for_timeout(500)
    after = [read_pixels(page) for page in pages]
    assert len({before[0], *after}) == 3


def test_a_closed_tab_stops_the_work(viewer, open_page):
    page, process = open_page(viewer[1]), psutil.Process(viewer[0].pid)
    page.get_by_role("button", name="turntable").click()
    index = frame_index(page)
    page.wait_for_function(f"before => Number({SHOWN}.index) > before + 5", arg=index)
    page.close()

    def used_s(during_s):
        before = sum(process.cpu_times()[:2])
        time.sleep(during_s)
        return sum(process.cpu_times()[:2]) - before

    assert wait_until(lambda: used_s(0.5) < 0.05)
    assert used_s(1.0) < 0.05


def test_dragging_leaks_nothing(viewer, open_page):
    page, process = open_page(viewer[1]), psutil.Process(viewer[0].pid)
    devtools = page.context.new_cdp_session(page)

    def measure():
        devtools.send("HeapProfiler.collectGarbage")
        heap = devtools.send("Runtime.getHeapUsage")
        return np.array([process.memory_info().rss, heap["usedSize"] + heap.get("backingStorageSize", 0)]) / 2**20

    drag(page, seconds=5)  # caches fill
    before = measure()
    drag(page, seconds=DRAGGING_S)
    server, heap = measure() - before
    assert server < 64  # a pixel buffer of each frame would be more, and so would each frame's bytes in the page
    assert heap < 0.25


def test_other_tokens_hosts_and_origins_are_refused(viewer):
    address = urlsplit(viewer[1])
    socket = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
    socket["Sec-WebSocket-Key"] = base64.b64encode(bytes(16)).decode()

    def ask(path, **headers):
        connection = http.client.HTTPConnection(address.netloc, timeout=30)
        connection.request("GET", path, headers=headers)
        status = connection.getresponse().status
        connection.close()
        return status

    assert ask(f"/?{address.query}") == 200
    assert ask(f"/socket?{address.query}", **socket) == 101
    for path in ("/", "/?token=wrong", "/?token="):
        assert ask(path) == 403
    assert ask("/socket?token=wrong", **socket) == 403
    assert ask(f"/?{address.query}", Host="example.org") == 403
    assert ask(f"/socket?{address.query}", **socket, Origin="https://example.org") == 403


def test_ctrl_c_ends_the_server_and_the_page_says_so(open_page, tmp_path):
    process, address = start_viewer(tmp_path)
    page = open_page(address)
    assert interrupt(process) == 0
    page.wait_for_selector("[role=alert]:visible >> text=ended")
    page.get_by_role("button", name="Reconnect").click()
    page.wait_for_selector("[role=alert]:visible >> text=lost")


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [DESKTOP, PHONE, SMALL_PHONE])
def test_every_button_is_reached_at_any_width(viewer, open_page, size, scheme):
    viewport = dict(zip(("width", "height"), size, strict=True))
    page = open_page(viewer[1], viewport=viewport, color_scheme=scheme, has_touch=size != DESKTOP)
    if size != DESKTOP:
        page.get_by_role("button", name="Show the panel").tap()
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    surface = page.locator(".panel").evaluate("(node) => getComputedStyle(node).backgroundColor")
    assert surface == {"light": "rgb(255, 255, 255)", "dark": "rgb(33, 35, 38)"}[scheme]
    controls = page.locator("button:visible, select:visible, input:visible, summary").all()
    assert len(controls) >= 20
    for control in controls:
        assert control.evaluate(IS_REACHABLE), control
        assert control.evaluate("(node) => node.ariaLabel || node.innerText || node.labels[0].innerText")


def test_a_phone_shows_the_answer_to_a_click_and_the_object_beside_an_open_panel(viewer, open_page):
    viewport = dict(zip(("width", "height"), PHONE, strict=True))
    page = open_page(viewer[1], viewport=viewport, has_touch=True)
    for place in ((x, y) for y in range(200, 600, 20) for x in range(60, 340, 20)):
        page.touchscreen.tap(*place)  # until one hits
        page.wait_for_timeout(200)  # a later tap that misses takes the answer away
        if page.locator("th:text('face')").count():
            break
    page.wait_for_selector("th:text('face') >> visible=true")
    page.get_by_role("button", name="Show the panel").tap()
    # A function, since the page's policy forbids to evaluate an expression again later.
    page.wait_for_function(
        "() => document.querySelector('.picture').getBoundingClientRect().height < 0.6 * innerHeight"
    )
    bottom = page.locator(".picture").evaluate("(node) => node.getBoundingClientRect().bottom")
    assert bottom <= page.locator(".panel").evaluate("(node) => node.getBoundingClientRect().top") + 1


def test_keys_work_while_the_help_is_open(viewer, open_page):
    page = open_page(viewer[1], viewport={"width": 1280, "height": 720})
    page.get_by_text("Mouse and keys").click()
    page.get_by_text("orbit; in flight").wait_for()
    page.keyboard.press("m")
    page.locator("input[type=checkbox]:checked").first.wait_for(state="attached")


def test_a_saved_picture_has_the_name_of_what_it_shows(viewer, open_page):
    page = open_page(viewer[1])
    with page.expect_download() as download:
        page.get_by_role("button", name="save PNG").click()
    assert download.value.suggested_filename == "knot-studio.png"
