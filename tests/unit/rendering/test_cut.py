"""Cuts: the parts of rays, texts, and pictures whose hits are those of rays with the same limits."""

import dataclasses

import numpy as np
import pytest

import clbvh
from clbvh import Cut, ValidationError
from clbvh.rendering.check_pixels import check_pixels
from clbvh.views.cut import as_cut

INF = np.inf
SIZE = {"width": 72, "height": 54}
PLANE = Cut.plane((0, 0, 1), (0, 0, 3))
BOX = Cut.box((0, 0, 0), (1, 2, 3))

CUTS = [
    Cut.plane((0, 0, 0.3), (0.3, 0.2, 1)), Cut.plane((0, 0, 0.3), (0, 0, -1)), Cut.plane((0, 0, -9), (0, 0, 5)),
    Cut.plane((0, 0, 90), (0, 0, 1e-30)), Cut.box((-0.5, -0.5, 0.2), (0.6, 2, 9)),
    Cut.box((-9, -9, 0.3), (9, 9, 2)), Cut.box((-1, -1, 0.9), (1, 1, 0.9)),
]  # fmt: skip
OUTSIDE = clbvh.Camera((0.3, 0.5, 4), (0, 0, 0))
CAMERAS = [
    OUTSIDE, clbvh.Camera((0, 0, 0.6), (0.1, 0.2, 0)),
    clbvh.Camera((0.3, 0.5, 4), (0, 0, 0), projection=clbvh.Orthographic(3)),
    clbvh.Camera((0.1, 0.2, 0.7), (0, 0, 0), projection=clbvh.Panorama()),
]  # fmt: skip


def test_the_parts_of_rays_that_are_cut_away():
    none = INF, -INF
    rows = [
        (PLANE, (0, 0, 5), (0, 0, -2), (-INF, 2)), (PLANE, (0, 0, 0), (0, 0, 2), (0.5, INF)),
        (PLANE, (0, 0, 5), (1, 0, 0), (-INF, INF)), (PLANE, (0, 0, 0), (1, 0, 0), none),
        (PLANE, (0, 0, 1), (1, 0, 0), none), (BOX, (0.5, 0.5, 10), (0, 0, -2), (3.5, 5)),
        (Cut.plane((0, 0, 0), (0, 1e-200, 0)), (0, 2, 0), (0, -1, 0), (-INF, 2)),
        (BOX, (0.5, 0.5, 1), (0, 0, -2), (-1, 0.5)), (BOX, (0, 0.5, 1), (0, 0, -2), (-1, 0.5)),
        (Cut.box((0, 0, 0), (0, 0, 0)), (-1, -1, -1), (1, 1, 1), (1, 1)),
    ]  # fmt: skip
    for cut, origin, direction, expected in rows:
        begin, end = cut.ranges(np.array(origin, float), np.array(direction, float))
        assert (begin, end) == pytest.approx(expected), (cut, origin, direction)
    begin, end = BOX.ranges(np.array([5.0, 9.0, 5.0]), np.eye(3))
    assert (end < begin).all()


def test_a_text_is_a_cut_and_a_cut_has_a_text():
    texts = {
        "0,1,2; 3,4,5.5": Cut.plane((0, 1, 2), (3, 4, 5.5)), "box 0,0,0;1,1e-3,1": Cut.box((0, 0, 0), (1, 0.001, 1)),
        "z=0.5": Cut.plane((0, 0, 0.5), (0, 0, 1)), "y > -2": Cut.plane((0, -2, 0), (0, 1, 0)),
        "x<1e3": Cut.plane((1000, 0, 0), (-1, 0, 0)), "y=33.3%": Cut("share", (0, 33.3, 0), (0, 1, 0)),
        "z<100 %": Cut("share", (0, 0, 100), (0, 0, -1)),
    }  # fmt: skip
    for text, cut in texts.items():
        assert as_cut(text) == as_cut(cut.text) == as_cut(cut) == cut
    # Per cent count from the lower side of the box.
    assert as_cut("z=25%").resolved((-1, -2, 10), (1, 2, 30)) == Cut.plane((-1, -2, 15), (0, 0, 1))
    assert as_cut("x>100%").resolved((-1e308,) * 3, (1e308,) * 3).first[0] == 1e308


