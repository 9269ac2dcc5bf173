"""Small pictures, whole pipeline: hits first, then pixels."""

from __future__ import annotations

import numpy as np
import pytest

import clbvh
from clbvh import Light
from clbvh.choices import REPORT_SHADINGS
from clbvh.errors import ConfigError, ValidationError
from clbvh.rendering import built_scene as brute_limit, painters as painters_module, picture as refine_module
from clbvh.rendering.options import RenderOptions
from clbvh.scene.transforms import Transform

KNOT = clbvh.make_shape("knot", triangles=4000, seed=1)
VIEW = clbvh.View(width=96, height=64, up="y")


@pytest.fixture(scope="module")
def knot_picture():
    return clbvh.render(KNOT, VIEW, options=RenderOptions(validate=True))


def write_ply(path, vertices, faces):
    lines = [
        "ply", "format ascii 1.0",
        f"element vertex {len(vertices)}", "property float x", "property float y", "property float z",
        f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header",
        *(" ".join(map(str, vertex)) for vertex in vertices),
        *(f"{len(face)} " + " ".join(map(str, face)) for face in faces),
    ]  # fmt: skip
    path.write_text("\n".join(lines) + "\n")
    return str(path)


def same_hits(a, b):
    return all((getattr(a.hits, name) == getattr(b.hits, name)).all() for name in ("t", "u", "v", "prim_id"))


@pytest.mark.parametrize("shading", REPORT_SHADINGS)
def test_each_shading_looks_as_it_did(shading, compare_with_reference):
    picture = clbvh.render(KNOT, VIEW, shading=shading)
    compare_with_reference(f"knot-{shading.replace('+', '-')}", picture.rgb)


def test_terrain_looks_as_it_did(compare_with_reference):
    terrain = clbvh.make_shape("terrain", triangles=8000, seed=7)
    picture = clbvh.render(terrain, VIEW, shading="lambert+shadow", light_direction=(-1, 0.5, 0.3))
    compare_with_reference("terrain", picture.rgb)


def test_every_pixel_of_a_small_picture_is_validated():
    ball = clbvh.make_shape("icosphere", triangles=320)
    assert clbvh.render(ball, options=RenderOptions(validate=True), width=32, height=20).validated_pixels == 32 * 20


def test_a_wrong_pixel_is_found(monkeypatch):
    def render_wrongly(self, view, painter, times=None):
        colours, hits = render_rightly(self, view, painter, times)
        hits["prim_id"][10, 16] = (hits["prim_id"][10, 16] + 100) % 320
        return colours, hits

    render_rightly = painters_module.FrameRenderer.render
    monkeypatch.setattr(painters_module.FrameRenderer, "render", render_wrongly)
    ball = clbvh.make_shape("icosphere", triangles=320)
    with pytest.raises(ValidationError, match=r"1 of 640 pixels differ .* column 16, row 10"):
        clbvh.render(ball, options=RenderOptions(validate=True), width=32, height=20)


def test_without_a_tree_the_picture_is_the_same(knot_picture):
    brute = clbvh.render(KNOT, VIEW, options=RenderOptions(builder="brute"))
    assert brute.bvh is None
    assert brute.layout == "brute"
    assert same_hits(brute, knot_picture)
    assert (brute.rgb == knot_picture.rgb).all()


def test_brute_refuses_a_mesh_that_would_take_forever(monkeypatch):
    monkeypatch.setattr(brute_limit, "BRUTE_LIMIT", 1000)
    with pytest.raises(ConfigError, match="brute"):
        clbvh.render(KNOT, VIEW, options=RenderOptions(builder="brute"))


def test_bands_do_not_show(knot_picture, monkeypatch):
    monkeypatch.setattr(painters_module, "BAND_PIXELS", VIEW.width * 7)
    banded = clbvh.render(KNOT, VIEW)
    assert same_hits(banded, knot_picture)
    assert (banded.rgb == knot_picture.rgb).all()


@pytest.mark.parametrize(("width", "height"), [(1, 1), (7, 3), (65, 33)])
def test_sizes_that_do_not_fill_a_tile_are_rendered_whole(width, height):
    ball = clbvh.make_shape("icosphere", triangles=320)
    picture = clbvh.render(ball, options=RenderOptions(validate=True), width=width, height=height)
    assert picture.rgb.shape == (height, width, 3)
    assert picture.validated_pixels == width * height


def test_hits_are_those_of_the_tracer(knot_picture):
    origins, directions = knot_picture.camera.rays(VIEW.width, VIEW.height)
    with clbvh.Tracer(knot_picture.bvh) as tracer:
        traced = tracer.closest_hit(origins.reshape(-1, 3), directions.reshape(-1, 3))
    same = traced.prim_id == knot_picture.hits.prim_id.reshape(-1)
    # The kernel makes its rays in float32: at an edge the neighbour may be hit.
    assert same.mean() > 0.995
    # On the same face the numbers are those of the same float64 arithmetic.
    for name in ("t", "u", "v"):
        assert np.array_equal(getattr(traced, name)[same], getattr(knot_picture.hits, name).reshape(-1)[same]), name


def test_hits_are_refined_once_and_by_rows(knot_picture, monkeypatch):
    assert knot_picture.hits is knot_picture.hits
    monkeypatch.setattr(refine_module, "_CHUNK_PIXELS", VIEW.width * 7)
    by_rows = refine_module.refine_pixels(knot_picture.scene.surface, knot_picture.camera, knot_picture.found)
    for name in ("t", "u", "v", "prim_id"):
        assert np.array_equal(getattr(by_rows, name), getattr(knot_picture.hits, name)), name


