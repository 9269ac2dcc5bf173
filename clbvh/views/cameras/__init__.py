"""Cameras: their lens and projection, their pose, their rays, and how they see the whole of a scene."""
