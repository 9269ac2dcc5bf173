"""Scenes become pictures."""

from ..callable_module import make_callable
from .camera import Camera
from .pipeline import Picture, RenderOptions, render
from .scene import Light, MeshSource, Scene, Transform
from .scene_file import open_scene, read_scene

__all__ = [
    "Camera",
    "Light",
    "MeshSource",
    "Picture",
    "RenderOptions",
    "Scene",
    "Transform",
    "open_scene",
    "read_scene",
    "render",
]

make_callable(__name__)
