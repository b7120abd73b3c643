"""The laboratory's bench, without a browser: what is chosen and changed, dragged, measured, and what fails."""

import importlib.util

import numpy as np
import pytest

from fish_env.bodies.distorted import DISTORTIONS, out_of_shape
from fish_env.bodies.mesh import box
from fish_env.lab import serve
from fish_env.lab.bench import Bench, checked_entry
from fish_env.lab.fields import LONGEST, SHADES, arrows, shade_of, shades
from fish_env.lab.geometry import boundary, enclosed_volume, signed_volume, surfaces, tet_strain, triangulate
from fish_env.lab.hand import Hand
from fish_env.lab.settings import SETTINGS, checked_point
from fish_env.lab.specimen import Entry
from fish_env.physics.elements import make_tets
from fish_env.physics.volume import volume_of

VISER = importlib.util.find_spec("viser") is not None


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


@pytest.mark.parametrize("value", [np.nan, np.inf, 5.1, -1.0, "1", True, None, [1.0]])
def test_numbers_from_the_page_are_checked(ring, value):
    """A number that is not allowed changes nothing."""
    before = ring.numbers["stiffness"], ring.specimens[0].tank
    with pytest.raises(ValueError, match="give a number from"):
        ring.set("stiffness", value)
    assert (ring.numbers["stiffness"], ring.specimens[0].tank) == before


def test_names_and_points_from_the_page_are_checked(ring):
    """Names and points that are not allowed change nothing."""
    tank = ring.specimens[0].tank
    for wrong in (lambda: ring.set("__class__", 1.0), lambda: ring.choose([Entry("../ring")]),
                  lambda: ring.choose([Entry("ring", "euler")]), lambda: ring.choose([]), lambda: ring.set_walls("x"),
                  lambda: ring.choose([Entry("ring", "", (("nodes", 1000),))]), lambda: ring.grab(7, (0, 0, 0)),
                  lambda: ring.grab(0, (np.nan, 0, 0)), lambda: ring.grab(0, "abc"), lambda: ring.set_strength(1e9),
                  lambda: checked_point((1e9, 0, 0), 1.0), lambda: ring.distort("__class__")):  # fmt: skip
        with pytest.raises(ValueError, match=r"choose from|give"):
            wrong()
    assert ring.specimens[0].tank is tank
    with pytest.raises(ValueError, match="at most 1100"):
        checked_entry(Entry("block", "", (("cells", 10),)))
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
    assert not bench.messages and one < 0.05 and two > 0.4
    bench.set("pressure", 1.0)
    assert bench.specimens[0].tank.fish.body.compartments is not None


def test_free_fall_is_that_of_gravity(bench):
    """A ring falls with 9.81 m/s2 and keeps its energy."""
    tank = advance(bench, 12, rate=60).specimens[0].tank
    centre = tank.fish.body.mass @ tank.position[0] / tank.fish.body.mass.sum()
    assert centre[1] == pytest.approx(-0.5 * 9.81 * tank.time[0] ** 2, rel=1e-9)
    energies = bench.series("energy")[1]
    assert np.ptp(energies) < 1e-3 * np.abs(energies).max()  # motion and height exchange it; the ring hardly deforms


def test_power_is_the_work_between_two_readings(bench):
    """The power that is plotted is that of the work since the reading before."""
    for work in (0.0, 0.3, 0.2):
        bench.specimens[0].tank.work[:] += work
        advance(bench, 6, rate=60)
    times, power = bench.series("power")
    widths = np.diff(bench.series("work")[0])
    assert len(times) == len(power) == len(widths) > 2
    assert power @ widths == pytest.approx(0.5) and np.count_nonzero(power) == 2


def test_a_drag_brings_the_node_to_the_pointer():
    """The drag spring moves with the hand, at its velocity, and brings the node to the pointer."""
    bench = Bench([Entry("ring")])
    bench.set("gravity", 0.0)
    bench.warm()  # changes nothing
    start = bench.specimens[0].position[3].copy()
    assert bench.hand is None and bench.grab(0, start) == 3
    goal = np.add(start, (0.01, 0.03, 0.0))
    bench.drag(goal)
    tank = advance(bench, 1, rate=60).specimens[0].tank
    moved = tank.world.anchors.point[0] - start
    assert moved == pytest.approx(bench.hand.velocity * tank.time[0], rel=1e-9) and moved[0] > 0.0
    for _ in range(120):
        bench.drag(goal)
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
    bench.drag(np.add(place, (0.01, 0.01, 0.0)))
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


