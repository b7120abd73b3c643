"""A body swum by a given midline: forces, momentum, torque and power against what follows from the motion by hand."""

import naive
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from benchmarks.validation import robot
from fish_env import make_fish, make_water, prescribe
from fish_env.physics.forces import FORCES
from fish_env.physics.world import VACUUM

PERIOD, SHIFT, FISH = 0.5, 0.03, make_fish()
OMEGA, MASS, LENGTH = 2.0 * np.pi / PERIOD, FISH.body.mass, FISH.length


def wave(place, time):
    """A wave that grows toward the tail."""
    return (0.02 - 0.08 * place + 0.16 * place**2) * np.sin(2 * np.pi * place - OMEGA * time)


def heave(place, time):
    """The whole body to and fro."""
    return SHIFT * np.sin(OMEGA * time) + 0.0 * place


def table(points=False):
    """The wave at evenly spaced instants and places: offsets, or the points of a body that keeps its length."""
    place, time = np.linspace(0.0, 1.0, 401), np.arange(32)[:, None] * PERIOD / 32
    left = wave(place, time)
    along = np.insert(np.cumsum(np.sqrt(place[1] ** 2 - np.diff(left) ** 2), axis=1), 0, 0.0, axis=1)
    return np.stack([along, left], axis=2) if points else left


def change_of(values):
    """Rates of change of periodic values (T,...)."""
    waves = 1j * OMEGA * np.fft.fftfreq(len(values), 1.0 / len(values))
    return np.fft.ifft(waves.reshape(-1, *[1] * (values.ndim - 1)) * np.fft.fft(values, axis=0), axis=0).real


def check_balance(found, fish):
    """Force changes momentum, no torque acts on either end, and the torque bends with the power; velocities (T,N,3)."""
    moving = found.position - np.array([found.speed, 0.0, 0.0]) * found.time[:, None, None]
    v = change_of(moving) + np.array([found.speed, 0.0, 0.0])
    np.testing.assert_allclose(
        found.force, fish.body.mass @ change_of(v)[..., :2], atol=0.02 * np.abs(found.force).max()
    )
    assert np.abs(found.torque[:, [0, -1]]).max() < 1e-12 * np.abs(found.torque).max()
    slope = CubicSpline(found.station, wave(found.station, found.time[:, None]), axis=1)(found.station, 1)
    curvature = CubicSpline(found.station, np.arcsin(slope), axis=1)(found.station, 1)
    bending = -np.trapezoid(found.torque * change_of(curvature), found.station, axis=1)
    np.testing.assert_allclose(bending, found.power, atol=0.02 * found.power.max())
    return v


def test_towed_straight():
    """A straight body that is towed meets the drag of its faces and puts in no power."""
    found, speed = prescribe(FISH, np.zeros((1, 4)), PERIOD, speed=0.3), np.tile((0.3, 0.0, 0.0), (len(MASS), 1))
    by_hand = naive.water_force(FISH.body, FISH.water, FISH.body.position, speed).sum(axis=0)[:2]
    assert by_hand[0] < 0.0 == found.power.max() == found.sweep.max() == found.strouhal
    np.testing.assert_allclose(found.force, np.tile(by_hand, (len(found.time), 1)), rtol=1e-12, atol=1e-15)
    assert (found.speed, found.relative_speed) == pytest.approx((0.3, 0.3 / LENGTH))


def test_own_force(monkeypatch):
    """A user's own force acts: a bluff front pulls a towed body backward, by the surface along its motion."""
    monkeypatch.setitem(FORCES, "front", robot)
    coefficient, speed = 0.1, 0.3
    rough = robot.with_bluff_front(FISH, FISH.water, coefficient)
    smooth, found = (prescribe(FISH, np.zeros((1, 4)), PERIOD, water=w, speed=speed).force[0, 0]
                     for w in (FISH.water, rough))  # fmt: skip
    p, q, r, s = FISH.body.position[FISH.body.faces.nodes.T]
    area = 0.5 * np.cross(r - p, s - q)
    along = (np.linalg.norm(area, axis=1) - area[:, 0] ** 2 / np.linalg.norm(area, axis=1)).sum()
    assert found - smooth == pytest.approx(-500.0 * coefficient * speed**2 * along, rel=1e-9)


