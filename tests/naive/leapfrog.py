"""Reference implementation of the leapfrog with Chebyshev-filtered kicks."""

import numpy as np

from naive.elements import barrier_stiffness, gas_volume, tet_blocks
from naive.springs_and_water import area_vector, face_force, face_friction
from naive.sums import highest_rate, stiffness_matrix, total_force
from naive.surroundings import anchor_rates, anchors_of, at, constrain


def face_mobility(body, duration, corners, share):
    """Velocity that a face gains from a force of 1 N while half the faces around each corner feel the same."""
    gained = 0.0
    for node, part in zip(corners, share, strict=True):
        carried = sum(parts @ (other == node) for other, parts in zip(body.faces.nodes, body.faces.share, strict=True))
        gained += 0.5 * duration * part * carried * body.inverse_mass[node].max()
    return gained


def water_pushes(body, world, duration, x, v, ahead):
    """Forces of the water (N,3) at v, and their change when v becomes `ahead`, each face's drag on itself implicit.

    A face that its push would turn around in this time is pushed no more than stops it. Friction
    stops no face within a step, as if all faces around had the same.
    """
    first, change = np.zeros_like(x), np.zeros_like(x)
    for corners, share, factor in zip(body.faces.nodes, body.faces.share, body.faces.drag, strict=True):
        area = area_vector(x[corners])
        size, mobility = np.linalg.norm(area), face_mobility(body, duration, corners, share)
        push = factor * face_force(corners, share, world, x, v)
        outward = np.dot(share @ v[corners] - world[2], area) / size
        if mobility * np.linalg.norm(push) > outward > 0:
            push = -outward / mobility * area / size
        differs = factor * face_force(corners, share, world, x, ahead) - push
        velocity = share @ ahead[corners] - world[2]
        outward, speed = np.dot(velocity, area) / size, np.linalg.norm(velocity)
        if outward > 0:
            slope = factor * size * (world[0] + world[1] * (speed + outward**2 / speed))
            differs /= 1.0 + mobility * slope
        most = 0.25 / mobility if mobility else np.inf
        pulls = []
        for speeds in (v, ahead):
            rough, along = face_friction(body, corners, share, world, x, speeds)
            pulls.append(-min(rough, most) * along)
        push, differs = push + pulls[0], differs + pulls[1] - pulls[0]
        for node, part in zip(corners, share, strict=True):
            first[node] += part * push
            change[node] += part * differs
    return first, change


def filtered_matrix(body, world, rest_length, h, least, x, factor=1.0):
    """What the leapfrog filters by, (3N,3N) kg: factor (h^2 K + 2 h D) of each element, frozen, at least `least` h D.

    A unit's strain across is taken to be at least -0.1, an anchor's at least zero; gas counts by its compression,
    a barrier by its stiffness along the gradient of its volume.
    """

    def weight(stiffness, damping):
        return max(factor * (h**2 * stiffness + 2 * h * damping), least * h * damping)

    springs = body.springs
    matrix = np.zeros((len(x), 3, len(x), 3))
    for (i, j), c, k, natural in zip(springs.nodes, springs.stiffness, springs.damping, rest_length, strict=True):
        length = np.linalg.norm(x[j] - x[i])
        along = np.outer(x[j] - x[i], x[j] - x[i]) / length**2
        across = factor * h**2 * c * max(-0.1, (length - natural) / length)
        block = weight(c, k) * along + across * (np.eye(3) - along)
        for p, q, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            matrix[p, :, q] += sign * block
    for i, c, k, along, strain in anchors_of(world, x):
        matrix[i, :, i] += weight(c, k) * along + factor * h**2 * c * strain * (np.eye(3) - along)
    for t, corners, block, turning in tet_blocks(body, x, 0 * x, projected=True) if body.tets is not None else ():
        for a, p in enumerate(corners):
            for b, q in enumerate(corners):
                here = slice(3 * a, 3 * a + 3), slice(3 * b, 3 * b + 3)
                matrix[p, :, q] += weight(1.0, body.tets.relaxation_time[t]) * block[here]
                matrix[p, :, q] += factor * h**2 * turning[here]
    matrix = matrix.reshape(x.size, x.size)
    for c, gas in enumerate(body.compartments.gas) if body.compartments is not None else ():
        volume, slope = gas_volume(body.compartments, c, x)
        matrix += factor * h**2 * gas / volume**2 * np.outer(slope, slope)
    if body.barriers is not None:
        matrix += factor * h**2 * barrier_stiffness(body.barriers, x)
    return matrix


def chebyshev_filter(stages, operator):
    """Polynomial C (1 - T_p(nu - beta z) / T_p(nu)) / z of a matrix: power series, by Horner. Also where it ends."""
    nu = 1.0 + 4.0 / stages**2
    chebyshev = np.polynomial.Chebyshev.basis(stages)
    top, slope = chebyshev(nu), chebyshev.deriv()(nu)
    constant = 4.0 / (1.0 + 1.0 / top)
    beta = top / slope / constant
    shifted = chebyshev.convert(kind=np.polynomial.Polynomial)(np.polynomial.Polynomial([nu, -beta]))
    coefficients = -constant * shifted.coef[1:] / top
    result = np.zeros_like(operator)
    for coefficient in coefficients[::-1]:
        result = result @ operator + coefficient * np.eye(len(operator))
    return result, (1.0 + nu) / beta, coefficients


def leapfrog_chebyshev(body, world, rest, t, h, x, v):
    """Half a drift, a kick through the filter as a polynomial of a dense matrix, half a drift; the air by itself."""
    slowed = np.exp(-0.5 * h * world.viscosity * body.inverse_mass)
    v, world = slowed * v, world._replace(viscosity=0.0)
    middle, lengths, inverse = x + 0.5 * h * v, rest(t + 0.5 * h), body.inverse_mass.ravel()
    pulled, held_back = anchor_rates(body, world)
    fastest = highest_rate(body, stiffness_matrix(body)) + pulled
    dampest = highest_rate(body, stiffness_matrix(body, "damping")) + held_back
    viscous = 1.2 * h * dampest
    wanted = 1.2 * h**2 * fastest + 2.0 * viscous
    stages = 2
    while chebyshev_filter(stages, np.zeros((1, 1)))[1] < wanted or (stages == 2 and viscous > 2.0):
        stages += 1
    _, _, coefficients = chebyshev_filter(stages, np.zeros((1, 1)))
    least = -0.5 / coefficients[1] if stages == 2 else 0.0  # two stages hold back half a step of damping or more
    world = at(world, t + 0.5 * h)
    matrix = filtered_matrix(body, world, lengths, h, least, middle)
    filtering, _, _ = chebyshev_filter(stages, inverse[:, None] * matrix)
    pushed, _ = water_pushes(body, world, 0.5 * h, middle, v, v)
    dry = world._replace(linear=0.0, quadratic=0.0, friction=0.0)
    acceleration = total_force(body, dry, lengths, middle, v, pushed).ravel() * inverse
    kick = constrain(world.planes, middle, v, h, (filtering @ acceleration).reshape(x.shape))
    _, change = water_pushes(body, world, 0.5 * h, middle, v, v + 0.5 * h * kick)
    kick = kick + change * body.inverse_mass
    v = v + h * kick
    return middle + 0.5 * h * v, slowed * v
