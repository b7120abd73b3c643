"""The laboratory's scenes and sessions, without a browser: what is chosen, changed, dragged, steered and answered."""

import json
import struct
from functools import partial

import numpy as np
import pytest

from fish_env.control.policy import load_policy
from fish_env.lab.objects import MOTIONS, SCALE, SETTINGS, Entry, ObjectScene, signed_volume
from fish_env.lab.session import SCENES, Session
from fish_env.lab.swimmers import BETWEEN, DRIVERS, GAIT, SWERVE, TURN, YOU, SwimmerScene, UserScene
from fish_env.soft.distorted import DISTORTIONS
from fish_env.soft.volume import volume_of

ASK = {"do": "frame"}


@pytest.fixture(scope="module")
def session():
    """A session that tests leave as it is, but for its scene."""
    session = Session()
    yield session
    session.close()


def advance(scene, frames, rate=30):
    """The scene, moved on by so many frames."""
    for _ in range(frames):
        scene.advance(1 / rate)
    return scene


def control(scene, name):
    """A control of a scene, by its name."""
    return next(each for each in scene.controls() if each.name == name)


def messages(replies) -> dict:
    """The messages of an answer that are text, together."""
    found = {}
    for reply in replies:
        found |= json.loads(reply) if isinstance(reply, str) else {}
    return found


def picture(replies) -> tuple[dict, np.ndarray]:
    """Header and numbers of the picture in an answer."""
    (data,) = [reply for reply in replies if isinstance(reply, bytes)]
    (size,) = struct.unpack("<I", data[:4])
    return json.loads(data[4 : 4 + size]), np.frombuffer(data[4 + size :], "<f4")


def test_what_the_page_chooses_is_checked():
    """Names that are not offered, methods that cannot move an object and too many nodes change nothing."""
    ring = ObjectScene([Entry("ring")])
    tank = ring.objects[0].tank
    for name, value in (("object 0", "../ring"), ("integrator 0", "euler"), ("walls", "x"), ("nodes 0", 1000),
                        ("integrator 0", "dop853"), ("stiffness", 5.1)):  # fmt: skip
        with pytest.raises(ValueError, match=r"choose|give"):
            control(ring, name).set(value)
    with pytest.raises(ValueError, match="at most 1100"):
        ring.choose([Entry("ring"), Entry("block", "", (("cells", 10),))])
    assert ring.objects[0].tank is tank and len(ring.objects) == 1
    for setting in SETTINGS.values():
        assert isinstance(setting.default, bool | str) or setting.low <= setting.default <= setting.high


def test_a_change_goes_on_in_the_same_motion():
    """A change of numbers or walls keeps positions and velocities, and reaches the body and the world."""
    scene = advance(ObjectScene([Entry("ring")]), 6)
    x, v = scene.objects[0].tank.position.copy(), scene.objects[0].tank.velocity.copy()
    for name, value in (("stiffness", 2.0), ("damping", 0.5), ("pressure", 0.5), ("density", 2.0),
                        ("inner_density", 2.0), ("gravity", 1.0), ("restitution", 0.0), ("step", 0.5)):  # fmt: skip
        dt = scene.objects[0].tank.dt
        scene.set(name, value)
        tank = scene.objects[0].tank
        assert np.array_equal(tank.position, x) and np.array_equal(tank.velocity, v)
    body, own = tank.fish.body, scene.objects[0].original.body
    assert np.allclose(body.springs.stiffness, 2.0 * own.springs.stiffness)
    assert np.allclose(body.springs.damping, 0.5 * own.springs.damping)
    assert np.allclose(body.compartments.gas, own.compartments.gas)  # stiffness doubles it, pressure halves it
    assert body.mass[:12] == pytest.approx(2.0 * own.mass[:12]) and body.mass[12:] == pytest.approx(4.0 * own.mass[12:])
    assert np.linalg.norm(tank.world.gravity) == pytest.approx(1.0) and tank.dt == pytest.approx(0.5 * dt)
    assert set(tank.world.planes[:, 4]) == {0.0}
    for walls, planes, shown in (("closed room", 6, 3), ("none", 0, 0), ("own", 3, 2)):
        scene.set("walls", walls)
        found = scene.objects[0].tank.world.planes
        assert (0 if found is None else len(found)) == planes and len(scene.frame().walls) == shown
    for name, value in (("density", 1.0), ("inner_density", 1.0), ("pressure", 0.0)):
        scene.set(name, value)
    assert scene.objects[0].tank.fish.body.compartments is None and not advance(scene, 6).failure


