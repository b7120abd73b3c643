"""Tables of the pages are those of benchmarks/results: each is written again from its CSV file and found there."""

import json
import re

import gymnasium as gym
import numpy as np
import pytest
from pages import ROOT

from benchmarks.accuracy.held_out import SETTINGS, least_expensive
from benchmarks.calibration import living_fish
from benchmarks.common.tables import columns, line, read_table, select
from benchmarks.objects import layers, solids, survey
from benchmarks.objects.scenes import SCENES
from benchmarks.stability import claim
from benchmarks.water import levels
from fish_env import make_fish
from fish_env.control.chart import steps_of
from fish_env.soft.objects import OBJECTS, SONG
from fish_env.training.config import CONFIGS


def one(table, /, **wanted):
    """The only row of a table with these values."""
    (row,) = read_table(table, **wanted)
    return row


def short(value, digits=2):
    """A number with a few significant digits."""
    return f"{float(f'{value:.{digits}g}'):,.10g}" if value >= 10 else f"{value:#.{digits}g}".rstrip(".")


HELD_OUT = (("reactive", "mass_spring"), ("drag", "mass_spring"), ("drag", "tetrahedral"))


def first_held_out(water="reactive", body="mass_spring", **wanted):
    """The first row of a body on the held-out scenes: without other wishes, its own method at its own step."""
    return read_table("held_out.csv", body=body, water=water, **wanted)[0]


def held_out(row):
    """Cost and errors of a method at a step: over the held-out scenes, and on the abrupt turn."""
    errors = (row[key] for key in ("geometric_mean", "ninety_percent", "worst", "turn"))
    percent = (np.format_float_positional(float(f"{100 * error:.2g}"), trim="-") for error in errors)
    return short(row["us_per_interval"]), *("fails" if error == "nan" else f"{error} %" for error in percent)


def methods():
    """Methods on the held-out scenes of the default fish."""
    for name, steps in (
        ("leapfrog_chebyshev", (12, 32)), ("symplectic_euler", (64,)), ("semi_implicit", (64,)),
        ("rosenbrock", (24,)), ("rk4", (24,)),
    ):  # fmt: skip
        for k in steps:
            row = first_held_out("reactive", "mass_spring", integrator=name, substeps=k)
            assert not row["failed"]
            cost, mean, high, _, turn = held_out(row)
            yield line(f"`{name}`", k, cost, mean, high, turn)


def scenes_to_choose():
    """Methods for scenes, with costs and errors on the held-out scenes."""
    for text, water, body, name, k in (
        ("turns, starts, power: the default", "reactive", "mass_spring", "leapfrog_chebyshev", 12),
        ("the same, at one depth", "reactive", "planar", "leapfrog_chebyshev", 12),
        ("steady swimming, large batches", "drag", "mass_spring", "leapfrog_chebyshev", 6),
        ("the same, at one depth", "drag", "planar", "leapfrog_chebyshev", 6),
        ("an enclosed volume, a soft interior", "drag", "two_layer", "leapfrog_chebyshev", 24),
        ("a known material", "drag", "tetrahedral", "leapfrog_chebyshev", 12),
        ("a seventh of the default's error", "reactive", "mass_spring", "leapfrog_chebyshev", 32),
        ("an error far below that of the model", "reactive", "mass_spring", "rk4", 24),
        ("the published method", "reactive", "mass_spring", "semi_implicit", 64),
    ):  # fmt: skip
        row = first_held_out(water, body, integrator=name, substeps=k)
        assert not row["failed"]
        cost, mean, _, worst, _ = held_out(row)
        yield line(text, f'`"{water}"`', f"`{body}`", f"`{name}`; {k}", cost, mean, worst)


def unpredictable():
    """Held-out scenes without an error, of the bodies with their own methods and steps."""
    found = [first_held_out(water, body) for water, body in SETTINGS]
    assert not any(row["failed"] for row in found)
    yield f"At most {max(row['unpredictable'] for row in found)} of the 64 scenes of a body are [unpredictable]"


def failures():
    """Fish that failed in the stress test, by body and kind of stress."""
    rows = read_table("stress.csv")
    starts = ("perturbed", "fast", "crumpled", "inverted")
    for body in dict.fromkeys(row["body"] for row in rows):
        cells, tried = [], 0
        for kinds in (("random", "bang-bang", "oscillating"), starts, ("stiffness",), ("search",)):
            mine = [row for row in rows if row["body"] == body and row["family"].split(",")[0].split(" ")[0] in kinds]
            failed, count = (sum(row[key] for row in mine) for key in ("failures", "fish"))
            cells.append(f"{failed} of {count:,}" if failed else "0")
            tried += count
        yield line(f"`{body}`{', at its step of 0.0275' * (body == 'published')}", f"{tried:,}", *cells)


