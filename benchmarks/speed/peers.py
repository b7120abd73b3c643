"""How fast MuJoCo computes the same springs, and its environments a step: results/speed/peers.csv.

    pip install -c constraints.txt -e ".[peers]"

Everything runs in one process on one core (the last one it may use), measured in turn. The springs are the masses and
springs of the default fish in vacuum, deformed and moving, by symplectic Euler (velocity first, then position with the
new velocity). MuJoCo is timed only if its masses arrive, after 1000 steps, where ours do. Its Euler integrator is
symplectic Euler once `eulerdamp`, its implicit treatment of joint damping, is off.

At 1 % error, each method takes its largest step at and below which the error of this motion over 0.5 s is at most 1 %:
the largest distance of a mass from RK4 with converged steps, every 0.02 s; geometric mean over 64 fish.
"""

import os
from collections.abc import Iterator
from functools import partial
from importlib.metadata import version
from itertools import takewhile
from typing import NamedTuple

import gymnasium as gym
import numpy as np

import fish_env
from benchmarks.common.tables import publish
from benchmarks.common.timing import interleaved, timed
from fish_env.control.chart import CONVERGED, converge, distances

ROUNDS = 15
BATCHES = (1, 256)
STEP = 0.0003  # s: 0.4 of the largest stable step for small motion of this body at rest
CHECKED, TOLERANCE = 1000, 1e-12  # steps after which positions are compared; body lengths that they may be apart
STRETCH, SHAKE, TURN = 0.01, 0.1, 3.0  # of the start: BL, BL/s and rad/s
INTERVAL, INTERVALS, SCENES = 0.02, 25, 64  # of the motion whose error is measured: s, how many, and of how many fish
ACCURACY, MOST_STEPS = 0.01, 64  # body lengths; steps an interval from which fewer are tried
ENVIRONMENTS = (
    ("FishEnv/Swim-v0", "fish_env", 1), ("FishEnv/Swim-v0", "fish_env", 256), ("HalfCheetah-v5", "mujoco", 1),
    ("Swimmer-v5", "mujoco", 1), ("fish-swim", "dm_control", 1), ("swimmer-swimmer6", "dm_control", 1),
)  # fmt: skip
"""Environments with the wrappers of `gym.make`, their packages and copies; costs are over those of the first."""
ENV_STEPS = 1000  # of a run, a whole number of episodes of each: resets are included
OFF = (
    "eulerdamp gravity contact constraint equality limit frictionloss sensor actuation clampctrl filterparent refsafe "
    "warmstart midphase island autoreset"
)  # whatever this scene does not need and MuJoCo can leave out


class Scene(NamedTuple):
    """B fish of N masses and E springs, and how they start."""

    position: np.ndarray  # (B,N,3) m, about the origin
    velocity: np.ndarray  # (B,N,3) m/s
    mass: np.ndarray  # (N,) kg
    nodes: np.ndarray  # (E,2)
    stiffness: np.ndarray  # (E,) N/m
    damping: np.ndarray  # (E,) N s/m
    rest_length: np.ndarray  # (E,) m
    length: float  # body length, m


def make_scene(num_fish: int) -> Scene:
    """The default fish's springs, every fish started differently; fish 0 is the same in a batch of any size."""
    fish = fish_env.make_fish("mass_spring")
    body, springs, length = fish.body, fish.body.springs, fish.length
    noise = np.random.default_rng(0).standard_normal((num_fish, 2, body.mass.size, 3))
    position = body.position - body.position.mean(axis=0) + STRETCH * length * noise[:, 0]
    velocity = SHAKE * length * noise[:, 1] + np.cross([0.0, 0.0, TURN], position)
    return Scene(
        position, velocity, body.mass, springs.nodes, springs.stiffness, springs.damping, springs.rest_length, length
    )


class Ours:
    """This package's `Tank` in vacuum."""

    name, package = "fish_env", "fish_env"

    def __init__(self, scene: Scene, dtype: str = "float64", integrator: str = "symplectic_euler", step: float = STEP):
        self.scene, self.dtype, self.count = scene, dtype, len(scene.position)
        fish = fish_env.make_fish("mass_spring")
        self.tank = fish_env.Tank(fish, len(scene.position), integrator, step, threads=1, dtype=dtype)

    def start(self) -> None:
        """Put all fish to the start of the scene."""
        self.tank.reset()
        self.tank.position[:], self.tank.velocity[:] = self.scene[:2]

    def run(self, steps: int) -> None:
        """Take so many steps."""
        self.tank.advance(steps)

    def position(self) -> np.ndarray:
        """Positions of the masses, (B,N,3) m."""
        return self.tank.position