def test_free_fall_is_that_of_gravity():
    """A ring falls with 9.81 m/s2; motion and height exchange energy, and it hardly deforms."""
    scene = ObjectScene([Entry("ring")])
    energies = [advance(scene, 1, rate=60).objects[0].energies() for _ in range(12)]
    tank = scene.objects[0].tank
    centre = tank.fish.body.mass @ tank.position[0] / tank.fish.body.mass.sum()
    assert centre[1] == pytest.approx(-0.5 * 9.81 * tank.time[0] ** 2, rel=1e-9)
    assert max(abs(total) for _, total in energies) < 1e-3 * energies[-1][0]
    motion, stored, lost = dict(zip(scene.plots, scene.readings(), strict=True))["energy of the first (J)"]
    assert motion > 0.0 > stored and abs(lost) < 0.02 * motion


def test_a_drag_brings_the_node_to_the_pointer():
    """The node of the surface nearest to the pointer is pulled there, in all objects with as many nodes."""
    scene = ObjectScene([Entry("ring"), Entry("ring", "rk4"), Entry("beam")])
    scene.set("gravity", 0.0)
    press = scene.frame().bodies[0].position[3]
    scene.point("start", press, 0)
    assert scene.dragged == (0, 3) and scene.frame().balls and scene.frame().arrows
    goal = press + np.array([0.01, 0.0, 0.03])
    scene.point("move", goal, 0)
    rest = scene.objects[2].position.copy()
    advance(scene, 120, rate=60)
    for body, offset in zip(scene.frame().bodies[:2], (0.0, scene.spacing), strict=True):
        assert np.linalg.norm(body.position[3] - goal - (offset, 0.0, 0.0)) < 0.003
    assert np.abs(scene.objects[2].position - rest).max() < 1e-3
    scene.point("end", goal, 0)
    assert scene.dragged is None and scene.objects[0].tank.world.anchors is None
    scene = ObjectScene([Entry("uniform sphere", "", (("level", 1),))])
    inner = scene.objects[0].original.inner
    scene.point("start", scene.frame().bodies[0].position[inner[4]], 0)
    assert scene.dragged[1] not in inner


def test_a_method_that_fails_is_named_and_waits():
    """A method that fails is named with its step and its node; half the step is a way on."""
    scene = ObjectScene([Entry("ring", "explicit_euler")])
    scene.set("step", 50.0)
    scene.throw()
    while not scene.failure:
        assert advance(scene, 1).time < 4.0
    assert "explicit_euler failed on the ring" in scene.failure and "step" in scene.failure
    assert scene.failed[0] == 0 and 0 <= scene.failed[1] < 24
    control(scene, "halve").set(None)
    assert scene.settings["step"] == 25.0 and not scene.failure and scene.objects[0].tank.alive.all()


def test_side_by_side_is_compared(monkeypatch):
    """Equal objects have no distance; at the same cost, steps that cost twice as much are twice as long."""
    scene = ObjectScene([Entry("ring"), Entry("ring"), Entry("ring", "explicit_euler")])
    advance(scene, 12, rate=60)
    assert scene.distance_of(1) == 0.0 and 0.0 < scene.distance_of(2) < 0.5
    assert scene.readings()[-1] == [scene.distance_of(1), scene.distance_of(2)]
    scene.choose([Entry("ring", "explicit_euler"), Entry("ring")])
    costs = {"explicit_euler": 1e-6, "": 2e-6}
    monkeypatch.setattr("fish_env.lab.objects.SimulatedObject.cost_of_step", lambda each: costs[each.entry.integrator])
    control(scene, "same_cost").set(True)
    cheap, costly = scene.objects
    assert cheap.tank.dt == cheap.own_step and costly.tank.dt == pytest.approx(2.0 * cheap.tank.dt)


