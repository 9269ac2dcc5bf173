"""Any transform: hits on an instance are those on its mesh, placed."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from clbvh import Mesh, Spheres
from clbvh.trace.hits.hits import Hits
from clbvh.trace.hits.surface import Surface

from ..profiles import examples

HITS = 50

entry = st.floats(-100, 100, allow_subnormal=False)


@st.composite
def transforms(draw):
    """A regular matrix of moderate condition, and a translation, in any unit."""
    linear = np.array(draw(st.lists(entry, min_size=9, max_size=9))).reshape(3, 3)
    values = np.linalg.svd(linear, compute_uv=False)
    if not values[2] > 1e-3 * values[0] > 1e-6:
        linear = np.eye(3)
    transform = np.eye(4)
    transform[:3, :3] = linear
    transform[:3, 3] = draw(st.lists(entry, min_size=3, max_size=3))
    transform[:3] *= 10.0 ** draw(st.integers(-30, 30))
    return transform


@pytest.fixture(scope="module")
def shapes(mesh):
    """A mesh, spheres, and triangles that disagree about their sides, so that vertex normals cancel."""
    generator = np.random.default_rng(0)
    balls = Spheres(generator.normal(size=(30, 3)), np.linspace(0.01, 0.5, 30))
    return (
        mesh,
        balls,
        Mesh.from_arrays(generator.normal(size=(12, 3)), generator.permuted([range(12)] * 200, axis=1)[:, :3]),
    )


def make_hits(shape, transform, seed):
    generator = np.random.default_rng(seed)
    surface = Surface.from_shapes([shape], ["shape"], np.zeros(1, np.int32), transform[None])
    prim_id = generator.integers(0, shape.prim_count, HITS).astype(np.int32)
    u, v = generator.uniform(0, 0.5, (2, HITS))
    is_front = generator.random(HITS) < 0.5
    return Hits(u, u, v, prim_id, is_front=is_front, surface=surface, known_instance_id=0 * prim_id)


@examples(short=40, long=2000)
@given(transform=transforms(), seed=st.integers(0, 2**32 - 1), kind=st.integers(0, 2))
def test_hits_of_an_instance_are_those_of_its_shape_placed(shapes, transform, seed, kind):
    hits, in_object = make_hits(shapes[kind], transform, seed), make_hits(shapes[kind], np.eye(4), seed)
    linear, offset = transform[:3, :3], transform[:3, 3]
    placed = in_object.locations @ linear.T + offset
    sizes = np.abs(in_object.locations) @ np.abs(linear).T + np.abs(offset)
    assert (np.abs(hits.locations - placed) <= 1e-14 * sizes).all()

    # Normals are perpendicular to placed tangents, of length 1, and on the side of the object's.
    tangents = np.cross(in_object.normals, np.roll(in_object.normals, 1, axis=1) * [1, -1, 2])
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    scale = np.abs(linear).max()
    assert np.abs(((tangents @ linear.T) / scale * hits.normals).sum(axis=1)).max() < 1e-13
    np.testing.assert_allclose((hits.normals**2).sum(axis=1), 1, atol=1e-14)
    assert (((in_object.normals @ linear.T) / scale * hits.normals).sum(axis=1) > 0).all()

    # So are smooth ones, and those that face the rays.
    smooth = hits.normals(smooth=True)
    assert ((smooth * hits.normals).sum(axis=1) > 0).all()
    np.testing.assert_array_equal((hits.normals(smooth=True, facing=True) == smooth).all(axis=1), hits.is_front)

    # Start points are on the side of the ray, as seen from the object.
    leaving = np.linalg.solve(linear, (hits.offset_origins() - hits.locations).T).T * scale
    heights = (leaving * in_object.normals).sum(axis=1)
    np.testing.assert_array_equal(heights > 0, hits.is_front)
    np.testing.assert_array_equal(heights < 0, ~hits.is_front)