class Mujoco:
    """MuJoCo: a body with three slide joints for each mass; springs are edges of one-dimensional flexes.

    One fish moves by `mj_step`, more by `mujoco.batch` on this thread.
    """

    name, package, dtype = "MuJoCo, edges of flexes", "mujoco", "float64"

    def __init__(self, scene: Scene, step: float = STEP):
        import mujoco
        from mujoco import batch

        self.scene, self.model, self.count = scene, mujoco.MjModel.from_xml_string(mjcf(scene)), len(scene.position)
        set_rest_lengths(self.model, scene)
        self.model.opt.timestep = step
        self.data = mujoco.MjData(self.model) if self.count == 1 else batch.Batch(self.model, self.count, nthread=1)
        self.step = partial(mujoco.mj_step, self.model, self.data) if self.count == 1 else self.data.step

    def start(self) -> None:
        """Put all fish to the start of the scene; `qpos` is how far the masses are from fish 0's start."""
        for array, values in (
            (self.data.qpos, self.scene.position - self.scene.position[0]),
            (self.data.qvel, self.scene.velocity),
        ):
            array[:] = values.reshape(array.shape)

    def run(self, steps: int) -> None:
        """Take so many steps."""
        self.step(nstep=steps)

    def position(self) -> np.ndarray:
        """Positions of the masses, (B,N,3) m."""
        return self.scene.position[0] + self.data.qpos.reshape(self.scene.position.shape)


def text(values) -> str:
    """Numbers as MJCF wants them, to the last digit."""
    return " ".join(repr(float(value)) for value in np.atleast_1d(values))


def mjcf(scene: Scene) -> str:
    """The model of the scene in MuJoCo's language."""
    bodies = [
        f'<body name="n{n}" pos="{text(position)}">'
        f'<inertial pos="0 0 0" mass="{text(mass)}" diaginertia="1e-6 1e-6 1e-6"/>'
        + "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
        + "</body>"
        for n, (position, mass) in enumerate(zip(scene.position[0], scene.mass, strict=True))
    ]
    flags = " ".join(f'{flag}="disable"' for flag in OFF.split())
    return (
        f'<mujoco><option integrator="Euler"><flag {flags}/></option>'
        f"<worldbody>{''.join(bodies)}</worldbody><deformable>{''.join(flexes(scene))}</deformable></mujoco>"
    )


def flexes(scene: Scene) -> Iterator[str]:
    """A one-dimensional flex for all springs of one stiffness and damping, which are numbers of the whole flex."""
    laws = np.stack([scene.stiffness, scene.damping], axis=1)
    for f, law in enumerate(np.unique(laws, axis=0)):
        nodes, element = np.unique(scene.nodes[(laws == law).all(axis=1)], return_inverse=True)
        bodies, ends = " ".join(f"n{n}" for n in nodes), " ".join(map(str, element.ravel()))
        yield f'<flex name="f{f}" dim="1" radius="0.0001" body="{bodies}" element="{ends}">'
        yield f'<edge stiffness="{text(law[0])}" damping="{text(law[1])}"/>'
        yield '<contact contype="0" conaffinity="0" selfcollide="none"/></flex>'


def set_rest_lengths(model, scene: Scene) -> None:
    """Give the edges of the flexes the rest lengths of the scene: the compiler took the lengths of fish 0's start."""
    springs = {tuple(nodes): e for e, nodes in enumerate(np.sort(scene.nodes, axis=1).tolist())}
    for flex in range(model.nflex):
        bodies = model.flex_vertbodyid[model.flex_vertadr[flex] :]
        first = model.flex_edgeadr[flex]
        for edge in range(first, first + model.flex_edgenum[flex]):
            nodes = tuple(sorted((bodies[model.flex_edge[edge]] - 1).tolist()))  # body 0 is the world
            model.flexedge_length0[edge] = scene.rest_length[springs[nodes]]


def disagreement(peer, steps: int = CHECKED) -> float:
    """Largest distance along an axis between a peer's masses and ours after these steps, body lengths."""
    own = Ours(peer.scene)
    for each in (own, peer):
        each.start()
        each.run(steps)
    return float(np.abs(peer.position() - own.position()).max() / peer.scene.length)


def spring_rows(num_fish: int) -> list[dict]:
    """Check MuJoCo, then time it beside ours, for a batch in single precision, too.

    Raises:
        ValueError: if MuJoCo's masses are elsewhere than ours.
    """
    scene = make_scene(num_fish)
    peers = [Ours(scene), *([Ours(scene, "float32")] if num_fish > 1 else []), Mujoco(scene)]
    if not (apart := disagreement(peers[-1])) <= TOLERANCE:
        raise ValueError(f"MuJoCo is {apart:.1e} body lengths from fish_env, more than {TOLERANCE:.0e}")
    return [
        row("springs", f"{peer.name}, {peer.dtype}", peer.package, num_fish, cost, STEP)
        for peer, cost in zip(peers, timed(peers, ROUNDS, most=100_000), strict=True)
    ]


