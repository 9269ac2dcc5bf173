"""Frames around normals: orthonormal and right-handed for all of them."""

import numpy as np
import pytest

FLOAT3 = (np.float32, (3,))
FRAME = (np.float32, (3, 3))
ERROR = 4e-7


def make_normals():
    generator = np.random.default_rng(31)
    normals = generator.normal(size=(50_000, 3))
    # Close to both poles and to the equator, where the formula changes sides.
    normals[:10_000, :2] *= np.geomspace(1e-12, 1, 10_000)[:, None]
    normals[10_000:20_000, 2] *= np.geomspace(1e-30, 1, 10_000)
    axes = np.concatenate((np.eye(3), -np.eye(3), [[1, 0, -0.0], [0, 1, -0.0], [-0.0, -0.0, -1]]))
    normals = np.concatenate((axes, normals))
    return (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)


@pytest.fixture(scope="module")
def framed(run_shell):
    """Normals, vectors, and what the shell makes of them in float64: frames, vectors outside, vectors inside."""
    normals = make_normals()
    vectors = np.random.default_rng(32).normal(size=normals.shape).astype(np.float32)
    results = run_shell("frame_normals", [normals, vectors], [FRAME, FLOAT3, FLOAT3], "sampling_shells", {})
    return normals, vectors.astype(np.float64), *(result.astype(np.float64) for result in results)


def test_frames_are_orthonormal(framed):
    frames = framed[2]
    products = frames @ frames.transpose(0, 2, 1)
    np.testing.assert_allclose(products, np.broadcast_to(np.eye(3), products.shape), rtol=0, atol=ERROR)


def test_frames_are_right_handed_around_their_normals(framed):
    normals, _, frames, _, _ = framed
    np.testing.assert_array_equal(frames[:, 2], normals)
    np.testing.assert_allclose(np.linalg.det(frames), 1, rtol=0, atol=ERROR)


def test_vectors_go_in_and_out(framed):
    _, vectors, frames, outside, inside = framed
    error = 2e-6
    np.testing.assert_allclose(outside, (vectors[:, None] @ frames)[:, 0], rtol=0, atol=error)
    np.testing.assert_allclose(inside, (frames @ vectors[:, :, None])[..., 0], rtol=0, atol=error)