def bodies():
    """Nodes, costs and distances of the bodies."""
    rows = read_table("fidelity.csv", quantity="all")
    (cost,) = {row["cost_s_per_s"] for row in rows if row["body"] == "mass_spring"}
    for body, level in dict.fromkeys((row["body"], row["level"]) for row in rows):
        mine = select(rows, body=body, level=level)
        worst, best = (100 * choose(row["error"] for row in mine) for choose in (max, min))
        distance = f"{short(best)} to {short(worst)} %" if best else "0"
        ratio = mine[0]["cost_s_per_s"] / cost
        relative = "1" if ratio == 1 else short(ratio, 1 if ratio > 50 else 2)
        yield line(mine[0]["nodes"], relative, distance)


def fits():
    """Distances of the fitted bodies to the finest one: on other seeds, and over what they were fitted to."""
    found = {}
    for body in ("mass_spring", "planar", "two_layer"):
        rows = read_table("fit_tests.csv", water="reactive", body=body, kind="task", quantity="all")
        tasks = {row["scene"]: 100 * row["distance"] for row in rows}
        start = tasks.pop("fast_start")
        found[body] = f"{min(tasks.values()):.0f} to {max(tasks.values()):.0f} %", f"{start:.0f} %"
    yield "`mass_spring` is {} from the finest body in tasks, and {} in fast starts".format(*found["mass_spring"])
    yield "`planar` is {} and {} from it, `two_layer` {} and {}".format(*found["planar"], *found["two_layer"])
    found = {}
    for body in ("mass_spring", "planar", "two_layer"):
        record = json.loads((ROOT / f"fish_env/bodies/{body}.json").read_text())
        found[body] = f"{record['reactive']['distance_percent']:.1f} %"
    yield f"is {found['mass_spring']} from the finest body over what it was fitted to, `planar` {found['planar']}"


def transfers():
    """What the shipped policies and the motor controllers do on every body."""
    for task, metric, text in (
        ("swim", "speed", "Swim: speed, BL/s"), ("turn", "success", "Turn: success, %"),
        ("left_after_right", "success", "LeftAfterRight: success, %"),
        ("target", "time_per_target", "Target: time per target, s"), ("avoid", "avoided", "Avoid: avoided, %"),
    ):  # fmt: skip
        rows = read_table("transfer.csv", task=task, metric=metric)
        scale, digits = (100, ".0f") if "%" in text else (1, ".2f")
        found = {(row["who"], row["body"]): f"{scale * row['mean']:{digits}}" for row in rows}
        bodies = ("planar", "mass_spring", "two_layer", "tetrahedral")
        yield line(text, *(f"{found['policy', body]}; {found['motor controllers', body]}" for body in bodies))
    assert not any(row["mean"] for row in read_table("transfer.csv", metric="failed"))


def bounds():
    """The best that was found, beside the motor controllers and the policy: means of the starts in which both are."""
    names = {"turn": "Turn", "left_after_right": "Left after right", "fast_start": "Fast start", "swim": "Swim"}
    rows = read_table("learning/bound.csv")
    for task, quantity in dict.fromkeys((row["task"], row["quantity"]) for row in rows):
        mine = select(rows, task=task, quantity=quantity)
        cells = [f"{np.mean([row['bound'] for row in mine]):.2f}"]
        for who in ("motor_controllers", "policy"):
            both = [(row[who], row["bound"]) for row in mine if row[who] != ""]
            few = f", in {len(both)} of {len(mine)}" if len(both) < len(mine) else ""
            cells.append(f"{np.divide(*np.sum(both, axis=0)):.2f} times{few}" if both else "-")
        apart = max(row["seeds_apart"] for row in mine)
        yield line(f"{names[task]}: {quantity}{UNITS[quantity]}", *cells, f"{apart:.3f}")
    over = []
    for task in list(names)[:2]:
        own = select(rows, task=task, swum_by="policy")
        best, rewarded = (sum(row["bound"] for row in select(own, quantity=name)) for name in list(UNITS)[:2])
        policy = sum(row["policy"] for row in select(own, quantity="latency"))
        over.append((policy / best, rewarded / best, policy / rewarded))
    latency, reward, learning = zip(*over, strict=True)
    yield "its latency is {:.2f} times the best in Turn and {:.2f} times in left after right".format(*latency)
    yield "the largest return takes {:.2f} and {:.2f} times the best latency".format(*reward)
    yield "the policy {:.2f} and {:.2f} times that".format(*learning)