METHODS = {
    "leapfrog_chebyshev": partial(Ours, integrator="leapfrog_chebyshev"), "symplectic_euler": Ours,
    "MuJoCo, symplectic Euler": Mujoco,
}  # fmt: skip


def move(peer, steps: int) -> list[np.ndarray]:
    """Take so many steps in each of INTERVALS intervals; return the positions at their ends, (B,N,3) m."""
    path = []
    for _ in range(INTERVALS):
        peer.run(steps)
        path.append(peer.position().copy())
    return path


def accuracy_rows() -> list[dict]:
    """Time the motion of one fish and of many by the largest steps from which on the error is at most ACCURACY."""
    scene, rows = make_scene(SCENES), []

    def solve(method, steps: int) -> np.ndarray:
        peer = method(scene, step=INTERVAL / steps)
        peer.start()
        return np.array(move(peer, steps))

    def accurate(method, steps: int) -> bool:
        return np.exp(np.log(distances(scene, solve(method, steps), exact)).mean()) <= ACCURACY

    rk4 = partial(solve, partial(Ours, integrator="rk4"))
    exact, *_ = converge("springs", rk4, lambda *two: distances(scene, *two).max(), (64, 4096), CONVERGED)
    fewest = [list(takewhile(partial(accurate, method), range(MOST_STEPS, 0, -1)))[-1] for method in METHODS.values()]
    for start in map(make_scene, BATCHES):
        peers = [method(start, step=INTERVAL / k) for method, k in zip(METHODS.values(), fewest, strict=True)]
        runs = [(p.start, partial(move, p, k), INTERVALS * p.count) for p, k in zip(peers, fewest, strict=True)]
        rows += [
            row("1 % error, springs in vacuum", f"{name}, {k} steps", peer.package, peer.count, cost, INTERVAL)
            for name, k, peer, cost in zip(METHODS, fewest, peers, interleaved(runs, ROUNDS), strict=True)
        ]
    return rows


def act(env, actions, ended) -> None:
    """Step an environment, and reset it when an episode ends."""
    for action in actions:
        if ended(env.step(action)):
            env.reset()


def make_run(name: str, package: str, copies: int) -> tuple:
    """Simulated time of a step of an environment, s, and a function that takes ENV_STEPS steps, by random actions."""
    if package == "dm_control":
        os.environ.setdefault("MUJOCO_GL", "disable")  # no display
        from dm_control import suite

        env = suite.load(*name.split("-"), task_kwargs={"random": 0})
        spec = env.action_spec()
        actions = np.random.default_rng(0).uniform(spec.minimum, spec.maximum, (ENV_STEPS, *spec.shape))
        return env.control_timestep(), partial(act, env, actions, lambda step: step.last())
    single = copies == 1  # a vector environment resets itself
    env = gym.make(name) if single else gym.make_vec(name, num_envs=copies, threads=1)
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(ENV_STEPS)]
    return 1.0 / env.metadata["render_fps"], partial(act, env, actions, lambda step: single and (step[2] or step[3]))


def environment_rows(rounds: int = ROUNDS) -> list[dict]:
    """Time steps of ENVIRONMENTS with random actions drawn beforehand, resets included."""
    made = [(*each, *make_run(*each)) for each in ENVIRONMENTS]
    costs = interleaved([(lambda: None, run, ENV_STEPS * copies) for _, _, copies, _, run in made], rounds)
    return [row("environment step", *each[:3], cost, each[3]) for each, cost in zip(made, costs, strict=True)]


def row(what: str, name: str, package: str, copies: int, cost, interval: float) -> dict:
    """Line of the table; `interval` is the simulated time of a step, s."""
    times, ratios = cost
    return {
        "what": what, "name": name, "package": f"{package} {version(package)}", "copies": copies,
        "simulated_s": interval, "us": f"{times[1]:.4g}", "us_q1": f"{times[0]:.4g}", "us_q3": f"{times[2]:.4g}",
        "times_ours": f"{ratios[1]:.3g}", "times_q1": f"{ratios[0]:.3g}", "times_q3": f"{ratios[2]:.3g}",
    }  # fmt: skip


def measure() -> list[dict]:
    """All rows."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    springs = [each for num_fish in BATCHES for each in spring_rows(num_fish)]
    return springs + accuracy_rows() + environment_rows()


if __name__ == "__main__":
    publish(__doc__, {"speed/peers.csv": measure})