@pytest.mark.parametrize(
    ("name", "labels"),
    [
        ("what the method does", ["1. leapfrog_chebyshev", "2. explicit_euler", "3. rk4"]),
        ("what the body does", ["1. mass_spring", "2. planar", "3. two_layer"]),
        ("what the water does", ["1. water: reactive", "2. water: drag"]),
        ("soft objects", []),
    ],
)
def test_labels_name_what_differs(name, labels):
    """Bodies that are compared have labels of what is not the same in all, and charts the same names."""
    scene = SCENES[name]()
    assert list(scene.labels) == labels and (not labels or scene.plots["largest strain"] == labels)
    scene.choose([Entry("ring"), Entry("ring"), Entry("ring", "", (("nodes", 20),))])
    assert list(scene.labels) == ["1. ring", "2. ring", "3. nodes 20"]


@pytest.mark.slow
def test_many_nodes_take_longer_steps():
    """By the stabilised method 841 nodes of a fish take twice their own step, those of solids four times, and last."""
    fine, rk4 = Entry("tetrahedral", "", (("level", 3),)), Entry("tetrahedral", "rk4", (("level", 3),))
    long, own = ObjectScene([fine], motion="gait"), ObjectScene([fine], motion="gait")
    assert long.settings["step"] == 2.0 and ObjectScene([rk4]).settings["step"] == 1.0
    own.set("step", 1.0)
    a, b = (advance(scene, 12).objects[0].position for scene in (long, own))
    assert np.sqrt(((a - b) ** 2).sum(axis=1).mean()) < 2e-3 * long.length
    assert not advance(long, 50).failure  # with four times its own step it is torn after 0.8 s
    for name, how in (("beam", "throw"), ("two materials", "twisted")):
        solid = ObjectScene([Entry(name, "", (("cells", 18), ("across", 6)))])
        control(solid, how).set(None)
        assert solid.settings["step"] == 4.0 and not advance(solid, 30).failure


@pytest.mark.parametrize("name", ["ring", "sphere", "uniform sphere", "beam", "mass_spring"])
def test_volumes(name):
    """A volume is that inside the surface, as of the gas; a ring has an area, and at rest the ratio is 1."""
    made = ObjectScene([Entry(name)]).objects[0]
    rest = made.look.marks(made.original.body.position)
    edges = np.pad(made.faces, ((0, 0), (0, 2)), constant_values=-1)
    faces = edges if name == "ring" else made.faces[:, [0, 1, 2, -1]]
    assert signed_volume(rest, made.faces) == pytest.approx(volume_of(faces, rest)[0], rel=0.02)
    made.position[:] *= 1.1
    assert made.volume() == pytest.approx(1.1 ** (2 if name == "ring" else 3), rel=1e-9)


def test_strains_are_those_of_the_eigenvalues():
    """Strains of tetrahedra are those of LAPACK, rotated and far out of shape."""
    made, noise = ObjectScene([Entry("tetrahedral")]).objects[0], np.random.default_rng(0)
    tets, rest = made.original.body.tets, made.original.body.position
    turn = np.linalg.qr(noise.normal(size=(3, 3)))[0]
    made.position[:] = (rest * (1.1, 0.7, 1.0)) @ turn.T
    assert made.largest_strain()[0] == pytest.approx(0.3, abs=1e-9)
    made.position[:] = x = rest + made.length * noise.normal(size=rest.shape)
    stretch = np.linalg.svd(np.einsum("tak,tal->tkl", x[tets.nodes], tets.gradient), compute_uv=False) - 1.0
    found = made.strains()[1]
    assert np.abs(found) == pytest.approx(np.abs(stretch).max(axis=1), rel=1e-9)
    assert (np.abs(stretch - found[:, None]).min(axis=1) < 1e-9).all()


@pytest.mark.parametrize("name", ["string", "beam", "ball", "two materials"])
def test_tones_tell_shortened_from_stretched(name):
    """A strain of a percent is told from rest, and thirty percent are the end of the scale."""
    made = ObjectScene([Entry(name)]).objects[0]
    assert np.abs(made.tone()).max() < 1e-3
    rest = made.original.body.position
    for strain, tone in ((0.01, (0.01 / SCALE) ** 0.5), (-0.01, -((0.01 / SCALE) ** 0.5)), (0.9, 1.0), (-0.9, -1.0)):
        made.position[:] = rest * (1.0 + strain, 1.0, 1.0)
        assert made.tone() == pytest.approx(tone, rel=1e-6)