def test_depth_is_the_distance_to_a_wall(tmp_path):
    wall = write_ply(tmp_path / "wall.ply", [(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], [(0, 1, 2), (0, 2, 3)])
    picture = clbvh.render(wall, eye=(0, 0, 4), look_at=(0, 0, 0), fov=60, width=31, height=31)
    _, directions = picture.camera.rays(31, 31)
    assert picture.hits.count == 31 * 31
    assert np.allclose(picture.hits.t, 4 / -directions[..., 2], rtol=1e-6)


def test_a_shadow_falls_where_geometry_says(tmp_path):
    # A floor at y = 0, and a square lid at y = 1 over x and z from -0.5 to 0.5; light from straight above.
    vertices = [(-2, 0, -2), (-2, 0, 2), (2, 0, 2), (2, 0, -2)]
    vertices += [(-0.5, 1, -0.5), (-0.5, 1, 0.5), (0.5, 1, 0.5), (0.5, 1, -0.5)]
    faces = [(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)]
    lid = write_ply(tmp_path / "lid.ply", vertices, faces)
    view = clbvh.View(
        eye=(0, 0.5, 5), look_at=(0, 0, 0), fov=40, width=160, height=90, up="y",
        light=Light(direction=(0, 1, 0), sky=(0, 0, 0), ground=(0, 0, 0)),
    )  # fmt: skip
    picture = clbvh.render(lid, view, shading="lambert+shadow")
    on_floor = np.isin(picture.hits.prim_id, (0, 1))
    _, directions = picture.camera.rays(160, 90)
    points = np.array(picture.camera.eye) + picture.hits.t[..., None] * directions
    inside = (np.abs(points[..., [0, 2]]) < 0.499).all(axis=-1) & on_floor
    outside = (np.abs(points[..., [0, 2]]) > 0.501).any(axis=-1) & on_floor
    assert inside.sum() > 40
    assert (picture.rgb[inside] == 0).all()
    assert (picture.rgb[outside] > 0).all()
    # The same light without shadows lights the whole floor.
    assert (clbvh.render(lid, view, shading="lambert").rgb[on_floor] > 0).all()


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e8])
def test_no_acne_at_any_scale(scale):
    # A smooth convex body never shadows itself: shadows may only be where the light does not reach anyway.
    placement = Transform(scale=scale, translate=(3 * scale, 0, 0))
    sphere = placement.apply(clbvh.make_shape("icosphere", triangles=1280))
    plain = clbvh.render(sphere, shading="lambert", width=80, height=60)
    shadowed = clbvh.render(sphere, shading="lambert+shadow", width=80, height=60)
    assert (plain.rgb == shadowed.rgb).all()


def test_a_mesh_far_from_zero_looks_as_one_at_zero():
    near = clbvh.render(KNOT, VIEW, shading="normal")
    far = clbvh.render(Transform(translate=(448_000, 5_411_000, 300)).apply(KNOT), VIEW, shading="normal")
    assert (np.abs(far.rgb.astype(int) - near.rgb) > 2).mean() < 0.005


def test_a_mesh_on_one_leaf_is_rendered(tmp_path):
    single = write_ply(tmp_path / "one.ply", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    picture = clbvh.render(single, options=RenderOptions(validate=True), width=40, height=40)
    assert 100 < picture.hits.count < 1600
    assert picture.report()["nodes"] == 1


def test_degenerate_triangles_are_counted_and_never_hit(tmp_path):
    vertices = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (2, 0, 0)]
    mesh = write_ply(tmp_path / "flat.ply", vertices, [(0, 1, 2), (0, 1, 3), (2, 2, 1), (0, 0, 0)])
    picture = clbvh.render(mesh, options=RenderOptions(validate=True), width=64, height=64)
    assert picture.report()["degenerate_triangles"] == 3
    assert set(np.unique(picture.hits.prim_id)) == {-1, 0}


def test_the_report_adds_up(knot_picture):
    report = knot_picture.report()
    assert report["triangles"] == knot_picture.mesh.face_count
    assert report["rays"] == 96 * 64
    assert report["hits"] == (knot_picture.hits.prim_id >= 0).sum()
    times = report["timings_ms"]
    assert list(times) == [
        "load", "cache", "build", "open", "layout", "compile", "upload", "kernel",
        "download", "other", "total",
    ]  # fmt: skip
    parts = sum(times[name] for name in times if name != "total")
    assert parts == pytest.approx(times["total"])
    assert min(times["layout"], times["other"]) > 0
    assert report["mrays_per_s"] == pytest.approx(report["samples"] * report["rays"] / times["kernel"] / 1e3)


def test_a_pool_gives_the_same_picture(knot_picture):
    pooled = clbvh.render(KNOT, VIEW, options=RenderOptions(workers=2, build=clbvh.BuildOptions(task_threshold=500)))
    assert pooled.workers == 2
    assert (pooled.rgb == knot_picture.rgb).all()


@pytest.mark.parametrize("option", [{"builder": "magic"}, {"workers": 0}])
def test_options_out_of_range_are_refused(option):
    with pytest.raises(ConfigError, match=next(iter(option))):
        RenderOptions(**option)
