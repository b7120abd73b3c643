"""The laboratory's bench, without a browser: what is chosen and changed, dragged, measured, and what fails."""

import numpy as np
import pytest

from fish_env.lab.bench import Bench
from fish_env.lab.hand import Hand
from fish_env.lab.measures import LONGEST, arrows, enclosed_volume, tet_strain, tone
from fish_env.lab.settings import SETTINGS
from fish_env.lab.specimen import MOTIONS, Entry, cost_of_step
from fish_env.scene.look import as_quads, boundary, look_of
from fish_env.soft.distorted import DISTORTIONS, out_of_shape
from fish_env.soft.elements import make_tets
from fish_env.soft.mesh import box
from fish_env.soft.volume import volume_of


@pytest.fixture(scope="module")
def ring():
    """A bench with a ring that no test changes for good."""
    return Bench([Entry("ring")])


@pytest.fixture
def bench(ring):
    """The same bench, started again."""
    ring.reset()
    yield ring
    ring.release_all()


def advance(bench, frames, rate=30) -> Bench:
    """The bench, moved on by so many frames."""
    for _ in range(frames):
        bench.advance(1 / rate)
    return bench


def control(bench, name):
    """A control of a bench, by its name."""
    return next(each for each in bench.controls() if each.name == name)


@pytest.mark.parametrize("value", [np.nan, np.inf, 5.1, -1.0, "1", True, None, [1.0]])
def test_numbers_from_the_page_are_checked(ring, value):
    """A number that is not allowed changes nothing."""
    before = ring.numbers["stiffness"], ring.specimens[0].tank
    with pytest.raises(ValueError, match="give a number from"):
        control(ring, "stiffness").set(value)
    assert (ring.numbers["stiffness"], ring.specimens[0].tank) == before


def test_what_the_page_chooses_is_checked(ring):
    """Names that are not offered and objects of too many nodes change nothing."""
    tank = ring.specimens[0].tank
    for name, value in (("thing 0", "../ring"), ("integrator 0", "euler"), ("walls", "x"), ("nodes 0", 1000)):
        with pytest.raises(ValueError, match=r"choose from|give"):
            control(ring, name).set(value)
    with pytest.raises(ValueError, match="at most 1100"):
        ring.choose([Entry("ring"), Entry("block", "", (("cells", 10),))])
    assert ring.specimens[0].tank is tank and len(ring.specimens) == 1
    for setting in SETTINGS.values():
        assert setting.low <= setting.default <= setting.high and setting.meaning


def test_a_change_goes_on_in_the_same_motion():
    """A change of numbers or walls keeps positions and velocities, and reaches the body and the world."""
    bench = advance(Bench([Entry("ring")]), 6)
    x, v = bench.specimens[0].tank.position.copy(), bench.specimens[0].tank.velocity.copy()
    for name, value in (("stiffness", 2.0), ("damping", 0.5), ("pressure", 0.5), ("density", 2.0),
                        ("inner_density", 2.0), ("gravity", 1.0), ("restitution", 0.0)):  # fmt: skip
        bench.set(name, value)
        tank = bench.specimens[0].tank
        assert np.array_equal(tank.position, x) and np.array_equal(tank.velocity, v)
    body, own = tank.fish.body, bench.specimens[0].thing.body
    assert np.allclose(body.springs.stiffness, 2.0 * own.springs.stiffness)
    assert np.allclose(body.springs.damping, 0.5 * own.springs.damping)
    assert np.allclose(body.compartments.gas, own.compartments.gas)  # stiffness doubles it, pressure halves it
    assert body.mass[:12] == pytest.approx(2.0 * own.mass[:12]) and body.mass[12:] == pytest.approx(4.0 * own.mass[12:])
    assert np.linalg.norm(tank.world.gravity) == pytest.approx(1.0)
    assert set(tank.world.planes[:, 4]) == {0.0}
    for walls, count in (("closed room", 4), ("none", 0), ("own", 3)):
        bench.set_walls(walls)
        planes = bench.specimens[0].tank.world.planes
        assert (0 if planes is None else len(planes)) == count


