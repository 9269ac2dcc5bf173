"""Cuts: the parts of rays, refused values, and pictures whose hits are those of rays with the same limits."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import clbvh
from clbvh import Cut
from clbvh.errors import SceneError, ValidationError
from clbvh.rendering.check_pixels import check_pixels
from clbvh.rendering.cut import as_cut

INF = np.inf
WIDTH, HEIGHT = 72, 54

# A closed room with a ball in it: the picture of its outside shows neither.
ROOM = clbvh.Scene()
ROOM.place(ROOM.add(clbvh.make_shape("icosphere", triangles=320)), clbvh.Transform(scale=0.4))
ROOM.place(ROOM.add(clbvh.Spheres([[0.5, 0, 0]], 0.2)))
ROOM.place(ROOM.add(clbvh.make_shape("icosphere", triangles=80)), clbvh.Transform(scale=(1.5, 1, 1)))

CUTS = {
    "plane": Cut.plane((0, 0, 0.3), (0.3, 0.2, 1)),
    "behind": Cut.plane((0, 0, 0.3), (0, 0, -1)),
    "all": Cut.plane((0, 0, -9), (0, 0, 5)),
    "nothing": Cut.plane((0, 0, 90), (0, 0, 1e-30)),
    "box": Cut.box((-0.5, -0.5, 0.2), (0.6, 2, 9)),
    "middle": Cut.box((-9, -9, 0.3), (9, 9, 2)),
    "flat": Cut.box((-1, -1, 0.9), (1, 1, 0.9)),
}
CAMERAS = {
    "perspective": clbvh.Camera((0.3, 0.5, 4), (0, 0, 0)),
    "inside": clbvh.Camera((0, 0, 0.6), (0.1, 0.2, 0)),
    "orthographic": clbvh.Camera((0.3, 0.5, 4), (0, 0, 0), projection=clbvh.Orthographic(3)),
    "panorama": clbvh.Camera((0.1, 0.2, 0.7), (0, 0, 0), projection=clbvh.Panorama()),
}


@pytest.mark.parametrize(
    ("cut", "origin", "direction", "expected"),
    [
        (Cut.plane((0, 0, 1), (0, 0, 3)), (0, 0, 5), (0, 0, -2), (-INF, 2)),
        (Cut.plane((0, 0, 1), (0, 0, 3)), (0, 0, 0), (0, 0, 2), (0.5, INF)),
        (Cut.plane((0, 0, 1), (0, 0, 3)), (0, 0, 5), (1, 0, 0), (-INF, INF)),
        (Cut.plane((0, 0, 1), (0, 0, 3)), (0, 0, 0), (1, 0, 0), (INF, -INF)),
        (Cut.plane((0, 0, 1), (0, 0, 3)), (0, 0, 1), (1, 0, 0), (INF, -INF)),
        (Cut.plane((0, 0, 0), (0, 1e-200, 0)), (0, 2, 0), (0, -1, 0), (-INF, 2)),
        (Cut.box((0, 0, 0), (1, 2, 3)), (0.5, 0.5, 10), (0, 0, -2), (3.5, 5)),
        (Cut.box((0, 0, 0), (1, 2, 3)), (0.5, 0.5, 1), (0, 0, -2), (-1, 0.5)),
        (Cut.box((0, 0, 0), (1, 2, 3)), (0, 0.5, 1), (0, 0, -2), (-1, 0.5)),
        (Cut.box((0, 0, 0), (0, 0, 0)), (-1, -1, -1), (1, 1, 1), (1, 1)),
    ],
)
def test_ranges(cut, origin, direction, expected):
    begin, end = cut.ranges(np.array([origin], float), np.array([direction], float))
    assert (begin[0], end[0]) == pytest.approx(expected)


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, 0, 1), (1, 1, 0)])
def test_a_ray_beside_a_box_is_not_cut(direction):
    begin, end = Cut.box((0, 0, 0), (1, 2, 3)).ranges(np.array([5.0, 9.0, 5.0]), np.array(direction, float))
    assert end < begin


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Cut.plane((0, 0, 0), (0, 0, 0)), "length above 0"),
        (lambda: Cut.plane((0, 0, np.nan), (0, 0, 1)), "point of a cut"),
        (lambda: Cut.plane((0, 0), (0, 0, 1)), "point of a cut"),
        (lambda: Cut.plane((0, 0, 0), (0, 0, np.inf)), "normal of a cut"),
        (lambda: Cut.box((0, 0, 1), (1, 1, 0)), "lower corner"),
        (lambda: Cut("ball", (0, 0, 0), (1, 1, 1)), "a 'plane', a 'share' or a 'box', not 'ball'"),
        (lambda: clbvh.View(cut=(0, 0, 1)), "clbvh.Cut"),
    ],
)
def test_wrong_cuts_are_refused(make, message):
    with pytest.raises(SceneError, match=message):
        make()


@pytest.mark.parametrize(
    ("text", "cut"),
    [
        ("0,1,2; 3,4,5.5", Cut.plane((0, 1, 2), (3, 4, 5.5))),
        ("box 0,0,0;1,1e-3,1", Cut.box((0, 0, 0), (1, 0.001, 1))),
        ("z=0.5", Cut.plane((0, 0, 0.5), (0, 0, 1))),
        ("y > -2", Cut.plane((0, -2, 0), (0, 1, 0))),
        ("x<1e3", Cut.plane((1000, 0, 0), (-1, 0, 0))),
        ("y=33.3%", Cut("share", (0, 33.3, 0), (0, 1, 0))),
        ("z<100 %", Cut("share", (0, 0, 100), (0, 0, -1))),
    ],
)
def test_texts(text, cut):
    assert as_cut(text) == as_cut(cut.text) == as_cut(cut) == cut


@pytest.mark.parametrize(
    "text",
    [
        "", "1,2,3", "1,2;3,4,5", "1,2,3;4,5,6;7,8,9", "a,b,c;1,2,3", "nan,0,0;1,1,1", "0,0,0;0,0,0", "box 1,1,1;0,0,0",
        "z", "z=", "z=a", "z=nan", "z=inf%", "z=-1%", "z=101%", "w=5", "zz=5", "z==5", "z=5%%",
    ],
)  # fmt: skip
def test_what_is_no_cut_is_refused(text):
    with pytest.raises(SceneError, match="cut"):
        as_cut(text)


def test_per_cent_count_from_the_lower_side_of_the_box():
    lower, upper = np.array([-1.0, -2.0, 10.0]), np.array([1.0, 2.0, 30.0])
    assert as_cut("z=25%").resolved(lower, upper) == Cut.plane((-1, -2, 15), (0, 0, 1))
    assert as_cut("y<0%").resolved(lower, upper) == Cut.plane((-1, -2, 10), (0, -1, 0))
    assert as_cut("x>100%").resolved(-1e308 * np.ones(3), 1e308 * np.ones(3)).first[0] == 1e308
    for text in ("z=0.5", "box 0,0,0;1,1,1"):
        assert as_cut(text).resolved(lower, upper) == as_cut(text)


@pytest.mark.parametrize(
    ("text", "misses"),
    [
        ("z=3.01", True),
        ("z=2.99", False),
        ("y<0.01", False),
        ("y<-0.01", True),
        ("1,2,3.1;1,1,1", True),
        ("1,2,2.9;1,1,1", False),
        ("0,0,-0.1;-1,-1,-1", True),
        ("box 2,0,0;3,9,9", True),
        ("box -9,-9,-9;0.1,0.1,0.1", False),
    ],
)
def test_a_cut_beside_everything_is_described(text, misses):
    note = as_cut(text).describe_miss((0, 0, 0), (1, 2, 3))
    assert note == ("the cut takes nothing away: all objects are in the box 0,0,0;1,2,3" if misses else None)


@pytest.fixture(scope="module", params=["mesh", "scene"])
def renderer(request):
    source = clbvh.make_shape("knot", triangles=2000) if request.param == "mesh" else ROOM
    with clbvh.Renderer(source) as renderer:
        yield renderer


@pytest.fixture(scope="module")
def tracer(renderer):
    with clbvh.Tracer(renderer.mesh if renderer.mesh is not None else ROOM) as tracer:
        yield tracer


def trace(tracer, cut, origins, directions):
    """Return t and the ids of the first hits before a cut, or else behind it."""
    begin, end = cut.ranges(origins, directions)
    is_cut = begin <= end
    before = tracer.closest_hit(origins, directions, t_max=np.where(is_cut, begin, INF))
    behind = tracer.closest_hit(origins, directions, t_min=np.where(is_cut, np.maximum(end, 0), INF))
    names = ("t", "prim_id", "instance_id")
    return [np.where(before.is_hit, getattr(before, name), getattr(behind, name)) for name in names]


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("cut", CUTS)
@pytest.mark.parametrize("shading", ["studio", "normal"])
def test_hits_are_those_of_rays_with_the_same_limits(renderer, tracer, shading, cut, camera):
    cut, camera = CUTS[cut], CAMERAS[camera]
    picture = renderer.render(camera=camera, cut=cut, width=WIDTH, height=HEIGHT, shading=shading, samples=1)
    origins, directions = camera.rays(WIDTH, HEIGHT)
    t, prim_id, instance_id = trace(tracer, cut, origins, directions)
    hits = picture.hits
    same = (hits.prim_id == prim_id) & (hits.instance_id == instance_id)
    # A surface that ends at the cut, or that touches a ray, may be on either side by what is rounded.
    assert np.count_nonzero(~same) <= 2
    np.testing.assert_allclose(hits.t[same], t[same], rtol=1e-6)
    begin, end = cut.ranges(origins, directions)
    is_inside = (begin <= end) & (hits.t > begin) & (hits.t < end)
    assert not is_inside.any()
    assert check_pixels(picture).validated_pixels > 100


@pytest.mark.parametrize("renderer", ["scene"], indirect=True)
def test_a_cut_opens_a_room(renderer):
    camera = CAMERAS["perspective"]
    closed = renderer.render(camera=camera, width=WIDTH, height=HEIGHT, shading="normal").hits
    for cut in (Cut.plane((0, 0, 0.5), (0, 0, 1)), Cut.box((-2, -2, 0.5), (2, 2, 2))):
        opened = renderer.render(camera=camera, cut=cut, width=WIDTH, height=HEIGHT, shading="normal").hits
        assert set(np.unique(closed.instance_id)) == {-1, 2}
        assert set(np.unique(opened.instance_id)) == {-1, 0, 1, 2}


@pytest.mark.parametrize("shading", ["studio", "lambert+shadow"])
def test_light_comes_as_if_nothing_were_cut(shading):
    # The inside of a closed box, seen through a cut wall, has no light from outside.
    box = clbvh.Mesh.from_arrays(*_cube())
    view = clbvh.View(
        camera=clbvh.Camera((0, 0, 9), (0, 0, 0)), cut="z=0.5", shading=shading, width=20, height=20, ground=False,
        background=(0, 0, 0), light=clbvh.Light((0, 0, 1), sky=(0, 0, 0), ground=(0, 0, 0)),
    )  # fmt: skip
    picture = clbvh.render(box, view)
    wall = picture.rgb[10, 10]
    assert picture.hits.t[10, 10] == pytest.approx(10, rel=1e-3)
    assert wall.max() == 0


def _cube():
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]


def test_cut_outs_are_cut():
    # Two panes of which nothing is shown, and a wall.
    panes = np.array([[[-1, -1, z], [1, -1, z], [0, 2, z]] for z in (0, 1.3, 2)], float)
    clear = clbvh.Material(alpha=0.0)
    wall = clbvh.Material()
    appearance = clbvh.Appearance(materials=(clear, wall), material_ids=np.array([1, 0, 0], np.int32))
    mesh = clbvh.Mesh.from_arrays(panes.reshape(-1, 3), np.arange(9).reshape(3, 3), appearance=appearance)
    camera = clbvh.Camera((0, 0, 9), (0, 0, 0))
    view = clbvh.View(camera=camera, width=9, height=9, samples=4, ground=False, transparent=True)
    with clbvh.Renderer(mesh, view) as renderer:
        shown = renderer.render(cut=Cut.plane((0, 0, 1.6), (0, 0, 1)))
        hidden = renderer.render(cut=Cut.box((-2, -2, -0.5), (2, 3, 0.5)))
    assert shown.alpha[4, 4] == 255
    assert hidden.alpha[4, 4] == 0


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_cuts_of_any_size(scale):
    mesh = clbvh.make_shape("knot", triangles=2000)
    big = clbvh.Mesh.from_arrays(mesh.vertices * scale, mesh.faces)
    cut, scaled = Cut.plane((0, 0, 0.1), (1, 1, 1)), Cut.plane((0, 0, 0.1 * scale), (1, 1, 1))
    size = {"width": 40, "height": 30, "shading": "normal"}
    plain, other = clbvh.render(mesh, cut=cut, **size), clbvh.render(big, cut=scaled, **size)
    assert np.count_nonzero(plain.hits.prim_id != other.hits.prim_id) <= 2
    assert 0 < plain.hits.count < clbvh.render(mesh, **size).hits.count


def test_validation_finds_a_pixel_that_ignores_its_cut(renderer):
    camera = CAMERAS["perspective"]
    whole = renderer.render(camera=camera, width=WIDTH, height=HEIGHT, shading="normal")
    for cut in (CUTS["plane"], CUTS["middle"], CUTS["all"]):
        with pytest.raises(ValidationError):
            check_pixels(dataclasses.replace(whole, cut=cut))
        shown = renderer.render(camera=camera, cut=cut, width=WIDTH, height=HEIGHT, shading="normal")
        with pytest.raises(ValidationError):
            check_pixels(dataclasses.replace(shown, cut=None))
