"""The laboratory's page from the server's side: what controls, keys and the mouse do, without a browser."""

import threading
import time

import numpy as np
import pytest

pytest.importorskip("viser", reason='needs pip install -e ".[lab]"')

from viewer import CAMERA, Viewer, until

from fish_env.bodies.distorted import DISTORTIONS
from fish_env.lab import server
from fish_env.lab.bench import Bench
from fish_env.lab.fields import SHADES, shade_of, shades
from fish_env.lab.geometry import boundary
from fish_env.lab.settings import SETTINGS, checked_point


@pytest.fixture(scope="module")
def laboratory():
    """A laboratory at a port of its own, where what a drag needs is compiled at the first drag."""
    laboratory = server.Laboratory("127.0.0.1", 18300)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Bench, "warm", lambda self: None)
        yield laboratory
    laboratory.close()


@pytest.fixture
def page(laboratory):
    """A page that has just been opened."""
    with Viewer(laboratory).entered() as page:
        yield page


def status(page):
    """All that the page says in running text."""
    return " ".join(str(each.get("_markdown", each)) for each in list(page.controls.values()))


def drawn(page, name, part="batched_positions"):
    """Points (K,3) of a part of the scene as they were last sent."""
    return page.nodes[name][part].reshape(-1, 3)


def choose_object(page, thing):
    """Choose an object, and wait until it is there."""
    page.choose("object", thing)
    until(lambda: page.session.bench.specimens[0].entry.thing == thing and "/0/nodes" in page.nodes)


def lines(page, title):
    """Rows of a chart, the first its times, as they were last sent; none before it is there."""
    return next((each["data"] for each in list(page.controls.values()) if each.get("title") == title), [])


def told(page, *texts):
    """Wait until the page has been told of each text."""
    for text in texts:
        until(lambda text=text: any(text in note for note in page.notes))


def goes_on(page):
    """Return True if the session still answers and moves, and made no mistake of its own."""
    session = page.session
    other = "drag" if session.panel.mouse == "fix" else "fix or release"
    page.choose("mouse", other)
    until(lambda: session.panel.mouse == other.split()[0])
    clock = (session.school or session.bench).clock
    until(lambda: (session.school or session.bench).clock > clock)
    return session.alive and not any("mistake" in note for note in page.notes)


def test_what_is_on_the_bench_is_drawn_where_it_is(page):
    """What is on the bench is drawn where it is, in its lengths, and the page says what it is."""
    session = page.session
    until(lambda: session.bench.clock > 0.3)
    page.key("Pause")
    until(lambda: session.paused)
    want = session.bench.specimens[0].position / session.bench.specimens[0].thing.length
    until(lambda: np.allclose(drawn(page, "/0/nodes"), want, atol=1e-5))
    assert np.ptp(want[:, 2]) > 0.5
    until(lambda: "uniform sphere" in status(page) and len(lines(page, "energy (J)")[0]) > 3)
    assert len(lines(page, "energy (J)")) == 2  # a chart has as many lines as there are finite numbers
    assert page.notes == []


def test_every_number_and_the_walls_reach_the_bench(page):
    """Every number of the page reaches the bench, and so do the walls; what is not allowed is shown as it was."""
    bench = page.session.bench
    for name, setting in SETTINGS.items():
        value = round(0.7 * setting.default + 0.3 * setting.low, 2)
        page.choose(setting.label, value)
        until(lambda name=name, value=value: bench.numbers[name] == value)
    for walls, count in (("none", 0), ("closed room", 6)):
        page.choose("walls", walls)
        until(lambda count=count: sum("wall" in name for name in list(page.nodes)) == count)
    page.choose("strength of hand", 3.0)
    page.choose("speed", 0.5)
    until(lambda: bench.strength == 3.0 and page.session.speed == 0.5)
    assert page.notes == []
    page.choose("stiffness", 1e9)
    page.choose("speed", 100.0)
    page.key("Turn left")
    told(page, "stiffness", "speed", "nothing is steered")
    until(lambda: page.shows("stiffness") == bench.numbers["stiffness"])


