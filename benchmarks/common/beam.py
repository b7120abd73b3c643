"""A clamped beam of tetrahedra, ten times as long as thick, and what the theory of beams says of it.

It is clamped at x = 0, of a material with Poisson's ratio 0, so that nothing but its elements keeps it from being the
beam of the theory. Cells are cubes, split so that the mesh mirrors itself.
"""

import numpy as np

from fish_env.physics.body import fix, make_body
from fish_env.physics.fish import ElasticObject
from fish_env.physics.records import Body
from fish_env.soft import statics
from fish_env.soft.elements import make_tets
from fish_env.soft.mesh import box, lumped_mass

THICK, RATIO, YOUNG, DENSITY = 0.02, 10, 2e5, 1000.0
LENGTH = RATIO * THICK
SHEAR = 0.6 / RATIO**2  # by which Timoshenko's beam is softer than Euler's: 3 EI / (5/6 G A L^2), G = E/2
CLAMPED = 1.8751040687119611  # cos b cosh b = -1


def solid(position, nodes, poisson=0.0, rule="quarter", young=YOUNG, **options) -> Body:
    """A body of tetrahedra alone."""
    mass = lumped_mass(position, nodes, DENSITY, rule)
    material = make_tets(position, nodes, young, poisson, **options)
    return make_body(position, mass, [], [], [], [], [], tets=material)


def cantilever(n: int, rule="quarter", **options) -> Body:
    """The beam with n cells through its thickness and two across its width, which is two cells wide."""
    position, nodes = box((LENGTH, 2 * THICK / n, THICK), (RATIO * n, 2, n), mirrored=True)
    return fix(solid(position, nodes, rule=rule, **options), position[:, 0] == 0.0)


def rigidity(body: Body) -> float:
    """E I of the beam, N m2, for bending along z."""
    return YOUNG * np.ptp(body.position[:, 1]) * THICK**3 / 12


def tip_load(body: Body, force: float) -> np.ndarray:
    """A force along z, N, shared by the nodes of the free end as evenly spread pressure would be, (N,3)."""
    x, load = body.position, np.zeros_like(body.position)
    end = np.isclose(x[:, 0], LENGTH, rtol=0, atol=1e-9 * LENGTH)
    weight = np.where(np.abs(np.abs(x[:, 2]) - THICK / 2) < 1e-9 * THICK, 0.5, 1.0) * end
    weight *= np.where(np.abs(np.abs(x[:, 1]) - np.abs(x[:, 1]).max()) < 1e-9 * THICK, 0.5, 1.0)
    load[:, 2] = force * weight / weight.sum()
    return load


def tip(body: Body, x) -> np.ndarray:
    """Middle of the free end, (3,) m, of a beam at x (N,3)."""
    return x[np.argmin(np.linalg.norm(body.position - [LENGTH, 0.0, 0.0], axis=1))]


def first_frequency(body: Body) -> float:
    """Of Euler's beam, Hz."""
    line_density = DENSITY * np.ptp(body.position[:, 1]) * THICK
    return CLAMPED**2 / LENGTH**2 * np.sqrt(rigidity(body) / line_density) / (2.0 * np.pi)


def vertical(body: Body, count=4) -> tuple[float, np.ndarray]:
    """Lowest frequency of the beam's bending along z, Hz, and its shape (N,3)."""
    found, shapes = statics.modes(body, count)
    across = np.einsum("n,cn->c", body.mass, shapes[:, :, 2] ** 2) > 0.5
    first = int(np.argmax(across))
    return float(found[first]), shapes[first]


def loose(body: Body, step: float, name="body") -> ElasticObject:
    """What a tank moves."""
    size = float(np.ptp(body.position, axis=0).max())
    return ElasticObject(name=name, body=body, length=size, time_step=step, control_interval=step)
