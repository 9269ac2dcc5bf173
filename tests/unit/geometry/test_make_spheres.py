"""The procedural spheres: their form, repeatability, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh.errors import ConfigError
from clbvh.geometry.shapes import make_spheres as module
from clbvh.geometry.shapes.make_spheres import SPHERE_SETS, make_spheres


@pytest.mark.parametrize("seed", [0, 9])
@pytest.mark.parametrize("count", [1, 2, 5000])
@pytest.mark.parametrize("name", SPHERE_SETS)
def test_the_spheres_are_sound(name, count, seed):
    made = make_spheres(name, count=count, seed=seed)
    centres, radii = made.centres, made.radii
    assert (centres.shape, radii.shape) == ((count, 3), (count,))
    assert np.isfinite(centres).all()
    assert (radii > 0).all()


@pytest.mark.parametrize("seed", [1])
@pytest.mark.parametrize("name", SPHERE_SETS)
def test_the_same_seed_gives_the_same_bytes(name, seed):
    first, second, other = (make_spheres(name, count=500, seed=number) for number in (seed, seed, seed + 1))
    assert first.centres.tobytes() == second.centres.tobytes() != other.centres.tobytes()
    assert first.radii.tobytes() == second.radii.tobytes()


@pytest.mark.parametrize("seed", [4])
def test_a_galaxy_is_flat_and_dense_in_the_middle(seed):
    centres = make_spheres("galaxy", count=20_000, seed=seed).centres
    assert np.median(np.abs(centres[:, 1])) < 0.15 * np.median(np.abs(centres[:, 0]))
    distance = np.linalg.norm(centres, axis=1)
    assert 0.15 < (distance < 1.5).mean() < 0.5
    assert (distance < 15).all()


@pytest.mark.parametrize("arms", [2, 3])
def test_a_galaxy_has_arms(arms):
    centres = make_spheres("galaxy", count=50_000, seed=1, arms=arms).centres
    # A ring of the disk, cut into sectors: an angular wave with one crest per arm stands out.
    distance = np.hypot(centres[:, 0], centres[:, 2])
    angles = np.arctan2(centres[:, 2], centres[:, 0])[(distance > 5.8) & (distance < 6.2)]
    waves = [abs(np.exp(1j * number * angles).mean()) for number in range(1, 6)]
    assert int(np.argmax(waves)) + 1 == arms


def test_options_change_the_size():
    wide, narrow = (make_spheres("galaxy", count=500, radius=radius).centres for radius in (100, 10))
    assert np.allclose(wide, 10 * narrow)


@pytest.mark.parametrize("seed", [0, 1, 7])
@pytest.mark.parametrize("count", [4, 5, 40, 480, 2500])
def test_spheres_of_the_weekend_touch_nothing_but_the_ground(count, seed):
    made = make_spheres("weekend", count=count, seed=seed)
    centres, radii = made.centres, made.radii
    assert radii.tolist() == [radii[0], 1, 1, 1, *[0.2] * (count - 4)]
    others = centres[1:]
    gaps = np.linalg.norm(others[:, None] - others[None], axis=2) - radii[1:, None] - radii[None, 1:]
    assert gaps[~np.eye(count - 1, dtype=bool)].min() > 1e-3
    heights = np.linalg.norm(others - centres[0], axis=1) - radii[0] - radii[1:]
    assert np.abs(heights).max() < 1e-9 * radii[0]


@pytest.mark.parametrize("count", [1, 3, 4, 5, 1004, 3000])
def test_each_sphere_of_the_weekend_has_a_material(count):
    made = make_spheres("weekend", count=count, seed=2).appearance
    assert made.material_ids.shape == (count,)
    assert made.material_ids.dtype == np.int32
    assert 0 <= made.material_ids.min() <= made.material_ids.max() < len(made.materials) <= 1004
    # The large ones keep theirs, and the small ones begin with the first of their own.
    assert made.material_ids[:1004].tolist() == list(range(min(count, 1004)))


@pytest.mark.parametrize("seed", [3])
def test_the_weekend_fills_a_square(seed):
    centres = make_spheres("weekend", count=480, seed=seed).centres[4:]
    assert np.abs(centres[:, [0, 2]]).max() < 13
    assert ((centres[:, 0] > 0).mean(), (centres[:, 2] > 0).mean()) == pytest.approx((0.5, 0.5), abs=0.05)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "nebula"}, "no spheres 'nebula': take one of galaxy, weekend"),
        ({"loops": 3}, "no option 'loops': it has arms, winding"),
        ({"arms": 0}, "'arms' .* must be 1 to 100, not 0"),
        ({"arms": 2.5}, "'arms' .* must be 1 to 100, not 2.5"),
        ({"bulge": 1.5}, "'bulge' .* must be at most 1, not 1.5"),
        ({"radius": -1}, "'radius' .* must be a number from 0, not -1"),
        ({"radius": float("nan")}, "must be a number from 0"),
        ({"count": 0}, "count must be a whole number from 1, not 0"),
        ({"count": 1.5}, "count must be a whole number from 1"),
        ({"count": 2**31}, "2,147,483,648 spheres are too many"),
        ({"seed": -1}, "seed must be a whole number from 0, not -1"),
    ],
)
def test_what_cannot_be_made_is_refused(arguments, message):
    with pytest.raises(ConfigError, match=message):
        make_spheres(**{"name": "galaxy", "count": 10, **arguments})


def test_the_memory_is_checked_first(monkeypatch):
    def refuse(subject, needed_bytes, error):
        raise error(f"{subject} need {needed_bytes}")

    monkeypatch.setattr(module, "check_memory", refuse)
    monkeypatch.setitem(SPHERE_SETS, "galaxy", lambda count, generator: pytest.fail("it was made"))
    with pytest.raises(ConfigError, match="1,000,000 spheres need 300000000"):
        make_spheres("galaxy", count=10**6)
