"""Outlines: shape, masses and refusals of every body that is built from a table of stations."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fish_env import Tank, make_fish
from fish_env.bodies import mass_spring as tu
from fish_env.bodies import masses
from fish_env.bodies.fitted import read_calibration
from fish_env.bodies.outline import layers_of, outline_of, read_outline
from fish_env.control.gait import best_gait

BODIES = [("mass_spring", {}), ("planar", {}), ("two_layer", {}), ("tetrahedral", {}), ("tetrahedral", {"level": 2})]
BARREL = [(0.0, 0.02, 0.03), (0.25, 0.07, 0.06), (0.6, 0.06, 0.09), (1.0, 0.01, 0.05)]  # blunt, without a peduncle
each_body = pytest.mark.parametrize(("body", "options"), BODIES, ids=str)


def parameters(**given):
    """Those of the default body, some of them replaced."""
    return tu.check_parameters("mass_spring", given)


def check_masses(body, options, outline, length):
    """Mass, centre and yaw inertia are those of ellipses, by quadrature of 20,000 slices."""
    fish, table = make_fish(body, outline=outline, length=length, **options), read_outline(outline)
    s = length * (np.arange(20_000) + 0.5) / 20_000
    width, depth = (length * np.interp(s / length, table.place, part) for part in (table.widths, table.depths))
    slices = 1000.0 * np.pi * width * depth * length / s.size
    found = masses.moments(fish.body.mass, fish.body.position)
    centre = slices @ s / slices.sum()
    yaw = slices @ ((s - centre) ** 2 + width**2 / 4)
    assert (found.mass, -found.centre, found.inertia[2]) == pytest.approx((slices.sum(), centre, yaw), rel=1e-5)
    assert fish.body.mass.min() > 0.0
    return fish


@each_body
@pytest.mark.parametrize("outline", ["trout", BARREL], ids=["trout", "barrel"])
def test_masses_follow_the_outline(body, options, outline):
    """Every body has them; of the solid ones roll and pitch too. Landmarks are where those of the default body are."""
    fish = check_masses(body, options, outline, 0.25)
    wanted = masses.continuum(parameters(outline=outline, length=0.25)).inertia
    if body in ("two_layer", "tetrahedral"):
        found = masses.moments(fish.body.mass, fish.body.position).inertia
        np.testing.assert_allclose(found, wanted, rtol=1e-8)
    default = make_fish(outline=outline, length=0.25)
    np.testing.assert_allclose(fish.points(fish.body.position), default.body.position, rtol=0, atol=1e-12)


@settings(max_examples=10)
@given(
    count=st.integers(2, 12), bulge=st.floats(0.5, 1.5), depth=st.floats(0.05, 0.15), narrow=st.floats(0.3, 1.0),
    tail=st.floats(0.02, 0.15), seed=st.integers(0, 99),
)  # fmt: skip
def test_masses_follow_any_outline(count, bulge, depth, narrow, tail, seed):
    """Also where the stations are few, many or nowhere near the layers."""
    inside = np.sort(np.random.default_rng(seed).uniform(0.02, 0.98, count))
    half = depth * np.sin(np.pi * inside**bulge) + 0.01
    table = np.array([(0, 0, 0), *zip(inside, narrow * half, half, strict=True), (1, 0, tail)])
    for body, options in BODIES[:2] + BODIES[3:]:
        check_masses(body, options, table, 0.2)


def test_trout():
    """It has a trout's mass and tail fin; its last layer stands in its peduncle, unless layers are given."""
    p = parameters(outline="trout")
    assert 0.0107 < masses.continuum(p).mass / (1000.0 * p.length**3) < 0.0110
    assert p.tail_half_span == pytest.approx(0.5 * 0.18 * 20.0**1.05 / 20.0, rel=1e-3)  # Webb 1984, cm
    narrowest = outline_of(p).place[5:][np.argmin(outline_of(p).depths[5:])] / p.length
    assert p.layer_position == (*tu.calibrated()["layer_position"][:4], narrowest)
    assert parameters(outline=BARREL).layer_position == tuple(tu.calibrated()["layer_position"])
    assert parameters(outline="trout", layer_position=(0.2, 0.4, 0.5, 0.7, 0.9)).layer_position[4] == 0.9


@pytest.mark.parametrize("body", ["mass_spring", "planar", "two_layer", "tetrahedral"])
def test_trout_swims(body):
    """With three times the stiffness, two seconds of the best gait's strokes carry every body forward."""
    own = read_calibration("tetrahedral") if body == "tetrahedral" else {"parameters": tu.calibrated()}
    stiffer = {"young": tuple(3.0 * np.array(own["young"]))} if "young" in own else {}
    fish = make_fish(body, outline="trout", stiffness=tuple(3.0 * np.array(own["parameters"]["stiffness"])), **stiffer)
    tank, gait = Tank(fish, 1, water=fish.water), replace(best_gait(), frequency=2.5)
    for k in range(100):
        tank.swim(gait.action(fish, np.array(0.02 * (k + 1))), 0.02)
    assert tank.alive[0] and tank.position[0, fish.nose, 0] > 0.8 * fish.length


