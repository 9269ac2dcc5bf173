"""Vectors as tuples of three numbers, for compiled loops: slices of arrays would take the compiler seconds."""

from __future__ import annotations

from .compiled import compiled


@compiled
def dot(one, other):
    """Return the dot product."""
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


@compiled
def cross(one, other):
    """Return the cross product."""
    return (
        one[1] * other[2] - one[2] * other[1],
        one[2] * other[0] - one[0] * other[2],
        one[0] * other[1] - one[1] * other[0],
    )


@compiled
def subtract(one, other):
    """Return the difference."""
    return one[0] - other[0], one[1] - other[1], one[2] - other[2]


@compiled
def add_scaled(one, factor, other):
    """Return ``one + factor * other``."""
    return one[0] + factor * other[0], one[1] + factor * other[1], one[2] + factor * other[2]