def test_heaving():
    """The power of a body that heaves is that of its mass and of the water on its faces, if that has no inertia."""
    still = FISH.water._replace(added_mass=None, righting=0.0)
    found = prescribe(FISH, heave, PERIOD, water=still, speed=0.0)
    rate = SHIFT * LENGTH * OMEGA * np.cos(OMEGA * found.time)
    water = [naive.water_force(FISH.body, still, FISH.body.position, v) for v in
             rate[:, None, None] * np.tile((0.0, 1.0, 0.0), (len(MASS), 1))]  # fmt: skip
    water = np.array(water).sum(axis=1)[:, 1]
    lift = -MASS.sum() * SHIFT * LENGTH * OMEGA**2 * np.sin(OMEGA * found.time)
    np.testing.assert_allclose(found.force[:, 1], water, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.power, (lift - water) * rate, rtol=1e-9, atol=1e-9)
    assert found.sweep == pytest.approx(2.0 * SHIFT)


@pytest.mark.parametrize("body", ["mass_spring", "tetrahedral"])
def test_free(body):
    """Force changes momentum, no torque acts on either end, and the torque bends with the power that goes in.

    That power changes the kinetic energy of the body and is lost to the water, which has none itself.
    """
    fish = make_fish(body, water="drag")
    found, mass = prescribe(fish, wave, PERIOD), fish.body.mass
    v = check_balance(found, fish)
    lost = [(naive.water_force(fish.body, fish.water, *at) * at[1]).sum() for at in zip(found.position, v, strict=True)]
    stored = change_of(0.5 * (mass @ (v**2).sum(axis=2).T))
    np.testing.assert_allclose(found.power, stored - lost, atol=0.02 * found.power.max())
    assert found.power.mean() > 0.0 and found.speed > 0.1 and found.strouhal == pytest.approx(
        found.sweep[-1] * LENGTH / PERIOD / found.speed
    )  # fmt: skip


def test_inertia_of_the_water():
    """A body that heaves moves the water beside its sections; one that swims balances momentum and torque with it."""
    water = make_water(drag_coefficient=0.2, inertia=True)
    found = prescribe(FISH, heave, PERIOD, water=water, speed=0.0)
    drag = prescribe(FISH, heave, PERIOD, water=make_water(drag_coefficient=0.2), speed=0.0)
    beside = 1000.0 * FISH.body.sections.lateral.sum() * SHIFT * LENGTH * OMEGA**2 * np.sin(OMEGA * found.time)
    np.testing.assert_allclose(found.force[:, 1] - drag.force[:, 1], beside, rtol=1e-9, atol=1e-9)
    check_balance(prescribe(FISH, wave, PERIOD, water=water), FISH)


def test_without_water():
    """Without water, a body that bends stays where it is, and puts in no power on average."""
    found = prescribe(FISH, wave, PERIOD, water=VACUUM)
    centre = found.position.transpose(0, 2, 1) @ MASS
    np.testing.assert_allclose(centre, np.tile(centre[0], (len(centre), 1)), atol=1e-8)
    assert found.power.std() > 1e-4 and abs(found.power.mean()) < 1e-6 * found.power.std()
    assert np.abs(found.force).max() < 1e-12 and abs(found.relative_speed) < 1e-6


def test_tables():
    """Offsets and points of a table swim as the function that they are of."""
    wanted = prescribe(FISH, wave, PERIOD)
    for given in (table(), table(points=True)):
        found = prescribe(FISH, given, PERIOD)
        np.testing.assert_allclose(found.torque, wanted.torque, atol=2e-3 * wanted.torque.max())
        assert found.speed == pytest.approx(wanted.speed, rel=2e-3)


@pytest.mark.parametrize(
    ("midline", "others", "message"),
    [
        (lambda place, time: np.where(place > 0.5, np.nan, place), {}, "midline is not finite at instant 0, place 51"),
        (lambda place, time: 0.1 * time * place, {}, "midline changes by 0.05 body lengths from one period"),
        (lambda place, time: 0.5 * np.sin(6 * place), {}, "midline stretches the body: its offset changes by 3"),
        (1.2 * table(points=True), {}, "midline stretches the body: its points are 1.2 body lengths long"),
        (np.zeros((3, 3)), {}, r"midline has shape \(3, 3\); give a function"),
        ("wave", {}, "midline is not an array of numbers"),
        (wave, {"period": 0.0}, r"period \(s\) is 0.0 at \(\); give positive"),
        (wave, {"water": "soup"}, "unknown water 'soup'; choose from 'none', 'drag'"),
        (wave, {"speed": "fast"}, "speed is 'fast'; give a finite number of m/s, or None"),
    ],
)  # fmt: skip
def test_refused(midline, others, message):
    """What a body cannot follow, and other wrong arguments."""
    with pytest.raises(ValueError, match=message):
        prescribe(FISH, midline, **{"period": PERIOD, **others})


def test_water_too_heavy_for_the_steps():
    """Where the steps of the method are too long for the water, that is said at once."""
    with pytest.raises(ArithmeticError, match="grows without limit: the water is too heavy for 64 steps"):
        prescribe(FISH, wave, PERIOD, water=make_water(drag_coefficient=1e4))
