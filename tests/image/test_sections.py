"""Sections of closed objects where a cut opens them: their area by formula, their colour in every shading."""

import math

import numpy as np
import pytest

import clbvh
from clbvh import Mesh, Orthographic, Scene, Transform
from clbvh.choices import SHADINGS
from clbvh.geometry.appearance.srgb import linear_to_srgb

BALL = clbvh.make_shape("icosphere", triangles=20_480)
COLOUR = (0.25, 0.5, 0.75)
SIDE, HEIGHT = 121, 2.5
VIEW = clbvh.View(
    side="front", up="y", projection=Orthographic(HEIGHT), width=SIDE, height=SIDE, cut="z>0", shading="normal",
    section=clbvh.Section(colour=COLOUR),
)  # fmt: skip
# A ball with a hole inside: the walls of the hole face it.
HOLLOW = Mesh.from_arrays(
    np.concatenate((BALL.vertices, 0.5 * BALL.vertices)),
    np.concatenate((BALL.faces, BALL.faces[:, ::-1] + len(BALL.vertices))),
)
OPEN = Mesh.from_arrays(BALL.vertices, BALL.faces[1:])


def area_of(picture):
    """The area that has the colour of sections, in the unit of the scene."""
    expected = np.rint(255 * linear_to_srgb(np.array(COLOUR)))
    is_section = (np.abs(picture.rgb - expected) <= 1).all(axis=-1)
    return is_section.mean() * HEIGHT**2


@pytest.mark.on_both
@pytest.mark.parametrize("shading", SHADINGS)
def test_the_section_of_a_ball_is_a_disc_in_every_shading(session, shading):
    samples = None if shading in ("lambert", "lambert+shadow", "normal", "depth") else 4
    picture = clbvh.render(BALL, VIEW, shading=shading, samples=samples)
    # At the rim, samples of a pixel see the section and what is beside it.
    assert area_of(picture) == pytest.approx(math.pi, rel=0.06 if samples else 0.01)
    assert not area_of(clbvh.render(BALL, VIEW, shading=shading, samples=samples, section_fill=False))


def test_holes_stay_open_and_open_meshes_have_no_section():
    assert area_of(clbvh.render(HOLLOW, VIEW)) == pytest.approx(math.pi * (1 - 0.5**2), rel=0.02)
    assert area_of(clbvh.render(OPEN, VIEW)) == 0
    atoms = clbvh.Spheres([[0, 0, 0], [0, 0.9, 0.2]], [0.5, 0.3])
    radii = 0.5, math.sqrt(0.3**2 - 0.2**2)
    assert area_of(clbvh.render(atoms, VIEW)) == pytest.approx(math.pi * sum(r * r for r in radii), rel=0.02)


@pytest.mark.on_both
def test_instances_are_closed_each_by_itself(session):
    scene = Scene()
    ball, shell = scene.add(BALL), scene.add(OPEN)
    scene.place(ball, Transform(scale=0.4, translate=(-0.6, 0, 0)))
    scene.place(ball, Transform(scale=(-0.3, 0.3, 0.3), translate=(0.5, 0.5, 0)))
    scene.place(shell, Transform(scale=0.3, translate=(0.5, -0.5, 0)))
    for changes in ({}, {"shading": "path", "samples": 4}):
        area = area_of(clbvh.render(scene, VIEW, **changes))
        assert area == pytest.approx(math.pi * (0.4**2 + 0.3**2), rel=0.1 if changes else 0.02)


def test_a_box_opens_three_sides_and_what_is_in_front_of_the_cut_has_none():
    box = "box 0,0,0;2,2,2"
    corner = clbvh.render(BALL, VIEW, cut=box, eye=(9, 9, 9), look_at=(0, 0, 0), side=None)
    # Three quarters of discs, each seen at the same angle.
    assert area_of(corner) == pytest.approx(3 * math.pi / 4 / math.sqrt(3), rel=0.02)
    assert area_of(clbvh.render(BALL, VIEW, cut="z<0")) == 0


def test_hatching_has_lines_and_neither_light_nor_exposure_changes_the_colour():
    plain, hatched = (clbvh.render(BALL, VIEW, shading="studio", section_hatch=hatch).rgb for hatch in (0, 10))
    assert 0.15 < (plain != hatched).any(axis=-1).mean() / (math.pi / HEIGHT**2) < 0.25
    bright = clbvh.render(BALL, VIEW, shading="studio", exposure=2, light_colour=(9, 9, 9))
    assert area_of(bright) == pytest.approx(math.pi, rel=0.06)