@pytest.mark.slow
def test_without_gas_one_layer_collapses_and_two_stand():
    """At pressure 0 there is no gas: one layer lies flat and does not fail for a lost volume, two layers stand."""
    bench = Bench([Entry("ring"), Entry("ring", "", (("layers", 1),))])
    for name, value in (("pressure", 0.0), ("stiffness", 3.0), ("restitution", 0.0)):
        bench.set(name, value)
    assert all(specimen.tank.fish.body.compartments is None for specimen in bench.specimens)
    advance(bench, 120, rate=60)
    two, one = (np.ptp(specimen.position[:, 1]) / specimen.thing.length for specimen in bench.specimens)
    assert not bench.failure and one < 0.05 and two > 0.4
    bench.set("pressure", 1.0)
    assert bench.specimens[0].tank.fish.body.compartments is not None


def test_free_fall_is_that_of_gravity(bench):
    """A ring falls with 9.81 m/s2 and keeps its energy."""
    tank = advance(bench, 12, rate=60).specimens[0].tank
    centre = tank.fish.body.mass @ tank.position[0] / tank.fish.body.mass.sum()
    assert centre[1] == pytest.approx(-0.5 * 9.81 * tank.time[0] ** 2, rel=1e-9)


def test_energy_of_a_fall_is_kept(bench):
    """Motion and height exchange energy; the ring hardly deforms."""
    energies = [advance(bench, 1, rate=60).specimens[0].energy() for _ in range(12)]
    assert np.ptp(energies) < 1e-3 * np.abs(energies).max()


def test_a_drag_brings_the_node_to_the_pointer():
    """The drag spring moves with the hand, at its velocity, and brings the node to the pointer."""
    bench = Bench([Entry("ring")])
    bench.set("gravity", 0.0)
    start = bench.specimens[0].position[3].copy()
    assert bench.hand is None and bench.grab(0, start) == 3
    goal = np.add(start, (0.01, 0.03, 0.0))
    bench.hand.aim(goal)
    tank = advance(bench, 1, rate=60).specimens[0].tank
    moved = tank.world.anchors.point[0] - start
    assert moved == pytest.approx(bench.hand.velocity * tank.time[0], rel=1e-9) and moved[0] > 0.0
    for _ in range(120):
        bench.hand.aim(goal)
        bench.advance(1 / 60)
    assert np.linalg.norm(bench.specimens[0].position[3] - goal) < 0.002
    bench.let_go()
    assert bench.hand is None and bench.specimens[0].tank.world.anchors is None


def test_a_fixed_node_stays_and_moves_with_the_hand(bench):
    """A fixed node stays, moves with the hand, and stays where a distortion puts it."""
    place = bench.specimens[0].position[0].copy()
    node = bench.fix(0, place)
    advance(bench, 10)
    assert np.array_equal(bench.specimens[0].position[node], place)
    bench.grab(0, place)
    bench.hand.aim(np.add(place, (0.01, 0.01, 0.0)))
    advance(bench, 12, rate=60)
    assert bench.specimens[0].position[node] == pytest.approx(np.add(place, (0.01, 0.01, 0.0)), abs=1e-3)
    bench.release_all()
    assert bench.specimens[0].fixed == []
    beam = Bench([Entry("beam")])
    node = beam.fix(0, beam.specimens[0].position[0])
    beam.distort("twisted")
    place = beam.specimens[0].position[node].copy()
    assert np.array_equal(advance(beam, 5).specimens[0].position[node], place)


def test_the_hand_moves_evenly_and_arrives():
    """The hand covers the way in equal steps, and then rests."""
    hand = Hand(0, 0, (0.0, 0.0, 0.0))
    hand.aim((1.0, 0.0, 0.0))
    steps = []
    for _ in range(5):
        before = hand.point[0]
        hand.advance(0.02)
        steps.append(hand.point[0] - before)
        assert hand.velocity[0] == pytest.approx(steps[-1] / 0.02)
    assert steps == pytest.approx([0.2] * 5) and hand.point[0] == pytest.approx(1.0)
    hand.advance(0.02)
    assert hand.velocity[0] == 0.0