UNITS = {"latency": ", s", "latency of the largest return": ", s", "escape distance": ", BL", "speed": ", BL/s"}


def gait():
    """The best gait, exponents of the fastest gaits, and the tables of living fish that are written into the page."""
    found = {(row["water"], row["quantity"]): row for row in read_table("gait.csv")}
    shown = {name: [found[water, name][key] for water in ("drag", "reactive") for key in ("ours", "reference")]
             for name in living_fish.GAIT}  # fmt: skip
    speeds = shown.pop("speed, BL/s")
    yield f"swims {speeds[0]:.1f} BL/s in drag and {speeds[2]:.1f} BL/s in reactive water"
    del shown["tail sweep, BL"], shown["tail tips apart, over the sweep"]
    for name, (drag, by_rk4, reactive, by_rk4_too) in shown.items():
        assert abs(by_rk4_too - reactive) < 0.001
        yield line(name, *(f"{value:.2f}" for value in (drag, by_rk4, reactive)), "")[:-2]
    exponents = []
    for fish in ("reactive", "drag"):
        length, *others = np.log(columns(read_table("validation/sizes.csv", fish=fish), *SCALED))
        exponents.append(", ".join(f"{np.polyfit(length, each, 1)[0]:.1f}" for each in others))
    yield "speed in BL/s and power: {} in reactive water; {} in drag".format(*exponents)
    yield living_fish.table(read_table("living_fish.csv"))
    yield living_fish.strength_table(read_table("strength.csv"))


def rates():
    """Environment steps a second, rounded to thousands; times of control intervals; what senses and pictures take."""
    found = {row["quantity"]: row["value"] for row in read_table("throughput.csv")}
    steps = [value for name, value in found.items() if name.endswith("steps/s")]
    yield f"| {round(steps[0], -2):,.0f} |"
    yield from (f"| {round(value, -3):,.0f} |" for value in steps[1:])
    times = [value for name, value in found.items() if name.startswith("a control interval")]
    yield from (f"| {short(value)} |" for value in times)
    first = [value for name, value in found.items() if name.startswith("first make")]
    yield f"take {first[0]:.1f} s with nothing compiled, and {first[1]:.1f} s after that"
    yield f"one environment takes {found['memory of a process with one environment, MB']:.0f} MB"
    batch, alone = intervals()
    yield f"In drag a control interval costs [{1 / batch:.2f} of that in a batch, and {1 / alone:.2f} alone]"
    one, many = (f"an environment step of {n} fish, noise, delays and a history, over one of nodes" for n in (1, 256))
    yield f"take less than {1 + int(100 * max(found[one] - 1.0, found[many] - 1.0, 0.0))} % of a step"
    one, many = ([found[f"{what} of {n} fish, us a fish"] for what in ("get_state", "set_state")] for n in (1, 256))
    yield f"take {one[0]:.0f} and {one[1]:.0f} µs for one fish, {many[0]:.1f} and {many[1]:.1f} µs a fish for 256"
    yield f"`linearise` takes {found['linearise of one fish, us'] / 1000:.1f} ms"
    above, side, follow = (
        f"{round(found[f'pictures of 84 x 84 a second, {camera}, with the step'], -1):,.0f}"
        for camera in ("above", "side", "follow")
    )
    yield f'come at {above} (`"above"`), {side} (`"side"`) and {follow} (`"follow"`) a second'


def peers():
    """MuJoCo's time over this package's; environments; simulated seconds a second at 1 % error."""
    alone, many = (read_table("speed/peers.csv", what="springs", copies=k)[-1]["times_ours"] for k in (1, 256))
    yield f"takes {alone:.0f} times as long for one fish, and {many:.0f} times for each of 256"
    for row in read_table("speed/peers.csv", what="environment step")[1:]:
        name = row["name"] if row["copies"] == 1 else f"`{row['name']}`, each of {row['copies']}"
        yield line(name, short(row["times_ours"]), short(row["times_ours"] * 0.02 / row["simulated_s"]))
    found = [read_table("speed/peers.csv", what="1 % error, springs in vacuum", copies=k) for k in (1, 256)]
    for same in zip(*found, strict=True):
        yield line(same[0]["name"], *(short(row["simulated_s"] / row["us"] * 1e6) for row in same))
    row = least_expensive(read_table("held_out.csv", body="mass_spring", water="reactive"), 0.01, "geometric_mean")
    name = f"swimming in reactive water: {row['integrator']}, {row['substeps']} steps"
    yield line(name, "-", short(0.02 / row["us_per_interval"] * 1e6))


# Elastic objects


