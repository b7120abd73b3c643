"""The scene in Newton: particles and springs under `SolverSemiImplicit`, its name for symplectic Euler; CPU device.

The law of Newton's springs is that of ours. Its numbers are of single precision.
"""

import newton
import numpy as np
import warp as wp

from benchmarks.speed.scene import STEP, Peer, Scene, make_scene

wp.config.log_level = wp.LOG_WARNING


class NewtonSprings:
    """All fish in one model. Steps are recorded once, as a graph, and replayed: launched from Python they cost more."""

    name = "Newton semi-implicit"
    package = f"newton {newton.__version__}"
    precision = "float32"

    def __init__(self, scene: Scene, chunk: int = 100):
        self.scene, self.chunk = scene, chunk  # steps of a graph, even: two states take turns
        b, n, _ = scene.position.shape
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
        start = [[wp.vec3(*row) for row in array.reshape(-1, 3).tolist()] for array in scene[:2]]
        builder.add_particles(*start, mass=np.tile(scene.mass, b).tolist())
        for first in range(0, b * n, n):
            for (i, j), *law in zip(scene.nodes + first, scene.stiffness, scene.damping, strict=True):
                builder.add_spring(int(i), int(j), *map(float, law), 0.0)
        self.model = builder.finalize(device="cpu")
        self.model.particle_grid = None  # no contact between particles
        self.model.spring_rest_length.assign(np.tile(scene.rest_length, b).astype(np.float32))
        self.solver = newton.solvers.SolverSemiImplicit(self.model)
        self.states = self.model.state(), self.model.state()
        self.control = self.model.control()
        self._steps(2)  # loads the kernels
        with wp.ScopedCapture(device="cpu") as capture:
            self._steps(chunk)
        self.graph = capture.graph

    def _steps(self, steps: int) -> None:
        now, then = self.states
        for _ in range(steps):
            now.clear_forces()
            self.solver.step(now, then, self.control, None, STEP)
            now, then = then, now

    def start(self) -> None:
        for array, values in zip((self.states[0].particle_q, self.states[0].particle_qd), self.scene[:2], strict=True):
            array.assign(values.reshape(-1, 3).astype(np.float32))

    def advance(self, steps: int) -> None:
        if steps % self.chunk:
            raise ValueError(f"{steps} steps are no multiple of {self.chunk}, those of the recorded graph")
        for _ in range(steps // self.chunk):
            wp.capture_launch(self.graph)

    def position(self) -> np.ndarray:
        return self.states[0].particle_q.numpy().astype(np.float64).reshape(self.scene.position.shape)


def peers(num_fish: int) -> list[Peer]:
    """The one way there is."""
    return [NewtonSprings(make_scene(num_fish))]