def test_a_method_that_fails_is_named_and_waits():
    """A method that fails is named with its step and its node; half the step is a way on."""
    bench = Bench([Entry("ring", "explicit_euler")])
    bench.set("step", 50.0)
    bench.throw()
    while not bench.failure:
        assert advance(bench, 1).time < 4.0
    assert "explicit_euler failed on the ring" in bench.failure and "step" in bench.failure
    assert bench.failed[0] == 0 and 0 <= bench.failed[1] < 24
    bench.halve_step()
    assert bench.numbers["step"] == 25.0 and not bench.failure and bench.specimens[0].tank.alive.all()


def test_side_by_side_is_compared(monkeypatch):
    """Equal objects have no distance; at the same cost, steps that cost twice as much are twice as long."""
    bench = Bench([Entry("ring"), Entry("ring"), Entry("ring", "explicit_euler")])
    advance(bench, 12, rate=60)
    assert bench.distance_of(1) == 0.0 and 0.0 < bench.distance_of(2) < 0.5
    assert bench.readings()[-1] == [bench.distance_of(1), bench.distance_of(2)]
    *_, (motion, stored, lost), _ = bench.readings()
    assert motion > 0.0 > stored and abs(lost) < 0.02 * motion  # it falls, and nothing has touched it yet
    bench.choose([Entry("ring", "explicit_euler"), Entry("ring")])
    cheap, costly = bench.specimens
    assert cost_of_step(cheap) > 0.0
    monkeypatch.setattr("fish_env.lab.bench.cost_of_step", lambda specimen: 1e-6 if specimen is cheap else 2e-6)
    control(bench, "same_cost").set(True)
    assert cheap.tank.dt == cheap.own_step() and costly.tank.dt == pytest.approx(2.0 * cheap.tank.dt)


def test_many_nodes_take_longer_steps():
    """A fish of more than 600 nodes takes twice its own step by the stabilised method, and its own by another one."""
    for integrator, level, step in (("", 3, 2.0), ("rk4", 3, 1.0), ("", 2, 1.0)):
        bench = Bench([Entry("tetrahedral", integrator, (("level", level),))])
        assert bench.numbers["step"] == step
        specimen = bench.specimens[0]
        assert specimen.tank.dt == pytest.approx(step * specimen.own_step())


@pytest.mark.slow
def test_longer_steps_are_as_good():
    """With twice its own step a fish of 841 nodes swims the same motion to 0.002 BL, and lasts."""
    fine = Entry("tetrahedral", "", (("level", 3),))
    long, own = Bench([fine]), Bench([fine])
    own.set("step", 1.0)
    for bench in (long, own):
        bench.move("gait")
        advance(bench, 12)
    a, b = long.specimens[0], own.specimens[0]
    assert a.time == pytest.approx(b.time) and a.tank.alive[0]
    assert np.abs(a.position - a.thing.body.position).max() > 0.05 * a.thing.length
    assert np.sqrt(((a.position - b.position) ** 2).sum(axis=1).mean()) < 2e-3 * a.thing.length
    advance(long, 50)
    assert not long.failure and long.time > 2.0  # with four times its own step it is torn after 0.8 s


@pytest.mark.slow
@pytest.mark.parametrize("how", ["throw", "twisted"])
@pytest.mark.parametrize("name", ["beam", "two materials"])
def test_solids_of_many_nodes_last_with_longer_steps(name, how):
    """Solids of nearly a thousand nodes take four times their own step, and last: thrown at a wall, or twisted."""
    bench = Bench([Entry(name, "", (("cells", 18), ("across", 6)))])
    assert bench.numbers["step"] == 4.0 and len(bench.specimens[0].position) > 900
    bench.throw() if how == "throw" else bench.distort(how)
    advance(bench, 30)
    assert not bench.failure and bench.time == pytest.approx(1.0)