def test_fish_move():
    """A fish swims by a gait, or turns; at rest it stays where it is."""
    scene = ObjectScene([Entry("mass_spring")])
    for motion in MOTIONS:
        scene.reset()
        control(scene, "motion").set(motion)
        moved = np.abs(advance(scene, 15).objects[0].position - scene.objects[0].original.body.position).max()
        assert (moved < 1e-3 * scene.length) == (motion == "rest") and (moved > 0.05 * scene.length) != (
            motion == "rest"
        )


def test_what_cannot_be_twisted_or_inverted_is_not_offered():
    """What lies in a plane is neither twisted nor inverted, springs alone are not inverted; a beam is twisted."""
    beam = ObjectScene([Entry("beam")])
    control(beam, "twisted").set(None)
    assert np.array_equal(beam.objects[0].position, DISTORTIONS["twisted"](beam.objects[0].original))
    for name, refused in (("ring", {"twisted", "inverted"}), ("mass_spring", {"inverted"}), ("beam", set())):
        scene = advance(ObjectScene([Entry("beam"), Entry(name)]), 3)
        before = scene.objects[0].position.copy()
        assert {"twisted", "inverted"} - {each.name for each in scene.controls()} == refused
        for how in refused:
            with pytest.raises(ValueError, match=r"in a plane|mirror image"):
                scene.reset(how=how)
        assert scene.time == pytest.approx(0.1) and np.array_equal(scene.objects[0].position, before)


def test_controls_are_those_that_apply():
    """Nothing is offered that does nothing, and every default is that of the object."""
    ring, fish = ({each.name: each for each in ObjectScene([Entry(name)]).controls()} for name in ("ring", "planar"))
    assert {"pressure", "inner_density", "throw", "walls"} <= set(ring) and "motion" not in ring
    assert "motion" in fish and not {"pressure", "inner_density", "throw", "same_cost"} & set(fish)
    assert all(each.default in (None, each.value) for each in (*ring.values(), *fish.values()))


def swum(driver="policy for turns", num_fish=1, seconds=1.0) -> SwimmerScene:
    """Fish that have swum for some seconds."""
    school = SwimmerScene("", "", driver, num_fish)
    school.advance(seconds)
    return school


def middle(school, i=0) -> np.ndarray:
    """Where a fish is shown, (3,) m."""
    return school.frame().bodies[i].position.mean(axis=0)


@pytest.mark.parametrize(
    "driver", [name for name in DRIVERS if DRIVERS[name][0] != "target" and name not in (GAIT, YOU)]
)
def test_fish_turn_by_the_commanded_angle(driver):
    """Fish turn by the commanded angle, and back; charts show it in degrees."""
    school = swum(driver, 3)
    most = 1 if driver == "policy for speed" else 3  # it was trained with commands of up to half a radian
    for turns in (most, -most):
        school.turn(turns * TURN)
        school.advance(3.0)
        (heading, command), (speed,) = school.readings()
        assert command == pytest.approx(30.0 * most if turns > 0 else 0.0, abs=1e-6) and speed > 1.0
        exact = driver not in ("policy for fast starts", "policy for obstacles")  # whose tasks reward the way instead
        assert heading == pytest.approx(command, abs=12.0 if exact else 18.0)
    school.turn(7 * TURN)
    (heading, command), _ = school.readings()
    assert abs(heading) <= 180.0 and abs(command - heading) <= 180.0  # however far it has turned


def test_commands_do_not_steer_the_gait():
    """A command changes no bit of the motion of a gait; by hand a slider contracts its muscle alone."""
    school, other = swum(GAIT, seconds=0.0), swum(GAIT, seconds=0.5)
    school.turn(TURN)
    school.advance(0.5)
    assert np.array_equal(school.tank.position, other.tank.position)
    school = swum(YOU, seconds=0.0)
    muscles = [each for each in school.controls() if each.group == "Muscles"]
    muscles[3].set(1.0)
    school.advance(0.2)
    assert school.frame().bodies[0].contraction == pytest.approx(np.eye(12)[3], abs=0.05) and len(muscles) == 12


