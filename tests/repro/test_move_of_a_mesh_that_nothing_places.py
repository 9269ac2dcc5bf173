"""A mesh that no instance places took the place of the only one that is placed, when its vertices moved."""

import clbvh


def test_it_stays_out_of_sight():
    scene, ball = clbvh.Scene(), clbvh.make_shape("icosphere", triangles=320)
    placed, other = scene.add(ball), scene.add(ball)
    scene.place(placed)
    with clbvh.Tracer(scene) as tracer:
        tracer.set_vertices(other, 2 * ball.vertices)
        assert tracer.closest_hit([[0, 0, 5]], [[0, 0, -1]]).t.tolist() == [4.0]
        tracer.set_vertices(placed, 3 * ball.vertices)
        assert tracer.closest_hit([[0, 0, 5]], [[0, 0, -1]]).t.tolist() == [2.0]