def test_volumes():
    """Volumes are those of the gas or the tetrahedra."""
    for name in ("sphere", "uniform sphere"):
        thing = Bench([Entry(name)]).specimens[0].thing
        want, _ = volume_of(thing.skin, thing.body.position)
        assert enclosed_volume(thing, look_of(thing), thing.body.position) == pytest.approx(want, rel=0.02)
    place, nodes = box((2.0, 1.0, 1.0), (2, 2, 2))
    sides = boundary(nodes)
    a, b, c = place[sides].transpose(1, 0, 2)
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0 == pytest.approx(2.0, rel=1e-12)
    assert len(sides) == 6 * 4 * 2 and as_quads(sides).shape == (48, 4)


def test_strains_are_those_of_the_eigenvalues():
    """Strains of tetrahedra are those of LAPACK, at rest, rotated, in small strain and far out of shape."""
    place, nodes = box((1.0, 1.0, 1.0), (1, 1, 1))
    cube = make_tets(place, nodes, 1e5, 0.3)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    assert tet_strain(cube, place @ turn.T) == pytest.approx(0.0, abs=1e-12)
    assert tet_strain(cube, (place * (1.1, 0.7, 1.0)) @ turn.T) == pytest.approx(-0.3, abs=1e-12)
    thing = Bench([Entry("tetrahedral")]).specimens[0].thing
    tets, noise = thing.body.tets, np.random.default_rng(0).normal(size=thing.body.position.shape)
    for size in (0.0, 1e-6, 1e-3, 1.0):
        x = thing.body.position + size * thing.length * noise
        stretch = np.linalg.svd(np.einsum("tak,tal->tkl", x[tets.nodes], tets.gradient), compute_uv=False) - 1.0
        want, found = np.abs(stretch).max(axis=1), tet_strain(tets, x)
        assert np.abs(found) == pytest.approx(want, rel=1e-9, abs=1e-12)
        assert (np.abs(stretch - found[:, None]).min(axis=1) < 1e-9 * (1.0 + want)).all()


def test_most_forces_are_seen_beside_one_that_is_much_larger(bench):
    """Most arrows are seen beside one of a node that is fixed; none is of noise."""
    bench.fix(0, bench.specimens[0].position[0])
    advance(bench, 18)
    force, mass = bench.specimens[0].forces(), bench.specimens[0].tank.fish.body.mass
    force[0] *= 100.0 * np.linalg.norm(force, axis=1).max() / max(float(np.linalg.norm(force[0])), 1e-300)
    size = np.linalg.norm(force, axis=1)
    nodes, arrow = arrows(force, mass)
    length = np.linalg.norm(arrow, axis=1)
    assert np.median(length) > 0.05 and length.max() == pytest.approx(LONGEST)
    assert np.einsum("ij,ij->i", arrow, force[nodes]) == pytest.approx(length * size[nodes])
    assert np.abs(arrows(1e-12 * force, mass)[1]).max() < 1e-4 and not arrows(0.0 * force, mass)[1].any()


def test_tones_tell_shortened_from_stretched():
    """A strain of a percent is told from rest, and thirty percent are the end of the scale."""
    specimen = Bench([Entry("string", "", (("nodes", 3),))]).specimens[0]
    springs = specimen.thing.body.springs
    found = tone(3, springs.nodes, np.array([0.01, -9.0]))
    assert found[0] == pytest.approx((0.01 / 0.3) ** 0.5) and found[2] == -1.0 and found[1] == -1.0


@pytest.mark.parametrize("name", ["beam", "ball", "two materials"])
def test_a_dropped_solid_shows_its_strain(name):
    """At rest no node has a strain; after its fall some are shortened and others stretched."""
    bench = Bench([Entry(name)])
    assert np.abs(bench.specimens[0].tone()).max() < 1e-3
    seen = np.array([advance(bench, 1).specimens[0].tone() for _ in range(30)])
    assert seen.max() > 0.1 and seen.min() < -0.1


@pytest.mark.parametrize("motion", MOTIONS[1:])
def test_fish_move(motion):
    """A fish does what it is told; at rest it stays where it is."""
    bench = Bench([Entry("mass_spring")])
    rest = advance(bench, 5).specimens[0].position.copy()
    bench.move(motion)
    bench.specimens[0].by_hand[:] = 0.5
    moved = np.abs(advance(bench, 15).specimens[0].position - rest).max() / bench.length
    assert np.abs(rest - bench.specimens[0].thing.body.position).max() < 1e-3 * bench.length < 0.02 * moved