def test_the_mouse_drags_a_node_and_lets_go(page):
    """The mouse drags a node to the pointer, a line shows the hand, and the end of the drag lets go."""
    session = page.session
    bench, thing = session.bench, session.bench.specimens[0].thing
    page.choose("gravity (m/s2)", 0.0)
    until(lambda: bench.numbers["gravity"] == 0.0)
    page.press("Drop: start again (R)")
    until(lambda: np.allclose(drawn(page, "/0/nodes"), thing.body.position / thing.length, atol=1e-4))
    start = drawn(page, "/0/nodes")[0].copy()
    aim = start - np.array([0.0, 0.3, 0.0])
    page.drag("start", "/0/nodes", start, start)
    until(lambda: bench.hand is not None)
    assert bench.hand.node == 0
    page.drag("update", "/0/nodes", start, aim)
    until(lambda: np.linalg.norm(bench.specimens[0].position[0] / thing.length - aim) < 0.1)
    until(lambda: page.nodes["/0/hand"].get("visible") is True)
    page.drag("end", "/0/nodes", aim, aim)
    until(lambda: bench.hand is None and page.nodes["/0/hand"]["visible"] is False)
    page.drag("update", "/0/nodes", aim, start)  # late: nothing is dragged
    page.choose("mouse", "fix or release")
    until(lambda: session.panel.mouse == "fix")
    page.drag("start", "/0/nodes", drawn(page, "/0/nodes")[3], aim)
    until(lambda: len(bench.specimens[0].fixed) == 1)
    page.press("Release fixed nodes")
    until(lambda: bench.specimens[0].fixed == [])


def test_keys_and_buttons(page):
    """The page's keys and buttons: pause, one step, throw, drop, twist, invert."""
    session, bench = page.session, page.session.bench
    page.key("One step")
    until(lambda: session.paused)
    clock, step = bench.clock, bench.specimens[0].tank.dt
    page.press("One step (N)")
    until(lambda: bench.clock > clock)
    assert bench.clock == pytest.approx(clock + step)
    page.press("Throw (T)")
    until(lambda: bench.clock == 0.0)
    assert np.linalg.norm(bench.specimens[0].tank.velocity[0], axis=1).min() > 0.0
    page.key("Start again")
    until(lambda: not bench.specimens[0].tank.velocity.any())
    choose_object(page, "block")
    for label, how in (("Twist", "twisted"), ("Invert", "inverted")):
        page.press(label)
        until(lambda how=how: np.array_equal(bench.specimens[0].position, DISTORTIONS[how](bench.specimens[0].thing)))
    choose_object(page, "ring")
    page.press("Twist")
    told(page, "in a plane")
    page.choose("pause (space)", False)
    until(lambda: bench.clock > 0.05)


KINDS = ["sphere", "tetrahedral"]
KINDS += [pytest.param(name, marks=pytest.mark.slow) for name in ("string", "ring", "block", "mass_spring", "planar")]


@pytest.mark.parametrize("thing", KINDS)
def test_every_kind_of_object_is_drawn(page, thing):
    """Objects of every kind are drawn: lines, skins, tetrahedra by their strain, muscles, forces."""
    session = page.session
    page.choose("forces", True)
    choose_object(page, thing)
    until(lambda: "/0/forces" in page.nodes and "pictures" in status(page) and session.bench.clock > 0.1)
    parts = {name for _, name in session.drawing._handles}
    until(lambda: parts == {name[3:] for name in list(page.nodes) if name[:3] == "/0/" and "wall" not in name})
    assert ("element 0" in parts) == (session.bench.specimens[0].thing.body.tets is not None)
    assert ("skin 0" in parts) == (thing != "string") and ("skin 1" in parts) == (thing in ("ring", "sphere"))
    assert ("muscles" in parts) == (thing in ("mass_spring", "planar", "tetrahedral"))
    until(lambda: page.nodes["/0/forces"]["points"].any())
    arrows = page.nodes["/0/forces"]["points"].reshape(-1, 2, 3)
    assert np.isfinite(arrows).all() and np.linalg.norm(arrows[:, 1] - arrows[:, 0], axis=1).max() < 0.36
    for view in ("skin", "tetrahedra", "springs"):
        page.choose(view, False)
    for part in parts & {"element 0", "skin 0", "skin 1", "springs", "muscles"}:
        until(lambda part=part: page.nodes[f"/0/{part}"].get("visible") is False)
    page.press("Look again")
    choose_object(page, "uniform sphere")  # what is hidden stays hidden
    until(lambda: all(page.nodes.get(f"/0/{k}", {}).get("visible") is False for k in ("skin 0", "springs")))
    assert page.notes == []


