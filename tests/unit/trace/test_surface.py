"""What hits know of the surface: where they are, its normals as an array and as a function, ids; and its arrays."""

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given, strategies as st

from clbvh import ConfigError, Hits, Mesh, SceneError, Spheres
from clbvh.trace.hits.surface import Surface
from clbvh.trace.world.surface_arrays import make_surface_arrays

from ...profiles import examples
from .scene_states import affine, random_linear

SQUARE = Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])


def place(shapes, geometry_id, transforms):
    names = [shape.name for shape in shapes]
    return Surface.from_shapes(shapes, names, np.asarray(geometry_id, np.int32), np.reshape(transforms, (-1, 4, 4)))


def hits_on(surface, seed):
    """Hits at random points of the first instance."""
    generator, shape = np.random.default_rng(seed), surface.shapes[surface.arrays.geometry_id[0]]
    prim_id = generator.integers(0, shape.prim_count, 50).astype(np.int32)
    u, v = generator.uniform(0, 0.5, (2, len(prim_id)))
    is_front = generator.random(len(prim_id)) < 0.5
    return Hits(u, u, v, prim_id, is_front=is_front, surface=surface, known_instance_id=0 * prim_id)


@pytest.fixture(scope="module")
def hits(open_tracer, source, rays):
    return open_tracer(source).closest_hit(*rays)


@pytest.fixture(scope="module")
def normals(open_tracer, mesh, rays):
    return open_tracer(mesh).closest_hit(*rays).normals


@pytest.fixture(scope="module")
def shapes(mesh):
    """A mesh, spheres, and triangles that disagree about their sides, so that vertex normals cancel."""
    generator = np.random.default_rng(0)
    balls = Spheres(generator.normal(size=(30, 3)), np.linspace(0.01, 0.5, 30))
    faces = generator.permuted([range(12)] * 200, axis=1)[:, :3]
    return mesh, balls, Mesh.from_arrays(generator.normal(size=(12, 3)), faces)


class TestHits:
    def test_locations_and_normals_are_those_of_the_formulas(self, hits):
        arrays, is_hit = hits.surface.arrays, np.flatnonzero(hits.is_hit)
        assert len(is_hit) > 500
        assert np.isnan(hits.locations[~hits.is_hit]).all()
        assert np.isnan(hits.normals[~hits.is_hit]).all()
        for index in is_hit[:1000]:
            prim, u, v = hits.prim_id[index], hits.u[index], hits.v[index]
            shape, instance = hits.surface.shapes[hits.geometry_id[index]], hits.instance_id[index]
            if isinstance(shape, Spheres):
                azimuth, polar = 2 * np.pi * u, np.pi * v
                normal = [np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)]
                point = shape.centres[prim] + shape.radii[prim] * np.array(normal)
            else:
                a, b, c = shape.vertices[shape.faces[prim]]
                point, normal = (1 - u - v) * a + u * b + v * c, np.cross(b - a, c - a)
            linear, offset = arrays.linear[instance], arrays.offset[instance]
            normal = np.linalg.inv(linear).T @ normal
            np.testing.assert_allclose(hits.locations[index], linear @ point + offset, atol=1e-13)
            np.testing.assert_allclose(hits.normals[index], normal / np.linalg.norm(normal), atol=1e-11)

    def test_ids_of_hits_and_of_their_parts(self, hits, source):
        assert (hits.mesh is source) == isinstance(source, Mesh)
        for name in ("prim_id", "instance_id", "geometry_id"):
            array = getattr(hits, name)
            np.testing.assert_array_equal(array >= 0, hits.is_hit)
            for part, index in ((hits[5:9], slice(5, 9)), (hits.take(np.array([3, 1])), [3, 1]), (hits[7], 7)):
                np.testing.assert_array_equal(getattr(part, name), array[index])

    def test_a_copy_or_a_pickle_knows_what_they_know(self, hits):
        for other in (copy.copy(hits), copy.deepcopy(hits), pickle.loads(pickle.dumps(hits))):
            assert (other.mesh is None) == (hits.mesh is None)
            assert other.geometry_id.tobytes() == hits.geometry_id.tobytes()
            assert other.offset_origins().tobytes() == hits.offset_origins().tobytes()