def tiny(value, digits=2):
    """A number with a few digits; of small and large ones the first digit and the power of ten."""
    return "0" if value == 0.0 else f"{value:.{digits}g}" if 1e-3 <= abs(value) < 1e4 else f"{value:.0e}"


def step(value):
    """A step, ms, with two digits."""
    return f"{value:.0f}" if value > 99 else f"{value:.2g}"


def scenes():
    """Elastic objects: what their scenes and layers do, and their largest steps."""
    growth = []
    for kind in OBJECTS:
        rows = read_table("objects_scenes.csv", object=kind)
        assert [row["scene"] for row in rows] == list(SCENES) and not any(row["escapes"] for row in rows)
        assert all(row["times_real_time"] > 1.0 and row["depth_over_travel"] < 1.0 for row in rows)
        growth += [row["growth"] for row in rows]
    yield f"the energy grows by at most {100 * max(growth):.1f} % of that of the fall"
    vacuum = {"object": "ring", "pressure_over_standard": 0.0}
    single, double, *_, fallen = (
        f"{abs(one('objects_layers.csv', layers=count, drop=drop, **vacuum)['kept']):.2f}"
        for count, drop in ((1, layers.DROPS[0]), *((2, drop) for drop in layers.DROPS))
    )
    assert layers.DROPS[-1] == 0.3
    yield f"a ring of one layer keeps {single} of its area. One of two layers keeps {double}, and {fallen} after a fall"
    for kind in SONG:
        found = {row["method"]: row for row in read_table("objects_methods.csv", object=kind)}
        yield line(kind, *(f"{step(found[k]['stable_ms'])}; {step(found[k]['scenes_ms'])}" for k in survey.METHODS))


def beam():
    """The cantilever of four and of eight cells; measures of strain beside one another."""
    four, eight = (100 - 100 * one("elements_beam.csv", cells=count)["deflection"] for count in (4, 8))
    yield f"Eight through the thickness for {eight:.0f} % in the deflection, four for {four:.0f} %"

    def compared(label, case, at, key="value", digits=2):
        found = (one("elements_strains.csv", case=case, strain=strain, at=at)[key] for strain in solids.STRAINS)
        return line(label, *(tiny(value, digits) for value in found))

    def cost(method):
        rows = [one("solids_methods.csv", strain=strain, method=method) for strain in solids.STRAINS]
        return (tiny(row["cost_1.25_ms"] / rows[0]["cost_1.25_ms"]) for row in rows)

    yield compared("Energy of a block rotated by 90°, over $`E V`$", "rotation", 90)
    yield compared("Bent beam's tip from the elastica, over its length, end load $`10\\,EI/L^2`$", "bending", 10)
    yield compared("Its volume, over that at rest", "bending", 10, "volume", 4)
    yield compared("Force on a bar at 1.5 times its length, over $`E A`$", "extension", 1.5)
    yield line("Cost of a step of `leapfrog_chebyshev`", *cost("leapfrog_chebyshev"))
    yield line("Cost of a step of `linearly_implicit`, factors reused", *cost("linearly_implicit"))


def moved_solids():
    """Methods on the corotational beam."""
    for name in solids.METHODS:
        row = one("solids_methods.csv", strain="corotational", method=name)
        error, cost = solids.error_and_cost(row)
        yield line(f"`{name}`", step(row["stable_ms"]), tiny(row["error_1.25_ms"]), f"{cost[error < 1e-3].min():.0f}")


def water_tables():
    """Tables of the levels of water, as they are written."""
    for name, table in levels.TABLES.values():
        yield table(read_table(name))


SCALED = ("length_m", "frequency_hz", "speed", "power_w_kg")


# Sentences


def scores():
    """Values of the published methods by task, condition, method and metric."""
    rows = read_table("learning/methods.csv")
    return {tuple(row[key] for key in ("task", "condition", "method", "metric")): row["value"] for row in rows}


def test_reward_thresholds():
    """Every task is solved from between the motor controllers and the shipped policy on, at the middle third."""
    returns = {key[0]: value for key, value in scores().items() if key[1:] == ("", "PPO", "return")}
    assert set(returns) == set(CONFIGS)
    for task, best in returns.items():
        without = scores()[task, "", "motor controllers", "return"]
        share = (gym.spec(CONFIGS[task].env_id).reward_threshold - without) / (best - without)
        assert best > without and 1 / 3 < share < 2 / 3, f"{task}: set SOLVED near {(best + without) / 2:.0f}"