RETURNING = [("beam", "twisted"), ("block", "inverted")]
RETURNING += [
    pytest.param(name, how, marks=pytest.mark.slow) for name in ("two materials", "tetrahedral") for how in DISTORTIONS
]


@pytest.mark.parametrize(("name", "how"), RETURNING)
def test_what_is_twisted_or_inverted_comes_back(name, how):
    """A solid, or the fish of tetrahedra, is put at rest out of its shape, comes back to it, and nothing is said."""
    bench = Bench([Entry(name)])
    bench.throw()
    bench.advance(0.1)
    bench.distort(how)
    specimen = bench.specimens[0]
    body = specimen.thing.body
    assert bench.time == 0.0 and not specimen.tank.velocity.any()
    assert np.array_equal(specimen.position, DISTORTIONS[how](specimen.thing))
    assert out_of_shape(body, specimen.position) > 0.05
    advance(bench, 95)
    assert not bench.failure and not bench.note and out_of_shape(body, specimen.position) < 0.03


def test_what_does_not_come_back_is_named_with_its_reason():
    """An inverted ball stays inside out, a shell of gas loses its volume: both are told of."""
    bench = Bench([Entry("ball")])
    bench.distort("inverted")
    advance(bench, 95)
    assert "The ball was inverted and has not come back" in bench.note and "0.8" in bench.note
    bench.distort("inverted")
    bench.reset()
    advance(bench, 95)
    assert not bench.note  # it was not left inverted
    bench = Bench()
    bench.distort("inverted")
    bench.advance(1 / 30)
    assert "failed on the uniform sphere" in bench.failure and "no volume left" in bench.failure
    bench.reset()
    assert bench.time == 0.0 and np.array_equal(bench.specimens[0].position, bench.specimens[0].thing.body.position)


@pytest.mark.parametrize(
    ("name", "hows", "why"),
    [("string", ("twisted", "inverted"), "in a plane or on a line"), ("ring", ("twisted", "inverted"), "in a plane"),
     ("planar", ("twisted",), "in a plane"), ("mass_spring", ("inverted",), "mirror image")],
)  # fmt: skip
def test_what_cannot_be_twisted_or_inverted_is_refused(name, hows, why):
    """What lies in a plane is neither twisted nor inverted, springs alone are not inverted: nothing is changed."""
    bench = Bench([Entry("beam"), Entry(name)])
    bench.time, before = 0.1, bench.specimens[0].position.copy()
    for how in hows:
        assert not bench.can_distort(how)
        with pytest.raises(ValueError, match=f"{why}.*give"):
            bench.distort(how)
    assert bench.time == 0.1 and np.array_equal(bench.specimens[0].position, before)


def test_level_by_distance():
    """A uniform sphere is as coarse as nobody sees from the camera, and goes on in the same motion."""
    bench = advance(Bench([Entry("uniform sphere", "", (("level", 2),))]), 5)
    height = bench.specimens[0].position[:, 2].mean()
    bench.seen(3.0, 700.0)
    assert len(bench.specimens[0].position) == 2 * 66  # nothing was asked for
    control(bench, "by_distance").set(True)
    bench.seen(300.0, 700.0)
    assert len(bench.specimens[0].position) < 2 * 66 and bench.version == 2
    assert bench.specimens[0].position[:, 2].mean() == pytest.approx(height, abs=0.02 * bench.length)
    beam = Bench([Entry("beam")])
    assert not any(each.name == "by_distance" for each in beam.controls())


def test_controls_are_those_that_apply():
    """Nothing is offered that does nothing, and every default is that of the object."""
    ring, fish = ({each.name: each for each in Bench([Entry(name)]).controls()} for name in ("ring", "planar"))
    assert "pressure" in ring and "inner_density" in ring and "water" not in ring and "twisted" not in ring
    assert "pressure" not in fish and "water" in fish and "motion" in fish and "throw" not in fish
    for each in (*ring.values(), *fish.values()):
        assert each.kind in ("button", "switch", "slider", "choice")
        assert each.default in (None, each.value) or each.name == "motion"