class TestPlacedHits:
    ENTRY = st.floats(-100, 100, allow_subnormal=False)

    @examples(short=60, long=2000)
    @given(
        numbers=st.lists(ENTRY, min_size=12, max_size=12),
        unit=st.integers(-30, 30),
        seed=st.integers(0, 2**32 - 1),
        kind=st.integers(0, 2),
    )
    def test_they_are_those_of_the_shape_placed(self, shapes, numbers, unit, seed, kind):
        linear, offset = np.reshape(numbers[:9], (3, 3)) * 10.0**unit, np.array(numbers[9:]) * 10.0**unit
        stretches = np.linalg.svd(linear, compute_uv=False)
        if not stretches[2] > 1e-3 * stretches[0] > 1e-6 * 10.0**unit:
            linear = np.eye(3) * 10.0**unit
        hits = hits_on(place([shapes[kind]], [0], affine(linear, offset)), seed)
        in_object = hits_on(place([shapes[kind]], [0], np.eye(4)), seed)
        sizes = np.abs(in_object.locations) @ np.abs(linear).T + np.abs(offset)
        assert (np.abs(hits.locations - in_object.locations @ linear.T - offset) <= 1e-14 * sizes).all()

        # Normals are perpendicular to placed tangents, of length 1, and on the side of the object's.
        tangents = np.cross(in_object.normals, np.roll(in_object.normals, 1, axis=1) * [1, -1, 2])
        tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
        scale = np.abs(linear).max()
        assert np.abs(((tangents @ linear.T) / scale * hits.normals).sum(axis=1)).max() < 1e-13
        np.testing.assert_allclose((hits.normals**2).sum(axis=1), 1, atol=1e-14)
        assert (((in_object.normals @ linear.T) / scale * hits.normals).sum(axis=1) > 0).all()

        # Smooth ones are placed like them, and on their side; those that face the rays are on the side of the ray.
        smooth = hits.normals(smooth=True)
        assert ((smooth * hits.normals).sum(axis=1) > 0).all()
        np.testing.assert_array_equal((hits.normals(smooth=True, facing=True) == smooth).all(axis=1), hits.is_front)
        if kind == 0:
            expected = in_object.normals(smooth=True) @ np.linalg.inv(linear / scale)
            expected /= np.linalg.norm(expected, axis=1, keepdims=True)
            is_near = (expected * hits.normals).sum(axis=1) > 1e-9
            np.testing.assert_allclose(smooth[is_near], expected[is_near], atol=1e-9)

        # Start points are on the side of the ray, as seen from the object.
        leaving = np.linalg.solve(linear, (hits.offset_origins() - hits.locations).T).T * scale
        heights = (leaving * in_object.normals).sum(axis=1)
        np.testing.assert_array_equal(np.sign(heights), np.where(hits.is_front, 1, -1))


class TestNormals:
    def test_they_behave_as_a_plain_array(self, normals):
        plain = np.asarray(normals)
        assert repr(normals) == repr(plain)
        for result in (
            normals * 2, -normals, normals > 0, normals @ np.eye(3), normals.sum(axis=1), normals[0],
            np.concatenate([normals, normals]), np.einsum("ij,ij->i", normals, normals), np.array(normals),
            pickle.loads(pickle.dumps(normals)), np.add.reduce(normals), copy.deepcopy(normals), normals(), plain,
        ):  # fmt: skip
            assert type(result) is np.ndarray
        assert normals().tobytes() == pickle.loads(pickle.dumps(normals)).tobytes() == plain.tobytes()

    def test_what_is_refused(self, normals):
        with pytest.raises(TypeError, match="only the normals of hits can be called"):
            normals.reshape(-1)()
        of_unknown_side = Hits(*np.full((3, 1), 0.25), np.zeros(1, np.int32), SQUARE)
        with pytest.raises(ConfigError, match="from which side"):
            of_unknown_side.normals(facing=True)

    def test_smooth_ones_are_the_vertex_normals_at_vertices(self, mesh):
        faces, nothing = np.arange(mesh.face_count, dtype=np.int32), np.zeros(mesh.face_count)
        for corner, (u, v) in enumerate(((0, 0), (1, 0), (0, 1))):
            smooth = Hits(nothing, nothing + u, nothing + v, faces, mesh).normals(smooth=True)
            np.testing.assert_allclose(smooth, mesh.vertex_normals[mesh.faces[:, corner]], rtol=0, atol=1e-15)

    def test_collinear_corners_have_a_normal_across_them(self):
        """Float32 may see a triangle there, which is hit, and then has to be left."""
        way = np.array([0.3, 0.5, 0.7])
        line = Mesh.from_arrays([0 * way, way, 0.5 * way, [1, 1, 1]], [[0, 1, 2], [0, 0, 0]])
        hits = Hits(np.ones(2), np.zeros(2), np.zeros(2), np.array([0, 1], np.int32), line)
        assert np.linalg.norm(hits.normals[0]) == pytest.approx(1)
        assert abs(hits.normals[0] @ way) < 1e-15
        assert np.isnan(hits.normals[1]).all()


class TestArrays:
    def test_products_of_matrices_and_their_inverses_are_the_identity(self):
        """To a few roundings of the products that are added up, whatever the shear, mirror and unit."""
        generator = np.random.default_rng(0)
        linear = np.array([random_linear(generator) for _ in range(600)])
        linear[:200] = linear[:200] @ [[1, 1e6, 0], [0, 1, 0], [0, 0, 1]]
        linear[200:] *= 10 ** generator.uniform(-30, 30, (400, 1, 1))
        linear[400:] = np.linalg.qr(linear[400:])[0] * 10 ** generator.uniform(-30, 30, (200, 1, 3))
        transforms = np.array([affine(matrix) for matrix in linear])
        arrays = make_surface_arrays([SQUARE], np.zeros(600, np.int32), transforms)
        residual = np.abs(arrays.linear @ arrays.inverse - np.eye(3))
        assert (residual <= 1e-15 * (np.abs(arrays.linear) @ np.abs(arrays.inverse))).all()
        np.testing.assert_array_equal(arrays.is_mirrored, np.linalg.slogdet(linear)[0] < 0)

        for unit in (1e-160, 1e160):
            with pytest.raises(SceneError, match=r"instance 1 is smaller than .* or larger than"):
                make_surface_arrays([SQUARE], np.zeros(2, np.int32), np.stack((np.eye(4), affine([unit] * 3))))
