"""Fish that are steered in the laboratory, without a browser."""

import numpy as np
import pytest

from fish_env.lab.school import DRIVERS, SWERVE, TURN, School


def swum(driver="policy turn", num_fish=1, seconds=1.0) -> School:
    """A school that has swum for some seconds."""
    school = School(driver, num_fish)
    school.advance(seconds)
    return school


@pytest.mark.parametrize("driver", [name for name in DRIVERS if DRIVERS[name][0] != "target" and name[0] != "g"])
def test_fish_turn_by_the_commanded_angle(driver):
    """Fish turn by the commanded angle, and back."""
    school = swum(driver, 3)
    most = 1 if driver == "policy swim" else 3  # it was trained with commands of up to half a radian
    for turns in (most, -most):
        school.turn(turns * TURN)
        school.advance(3.0)
        assert np.degrees(school.commanded) == pytest.approx(30.0 * most if turns > 0 else 0.0)
        assert np.degrees(school.heading - school.commanded) == pytest.approx(0.0, abs=12.0)


def test_nothing_steers_the_gait():
    """Nothing steers the gait: a command changes no bit of the motion."""
    school, other = School("gait, which nothing steers"), School("gait, which nothing steers")
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


@pytest.mark.parametrize(("driver", "count"), [("policy target", 2), ("motor controllers, targets", 1)])
def test_a_target_that_is_put_is_reached(driver, count):
    """A target that is put is reached, by every fish where it is shown to that fish."""
    school = swum(driver, count, 0.5)
    goal = school.shown_positions()[0].mean(axis=0) + school.fish.length * np.array([1.5, 1.0, 0.0])
    goal[2] = 0.0
    before = school.task.reached.copy()
    school.put(goal)
    assert school.targets() == pytest.approx(np.tile(goal, (count, 1)))
    nearest = np.full(count, np.inf)
    for _ in range(400):
        school.advance(0.02)
        nose = school.shown_positions()[:, school.fish.nose]
        nearest = np.minimum(nearest, np.linalg.norm(nose - goal, axis=1))
    assert (nearest < 1.2 * school.radius).all() and (school.task.reached > before).all()


def test_an_obstacle_that_is_put_is_passed():
    """An obstacle that is put is passed: one that the fish would else swim into."""
    school, blind = swum("policy avoid", 1, 1.0), swum("policy swim", 1, 1.0)
    goal = school.shown_positions()[0].mean(axis=0) + school.fish.length * np.array([2.0, 0.05, 0.0])
    school.put(goal)
    room = {}
    for each in (school, blind):
        room[each] = np.inf
        for _ in range(150):
            each.advance(0.02)
            room[each] = min(room[each], float(np.linalg.norm(each.shown_positions()[0] - goal, axis=1).min()))
    assert room[school] > school.radius > room[blind]
    assert not school.task.touched[0] and np.ptp(school.shown_positions()[0, :, 0]) > 0.0
    assert school.shown_positions()[0, :, 0].min() > goal[0]
    school.clear()
    school.advance(0.02)
    assert not school.task.present.any()


def test_each_fish_sees_the_obstacle_that_is_nearest():
    """Each fish sees the obstacle that is nearest."""
    school = School("policy avoid", 2)
    centres = school.shown_positions().mean(axis=1)
    for centre in centres:
        school.put(centre + school.fish.length * np.array([3.0, 0.0, 0.0]))
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


def test_what_the_page_asks_for_is_checked():
    """What the page asks for is checked."""
    school = School()
    for wrong in (lambda: School("policy ../turn"), lambda: School("policy turn", 0), lambda: School(num_fish=10**6),
                  lambda: School(num_fish=True), lambda: school.turn(np.nan), lambda: school.turn("1"),
                  lambda: school.turn(4.0), lambda: school.put((0.0, 0.0, 0.0)),
                  lambda: School("policy target").put((np.nan, 0.0, 0.0)),
                  lambda: School("policy target").put((1e9, 0.0, 0.0))):  # fmt: skip
        with pytest.raises(ValueError, match=r"choose|give"):
            wrong()
    assert school.commanded[0] == 0.0 and np.isfinite(school.shown_positions()).all()


def test_a_fish_that_fails_is_told_of_and_all_begin_again():
    """A fish that fails is told of, and all begin again."""
    school = swum(num_fish=2)
    school.waters.tank.velocity[1] = np.nan
    school.advance(0.02)
    assert "1 fish failed" in school.messages[0]
    assert school.waters.tank.alive.all() and school.time == 0.0