def test_a_method_that_fails_is_named_and_starts_again():
    """A method that fails is named with its step, and all start again."""
    bench = Bench([Entry("ring", "explicit_euler")])
    bench.set("step", 50.0)
    bench.throw()
    while not bench.messages:
        assert advance(bench, 1).clock < 4.0
    assert "explicit_euler failed on the ring" in bench.messages[0] and "step" in bench.messages[0]
    assert bench.specimens[0].tank.alive.all() and bench.clock == 0.0


def test_side_by_side_is_compared():
    """Equal objects have no distance; at the same cost a costly method takes longer steps."""
    bench = Bench([Entry("ring"), Entry("ring"), Entry("ring", "explicit_euler")])
    advance(bench, 12, rate=60)
    assert bench.distance(1) == 0.0 and 0.0 < bench.distance(2) < 0.5
    assert np.shape(list(bench.distances)) == (len(bench.history), 2)
    bench.choose([Entry("ring", "explicit_euler"), Entry("ring")], same_cost=True)
    cheap, costly = (specimen.tank.dt / specimen.own_step() for specimen in bench.specimens)
    own = [specimen.own_step() for specimen in bench.specimens]
    assert cheap == 1.0 and costly * own[1] > own[0]


def test_many_nodes_take_longer_steps():
    """A fish of more than 600 nodes takes twice its own step by the stabilised method, and its own by another one."""
    for integrator, level, step in (("", 3, 2.0), ("rk4", 3, 1.0), ("", 2, 1.0)):
        bench = Bench([Entry("tetrahedral", integrator, (("level", level),))])
        assert bench.numbers["step"] == step
        specimen = bench.specimens[0]
        assert specimen.tank.dt == pytest.approx(step * specimen.own_step())


@pytest.mark.slow
def test_longer_steps_are_as_good():
    """With twice its own step a fish of 841 nodes swims the same motion to 0.001 BL, and lasts."""
    fine = Entry("tetrahedral", "", (("level", 3),))
    long, own = Bench([fine]), Bench([fine])
    own.set("step", 1.0)
    for bench in (long, own):
        bench.swim(True)
        advance(bench, 12)
    a, b = long.specimens[0], own.specimens[0]
    assert a.time == pytest.approx(b.time) and a.tank.alive[0]
    assert np.abs(a.position - a.thing.body.position).max() > 0.05 * a.thing.length
    assert np.sqrt(((a.position - b.position) ** 2).sum(axis=1).mean()) < 1e-3 * a.thing.length
    advance(long, 50)
    assert not long.messages and long.clock > 2.0  # with four times its own step it is torn after 0.8 s


@pytest.mark.slow
@pytest.mark.parametrize("how", ["throw", "twisted"])
@pytest.mark.parametrize("name", ["beam", "two materials"])
def test_solids_of_many_nodes_last_with_longer_steps(name, how):
    """Solids of nearly a thousand nodes take four times their own step, and last: thrown at a wall, or twisted."""
    bench = Bench([Entry(name, "", (("cells", 18), ("across", 6)))])
    assert bench.numbers["step"] == 4.0 and bench.nodes > 900
    bench.throw() if how == "throw" else bench.distort(how)
    advance(bench, 30)
    assert not bench.messages and bench.clock == pytest.approx(1.0)


def test_geometry():
    """Volumes are those of the gas or the tetrahedra, and a quadrilateral is two triangles."""
    for name in ("sphere", "uniform sphere"):
        thing = Bench([Entry(name)]).specimens[0].thing
        want, _ = volume_of(thing.skin, thing.body.position)
        assert enclosed_volume(thing, surfaces(thing), thing.body.position) == pytest.approx(want, rel=0.02)
    place, nodes = box((2.0, 1.0, 1.0), (2, 2, 2))
    triangles, owner = boundary(nodes)
    assert signed_volume(triangles, place) == pytest.approx(2.0, rel=1e-12)
    assert len(owner) == len(triangles) == 6 * 4 * 2
    assert triangulate(np.array([(0, 1, 2, 3), (4, 5, 6, 6)])).tolist() == [[0, 1, 2], [4, 5, 6], [0, 2, 3]]


def test_strains_in_closed_form_are_those_of_the_eigenvalues():
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


