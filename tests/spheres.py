"""Spheres whose coordinates are the device's own, and rays that are hard for them."""

import numpy as np

from clbvh import Spheres

from .rays import AXES, aim, as_float32


def spheres_as_on_device(centres, radii):
    """Spheres that are nowhere moved, scaled or rounded on the way to the device."""
    spheres = Spheres(as_float32(centres), as_float32(radii))
    values = {
        "origin": np.zeros(3),
        "scale": 1.0,
        "local_centres": spheres.centres.astype(np.float32),
        "local_radii": spheres.radii.astype(np.float32),
    }
    for name, value in values.items():
        object.__setattr__(spheres, name, value)
    return spheres


def make_spheres(count, generator, sizes=(-3, -0.5)):
    """Spheres of many sizes that overlap, within local coordinates; some twice, some within others."""
    radii = 10.0 ** generator.uniform(*sizes, count)
    centres = generator.uniform(-1, 1, (count, 3)) * (0.99 - radii[:, None])
    twice = generator.random(count) < 0.1
    centres[twice], radii[twice] = centres[0], radii[0]
    concentric = generator.random(count) < 0.1
    centres[concentric] = centres[1]
    radii[concentric] = np.minimum(radii[concentric], radii[1])
    return spheres_as_on_device(centres, radii)


def sphere_rays(spheres, count, generator):
    """To points on and around the surfaces, from near and far; along the axes; from inside."""
    which = generator.integers(0, spheres.prim_count, count)
    centres, radii = spheres.centres[which], spheres.radii[which, None]
    outwards = generator.normal(size=(count, 3))
    outwards /= np.linalg.norm(outwards, axis=1)[:, None]
    targets = centres + radii * outwards * generator.choice([0, 0.5, 0.999, 1, 1.001], (count, 1))
    origins = generator.normal(size=(count, 3)) * 10.0 ** generator.uniform(-3, 2, (count, 1))
    inside = generator.random(count) < 0.2
    origins[inside] = (centres + radii * 0.7 * generator.uniform(-0.5, 0.5, (count, 3)))[inside]
    origins, directions = aim(origins, targets)
    along_axis = generator.random(count) < 0.3
    directions[along_axis] = AXES[np.arange(count) % len(AXES)][along_axis]
    origins[along_axis] = as_float32(targets - 3 * directions)[along_axis]
    directions[(directions == 0).all(axis=1)] = [0, 0, 1]
    exponent = np.frexp(np.abs(directions).max(axis=1, keepdims=True))[1]
    return origins, as_float32(np.ldexp(directions, -exponent))