def test_tetrahedra_are_seen_by_strain_or_as_plain_skin(page):
    """A body of tetrahedra is drawn by its strain or as plain skin; its muscles stay as they are."""
    session = page.session
    choose_object(page, "tetrahedral")
    page.choose("fish swim by the gait", True)
    until(lambda: session.bench.clock > 0.2)
    page.key("Pause")
    until(lambda: session.paused)
    _, owner = boundary(session.bench.specimens[0].thing.body.tets.nodes)
    shade = shade_of(session.bench.specimens[0].tet_strain()[owner])
    count = np.bincount(shade, minlength=SHADES)
    assert (count > 0).sum() > 2
    for k in np.flatnonzero(count):
        until(lambda k=k: drawn(page, f"/0/element {k}", "vertices").shape[0] == 3 * count[k])
        assert page.nodes[f"/0/element {k}"]["color"] == shades()[k].tolist()
    assert page.nodes["/0/skin 0"]["visible"] is False
    page.choose("tetrahedra", False)
    until(lambda: page.nodes["/0/skin 0"]["visible"] and page.nodes["/0/element 0"]["visible"] is False)
    assert page.nodes["/0/muscles"]["visible"]


def test_what_would_hide_forces_is_faint(page):
    """While forces are shown, the skin is faint, so that arrows within it are seen; without them it is as before."""
    until(lambda: "/0/skin 0" in page.nodes)
    before = page.nodes["/0/skin 0"]["opacity"]
    page.choose("forces", True)
    until(lambda: page.nodes["/0/skin 0"]["opacity"] < 0.2 and page.nodes["/0/skin 1"]["opacity"] < 0.2)
    assert page.nodes["/0/forces"]["visible"]
    page.choose("forces", False)
    until(lambda: page.nodes["/0/skin 0"]["opacity"] == before and page.nodes["/0/skin 1"]["opacity"] is None)


def test_objects_side_by_side_are_compared(page):
    """Objects stand apart, each with its own numbers and method, and are plotted against the first."""
    bench = page.session.bench
    made = lambda: [len(specimen.position) for specimen in bench.specimens]  # noqa: E731
    until(lambda: page.has("level") and not page.has("second level"))
    page.choose("level", 1)
    until(lambda: made() == [36])
    page.choose("second object", "uniform sphere")  # begins with the numbers of the first
    until(lambda: made() == [36, 36] and page.has("second level"))
    until(lambda: page.shows("second level") == 1 and page.shows("second layers") == 2)
    page.choose("second level", 2)
    until(lambda: made() == [36, 132])
    page.choose("level", 2)
    until(lambda: made() == [132, 132])
    page.choose("second level", 1)
    until(lambda: made() == [132, 36] and page.shows("second level") == 1 and page.shows("level") == 2)
    page.choose("second layers", 3)
    told(page, "layers")
    until(lambda: page.shows("second layers") == 2)
    page.choose("third object", "ring")
    until(lambda: made() == [132, 36, 24] and "/2/nodes" in page.nodes and page.has("third nodes"))
    page.choose("third integrator", "explicit_euler")
    until(lambda: bench.specimens[2].entry.integrator == "explicit_euler")
    page.choose("same cost", True)
    until(lambda: bench.same_cost and len(bench.distances) > 3)
    across = [drawn(page, f"/{k}/nodes")[:, 0].mean() for k in range(3)]
    assert across[0] < across[1] - 1.0 < across[2] - 2.0
    until(lambda: "3. ring" in status(page))
    for title in ("energy (J)", "distance from the first (lengths)"):
        until(lambda title=title: len(lines(page, title)) == (4 if title[0] == "e" else 3))
        assert np.isfinite(lines(page, title)).all()
    page.choose("second object", "nothing")
    until(lambda: made() == [132, 24] and "/2/nodes" not in page.nodes and not page.has("third nodes"))
    until(lambda: page.shows("third object") == "nothing" and page.shows("second nodes") == 12)


def test_a_method_that_fails_is_told_of(page):
    """A method that fails is named on the page, and all begins again."""
    choose_object(page, "ring")
    page.choose("integrator", "explicit_euler")
    until(lambda: page.session.bench.specimens[0].tank.integrator.name == "explicit_euler")
    page.choose("step", 50.0)
    page.press("Throw (T)")
    told(page, "explicit_euler failed on the ring")


