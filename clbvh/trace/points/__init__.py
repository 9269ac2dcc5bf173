"""Queries about points: the closest point of the surface, and the side of it."""
