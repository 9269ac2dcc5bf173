"""The oracle of `clbvh.trace.check.reference`, for rays at a lone mesh: see there what is right."""

from clbvh import Scene
from clbvh.trace.check.intersections import Rays
from clbvh.trace.check.reference import Reference

from . import all_hits_reference


def find_differences(mesh, origins, directions, hits):
    """The rays whose closest hit cannot be right, each with its reason."""
    return Reference(Scene(mesh).snapshot()).find_differences(Rays.make(origins, directions), hits)


def find_wrong_crossings(mesh, origins, directions, hits):
    """The rays whose crossings cannot be all that there are, or not in this order."""
    reference = Reference(Scene(mesh).snapshot())
    return all_hits_reference.find_wrong_crossings(reference, Rays.make(origins, directions), hits)