def test_fish_are_steered_from_the_page(page):
    """Fish are steered from the page: keys and buttons command, the scene shows where to, and the bench comes back."""
    session = page.session
    page.choose("fish", 2)
    page.choose("steered by", "policy avoid")
    school = until(lambda: session.school)
    until(lambda: "/water/skin" in page.nodes and "/0/nodes" not in page.nodes)
    page.key("Turn left")
    until(lambda: np.degrees(school.commanded) == pytest.approx([30.0, 30.0]))
    until(lambda: "2 fish" in status(page))
    page.press("Right by 30 degrees (arrow key)")
    until(lambda: np.degrees(school.commanded) == pytest.approx([0.0, 0.0], abs=1e-9))
    page.click((0.0, 0.0, 3.0), (0.0, 0.1, -1.0))
    until(lambda: len(school.obstacles) == 1)
    place = school.obstacles[0] / school.fish.length
    until(lambda: np.allclose(drawn(page, "/water/obstacles")[0], place, atol=1e-5))
    page.click((0.0, 0.0, 3.0), (0.0, 0.1, 1.0))
    until(lambda: any("in the sky" in note for note in page.notes))
    page.press("Take obstacles away")
    until(lambda: school.obstacles == [])
    page.key("Pause")  # the command to the right is followed by one to the left after 0.2 s
    until(lambda: session.paused)
    page.press("Left after right (L)")
    until(lambda: (school.commanded < 0.0).all())
    page.choose("walls", "none")  # of the bench: not drawn while fish are steered
    page.press("Look again")
    clock = school.clock
    page.key("One step")
    until(lambda: school.clock == pytest.approx(clock + school.interval))
    page.key("Start again")
    until(lambda: school.time == 0.0)
    page.choose("steered by", "nobody: the objects above")
    until(lambda: session.school is None and "/0/nodes" in page.nodes)
    page.click((0.0, 0.0, 3.0), (0.0, 0.1, -1.0))  # on the objects: nothing is put


@pytest.mark.parametrize("count", [1, 64])
def test_the_camera_shows_all_fish_and_not_from_afar(page, count):
    """All fish are in what the panel leaves free of the page, and they fill a good part of it."""
    page.choose("fish", count)
    page.choose("steered by", "policy turn")
    until(lambda: page.session.school and page.session.school_drawing)
    page.key("Pause")
    until(lambda: page.session.paused)
    page.press("Look again")
    camera, free = page.session.client.camera, 1.0 - 2.0 * 336 / CAMERA["image_width"]
    until(lambda: np.linalg.norm(camera.look_at) > 0.0)
    ahead = (camera.look_at - camera.position) / np.linalg.norm(camera.look_at - camera.position)
    right = np.cross(ahead, (0.0, 0.0, 1.0)) / np.linalg.norm(np.cross(ahead, (0.0, 0.0, 1.0)))
    school = page.session.school
    nodes = school.shown_positions().reshape(-1, 3) / school.fish.length - page.session.school_drawing._focus
    way = nodes - camera.position
    half = np.tan(0.5 * CAMERA["fov"])
    across = way @ right / (way @ ahead) / half * CAMERA["image_height"] / CAMERA["image_width"]
    up = way @ np.cross(right, ahead) / (way @ ahead) / half
    assert across.min() > -1.0 and across.max() < free and np.abs(up).max() < 1.0
    assert np.ptp(across) > (0.6 if count > 1 else 0.15) * (free + 1.0)


def test_a_target_is_put_by_a_click(page):
    """A click puts the target of all fish on the water."""
    page.choose("steered by", "policy target")
    school = until(lambda: page.session.school)
    before = school.targets().copy()
    until(lambda: "/water/targets" in page.nodes)
    page.key("One step")
    until(lambda: page.session.paused)
    page.click((0.0, 0.0, 3.0), (0.2, 0.1, -1.0))
    until(lambda: not np.array_equal(school.targets(), before))
    assert school.targets()[0, 2] == pytest.approx(0.0, abs=1e-9)
    until(lambda: np.allclose(drawn(page, "/water/targets"), school.targets() / school.fish.length, atol=1e-5))