def aims():
    """What was reached of the aims, and what was missed."""
    value = scores()

    def ratio(task, metric, other):
        return value[task, "", "PPO", metric] / value[task, "", other, metric]

    yield f"open-loop gait: {ratio('swim', 'speed', 'best open-loop gait'):.1f} times (1.1)"
    turn, left = (ratio(task, "latency", "motor controllers") for task in ("turn", "left_after_right"))
    target = ratio("target", "time_per_target", "motor controllers")
    yield f"Turn {turn:.2f} (1), left after right {left:.1f} (1), time per target {target:.2f} (0.8)"
    rest = "90 degrees, from rest"
    angle = value["fast_start", rest, "PPO", "angle_300ms"]
    yield f"| fast start from rest, turned in 0.3 s | 90 degrees | {angle:.0f} degrees |"
    over = {name: sum(row["policy"] for row in rows) / sum(row["bound"] for row in rows) - 1 for name, rows in (
        (name, read_table("learning/bound.csv", task=name, quantity=quantity)) for name, quantity in (
            ("swim", "speed"), ("fast_start", "escape distance"), ("turn", "latency"), ("left_after_right", "latency")
        ))}  # fmt: skip
    swim, start, turn, left = (f"{abs(100 * part):.0f} %" for part in over.values())
    yield f"| speed off the best found, Swim | 3 % | {swim} |"
    yield f"Turn; left after right | 10 % | {turn}; {left} |"
    rows = read_table("fit_tests.csv", water="reactive", body="mass_spring", kind="task", quantity="all")
    found = {row["scene"]: 100 * row["distance"] for row in rows}
    start = found.pop("fast_start")
    yield f"in tasks; fast start | 3 % | {min(found.values()):.0f} to {max(found.values()):.0f} %; {start:.0f} % |"
    row = first_held_out()
    assert row["turn"] < 0.01 and row["geometric_mean"] < 0.003
    yield f"turn {100 * row['turn']:.1f} % (1 %), held-out scenes {100 * row['geometric_mean']:.1f} % (0.3 %)"
    cheetah = one("speed/peers.csv", name="HalfCheetah-v5")
    batch = one("speed/peers.csv", name="FishEnv/Swim-v0", copies=256)
    yield f"| 2.5; 9 times | {cheetah['times_ours']:.1f}; {cheetah['us'] / batch['us']:.1f} times |"
    rows = read_table("stress.csv", body="mass_spring")
    yield f"{sum(r['failures'] for r in rows)} of {sum(row['fish'] for row in rows):,} fish fail (0)"


def severe():
    """Left after right at twice the severity; every obstacle can be avoided."""
    success, failed = read_table("learning/severe.csv")
    yield f"{100 * success['value']:.1f} % of {success['episodes']:,} episodes, {failed['value']:g} failures (0)"
    possible, avoided = ([r["value"] for r in read_table("learning/methods.csv", task="avoid", metric=metric)]
                         for metric in ("avoided_possible", "avoided"))  # fmt: skip
    yield "Every obstacle can be avoided" if possible == avoided else "Not every obstacle can be avoided"
    rows = {who: read_table("reversal.csv", controller=who) for who in ("motor controllers", "PPO")}
    way, off = zip(*((np.hypot(*np.diff(columns(each, "x", "y")).reshape(2, -1)).sum(),
                      np.abs([row["heading"] - row["command"] for row in each]).mean())
                     for each in rows.values()), strict=True)  # fmt: skip
    assert way[1] > way[0] and off[1] < off[0]
    yield "PPO swims farther and follows its command more closely"


def beside_living_fish():
    """How near the default fish is to a trout."""
    rows = read_table("living_fish.csv", water="reactive", body="mass_spring")
    speed, sweep = (max(abs(row[key] / row[f"{key}_trout"] - 1) for row in rows) for key in ("speed", "sweep"))
    yield f"off its speed; sweep, at most | 10 % | {100 * speed:.0f} %; {100 * sweep:.0f} % |"
    for key, digits, aim in (
        ("envelope_off", 3, "midline off, BL | 0.012"), ("nose_over_tail", 2, "nose over tail | 0.08 to 0.20"),
        ("strouhal", 2, "Strouhal number | 0.2 to 0.35"),
    ):  # fmt: skip
        yield f"| {aim} | {', '.join(f'{row[key]:.{digits}f}' for row in rows)} |"
    turn = one("strength.csv", water="reactive", body="mass_spring", strength=1)
    costs = (rows[1]["thrust"] / 0.6, rows[2]["thrust"] / 0.9)  # J/kg/m over a trout's, in the table of validation.md
    yield f"| within a factor 1.5 | {costs[0]:.2f}, {costs[1]:.2f} |"
    yield f"at 0.5 and 1 BL/s | a third | {rows[0]['lost']:.2f}, {rows[1]['lost']:.2f} |"
    yield f"is within {100 * speed:.0f} % of its speed and {100 * sweep:.0f} % of its tail sweep"
    yield f"At best it turns by {turn['angle']:.0f} degrees in 0.3 s, with {turn['acceleration']:.0f} m/s²"
    drag = one("strength.csv", water="drag", body="mass_spring", strength=1)
    yield f"Its circles are {drag['radius'] / turn['radius']:.1f} times as wide"