def test_abrupt_turns_and_fast_starts():
    """Left after right is commanded before the first turn is complete; a fish at rest is soon two lengths away."""
    school = swum()
    school.left_after_right()
    school.advance(BETWEEN)
    assert school.commanded[0] == pytest.approx(-SWERVE) and school.facing[0] > -SWERVE
    expected = pytest.approx(school.facing[0] + SWERVE, abs=0.3)
    school.advance(0.05)
    assert school.commanded[0] == expected
    school.advance(3.0)
    assert school.readings()[0][0] == pytest.approx(np.degrees(school.commanded[0]), abs=12.0)
    school = swum("policy for fast starts", 1, 0.4)
    school.fast_start()
    start = middle(school)
    school.advance(1.5)
    assert np.linalg.norm(middle(school) - start) > 2.0 * school.length
    assert school.time == pytest.approx(1.5) and school.readings()[0][0] == pytest.approx(90.0, abs=20.0)


def test_a_school_swims_as_each_fish_alone():
    """One call of the policy for all of a school is that for one; many are drawn with fewer faces and own arrows."""
    school, alone = swum(num_fish=5), swum()
    assert np.allclose(school.tank.position[0], alone.tank.position[0], atol=1e-3 * alone.length)
    offset = np.array([middle(school, i) for i in range(5)]) - school._before[0].mean(axis=1)
    assert np.linalg.norm(offset[:, None] - offset[None], axis=2)[np.triu_indices(5, 1)].min() > school.length
    assert len(school.looks[0].surfaces[0].faces) < 0.2 * len(alone.looks[0].surfaces[0].faces)
    assert len(school.frame().arrows) == 5
    place, before = alone.tank.position[0], alone._before[0][0]  # pictures lie between two environment steps
    assert alone.frame().bodies[0].position == pytest.approx(before)
    alone.advance(0.5 * alone.interval)
    assert alone.frame().bodies[0].position == pytest.approx(0.5 * (before + place))


@pytest.mark.parametrize(("driver", "count"), [("policy for targets", 2), ("motor controllers, targets", 1)])
def test_a_target_that_is_put_is_reached(driver, count):
    """A target that is put is reached, by every fish where it is shown to that fish."""
    school = swum(driver, count, 0.5)
    goal = middle(school) + school.length * np.array([3.0, 1.0, 0.0])
    goal[2] = 0.0
    before = school.task.reached.copy()
    school.point("start", goal, -1)
    assert len(school.frame().spheres) == 1 and school.frame().spheres[0, :3] == pytest.approx(goal)
    school.advance(8.0)
    assert (school.task.reached > before).all()


def test_an_obstacle_that_is_put_is_passed():
    """An obstacle that is put is passed: one that the fish would else swim into."""
    school, blind = swum("policy for obstacles"), swum("policy for speed")
    assert not len(school.frame().spheres)
    goals = {each: middle(each) + school.length * np.array([2.0, 0.05, 0.0]) for each in (school, blind)}
    goal = goals[school]
    school.point("start", goal, -1)
    assert school.frame().spheres[0, :3] == pytest.approx(goal * (1.0, 1.0, 0.0))
    room = {}
    for each in (school, blind):
        room[each] = np.inf
        for _ in range(150):
            each.advance(0.02)
            room[each] = min(room[each], float(np.linalg.norm(each.tank.position[0] - goals[each], axis=1).min()))
    assert room[school] > school.task.radius * school.length > room[blind]
    assert not school.task.touched[0] and school.tank.position[0, :, 0].min() > goal[0]


def test_fish_follow_the_pointer():
    """A pointer to the left turns the fish to the left, one to the right back; turned off, it does nothing."""
    school = swum()
    for way, heading in (((0.0, 4.0, 0.0), 90.0), ((4.0, 0.0, 0.0), 0.0)):
        for _ in range(40):
            school.point("hover", middle(school) + school.length * np.array(way), -1)
            school.advance(0.05)
        assert school.readings()[0][0] == pytest.approx(heading, abs=15.0)
    control(school, "follow").set(False)
    before = school.commanded.copy()
    school.point("hover", np.zeros(3), -1)
    school.advance(0.1)
    assert np.array_equal(school.commanded, before)


