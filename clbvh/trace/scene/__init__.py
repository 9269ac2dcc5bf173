"""Scenes in a device's memory: the trees of the geometries, and the tree over their instances."""