NOWHERE = [(float("nan"), 0.0, 0.0), (0.0, float("inf"), 0.0)]
NO_POINTS = [(0.0, 0.0), (0.0, 0.0, 0.0, 0.0), (None, 0.0, 0.0), ("a", 0.0, 0.0), 3.0, (True, 0, 0)]


def test_points_that_are_nowhere_are_told_and_the_session_goes_on(page):
    """Drags and clicks whose points are not finite are told of, nothing is done, and the session goes on."""
    session, bench = page.session, page.session.bench
    good = drawn(page, "/0/nodes")[0]
    for bad in NOWHERE:
        page.notes.clear()
        page.drag("start", "/0/nodes", bad, good)
        told(page, "start is")
        assert bench.hand is None
        page.drag("start", "/0/nodes", good, good)
        until(lambda: bench.hand is not None)
        aim = bench.hand._goal.copy()
        page.drag("update", "/0/nodes", good, bad)
        told(page, "end is")
        assert np.array_equal(bench.hand._goal, aim)
        page.drag("end", "/0/nodes", bad, bad)
        until(lambda: bench.hand is None)
    assert goes_on(page)
    page.choose("steered by", "policy avoid")
    school = until(lambda: session.school)
    for bad in NOWHERE:
        page.notes.clear()
        page.click(bad, (0.0, 0.1, -1.0))
        page.click((0.0, 0.0, 3.0), bad)
        told(page, "origin is", "direction is")
    page.notes.clear()
    page.click((0.0, 0.0, 3.0), (1e300, 0.0, -1e-300))
    until(lambda: page.notes)
    assert school.obstacles == [] and goes_on(page)


@pytest.mark.parametrize("start", NO_POINTS)
def test_a_drag_from_no_point_ends_its_page_alone(page, laboratory, start):
    """A page that drags from what is no point is sent away, as one that leaves; the others go on."""
    other = Viewer(laboratory).entered()
    other.drag("start", "/0/nodes", start, drawn(other, "/0/nodes")[0])
    until(lambda: not other.session.alive and other.session not in laboratory.sessions.values())
    assert goes_on(page)


def test_points_are_three_finite_numbers():
    """A point of a message is three finite numbers, and nothing else."""
    for bad in [*NOWHERE, *NO_POINTS, (), "abc", [1], {}, ((0.0, 0.0, 0.0),) * 3]:
        with pytest.raises(ValueError, match=r"start is .*give three finite numbers"):
            checked_point(bad, what="start")
    assert checked_point((1, 2.0, np.float64(3.0))).tolist() == checked_point([1, 2, 3]).tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("value", ["abc", "", 1e300, float("nan")])
def test_malformed_values_leave_everything_as_it_was(page, value):
    """What is no number does not reach the bench, whatever control it is of, and the session goes on."""
    bench = page.session.bench
    until(lambda: page.has("correction") or page.has("level"))
    before, speed, entry = dict(bench.numbers), page.session.speed, bench.specimens[0].entry
    labels = [setting.label for setting in SETTINGS.values()]
    for label in ("speed", "strength of hand", "level", "fish", "object", "integrator", "walls", *labels):
        page.send("GuiUpdateMessage", uuid=page._control(label), updates={"value": value})
    page.send("GuiUpdateMessage", uuid=page._control("pause (space)"), updates={"value": value})
    page.choose("pause (space)", False)
    until(lambda: not page.session.paused)
    assert goes_on(page)
    assert bench.numbers == before and page.session.speed == speed and bench.strength == 1.0
    assert bench.specimens[0].entry == entry and bench.walls == "own"


def test_a_camera_that_makes_no_sense_is_not_turned(page):
    """A page that tells nonsense of its camera cannot have it turned, and its session goes on."""
    nan = float("nan")
    for wrong in ({"fov": nan}, {"fov": -1.0, "image_height": -1}, {"position": (nan,) * 3}, {"look_at": (nan,) * 3}):
        page.send("ViewerCameraMessage", **(CAMERA | wrong))
        page.press("Look again")
        page.choose("object", "ring" if page.session.bench.specimens[0].entry.thing != "ring" else "uniform sphere")
        assert goes_on(page) and page.notes == []