def test_a_fish_that_fails_is_named():
    """A fish that fails stops the scene, with its reason; a new start goes on."""
    school = swum(num_fish=3, seconds=0.2)
    school.tank.velocity[1] = np.nan
    school.advance(0.1)
    assert "1 of 3 fish failed" in school.failure and "non-finite" in school.failure
    school.reset()
    school.advance(0.1)
    assert not school.failure and school.time == pytest.approx(0.1)


def test_film():
    """The last seconds of one fish are a page that stands alone; of two there is none."""
    school = swum("policy for obstacles", seconds=0.3)
    school.point("start", middle(school) + school.length * np.array([2.0, 0.0, 0.0]), -1)
    school.advance(0.3)
    text = school.film()["text"]
    assert text.startswith("<!DOCTYPE html>") and "from the laboratory" in text and "src=" not in text
    with pytest.raises(ValueError, match="choose one fish"):
        swum(num_fish=2, seconds=0.1).film()


def test_an_environment_of_the_user():
    """A registered environment and a policy make the first scene, in which episodes follow one another."""
    session = Session(partial(UserScene, "FishEnv/Turn-v0", None))
    assert next(iter(session.scenes)) == session.name == "your own"
    next(each for each in session.controls() if each.group == "Muscles").set(1.0)
    session.scene.advance(0.3)
    assert session.scene.frame().bodies[0].contraction.max() > 0.1
    session.close()
    scene = UserScene(None, load_policy("target"))
    scene.advance(11.0)
    assert "Target-v0" in scene.title and "episode ended after 10.0 s" in scene.note and scene.frame().touchable
    assert scene.since == pytest.approx(1.0) and [len(row) for row in scene.readings()] == [1, 1]
    scene.close()
    with pytest.raises(ValueError, match="not registered"):
        UserScene("Mine-v0", None)


def test_the_first_picture_comes_with_what_it_needs():
    """The first answer describes the scene and its controls; the next one only the picture."""
    session = Session()
    first, second = messages(session.answer(ASK)), session.answer(ASK | {"passed": 0.0})
    scene = first["scene"]
    assert scene["name"] == "follow me" and scene["scenes"] == list(SCENES) and len(scene["looks"]) == 1
    assert first["controls"] and not messages(second)
    header, numbers = picture(second)
    ((look, nodes, muscles, tones),) = header["bodies"]
    assert (look, tones) == (0, 0) and len(numbers) == 3 * nodes + muscles
    shown = numbers[: 3 * nodes].reshape(-1, 3) * session.scene.length
    assert shown == pytest.approx(session.scene.frame().bodies[0].position, abs=1e-5)
    session.answer({"do": "set", "name": "pause", "value": True})
    before = session.scene.time
    assert picture(session.answer(ASK))[0]["time"] == before  # while paused nothing moves but by single steps
    session.answer({"do": "set", "name": "one_step"})
    assert session.scene.time == pytest.approx(before + session.scene.interval) and session.paused
    session.answer({"do": "set", "name": "reset"})
    assert session.scene.time == 0.0 and not session.paused
    session.close()


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_is_shown_and_every_control_acts(name, session):
    """Every scene moves, its plots have numbers, and every control takes another value that it offers."""
    assert "error" not in messages(session.answer({"do": "scene", "name": name}))
    scene = session.scene
    scene.advance(0.1)
    header, numbers = picture(session.answer(ASK))
    assert np.isfinite(numbers).all() and len(header["bodies"]) >= 1 and not header["failure"]
    assert [len(row) for row in header["values"]] == [len(lines) for lines in scene.plots.values()]
    assert all(value is not None for row in header["values"] for value in row)
    for each in session.controls():
        if each.group == "Objects" or each.name in ("fish", "driver"):
            continue  # these take other bodies
        value = {"button": None, "switch": not each.value, "choice": each.options[-1:] and each.options[-1],
                 "slider": 0.5 * (each.low + each.high)}[each.kind]  # fmt: skip
        assert "error" not in messages(session.answer({"do": "set", "name": each.name, "value": value})), each.name
        now = {after.name: after.value for after in session.controls()}
        assert each.kind == "button" or now.get(each.name, value) == pytest.approx(value)


