"""Song's inexpensive estimates of volume and normals against the exact ones; the roundness of a ball under pressure."""

import numpy as np

from fish_env.bodies.objects import Layered, make_uniform_sphere
from fish_env.bodies.skins import Skin, circle, globe, octasphere
from fish_env.elements import make_compartments
from fish_env.forces.evaluate import Evaluator
from fish_env.volume import volume_of
from fish_env.world import VACUUM

LONG = np.diag((2.0, 0.7, 0.7))
TURN = np.array(((1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (0.0, 0.0, 2.0**0.5))) / 2.0**0.5
SHAPES = {"round": np.eye(3), "flattened": np.diag((1.25, 0.8, 1.25)), "long": LONG, "long, turned": TURN @ LONG}
"""What the unit circle or sphere is deformed by; the last is turned by 45 degrees about z."""
SKINS = [("ring", n, circle(n)) for n in (6, 12, 24, 48, 96)]
SKINS += [("sphere", n, globe(n, 2 * n // 3)) for n in (6, 12, 24, 48)]
SKINS += [("uniform sphere", 4**n, octasphere(n)) for n in range(5)]


def estimated_volume(nodes, x) -> float:
    """Song's estimate of a volume, from the springs of its surface (E,2): half their |dx| |n_x| length (eq. 4.16).

    Units of an area, whatever the dimension. Every term is of second order in a spring's length, so that the sum goes
    to nothing with finer rings: it follows the volume of one mesh, up to a constant that belongs to that mesh.
    """
    edge = x[nodes[:, 1]] - x[nodes[:, 0]]
    length = np.linalg.norm(edge, axis=1)
    return float(0.5 * np.sum(np.abs(edge[:, 0]) * np.abs(estimated_normals(nodes, x)[:, 0]) * length))


def estimated_normals(nodes, x) -> np.ndarray:
    """Song's estimate of the normals of springs (E,2), unit vectors (E,3): the spring turned about each axis.

    Two components change places, and one its sign, about z, then y, then x; in the plane about z alone (ch. 4.5.2).
    """
    edge = x[nodes[:, 1]] - x[nodes[:, 0]]
    turned = edge[:, [1, 0, 2]] * (1.0, -1.0, 1.0)  # about z
    if np.ptp(x[:, 2]) > 0.0:
        turned = turned[:, [2, 1, 0]] * (-1.0, 1.0, 1.0)  # about y
        turned = turned[:, [0, 2, 1]] * (1.0, 1.0, -1.0)  # about x
    return turned / np.linalg.norm(turned, axis=1)[:, None]


def estimate(kind: str, detail: int, skin: Skin, shape: str) -> dict:
    """A row: volumes over that of the smooth ellipse or ellipsoid, and the angle between a spring's normals, degrees.

    The exact normal of a spring is that of the smooth surface at its middle. The sign of the estimate depends on which
    end of a spring comes first, which the text leaves open in space: of the two the nearer counts.
    """
    deformation = SHAPES[shape]
    x = skin.place @ deformation.T
    smooth = (
        np.pi * np.linalg.det(deformation[:2, :2]) if kind == "ring" else 4 / 3 * np.pi * np.linalg.det(deformation)
    )
    exact = volume_of(make_compartments(x, [skin.faces], 1.0).faces, x)[0]
    middle = x[skin.edges].mean(axis=1) @ np.linalg.inv(deformation @ deformation.T)
    normal = middle / np.linalg.norm(middle, axis=1)[:, None]
    cosine = np.abs(np.sum(estimated_normals(skin.edges, x) * normal, axis=1))
    angle = np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0)))
    return {"kind": kind, "shape": shape, "detail": detail, "springs": len(skin.edges),
            "exact_volume": exact / smooth, "estimated_volume": estimated_volume(skin.edges, x) / smooth,
            "mean_angle": angle.mean(), "largest_angle": angle.max()}  # fmt: skip


def estimates() -> list[dict]:
    """Rows of every skin and shape."""
    return [estimate(*skin, shape) for skin in SKINS for shape in SHAPES]


def relaxed(thing: Layered, most=60) -> tuple[np.ndarray, float]:
    """Where the nodes come to rest, (N,3) m, and the largest force left, N: Newton's method, damped by its energy.

    Raises:
        ArithmeticError: if it does not come to rest.
    """
    body, x = thing.body, thing.body.position.copy()
    rest, still, evaluator = body.springs.rest_length, np.zeros_like(x), Evaluator(body, VACUUM)

    def energy(y):
        return sum(evaluator.energies(rest, y, still).values())

    for _ in range(most):
        f = evaluator.force(rest, x, still)
        if np.abs(f).max() < 1e-11:
            return x, float(np.abs(f).max())
        value, vector = np.linalg.eigh(evaluator.jacobian(rest, x, still)[0])
        along = vector.T @ f.ravel()
        moved = np.abs(value) > 1e-6 * value[-1]  # not along the motions of a rigid body
        step = (vector[:, moved] @ (along[moved] / np.abs(value[moved]))).reshape(x.shape)
        part, before = 1.0, energy(x)
        while not energy(x + part * step) <= before + 1e-13 * abs(before) and part > 1e-6:
            part *= 0.5
        x = x + part * step
    raise ArithmeticError(f"{thing.name} did not come to rest: {np.abs(f).max():.1e} N are left")


def roundness(level: int, correction: bool) -> dict:
    """A row: how far the pressed outer skin is from a sphere, per cent of its mean radius: spread, and range.

    All springs begin unstretched, as the text's do, and the gas swells the ball until they balance it.
    """
    thing = make_uniform_sphere(level, correction)
    springs, x = thing.body.springs, thing.body.position
    length = np.linalg.norm(x[springs.nodes[:, 1]] - x[springs.nodes[:, 0]], axis=1)
    object.__setattr__(thing, "body", thing.body._replace(springs=springs._replace(rest_length=length)))
    found, left = relaxed(thing)
    radius = np.linalg.norm(found[thing.outer] - found[thing.outer].mean(axis=0), axis=1)
    around = np.bincount(springs.nodes[thing.kinds["outer"]].ravel(), minlength=len(radius))
    few = radius[around == 4].mean() / radius.mean() - 1.0
    return {"level": level, "correction": correction, "swollen": radius.mean() / 0.1 - 1.0,
            "spread": radius.std() / radius.mean(), "range": np.ptp(radius) / radius.mean(),
            "nodes_of_four": few, "force_left": left}  # fmt: skip
