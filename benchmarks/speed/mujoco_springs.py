"""The scene in MuJoCo: a body with three slide joints for each mass, and springs as tendons or as edges of flexes.

Both kinds of spring have the law of ours: force = stiffness (length - rest length) + damping x rate of length. MuJoCo's
Euler integrator is symplectic Euler once `eulerdamp`, its implicit treatment of joint damping, is off.
"""

from collections.abc import Iterator

import mujoco
import numpy as np
from mujoco import batch, rollout

from benchmarks.speed.scene import STEP, Peer, Scene, make_scene

OFF = (
    "eulerdamp gravity contact constraint equality limit frictionloss sensor actuation clampctrl filterparent refsafe "
    "warmstart midphase island autoreset"
)  # whatever this scene does not need and MuJoCo can leave out


def text(values) -> str:
    """Numbers as MJCF wants them, to the last digit."""
    return " ".join(repr(float(value)) for value in np.atleast_1d(values))


def model(scene: Scene, encoding: str) -> mujoco.MjModel:
    """The scene with its springs as "tendons" or "flexes"; qpos is how far the masses are from fish 0's start."""
    bodies = [
        f'<body name="n{n}" pos="{text(position)}">'
        f'<inertial pos="0 0 0" mass="{text(mass)}" diaginertia="1e-6 1e-6 1e-6"/>'
        + "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
        + (f'<site name="n{n}"/></body>' if encoding == "tendons" else "</body>")
        for n, (position, mass) in enumerate(zip(scene.position[0], scene.mass, strict=True))
    ]
    flags = " ".join(f'{flag}="disable"' for flag in OFF.split())
    springs = tendons(scene) if encoding == "tendons" else flexes(scene)
    made = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{STEP}" integrator="Euler"><flag {flags}/></option>'
        f"<worldbody>{''.join(bodies)}</worldbody>{''.join(springs)}</mujoco>"
    )
    if encoding == "flexes":
        set_rest_lengths(made, scene)
    return made


def tendons(scene: Scene) -> Iterator[str]:
    """A spatial tendon for each spring."""
    yield "<tendon>"
    for (i, j), *law in zip(scene.nodes, scene.stiffness, scene.damping, scene.rest_length, strict=True):
        stiffness, damping, rest = map(text, law)
        yield f'<spatial stiffness="{stiffness}" damping="{damping}" springlength="{rest}">'
        yield f'<site site="n{i}"/><site site="n{j}"/></spatial>'
    yield "</tendon>"


def flexes(scene: Scene) -> Iterator[str]:
    """A one-dimensional flex for all springs of one stiffness and damping, which are numbers of the whole flex."""
    laws = np.stack([scene.stiffness, scene.damping], axis=1)
    yield "<deformable>"
    for f, law in enumerate(np.unique(laws, axis=0)):
        nodes, element = np.unique(scene.nodes[(laws == law).all(axis=1)], return_inverse=True)
        bodies, ends = " ".join(f"n{n}" for n in nodes), " ".join(map(str, element.ravel()))
        yield f'<flex name="f{f}" dim="1" radius="0.0001" body="{bodies}" element="{ends}">'
        yield f'<edge stiffness="{text(law[0])}" damping="{text(law[1])}"/>'
        yield '<contact contype="0" conaffinity="0" selfcollide="none"/></flex>'
    yield "</deformable>"


def set_rest_lengths(made: mujoco.MjModel, scene: Scene) -> None:
    """Give the edges of the flexes the rest lengths of the scene: the compiler took the lengths of fish 0's start."""
    springs = {tuple(nodes): e for e, nodes in enumerate(np.sort(scene.nodes, axis=1).tolist())}
    for flex in range(made.nflex):
        bodies = made.flex_vertbodyid[made.flex_vertadr[flex] :]
        first = made.flex_edgeadr[flex]
        for edge in range(first, first + made.flex_edgenum[flex]):
            nodes = tuple(sorted((bodies[made.flex_edge[edge]] - 1).tolist()))  # body 0 is the world
            made.flexedge_length0[edge] = scene.rest_length[springs[nodes]]


class MujocoSprings:
    """One fish, by `mj_step`."""

    package = f"mujoco {mujoco.__version__}"
    precision = "float64"
    chunk = 1

    def __init__(self, scene: Scene, encoding: str):
        self.scene, self.name = scene, f"MuJoCo {encoding}"
        self.model = model(scene, encoding)
        self.data = mujoco.MjData(self.model)
        b = len(scene.position)
        self.begin = (scene.position - scene.position[0]).reshape(b, -1), scene.velocity.reshape(b, -1)

    def start(self) -> None:
        self.data.qpos[:], self.data.qvel[:] = (array[0] for array in self.begin)

    def advance(self, steps: int) -> None:
        mujoco.mj_step(self.model, self.data, nstep=steps)

    def moved(self) -> np.ndarray:
        """How far the masses are from fish 0's start, (B,3N) or (3N,) m."""
        return self.data.qpos

    def position(self) -> np.ndarray:
        return self.scene.position[0] + self.moved().reshape(self.scene.position.shape)


class MujocoBatch(MujocoSprings):
    """A batch, by `mujoco.batch` on this thread."""

    chunk = 10

    def __init__(self, scene: Scene, encoding: str):
        super().__init__(scene, encoding)
        self.name += ", batch"
        self.batch = batch.Batch(self.model, len(scene.position), nthread=1)

    def start(self) -> None:
        self.batch.qpos[:], self.batch.qvel[:] = self.begin

    def advance(self, steps: int) -> None:
        self.batch.step(nstep=steps)

    def moved(self) -> np.ndarray:
        return self.batch.qpos


class MujocoRollout(MujocoSprings):
    """A batch, by `mujoco.rollout` on this thread; it writes out the state of every step."""

    chunk = 10

    def __init__(self, scene: Scene, encoding: str):
        super().__init__(scene, encoding)
        self.name += ", rollout"
        size = mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_FULLPHYSICS)  # time, qpos and qvel
        self.trace = np.zeros((len(scene.position), self.chunk, size))
        self.rollout = rollout.Rollout(nthread=0)

    def start(self) -> None:
        self.trace[:, -1, 1:] = np.concatenate(self.begin, axis=1)

    def advance(self, steps: int) -> None:
        if steps % self.chunk:
            raise ValueError(f"{steps} steps are no multiple of {self.chunk}, those of a call")
        for _ in range(steps // self.chunk):
            begin = self.trace[:, -1].copy()
            self.rollout.rollout(self.model, self.data, begin, nstep=self.chunk, state=self.trace)

    def moved(self) -> np.ndarray:
        return self.trace[:, -1, 1 : 1 + self.model.nq]


def peers(num_fish: int) -> list[Peer]:
    """Tendons and flexes; a batch by both of MuJoCo's ways."""
    ways = (MujocoSprings,) if num_fish == 1 else (MujocoBatch, MujocoRollout)
    return [way(make_scene(num_fish), encoding) for way in ways for encoding in ("tendons", "flexes")]