def kinematics():
    """Motion of the shipped policy of Swim."""
    row = one("learning/kinematics.csv", task="swim")
    yield f"beats {row['beat_hz']:.1f} times a second and sweeps {row['sweep']:.2f} BL."
    yield f"Its nose moves {row['nose_over_tail']:.2f} of the tail's sweep"
    yield f"swings by {row['half_strain_percent']:.0f} % to either side, at up to {row['strain_rate']:.1f}/s"
    yield f"under up to {row['stress_peak_kpa']:.0f} kPa; living muscle"


def weights():
    """Speed that a weight on a swaying head costs Swim."""
    for row in read_table("learning/weights.csv", effort_weight=2.2):
        yield line(f"{row['sway_weight']:g}", f"{row['speed']:.2f}", f"{row['nose_over_tail']:.2f}")


def trainings():
    """How long a seed takes, and what the default step changes in the returns."""
    minutes = [row["training_seconds"] / 60 for row in read_table("learning/seeds.csv")]
    yield f"{min(minutes):.0f} to {max(minutes):.0f} minutes per seed on one core"
    rows = read_table("integrators_policies.csv", episodes=1000)
    assert not any(row["failed"] for row in rows)
    change, success = (max(abs(row[f"{name}_change"] or 0.0) for row in rows) for name in ("return", "success"))
    yield f"the returns are within {np.ceil(1000 * change) / 10} % of those under RK4 at an eighth of the step"
    yield f"success differs by at most {100 * success:.1f} %, and no fish fails"


def intervals():
    """Costs of a control interval in reactive water, over drag: in a batch, and alone."""
    steps = steps_of(make_fish()) / steps_of(make_fish(water="drag"))
    return [steps * one("water_prices.csv", fish="reactive", dtype="float64", count=k)["over_drag"] for k in (256, 1)]


def default_step():
    """The default step beside others."""
    own, finer = first_held_out(), first_held_out(integrator="leapfrog_chebyshev", refine=np.inf, substeps=32)
    less, longer = own["geometric_mean"] / finer["geometric_mean"], finer["us_per_interval"] / own["us_per_interval"]
    yield f"32 steps of two have an error {less:.0f} times smaller, for {longer:.0f} times the time"
    assert own["turn"] < 0.01
    drag = first_held_out("drag")
    ratios = [own[key] / drag[key] for key in ("geometric_mean", "ninety_percent", "worst", "turn")]
    yield f"is {min(ratios):.0f} to {max(ratios):.0f} times as accurate"
    tu, symplectic = (first_held_out(integrator=name, substeps=64) for name in ("semi_implicit", "symplectic_euler"))
    yield f"has {tu['geometric_mean'] / symplectic['geometric_mean']:.1f} times the mean error of symplectic Euler"
    turn = read_table("work_precision.csv", scene="turn", integrator="explicit_euler")
    yield f"`explicit_euler` needs {min(row['substeps'] for row in turn if row['error'] < 0.01):,} steps for 1 % on"
    magnified = [row["magnified"] for row in read_table("work_precision_references.csv")]
    yield f"of the initial state {min(magnified):.0f}- to {max(magnified):.0f}-fold"


