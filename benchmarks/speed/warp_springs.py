"""The scene as one plain kernel of NVIDIA Warp on its CPU device: a thread takes one fish through all its steps."""

import numpy as np
import warp as wp

from benchmarks.speed.scene import STEP, Peer, Scene, make_scene

wp.config.log_level = wp.LOG_WARNING
TYPES = {"float64": (wp.float64, wp.vec3d), "float32": (wp.float32, wp.vec3)}


def make_kernel(real, vec):
    """The kernel for numbers of one precision."""

    @wp.kernel(module="unique", enable_backward=False)
    def spring_steps(
        nodes: wp.array2d[int],
        stiffness: wp.array[real],
        damping: wp.array[real],
        rest_length: wp.array[real],
        impulse: wp.array[real],  # h/m of each mass
        h: real,
        steps: int,
        position: wp.array2d[vec],
        velocity: wp.array2d[vec],
        force: wp.array2d[vec],  # zero before and after
    ):
        b = wp.tid()
        x, v, f = position[b], velocity[b], force[b]
        for _ in range(steps):
            for e in range(nodes.shape[0]):
                i, j = nodes[e, 0], nodes[e, 1]
                r, u = x[j] - x[i], v[j] - v[i]
                length = wp.length(r)
                n = r * (real(1.0) / length)
                pull = (stiffness[e] * (length - rest_length[e]) + damping[e] * wp.dot(n, u)) * n
                f[i] = f[i] + pull  # += would be atomic, which costs time and is not needed
                f[j] = f[j] - pull
            for i in range(x.shape[0]):
                w = v[i] + impulse[i] * f[i]
                v[i] = w
                x[i] = x[i] + h * w
                f[i] = vec(real(0.0))

    return spring_steps


class WarpSprings:
    """One launch for all fish and all steps of a call."""

    name = "Warp kernel"
    package = f"warp-lang {wp.__version__}"
    chunk = 1

    def __init__(self, scene: Scene, precision: str):
        self.scene, self.precision = scene, precision
        real, vec = TYPES[precision]
        self.kernel = make_kernel(real, vec)
        shape = scene.position.shape[:2]
        constants = (scene.stiffness, scene.damping, scene.rest_length, STEP / scene.mass)
        self.inputs = [
            wp.array(scene.nodes, dtype=int, device="cpu"),
            *(wp.array(values, dtype=real, device="cpu") for values in constants),
            real(STEP),
        ]
        self.state = [wp.zeros(shape, dtype=vec, device="cpu") for _ in range(3)]

    def start(self) -> None:
        self.state[0].assign(self.scene.position.astype(self.precision))
        self.state[1].assign(self.scene.velocity.astype(self.precision))

    def advance(self, steps: int) -> None:
        wp.launch(self.kernel, len(self.scene.position), [*self.inputs, steps, *self.state], device="cpu")

    def position(self) -> np.ndarray:
        return self.state[0].numpy().astype(np.float64)


def peers(num_fish: int) -> list[Peer]:
    """Both precisions."""
    scene = make_scene(num_fish)
    return [WarpSprings(scene, precision) for precision in TYPES]