def test_shades_tell_shortened_from_stretched():
    """Shades tell shortened from stretched, a strain of a percent from rest, and end at thirty percent."""
    strain = np.array([-9.0, -0.3, -0.01, 0.0, 0.01, 0.3, np.inf])
    assert shade_of(strain).tolist() == [0, 0, 4, 5, 6, 10, 10]


@pytest.mark.parametrize(
    "name", ["beam", *(pytest.param(n, marks=pytest.mark.slow) for n in ("ball", "two materials"))]
)
def test_a_dropped_solid_shows_its_strain(name):
    """At rest all of a solid has the middle, light shade; after its fall it shows four others or more."""
    bench, middle, seen = Bench([Entry(name)]), SHADES // 2, 0
    assert shades()[middle].min() > 200 and (shade_of(bench.specimens[0].tet_strain()) == middle).all()
    for _ in range(30):
        bench.advance(1 / 30)
        seen = max(seen, len(set(shade_of(bench.specimens[0].tet_strain())) - {middle}))
    assert seen >= 4


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
    assert bench.clock == 0.0 and not specimen.tank.velocity.any()
    assert np.array_equal(specimen.position, DISTORTIONS[how](specimen.thing))
    assert out_of_shape(body, specimen.position) > 0.05
    advance(bench, 95)
    assert not bench.messages and out_of_shape(body, specimen.position) < 0.03


def test_what_does_not_come_back_is_named_with_its_reason():
    """An inverted ball stays inside out, a shell of gas loses its volume: both are told of."""
    bench = Bench([Entry("ball")])
    bench.distort("inverted")
    advance(bench, 95)
    assert len(bench.messages) == 1
    assert "The ball was inverted and has not come back" in bench.messages[0] and "0.8" in bench.messages[0]
    bench.distort("inverted")
    bench.reset()
    advance(bench, 95)
    assert len(bench.messages) == 1  # it was not left inverted
    bench = Bench()
    bench.distort("inverted")
    bench.advance(1 / 30)
    assert "failed on the uniform sphere" in bench.messages[0] and "no volume left" in bench.messages[0]
    assert bench.clock == 0.0 and np.array_equal(bench.specimens[0].position, bench.specimens[0].thing.body.position)


@pytest.mark.parametrize(
    ("name", "hows", "why"),
    [("string", ("twisted", "inverted"), "in a plane or on a line"), ("ring", ("twisted", "inverted"), "in a plane"),
     ("planar", ("twisted",), "in a plane"), ("mass_spring", ("inverted",), "mirror image")],
)  # fmt: skip
def test_what_cannot_be_twisted_or_inverted_is_refused(name, hows, why):
    """What lies in a plane is neither twisted nor inverted, springs alone are not inverted: nothing is changed."""
    bench = Bench([Entry("beam"), Entry(name)])
    bench.clock, before = 0.1, bench.specimens[0].position.copy()
    for how in hows:
        with pytest.raises(ValueError, match=f"{why}.*give"):
            bench.distort(how)
    assert bench.clock == 0.1 and np.array_equal(bench.specimens[0].position, before)


def test_only_layers_go_on_at_another_level():
    """A fish of tetrahedra has levels but no layers: it is refused, and stays on the bench as it was."""
    bench = Bench([Entry("tetrahedral")])
    with pytest.raises(ValueError, match="'tetrahedral' has no layers"):
        bench.set_detail(0, 2)
    assert bench.specimens[0].entry == Entry("tetrahedral")


@pytest.mark.skipif(not VISER, reason="viser is not installed")
@pytest.mark.parametrize(("host", "warned"), [("127.0.0.1", False), ("localhost", False), ("0.0.0.0", True)])
def test_another_address_than_this_machine_is_warned_of(host, warned, monkeypatch, capsys):
    """Another address than this machine's own is warned of before the page opens there."""
    from fish_env.lab import server

    opened = []

    class Opened:
        port = 9000

        def __init__(self, host, port):
            opened.append((host, port))
            assert ("WARNING" in capsys.readouterr().err) == warned

        def wait(self):
            pass

    monkeypatch.setattr(server, "Laboratory", Opened)
    serve(host, 9000)
    assert opened == [(host, 9000)]
    with pytest.raises(ValueError, match="1024 to 65535"):
        serve(port=80)


@pytest.mark.skipif(VISER, reason="viser is installed")
def test_without_viser_the_extra_is_named():
    """Without viser the extra is named."""
    with pytest.raises(RuntimeError, match=r"fish_env\[lab\]"):
        serve()