def claims():
    """Longest steps without failures, costs there, and what fails at the published step."""
    found = {name: [claim.longest_safe(body=body, integrator=name) for body in claim.FISH] for name in claim.METHODS}
    for name, ((published, cost), *others) in found.items():
        cells = (f"{short(1e3 * safe)}; {short(each)}" for safe, each in others)
        yield line(claim.METHODS[name], f"{short(published)}; {short(1e3 * cost)}", *cells)
    steps = {name: np.array([safe for safe, _ in pairs]) for name, pairs in found.items()}
    tu, default = steps["semi_implicit"], steps["leapfrog_chebyshev"]
    euler, midpoint = tu / steps["explicit_euler"], tu / steps["midpoint"]
    assert euler[1] < 1.0 and midpoint[1] < 1.0 and (steps["symplectic_euler"] >= tu).all()
    assert all((default >= each).all() for each in steps.values())
    yield f"steps {euler[0]:.0f} and {euler[2]:.0f} times as long as explicit Euler"
    yield f"They are {midpoint[0]:.1f} and {midpoint[2]:.1f} times as long as midpoint's"
    yield f"{(default / tu).min():.0f} to {(default / tu).max():.0f} times as long as Tu's"
    pairs = zip(found["symplectic_euler"], found["semi_implicit"], strict=True)
    parts = [own / cost for (_, own), (_, cost) in pairs]
    yield f"for {min(parts):.1f} to {max(parts):.1f} of the time"
    lost = {kind: {} for kind in claim.COMMANDS}
    for row in read_table("stability_claim.csv", body="published", step_s=claim.PUBLISHED):
        lost[row["commands"]][row["integrator"]] = 100 * row["failed"] / row["fish"]
    assert not any(each[name] for each in lost.values() for name in ("symplectic_euler", "rk4", "leapfrog_chebyshev"))
    turn, random = (lost[kind]["semi_implicit"] for kind in ("abrupt", "random"))
    yield f"Tu's method loses {turn:.0f} % of the fish in the abrupt turn and {random:.0f} % under random commands"


def theory():
    """Largest stable steps of the default fish over those of linear theory, at every stiffness."""
    found = {}
    for name in ("rk4", "symplectic_euler", "semi_implicit"):
        rows = read_table("stability_limits.csv", body="mass_spring", integrator=name)
        found[name] = np.divide(*columns(rows, "largest_stable_s", "linear_theory_s"))
        assert [row["stiffness"] for row in rows[:3]] == [1.0, 3.0, 10.0]
    off = np.abs(np.stack([found["rk4"], found["symplectic_euler"]]) - 1.0).max()
    yield f"follow the theory (dashed) to within {np.ceil(100 * off):.0f} %"
    first, _, *stiff = found["semi_implicit"]
    assert min(stiff) > 0.97
    yield f"`semi_implicit` reaches {first:.1f} of it, and all of it from 10 times the stiffness on"


def claim_in_short():
    """The abrupt turn of the published fish."""
    safe = {name: claim.longest_safe(body="published", commands="abrupt", integrator=name) for name in claim.METHODS}
    tu, cost = safe["semi_implicit"]
    euler, midpoint = (tu / safe[name][0] for name in ("explicit_euler", "midpoint"))
    yield f"steps {euler:.0f} times as long as explicit Euler and {midpoint:.1f} times as long as midpoint"
    own, default = (safe[name][0] / tu for name in ("symplectic_euler", "leapfrog_chebyshev"))
    assert 0.45 < safe["symplectic_euler"][1] / cost < 0.6  # half the time
    yield f"Symplectic Euler takes steps {own:.2f} times as long as Tu's method, for half the time"
    yield f"the default {default:.1f} times as long"


def choices():
    """Reasons for choices, and single sentences."""
    yield f"It costs {intervals()[0]:.1f} times as much in a batch."
    rows = read_table("water_stability.csv", body="mass_spring")
    assert not any(row["failures"] for row in rows)
    yield f"None of {sum(row['fish'] for row in rows) // 2:,} fish of the stress test fails, in either water."
    controllers, ppo = (scores()["swim", "", method, "return"] for method in ("motor controllers", "PPO"))
    yield f"The motor controllers reach {controllers:.1f}, and PPO {ppo:.1f} after 2 million steps."
    batch, alone = intervals()
    yield f"So a control interval costs {batch:.1f} times that in drag in a batch, and {alone:.1f} times alone."
    row = one("throughput.csv", quantity="256 fish on 2 processors, steps/s")
    yield f"two cores make [{round(row['value'], -3):,.0f} steps](performance.md#environments) a second"


