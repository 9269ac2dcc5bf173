"""Questions about inside and outside, put to a mesh that has no inside."""

from __future__ import annotations

import subprocess
import sys
import warnings

import numpy as np
import pytest
import trimesh

from clbvh import OpenMeshWarning, Tracer

BALL = trimesh.creation.icosphere(subdivisions=2)
OPEN = BALL.vertices, BALL.faces[1:]
POINTS = np.zeros((2, 3))


@pytest.mark.parametrize("query", ["contains", "signed_distance"])
def test_an_open_mesh_is_told_once(query):
    with Tracer(OPEN) as tracer:
        with pytest.warns(OpenMeshWarning, match=f"mesh is not closed.*{query}") as caught:
            getattr(tracer, query)(POINTS)
        assert caught[0].filename == __file__
        # The second one would raise: warnings are errors here.
        tracer.contains(POINTS)
        tracer.signed_distance(POINTS)


def test_a_closed_mesh_is_not_told():
    with Tracer(BALL) as tracer:
        assert tracer.contains(POINTS).all()
        assert (tracer.signed_distance(POINTS) > 0.9).all()


def test_other_queries_of_an_open_mesh_tell_nothing():
    with Tracer(OPEN) as tracer:
        tracer.closest_point(POINTS)
        tracer.count_hits(POINTS, np.ones((2, 3)))


def test_the_answers_of_an_open_mesh_come_all_the_same():
    with Tracer(OPEN) as tracer, warnings.catch_warnings():
        warnings.simplefilter("ignore", OpenMeshWarning)
        assert tracer.contains([[5.0, 0, 0]]).tolist() == [False]


def test_a_tracer_of_a_tree_imports_no_builder(tmp_path):
    script = """
import sys, numpy as np, clbvh
mesh = clbvh.Mesh.from_arrays(np.eye(3), [[0, 1, 2]])
from clbvh.structs import NODE
lower, upper = mesh.local_vertices.min(axis=0), mesh.local_vertices.max(axis=0)
nodes = np.array([(lower, 0, upper, 1)], NODE)
with clbvh.Tracer(clbvh.Bvh(nodes, np.zeros(1, np.int32), mesh)) as tracer:
    assert tracer.any_hit(np.full((1, 3), 2.0), np.full((1, 3), -1.0)).all()
print([name for name in sys.modules if name.startswith("clbvh.builders")])
"""
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert result.stdout.strip() == "[]", result.stderr
