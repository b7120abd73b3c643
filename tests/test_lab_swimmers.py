"""Fish that are steered in the laboratory, without a browser."""

import numpy as np
import pytest

from fish_env.lab.stage import Pointer
from fish_env.lab.swimmers import DRIVERS, GAIT, SWERVE, TURN, YOU, Swimmers


def made(driver="policy for turns", num_fish=1) -> Swimmers:
    """Fish of a driver."""
    return Swimmers("", "", driver, num_fish)


def put(school, point, phase="start") -> None:
    """Press at a point (3,) m."""
    school.point(Pointer(phase, np.asarray(point, dtype=float), -1))


def swum(driver="policy for turns", num_fish=1, seconds=1.0) -> Swimmers:
    """Fish that have swum for some seconds."""
    school = made(driver, num_fish)
    school.advance(seconds)
    return school


@pytest.mark.parametrize(
    "driver", [name for name in DRIVERS if DRIVERS[name][0] != "target" and name not in (GAIT, YOU)]
)
def test_fish_turn_by_the_commanded_angle(driver):
    """Fish turn by the commanded angle, and back."""
    school = swum(driver, 3)
    most = 1 if driver == "policy for speed" else 3  # it was trained with commands of up to half a radian
    for turns in (most, -most):
        school.turn(turns * TURN)
        school.advance(3.0)
        assert np.degrees(school.commanded) == pytest.approx(30.0 * most if turns > 0 else 0.0)
        assert np.degrees(school.heading - school.commanded) == pytest.approx(0.0, abs=12.0)


def test_nothing_steers_the_gait():
    """Nothing steers the gait: a command changes no bit of the motion."""
    school, other = made(GAIT), made(GAIT)
    school.turn(TURN)
    for each in (school, other):
        each.advance(1.0)
    assert np.array_equal(school.shown_positions(), other.shown_positions())


def test_left_after_right_is_commanded_before_the_first_turn_is_complete():
    """Left after right is commanded before the first turn is complete."""
    school = swum()
    school.left_after_right()
    school.advance(0.2)
    assert school.commanded[0] == pytest.approx(-SWERVE)
    at_most = school.facing[0]
    school.advance(0.05)
    assert at_most - SWERVE < school.commanded[0] - SWERVE and school.commanded[0] > 0.0
    school.advance(3.0)
    assert school.heading[0] == pytest.approx(school.commanded[0], abs=np.radians(12.0))


def test_a_school_swims_as_each_fish_alone():
    """A school swims as each fish alone: one call of the policy for all of them is that for one."""
    school, alone = swum(num_fish=5), swum()
    assert np.allclose(school.waters.tank.position[0], alone.waters.tank.position[0], atol=1e-3 * alone.fish.length)
    apart = school.shown_positions().mean(axis=1) - school.waters.tank.position.mean(axis=1)
    assert np.linalg.norm(apart[:, None] - apart[None], axis=2)[np.triu_indices(5, 1)].min() > school.fish.length


@pytest.mark.parametrize(("driver", "count"), [("policy for targets", 2), ("motor controllers, targets", 1)])
def test_a_target_that_is_put_is_reached(driver, count):
    """A target that is put is reached, by every fish where it is shown to that fish."""
    school = swum(driver, count, 0.5)
    goal = school.shown_positions()[0].mean(axis=0) + school.fish.length * np.array([1.5, 1.0, 0.0])
    goal[2] = 0.0
    before = school.task.reached.copy()
    put(school, goal)
    assert school._spheres()[:, :3] == pytest.approx(np.tile(goal, (count, 1)))
    nearest = np.full(count, np.inf)
    for _ in range(400):
        school.advance(0.02)
        nose = school.shown_positions()[:, school.fish.nose]
        nearest = np.minimum(nearest, np.linalg.norm(nose - goal, axis=1))
    assert (nearest < 1.2 * school.task.radius * school.length).all() and (school.task.reached > before).all()