def trace(tracer, cut, origins, directions):
    """Return t and the ids of the first hits before a cut, or else behind it."""
    begin, end = cut.ranges(origins, directions)
    is_cut = begin <= end
    before = tracer.closest_hit(origins, directions, t_max=np.where(is_cut, begin, INF))
    behind = tracer.closest_hit(origins, directions, t_min=np.where(is_cut, np.maximum(end, 0), INF))
    names = ("t", "prim_id", "instance_id")
    return [np.where(before.is_hit, getattr(before, name), getattr(behind, name)) for name in names]


@pytest.mark.parametrize(("name", "shading"), [("mesh", "normal"), ("world", "studio")])
def test_hits_are_those_of_rays_with_the_same_limits(request, open_tracer, name, shading):
    source = request.getfixturevalue(name)
    tracer = open_tracer(source)
    with clbvh.Renderer(source, up="y", shading=shading, samples=1, **SIZE) as renderer:
        for camera in CAMERAS:
            whole = renderer.render(camera=camera)
            origins, directions = camera.rays(**SIZE)
            for cut in CUTS:
                picture = renderer.render(camera=camera, cut=cut)
                t, prim_id, instance_id = trace(tracer, cut, origins, directions)
                hits = picture.hits
                same = (hits.prim_id == prim_id) & (hits.instance_id == instance_id)
                # A surface that ends at the cut, or that touches a ray, may be on either side by what is rounded.
                assert np.count_nonzero(~same) <= 2, cut
                np.testing.assert_allclose(hits.t[same], t[same], rtol=1e-6)
                begin, end = cut.ranges(origins, directions)
                assert not ((begin <= end) & (hits.t > begin) & (hits.t < end)).any(), cut
                # Light comes as if nothing were cut.
                unchanged = hits.t == whole.hits.t
                assert (picture.rgb[unchanged] == whole.rgb[unchanged]).all()
            assert check_pixels(picture).validated_pixels > 100
        # Validation finds pixels that ignore their cut, or that have one without a reason.
        cut, camera = CUTS[0], OUTSIDE
        whole, shown = renderer.render(camera=camera), renderer.render(camera=camera, cut=cut)
        for wrong in (dataclasses.replace(whole, cut=cut), dataclasses.replace(shown, cut=None)):
            with pytest.raises(ValidationError):
                check_pixels(wrong)


def test_surfaces_with_holes_are_cut():
    # Two panes of which nothing is shown, and a wall.
    panes = np.array([[[-1, -1, z], [1, -1, z], [0, 2, z]] for z in (0, 1.3, 2)], float)
    looks = clbvh.Appearance(materials=(clbvh.Material(alpha=0.0), clbvh.Material()), material_ids=np.array([1, 0, 0]))
    mesh = clbvh.Mesh.from_arrays(panes.reshape(-1, 3), np.arange(9).reshape(3, 3), appearance=looks)
    view = clbvh.View(camera=clbvh.Camera((0, 0, 9), (0, 0, 0)), width=9, height=9, samples=4, transparent=True)
    with clbvh.Renderer(mesh, view, ground=False) as renderer:
        assert renderer.render(cut=Cut.plane((0, 0, 1.6), (0, 0, 1))).alpha[4, 4] == 255
        assert renderer.render(cut=Cut.box((-2, -2, -0.5), (2, 3, 0.5))).alpha[4, 4] == 0


def test_cuts_of_any_size(mesh):
    size = {"width": 40, "height": 30, "shading": "normal"}
    plain = clbvh.render(mesh, cut=Cut.plane((0, 0, 0.1), (1, 1, 1)), **size)
    assert 0 < plain.hits.count < clbvh.render(mesh, **size).hits.count
    for scale in (1e-30, 1e30):
        scaled = clbvh.Mesh.from_arrays(mesh.vertices * scale, mesh.faces)
        other = clbvh.render(scaled, cut=Cut.plane((0, 0, 0.1 * scale), (1, 1, 1)), **size)
        assert np.count_nonzero(plain.hits.prim_id != other.hits.prim_id) <= 2
