"""The scene in MuJoCo: a body with three slide joints for each mass, and springs as edges of one-dimensional flexes.

The springs have the law of ours: force = stiffness (length - rest length) + damping x rate of length. MuJoCo's Euler
integrator is symplectic Euler once `eulerdamp`, its implicit treatment of joint damping, is off. Spatial tendons for
springs, and `mujoco.rollout` for batches, were slower (results/speed/peers.csv at commit b9e2c18).
"""

from collections.abc import Iterator

import mujoco
import numpy as np
from mujoco import batch

from benchmarks.speed.scene import STEP, Peer, Scene, make_scene

OFF = (
    "eulerdamp gravity contact constraint equality limit frictionloss sensor actuation clampctrl filterparent refsafe "
    "warmstart midphase island autoreset"
)  # whatever this scene does not need and MuJoCo can leave out


def text(values) -> str:
    """Numbers as MJCF wants them, to the last digit."""
    return " ".join(repr(float(value)) for value in np.atleast_1d(values))


def model(scene: Scene) -> mujoco.MjModel:
    """The scene; qpos is how far the masses are from fish 0's start."""
    bodies = [
        f'<body name="n{n}" pos="{text(position)}">'
        f'<inertial pos="0 0 0" mass="{text(mass)}" diaginertia="1e-6 1e-6 1e-6"/>'
        + "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
        + "</body>"
        for n, (position, mass) in enumerate(zip(scene.position[0], scene.mass, strict=True))
    ]
    flags = " ".join(f'{flag}="disable"' for flag in OFF.split())
    made = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{STEP}" integrator="Euler"><flag {flags}/></option>'
        f"<worldbody>{''.join(bodies)}</worldbody>{''.join(flexes(scene))}</mujoco>"
    )
    set_rest_lengths(made, scene)
    return made


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

    name = "MuJoCo flexes"
    package = f"mujoco {mujoco.__version__}"
    precision = "float64"
    chunk = 1

    def __init__(self, scene: Scene):
        self.scene, self.model = scene, model(scene)
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

    name = "MuJoCo flexes, batch"
    chunk = 10

    def __init__(self, scene: Scene):
        super().__init__(scene)
        self.batch = batch.Batch(self.model, len(scene.position), nthread=1)

    def start(self) -> None:
        self.batch.qpos[:], self.batch.qvel[:] = self.begin

    def advance(self, steps: int) -> None:
        self.batch.step(nstep=steps)

    def moved(self) -> np.ndarray:
        return self.batch.qpos


def peers(num_fish: int) -> list[Peer]:
    """One fish, or a batch."""
    return [(MujocoSprings if num_fish == 1 else MujocoBatch)(make_scene(num_fish))]