def test_an_obstacle_that_is_put_is_passed():
    """An obstacle that is put is passed: one that the fish would else swim into."""
    school, blind = swum("policy for obstacles", 1, 1.0), swum("policy for speed", 1, 1.0)
    goal = school.shown_positions()[0].mean(axis=0) + school.fish.length * np.array([2.0, 0.05, 0.0])
    put(school, goal)
    room = {}
    for each in (school, blind):
        room[each] = np.inf
        for _ in range(150):
            each.advance(0.02)
            room[each] = min(room[each], float(np.linalg.norm(each.shown_positions()[0] - goal, axis=1).min()))
    assert room[school] > school.task.radius * school.length > room[blind]
    assert not school.task.touched[0] and np.ptp(school.shown_positions()[0, :, 0]) > 0.0
    assert school.shown_positions()[0, :, 0].min() > goal[0]
    school.obstacles.clear()
    school.advance(0.02)
    assert not school.task.present.any()


def test_each_fish_sees_the_obstacle_that_is_nearest():
    """Each fish sees the obstacle that is nearest."""
    school = made("policy for obstacles", 2)
    centres = school.shown_positions().mean(axis=1)
    for centre in centres:
        put(school, centre + school.fish.length * np.array([3.0, 0.0, 0.0]))
    school.advance(school.interval)
    assert school.task.obstacle + school.offset == pytest.approx(np.array(school.obstacles))


def test_pictures_lie_between_two_steps():
    """Pictures lie between two environment steps."""
    school = swum(seconds=0.5)
    place = school.waters.tank.position + school.offset[:, None]
    before = school.shown_positions()
    assert before == pytest.approx(school._before + school.offset[:, None])
    school.advance(0.5 * school.interval)
    assert school.shown_positions() == pytest.approx(0.5 * (before + place))


def test_fish_follow_the_pointer():
    """A pointer to the left turns the fish to the left, one to the right back; turned off, it does nothing."""
    school = swum()
    for way, heading in (((0.0, 4.0, 0.0), 90.0), ((4.0, 0.0, 0.0), 0.0)):
        for _ in range(40):
            put(school, school.shown_positions()[0].mean(axis=0) + school.length * np.array(way), "hover")
            school.advance(0.05)
        assert np.degrees(school.heading[0]) == pytest.approx(heading, abs=15.0)
    school._set_follow(False)
    before = school.commanded.copy()
    put(school, (0.0, 0.0, 0.0), "hover")
    school.advance(0.1)
    assert np.array_equal(school.commanded, before)


def test_a_fast_start_gets_away():
    """From rest, the fish turns by a right angle and is two lengths away within its time."""
    school = swum("policy for fast starts")
    school.fast_start()
    school.advance(1.2)
    assert np.degrees(school.facing[0]) == pytest.approx(90.0, abs=25.0)
    assert school._centres()[0, 1] > 2.0 * school.length
    school.advance(1.0)
    assert np.degrees(school.heading[0]) == pytest.approx(90.0, abs=15.0)


def test_muscles_by_hand():
    """A slider contracts its muscle alone."""
    school = made(YOU)
    sliders = [control for control in school.controls() if control.group == "Muscles"]
    assert len(sliders) == 12 and len({control.label for control in sliders}) == 12
    sliders[3].set(1.0)
    school.advance(0.2)
    assert school._contraction()[0] == pytest.approx(np.eye(12)[3], abs=0.05)


def test_a_fish_that_fails_is_told_of_with_its_node():
    """One message with a count and the reason; the fish and the node are named, and starting again helps."""
    school = swum(num_fish=2)
    school.waters.tank.velocity[1, 5] = np.nan
    school.advance(0.02)
    assert "1 of 2 fish failed" in school.failure and school.failed[0] == 1
    school.advance(1.0)
    assert school.failure and school.time < 1.1
    school.reset()
    assert school.waters.tank.alive.all() and school.time == 0.0 and not school.failure


def test_every_fish_has_its_arrow():
    """A target that is near one fish takes the arrows of no other."""
    school = made("policy for targets", 9)
    for i in range(9):
        school.task.target[i] = school.waters.tank.position[i].mean(axis=0) + 2.0 * school.length * np.eye(3)[0]
    assert len(school.frame().arrows) == 9
    school.task.target[4] -= 1.6 * school.length * np.eye(3)[0]
    assert len(school.frame().arrows) == 8


def test_film():
    """The last seconds of one fish are a page that stands alone; of two there is none."""
    school = swum(seconds=0.5)
    text = school.film()["text"]
    assert text.startswith("<!DOCTYPE html>") and "from the laboratory" in text and "src=" not in text
    with pytest.raises(ValueError, match="choose one fish"):
        made(num_fish=2).film()