def test_new_bodies_are_compiled_before_their_picture(session, monkeypatch):
    """A choice of bodies is answered after a trial, so that a page waits once; then the scene is at its start."""
    trials, advance = [], ObjectScene.advance
    monkeypatch.setattr(ObjectScene, "advance", lambda scene, time: trials.append(time) or advance(scene, time))
    session.answer({"do": "scene", "name": "what the water does"})
    assert trials == 2 * [0.1] and session.scene.time == 0.0 and session.scene.objects[0].tank.time[0] == 0.0
    session.answer({"do": "set", "name": "object 1", "value": "none"})
    session.answer(SPEED | {"value": 1.0})
    assert trials == 4 * [0.1]


def test_another_object_is_another_look(session):
    """A choice under Objects sends the new looks and plots."""
    session.answer({"do": "scene", "name": "soft objects"})
    scene = messages(session.answer({"do": "set", "name": "object 0", "value": "ring"}))["scene"]
    assert scene["upright"] and len(scene["looks"][0]["surfaces"]) == 2
    for count in (2, 3):
        more = messages(session.answer({"do": "set", "name": f"object {count - 1}", "value": "ring"}))["scene"]
        assert len(more["looks"]) == count and all(len(plot["lines"]) == count for plot in more["plots"][:2])
        session.scene.advance(0.1)
        values = picture(session.answer(ASK))[0]["values"]
        assert len(values[0]) == count and len(values[-1]) == count - 1
        assert all(value is not None for row in values for value in row)
    assert len(messages(session.answer({"do": "set", "name": "object 1", "value": "none"}))["scene"]["looks"]) == 1
    session.answer({"do": "set", "name": "nodes 0", "value": 20})
    assert len(session.scene.objects[0].position) == 40


SPEED = {"do": "set", "name": "speed"}
POINT = {"do": "point", "phase": "start", "point": [0, 0, 0], "body": 0}
REFUSED = [
    *(None, 3, [], "frame", {}, {"do": "leave"}, {"do": 1}, {"do": "save"}, {"do": "set"}, {"do": "point"}),
    *({"do": "scene", "name": name} for name in (None, ["ring"])),
    *(SPEED | {"value": value} for value in ("fast", True, 1e9, None, np.nan)),
    *(SPEED | {"name": name, "value": 1} for name in ("__class__", {}, "pause", "walls")),
    *(POINT | {"point": point} for point in ([0, 0, None], [1e99, 0, 0], [[0], 0, 0])),
    *(POINT | changes for changes in ({"phase": "jump"}, {"phase": ["start"]}, {"body": True}, {"body": 9})),
]


@pytest.mark.parametrize("message", REFUSED)
def test_what_a_page_never_sends_is_refused(message, session, capsys):
    """It is told what is wrong, nothing is printed, and the next picture comes as if nothing had been sent."""
    if session.name != "soft objects":
        session.answer({"do": "scene", "name": "soft objects"})
    before = [(each.name, each.value) for each in session.controls()]
    text = messages(session.answer(message))["error"]
    assert text and "mistake" not in text
    assert [(each.name, each.value) for each in session.controls()] == before
    picture(session.answer(ASK | {"passed": "far"}))
    assert capsys.readouterr().err == ""


def test_a_refused_choice_is_shown_as_it_was(session):
    """What the page chose in vain is sent again; a failure has its reason and its node, and another choice moves."""
    session.answer({"do": "scene", "name": "what the method does"})
    refused = messages(session.answer({"do": "set", "name": "integrator 0", "value": "dop853"}))
    assert refused["error"] and "its own" in [each["value"] for each in refused["controls"]]
    session.answer({"do": "set", "name": "step", "value": 50.0})
    session.scene.throw()
    while not session.scene.failure:
        header, _ = picture(session.answer({"do": "frame", "passed": 0.05}))
    assert "failed on the ring" in header["failure"] and header["failed"][0] >= 0
    session.answer({"do": "set", "name": "object 0", "value": "string"})
    assert picture(session.answer({"do": "frame", "passed": 0.05}))[0]["time"] == pytest.approx(0.05)


def test_a_mistake_of_the_laboratory_does_not_end_the_session(session, capsys, monkeypatch):
    """It is told of, and printed in full for who runs it."""
    monkeypatch.setattr(session, "frame", lambda passed: 1 / 0)
    assert "mistake" in messages(session.answer(ASK))["error"]
    assert "ZeroDivisionError" in capsys.readouterr().err
