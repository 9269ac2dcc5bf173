"""Procedural meshes: one file per shape."""
