"""The error of pictures of `path` with and without the filter of `--denoise`, against 1,024 samples: one line a scene.

Run from the project's folder: ``python -m bench.denoise``; two minutes on a 2-core x86-64 server.
"""

import numpy as np

import clbvh

SCENES = ("cornell", "hall", "still-life")
VIEW = {"shading": "path", "width": 320, "height": 240, "keeps_film": True}


def main() -> None:
    for name in SCENES:
        with clbvh.Renderer(name) as renderer:

            def draw(**settings):
                return renderer.render(**settings, **VIEW).film[..., :3].astype(np.float64)

            truth = draw(samples=1024, seed=9)
            rows = {}
            for count in (16, 64, 256):
                for denoise in (False, True):
                    error = np.mean((draw(samples=count, denoise=denoise) - truth) ** 2 / (truth**2 + 0.01))
                    rows[f"{count}{' denoised' if denoise else ''}"] = f"{error:.5f}"
        print(name, ", ".join(f"{key}: {value}" for key, value in rows.items()), flush=True)


if __name__ == "__main__":
    main()