def held_out_comparisons():
    """Water beside measurements of others."""
    waters = ("drag", "drag, friction", "reactive", "reactive, friction")
    mackerel, eel = (read_table("validation/torque.csv", animal=animal) for animal in ("mackerel", "eel"))
    for name, rows, key, published in (
        ("lamprey: speed, BL/s", read_table("validation/lamprey.csv"), "speed_bl_s", "published"),
        ("computed eel: speed, BL a beat", read_table("validation/eel.csv"), "speed_bl_beat", "published"),
        ("computed mackerel: largest torque, 10⁻⁴ \u03c1L⁵/T²", mackerel, "torque", "published_torque"),
        ("another computed eel: largest torque", eel, "torque", "published_torque"),
        ("the same, speed, BL a period; Reynolds number assumed", mackerel, "speed_bl_period", "published_speed"),
    ):
        found = {row["water"]: row[key] for row in rows}
        yield line(name, f"{rows[0][published]:.2f}", *(f"{found[water]:.2f}" for water in waters))
    row = one("validation/torque.csv", animal="mackerel", water="reactive")
    yield f"With it, the torque is {row['off_percent']:.0f} % too large, and its peak lies 0.08 BL farther forward."
    found = [f"{row['coefficient']:.3f}" for row in read_table("validation/coasting.csv", reynolds=41000.0)]
    yield "the default body has {} with drag, and {} with friction as well; the finest one {} and {}".format(*found)
    pulls = {body: read_table("validation/strength.csv", body=body) for body in ("mass_spring", "tetrahedral")}
    for name, trout, key in (("force, N", "2.2", "force_n"), ("speed, m/s", "1.11", "speed_m_s"),
                             ("power, W", "0.64", "power_w")):  # fmt: skip
        yield line(f"largest {name}", trout, *(f"{max(row[key] for row in rows):.2f}" for rows in pulls.values()))
    told = (read_table("validation/robot.csv", water=water, fitted=0) for water in waters[1::2])
    drag, reactive = (f"{np.abs(columns(rows, 'off_m_s')).mean():.3f}" for rows in told)
    yield f"| - | {drag} | - | {reactive} |"


PAGES = {
    "choose": (scenes_to_choose,),
    "choosing-an-integrator": (claims, methods, unpredictable, failures, default_step, theory),
    "choosing-a-body": (bodies, fits, transfers),
    "choosing-the-water": (water_tables,),
    "results": (bounds, aims, severe, kinematics, weights, trainings),
    "validation": (gait, held_out_comparisons),
    "results validation": (beside_living_fish,),
    "performance": (rates, peers),
    "soft-objects": (scenes, beam, moved_solids),
    "../README design choosing-the-water recipes": (choices, claim_in_short),
}


@pytest.mark.parametrize("names", PAGES)
def test_pages(names):
    """Every row, and every number of a sentence, stands on one of the pages as it follows from the results."""
    text = "".join((ROOT / f"docs/{name}.md").read_text() for name in names.split())
    missing = [each for table in PAGES[names] for each in table() if each not in text]
    assert not missing


# Numbers in prose

MEASURED = re.compile(r"(?<![\w.,^-])\d+(?:,\d{3})+|(?<![\w.,^-])\d+\.\d+|(?<![\w.,^-])\d+(?= (?:%|times))")
"""What looks measured: a decimal number, thousands, per cent, or times; whole numbers count things."""
SHOWN = re.compile(
    r"\.csv\)|`(?:python -m benchmarks|python train\.py|fish_env (?:evaluate|chart|compare|train))|^python -m", re.M
)
NO_PROSE = re.compile(r"```(?s:.*?)```|\$`[^`]*`\$|`[^`]*`|\]\([^)]*\)|^\|[^\n]*$|^\d+\. ", re.M)
GIVEN = {  # by page, from the code, from a source, or chosen by the reader: other tests check most of them
    "README": "3.10 3.14 90",
    "benchmark": "100,000 1,000,000 7,000,000 0.7 1.4 0.6 1.3 1.6 0.3 95",
    "choosing-a-body": "10 3.2 0.2 0.0108 0.0107 0.221 0.40 0.079 0.209 0.05 0.6 0.02",
    "choosing-the-water": "1.3",
    "getting-started": "3.10 3.14",
    "performance": "3.10 3.12 3.13 3.14",
    "physics": "0.91 0.92 0.005 0.8 1.1",
    "physics-more": "200,000 1,000 0.26 0.2 0.02 0.1 0.055 4.5 4.4 4.6 3.4",
    "recipes": "40,000 4.1 9.0",
    "soft-objects": "100",
    "training": "98,304 95",
    "validation": "0.0055 0.0107",
}


def test_numbers_in_prose():
    """A number that looks measured stands in a section with its table or command, or follows from a table above."""
    told = {name: [] for name in ("../README", *(path.stem for path in (ROOT / "docs").glob("*.md")))}
    for names, tables in PAGES.items():
        for name in names.split():
            told[name] += [each for table in tables for each in table()]
    found = {}
    for name, sentences in told.items():
        text = (ROOT / f"docs/{name}.md").read_text()
        for sentence in sentences:
            text = text.replace(sentence, "")
        sections = re.split(r"^(?=##+ )", text, flags=re.M)
        bare = " ".join(
            NO_PROSE.sub(" ", each) for each in sections if not SHOWN.search(each) and "Sources" not in each[:12]
        )
        found[name.removeprefix("../")] = set(MEASURED.findall(bare))
    assert {name: numbers for name, numbers in found.items() if numbers} == {
        name: set(numbers.split()) for name, numbers in GIVEN.items()
    }
