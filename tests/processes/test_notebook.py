"""A notebook that is executed by a kernel of its own: a live picture as the last value of a cell."""

from __future__ import annotations

import base64

import imageio.v3 as imageio
import nbclient
import nbformat

SHOW = """
import clbvh
scene = clbvh.Scene(clbvh.make_shape("icosphere", triangles=320))
live = scene.view(samples=4, side="top")
live
"""

# The page's part, as a browser sends it to the kernel.
LOOK = """
import io, threading
import numpy as np
from PIL import Image

settled, frames = threading.Event(), []
def carry(message, buffers=None):
    if message["type"] == "frame":
        frames.append((message, buffers))
        live._handle_custom_msg({"event_type": "frame_feedback", "index": message["index"]}, [])
        if message["settled"]:
            settled.set()

live.send = carry
live._handle_custom_msg({"event_type": "resize", "width": 60, "height": 40, "pixel_ratio": 2}, [])
assert settled.wait(60)
live.close()
message, (content,) = frames[-1]
pixels = np.asarray(Image.open(io.BytesIO(content)))
print(np.array_equal(pixels, live.renderer.render(width=120, height=80, samples=4, shading="studio").rgb))
print([each for each in threading.enumerate() if each.name == "clbvh-view"])
"""


def test_a_cell_shows_a_live_picture_that_settles_to_the_rendered_one():
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in (SHOW, LOOK)])
    nbclient.NotebookClient(notebook, timeout=120).execute()
    (shown,) = (each for each in notebook.cells[0].outputs if each["output_type"] == "execute_result")
    assert "application/vnd.jupyter.widget-view+json" in shown["data"]
    # Where no program runs, as in HTML that was made of it, a still picture is left.
    still = imageio.imread(base64.b64decode(shown["data"]["image/png"]))
    assert still.std() > 5
    (printed,) = (each for each in notebook.cells[1].outputs if each.get("name") == "stdout")
    assert printed["text"].split() == ["True", "[]"]