def test_finer_meshes_follow_the_outline():
    """Between layers too: the volume inside a mesh tends to that of the outline, from below where it bulges."""
    p = parameters(outline="trout")
    off = []
    for level in (1, 2, 4):
        body = make_fish("tetrahedral", outline="trout", level=level).body
        off.append(body.tets.volume.sum() * 1000.0 / masses.continuum(p).mass - 1.0)
    assert -0.15 < off[0] < 3 * off[1] < 9 * off[2] < 0.0 and off[2] > -0.01, off
    middle = np.unique(body.position[:, 0])[10]  # behind it the fin, whose sides tend to the half axes
    place, high = -middle, body.position[body.position[:, 0] == middle, 2].max()
    whole = outline_of(p)
    assert (2.0 * high) ** 2 * whole.half_width(place) / whole.half_depth(place) == pytest.approx(whole.area(place))


def test_without_an_outline_every_bit_is_as_before():
    """The straight outline through seven layers, of rectangles, gives the sums that it always gave."""
    p = tu.check_parameters("mass_spring", {}, "drag")
    x, width, depth = p.length * np.array([
        [0.0, *(-np.array(p.layer_position)), -1.0], [0.0, *p.half_width, 0.0],
        [0.0, *p.half_depth, p.tail_half_span],
    ])  # fmt: skip
    np.testing.assert_array_equal(layers_of(p), [x, width, depth])
    assert not np.signbit(layers_of(p)[0, 0])
    share, step = 0.5 * (1.0 + masses.POINTS), 0.5 * masses.WEIGHTS * np.abs(np.diff(x))[:, None]
    x, width, depth = (row[:-1, None] + share * np.diff(row)[:, None] for row in (x, width, depth))
    mass = 1000.0 * 4.0 * width * depth * step
    layer = np.zeros(7)
    layer[:-1] += (mass * (1.0 - share)).sum(axis=1)
    layer[1:] += (mass * share).sum(axis=1)
    np.testing.assert_array_equal(masses.layer_masses(p), layer)
    found, centre = masses.continuum(p), (mass * x).sum() / mass.sum()
    assert (found.mass, found.centre) == (mass.sum(), centre)
    squares = [(mass * part).sum() for part in ((x - centre) ** 2, width**2 / 3.0, depth**2 / 3.0)]
    np.testing.assert_array_equal(found.squares, squares)


@pytest.mark.parametrize(
    ("outline", "text"),
    [
        ("eel", r"unknown outline 'eel'; choose 'trout' or give a table of stations, shape \(S, 3\)"),
        (0.2, r"outline has shape \(\); give shape \(4, 3\)"),
        (BARREL[:3], "outline has 3 stations; give 4 or more"),
        (np.ones((5, 2)), r"outline has shape \(5, 2\); give shape \(5, 3\)"),
        ([BARREL[0], (0.2, 0.1), *BARREL[2:]], r"outline is .*; give finite numbers of shape \(4, 3\)"),
        ([*BARREL[:3], (1.0, 0.0, np.nan)], r"outline is nan at \(3, 2\); give finite numbers"),
        (BARREL[::-1], r"outline has the places \[1.0, .*; give increasing ones, from 0 \(nose\) to 1 \(tail\)"),
        ([*BARREL[:3], BARREL[2], BARREL[3]], "outline has the places .*; give increasing ones"),
        ([*BARREL[:3], (0.9, 0.0, 0.05)], "outline has the places .*; give increasing ones"),
        ([*BARREL[:2], (0.6, -0.06, 0.09), BARREL[3]], "outline has the half width -0.06 at place 0.6; its sides must"),
        ([*BARREL[:2], (0.6, 0.06, -0.09), BARREL[3]], "outline has the half depth -0.09 at place 0.6"),
        ([*BARREL[:2], (0.6, 0.0, 0.09), BARREL[3]], "outline has no half width at place 0.6; there must be a volume"),
        (np.array(BARREL) * (1, 0, 1), "outline has no half width at place 0.25; there must be a volume"),
        ([*BARREL[:3], (1.0, 0.01, 0.0)], "outline has no half depth at place 1; give that of the tail fin's tips"),
    ],
    ids=str,
)  # fmt: skip
def test_outlines_that_are_refused(outline, text):
    """In one line that says what is allowed."""
    with pytest.raises(ValueError, match=text) as refused:
        make_fish(outline=outline)
    assert "\n" not in str(refused.value)


def test_an_outline_is_given_once():
    """Not beside the half depths that it has; nor to the published fish, whose masses were published."""
    with pytest.raises(ValueError, match="half_depth and an outline, which has it, are both given; give one of them"):
        make_fish("planar", outline="trout", half_depth=(0.1,) * 5)
    with pytest.raises(ValueError, match="unknown parameter 'outline' of the published fish"):
        make_fish("published", outline="trout")
