"""Water on the surface: every face that moves outward through the water is pushed back along its normal.

The linear law is Tu & Terzopoulos 1994; the quadratic one Terzopoulos, Tu & Grzeszczuk 1994 with half the density
times a drag coefficient in place of their unit constant. No lift, added mass, friction or wake.

Legend: a area vector (area times outward normal); w velocity of the face through the water.
"""

import math

from fish_env._jit import INDEX, njit


@njit
def add_force(body, world, x, v, f):
    """Add the force of the water on every face to f (N,3) N, shared among the face's corners."""
    if world.linear == 0.0 and world.quadratic == 0.0:
        return
    c0, c1, c2 = world.current[0], world.current[1], world.current[2]
    for k in range(body.faces.nodes.shape[0]):
        p, q = INDEX(body.faces.nodes[k, 0]), INDEX(body.faces.nodes[k, 1])
        r, s = INDEX(body.faces.nodes[k, 2]), INDEX(body.faces.nodes[k, 3])
        sp, sq, sr, ss = body.faces.share[k, 0], body.faces.share[k, 1], body.faces.share[k, 2], body.faces.share[k, 3]
        d0, d1, d2 = x[r, 0] - x[p, 0], x[r, 1] - x[p, 1], x[r, 2] - x[p, 2]
        e0, e1, e2 = x[s, 0] - x[q, 0], x[s, 1] - x[q, 1], x[s, 2] - x[q, 2]
        a0, a1, a2 = 0.5 * (d1 * e2 - d2 * e1), 0.5 * (d2 * e0 - d0 * e2), 0.5 * (d0 * e1 - d1 * e0)  # (10)
        w0 = sp * v[p, 0] + sq * v[q, 0] + sr * v[r, 0] + ss * v[s, 0] - c0  # (11)
        w1 = sp * v[p, 1] + sq * v[q, 1] + sr * v[r, 1] + ss * v[s, 1] - c1
        w2 = sp * v[p, 2] + sq * v[q, 2] + sr * v[r, 2] + ss * v[s, 2] - c2
        flux = a0 * w0 + a1 * w1 + a2 * w2
        if flux <= 0.0:  # moving inward: the one-sided laws exert no suction
            continue
        area = math.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
        speed = math.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
        push = -(world.linear + world.quadratic * speed) * flux / area  # (12), (13)
        f0, f1, f2 = push * a0, push * a1, push * a2
        f[p, 0] += sp * f0
        f[p, 1] += sp * f1
        f[p, 2] += sp * f2
        f[q, 0] += sq * f0
        f[q, 1] += sq * f1
        f[q, 2] += sq * f2
        f[r, 0] += sr * f0
        f[r, 1] += sr * f1
        f[r, 2] += sr * f2
        f[s, 0] += ss * f0
        f[s, 1] += ss * f1
        f[s, 2] += ss * f2