def test_a_mistake_of_the_laboratory_does_not_end_the_session(page, capsys):
    """A request that fails in a way that nobody foresaw is told of, here in full, and the session goes on."""
    page.session.ask(lambda: {}["nothing"])
    told(page, "mistake")
    assert "KeyError: 'nothing'" in capsys.readouterr().err
    clock = page.session.bench.clock
    until(lambda: page.session.bench.clock > clock)


def test_pages_are_independent(page, laboratory):
    """Pages have a session each; one that vanishes in mid-drag ends its own, and what it dragged is let go."""
    other = Viewer(laboratory).entered()
    other.key("One step")
    until(lambda: other.session.paused)
    time.sleep(0.2)  # in which the step is taken
    clock, still = page.session.bench.clock, other.session.bench.clock
    until(lambda: page.session.bench.clock > clock + 0.2)
    assert not page.session.paused and other.session.bench.clock == still
    point = drawn(other, "/0/nodes")[0]
    other.drag("start", "/0/nodes", point, point)
    until(lambda: other.session.bench.hand)
    other.leave()
    assert other.session.bench.hand is None and other.session not in laboratory.sessions.values()
    assert goes_on(page)


def test_a_laboratory_waits_until_it_is_closed():
    """A laboratory waits until it is closed; it listens at this machine only, and has no public address."""
    laboratory = server.Laboratory("127.0.0.1", 18400)
    assert laboratory.server.get_host() == "127.0.0.1" and laboratory.server.request_share_url() is None
    waiting = threading.Thread(target=laboratory.wait)
    waiting.start()
    assert waiting.is_alive()
    laboratory.close()
    waiting.join(60.0)
    assert not waiting.is_alive()


@pytest.mark.parametrize("host", ["203.0.113.7", "no such host", "x" * 70])
def test_an_address_that_cannot_be_listened_at_is_refused(host):
    """An address of another machine, or of none, is refused instead of waited for."""
    with pytest.raises(ValueError, match="cannot listen at"):
        server.Laboratory(host, 18400)


def test_the_distance_of_the_camera_chooses_the_level(page):
    """From far away the uniform sphere is coarse, and goes on falling; from near it is fine; a ring stays a ring."""
    bench, specimen = page.session.bench, lambda: page.session.bench.specimens[0]
    nodes = lambda: len(specimen().position)  # noqa: E731
    assert nodes() == 132
    far = {**CAMERA, "position": (0.0, -60.0, 1.0)}
    page.send("ViewerCameraMessage", **far)
    clock = bench.clock
    page.choose("level by distance", True)
    until(lambda: nodes() == 36)
    assert bench.clock >= clock and specimen().time > 0.0 and specimen().tank.alive[0]
    until(lambda: page.shows("level") == 1)
    page.send("ViewerCameraMessage", **CAMERA)
    until(lambda: nodes() == 516)
    page.send("ViewerCameraMessage", **{**CAMERA, "position": (float("nan"), 0.0, 0.0)})
    told(page, "camera")
    until(lambda: page.shows("level by distance") is False)
    page.send("ViewerCameraMessage", **CAMERA)
    page.choose("level by distance", True)
    choose_object(page, "ring")
    page.send("ViewerCameraMessage", **far)
    until(lambda: bench.clock > 0.2)
    assert nodes() == 24 and page.shows("level by distance") is False


def test_a_choice_made_while_another_is_answered_holds(page):
    """A choice that is made while another one is answered holds: controls may be ahead of the bench."""
    session = page.session
    page.key("Pause")
    until(lambda: session.paused)
    hold, held = threading.Event(), threading.Event()

    def wait():
        held.set()
        hold.wait(60.0)

    session.ask(wait)
    held.wait(60.0)
    for label, value in (("object", "ring"), ("integrator", "explicit_euler"), ("second object", "ring"), ("fish", 2)):
        page.choose(label, value)
    page.choose("second integrator", "explicit_euler")
    last = page._control("second integrator")
    until(lambda: session.client.gui._gui_input_handle_from_uuid[last].value == "explicit_euler")
    hold.set()
    until(lambda: [s.entry.integrator for s in session.bench.specimens] == ["explicit_euler", "explicit_euler"])
    assert [s.entry.thing for s in session.bench.specimens] == ["ring", "ring"] and session.school is None
    with pytest.raises(ValueError, match="made with nodes, layers"):
        session.panel.first.set_number("level", 3)  # of an object that is gone
