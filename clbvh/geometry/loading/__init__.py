"""Mesh files become meshes: one file per family of formats."""
