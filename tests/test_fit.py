"""What inexpensive bodies are fitted by: residuals, sections that invert, parameters and their ranges."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.calibration import commands, fit_search
from benchmarks.calibration.fit_search import SEARCHED, Search, beginning, parameters
from benchmarks.calibration.keep import rounded
from benchmarks.common.motion import FAILED, Motion, areas, errors, play, residuals
from benchmarks.common.roll import roll, strong_gaits
from benchmarks.common.search import minimise
from fish_env import Tank, make_fish
from fish_env.bodies import BODIES
from fish_env.bodies import mass_spring as tu
from fish_env.bodies.fitted import read_calibration


def drawn_motion(seed, scenes=3, intervals=120) -> Motion:
    """A motion of random walks, heading in any direction."""
    generator = np.random.default_rng(seed)
    centre = np.cumsum(0.01 + 0.003 * generator.standard_normal((scenes, intervals, 3)), axis=1)
    centre[:, :, 2] = 0.0
    yaw = np.cumsum(0.02 * generator.standard_normal((scenes, intervals)), axis=1)
    tail = 0.1 * generator.standard_normal((scenes, intervals))
    return Motion(centre, yaw, tail, np.ones((scenes, intervals)), [""] * scenes)


def test_residuals_are_the_errors():
    """The first two are the errors of speed and sweep with signs; the others square to those of heading and path."""
    found, finest = drawn_motion(1), drawn_motion(2)
    rows, off = residuals(found, finest, 0.02), errors(found, finest, 0.02)
    np.testing.assert_allclose(np.abs(rows[:, 0]), off["speed"], rtol=1e-12)
    np.testing.assert_allclose(np.abs(rows[:, 1]), off["sweep"], rtol=1e-12)
    turned = np.maximum(np.abs(finest.yaw).max(axis=1), np.pi / 2)
    heading = np.sqrt(((found.yaw - finest.yaw) ** 2).mean(axis=1)) / turned
    np.testing.assert_allclose(np.linalg.norm(rows[:, 2:122], axis=1), heading, rtol=1e-12)
    assert (np.linalg.norm(rows[:, 122:], axis=1) >= 0.98 * off["path"]).all()  # a root mean square is above the mean
    assert np.abs(residuals(finest, finest, 0.02)).max() == 0.0


def test_residuals_of_a_fish_that_failed():
    """A motion that is not finite has the largest residuals, and the other scenes keep theirs."""
    found, finest = drawn_motion(1), drawn_motion(2)
    healthy = residuals(found, finest, 0.02)
    found.centre[1], found.yaw[1], found.tail[1] = np.nan, np.nan, np.nan
    rows = residuals(found, finest, 0.02)
    assert (rows[1] == FAILED).all()
    np.testing.assert_array_equal(rows[[0, 2]], healthy[[0, 2]])


@pytest.mark.parametrize("body", ["mass_spring", "planar", "tetrahedral"])
def test_areas_of_sections(body):
    """A section at rest has its area, whatever the heading and the roll; one whose sides cross has a negative one."""
    fish = make_fish(body)
    points = fish.points(fish.body.position[None])
    p = tu.check_parameters("mass_spring", {})
    width, along = np.array(p.half_width), np.diff(p.layer_position)
    wanted = fish.length**2 * along * (width[1:] + width[:-1])
    np.testing.assert_allclose(areas(points)[0], wanted, rtol=1e-9)
    angle = 1.1
    c, s = np.cos(angle), np.sin(angle)
    for turn in ([[c, s, 0], [-s, c, 0], [0, 0, 1]], [[1, 0, 0], [0, c, s], [0, -s, c]]):
        np.testing.assert_allclose(areas(points @ np.array(turn))[0], wanted, rtol=1e-9)
    crossed = points.copy()
    layer = np.array(tu.LAYERS[3])
    crossed[0, layer, 0] = points[0, tu.LAYERS[1][0], 0] + 0.01  # the third layer in front of the first
    assert areas(crossed)[0, 1] < 0.0


def test_play_reports_the_least_area():
    """A fish at rest keeps its sections; one that bends keeps of each the least that it has after an interval."""
    fish = make_fish("planar")
    still, bent = np.zeros((1, 20, 12)), np.zeros((1, 20, 12))
    bent[0, :, fish.sides > 0] = 1.0
    kept = play(fish, np.concatenate([still, bent])).kept
    np.testing.assert_allclose(kept[0], 1.0, atol=1e-12)
    tank, least, rest = Tank(fish, 1, water=fish.water), [], areas(fish.points(fish.body.position[None]))[0]
    for goal in bent[0]:
        tank.drive(goal[None], round(fish.control_interval / tank.dt))
        least.append(areas(fish.points(tank.position))[0] / rest)
    np.testing.assert_allclose(kept[1], np.min(least, axis=0), rtol=1e-12)
    assert (kept[1] > 0.5).all() and kept[1, :3].max() < 0.99  # the three segments with muscles


@pytest.mark.parametrize(("water", "body"), [(water, body) for water in SEARCHED for body in SEARCHED[water]])
def test_parameters_at_the_beginning(water, body):
    """A search begins at the values of its table, which are within their ranges and make a body."""
    start, low, high = beginning(body, water)
    assert ((low < start) & (start < high)).all()
    given = parameters(body, water, start)
    for name, (values, least, most) in SEARCHED[water][body].items():
        np.testing.assert_allclose(given[name], values[0] if len(values) == 1 else values, rtol=1e-12)
        assert least < min(values) and max(values) < most
    assert make_fish(body, water=water, **rounded(given)).body.mass.sum() > 0.0
    short = {"a": [0.1235, 12350.0], "b": 0.0001235, "c": "trout", "d": None}
    assert rounded({"a": [0.123456, 12345.6], "b": 0.000123456, "c": "trout", "d": None}) == short


def test_scenes_that_count_more():
    """A weight multiplies the rows of its scene, and those alone; the scenes of a task come in a row."""
    swum, point = np.zeros((2, 75, 12)), beginning("planar", "drag")[0]
    swum[1, :, ::2] = 0.5
    finest = play(make_fish("mass_spring"), swum)
    plain, weighted = (Search("planar", "drag", swum, finest, weights=w).residuals(point) for w in (None, [1.0, 3.0]))
    size = 2 + 3 * swum.shape[1]
    np.testing.assert_array_equal(weighted[:size], plain[:size])
    np.testing.assert_allclose(weighted[size : 2 * size], 3.0 * plain[size : 2 * size], rtol=1e-12)
    np.testing.assert_array_equal(weighted[2 * size :], plain[2 * size :])
    assert np.abs(plain[size : 2 * size]).max() > 0.0
    found = commands.weights()
    assert found.size == len(commands.training_scenes(0, 1.0)) and set(found) == {1.0, 2.0}
    assert (found[-commands.EACH["sprints"] :] == 2.0).all()


def test_shipped_bodies_are_what_a_search_may_find():
    """The fitted parameters in the package lie within the ranges of the search."""
    for water, bodies in SEARCHED.items():
        for body, ranges in bodies.items():
            if water not in BODIES[body].waters:
                continue
            kept = read_calibration(body, water)["parameters"]
            for name, (start, least, most) in ranges.items():
                value = np.ravel(kept[name])
                assert value.size == len(start)
                assert (value >= least * (1 - 1e-3)).all() and (value <= most * (1 + 1e-3)).all(), (body, name)


def test_the_search_finds_the_way_back():
    """A body has no distance to its own motion, and a search gets most of the way back from one that was changed."""
    fish = make_fish("planar", water="drag")
    swum = np.zeros((2, 75, 12))
    times = np.arange(75) * 0.02
    for k, frequency in enumerate((2.0, 3.0)):
        wave = np.sin(2 * np.pi * (frequency * times[:, None] - 0.2 * fish.segments))
        swum[k] = 0.5 * (1.0 + fish.sides * wave)
    problem, kept = Search("planar", "drag", swum, play(fish, swum)), read_calibration("planar", "drag")["parameters"]
    point = np.concatenate([fit_search.logarithms(name, np.ravel(kept[name])) for name in SEARCHED["drag"]["planar"]])
    motion = slice(0, swum.shape[0] * (2 + 3 * swum.shape[1]))
    assert np.abs(problem.residuals(point)[motion]).max() < 1e-12
    searched = [1, 7, 10]  # bending, muscles and drag of a section

    def squares(part):
        changed = point.copy()
        changed[searched] = part
        return float((problem.residuals(changed)[motion] ** 2).sum())

    away = point[searched] + [0.02, -0.02, 0.02]  # stiffer and weaker: the one does not make up for the other
    _, least = minimise(squares, away, 0.02, 8, 1, 6)
    assert least < 0.01 * squares(away)


def test_a_flat_fish_does_not_roll():
    """The flat fish stays upright in every strong gait, the default one rolls a little, and a failed one counts pi."""
    assert roll(make_fish("planar")).max() < 1e-7
    angles = roll(make_fish("mass_spring"))
    assert angles.shape == (len(strong_gaits()),) and 0.0 < angles.max() < np.pi
    torn = roll(replace(make_fish("mass_spring"), refine=np.inf, time_step=0.02, control_interval=0.02))
    assert (torn == np.pi).any()
