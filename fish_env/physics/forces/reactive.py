"""Inertia of the water along the sections of a body: elongated-body theory in Lagrange's form (Lighthill 1971).

The water beside a section moves with it: its kinetic energy is half the added mass, lateral and vertical, times the
square of the section's velocity across the body. Lagrange's equations give three parts: a resistance to acceleration
(`add_reaction`), terms of second degree in the velocities, and at the trailing edge the momentum that is shed with the
wake while the tail moves forward. Shedding takes energy from the fish at any velocity. Upward, the flow leaves the
narrowing rear of the body too. Forces along a tail fin act on the peduncle (`relieve_fin`).

The added mass of a section is a matrix of rank two on its nodes, so that it is solved for in closed form. Tu's method,
whose matrix couples the sections, solves for all of them by the formula of Woodbury (`solve_lagged`).

Legend: k section; X, W its centre and its velocity through the water; t tangent, backward; r upward; n = t x r / |..|
lateral, b = n x t vertical; w, y, u velocities along n, b, t; m, q lateral and vertical added mass; a dot is a d.
"""

import numpy as np

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import Pack, cross, dot, fma, select, sqrt, vec3, zero
from fish_env.physics.forces.plan import H
from fish_env.physics.linalg import ldlt
from fish_env.physics.records import Body, World

ANYWHERE = IN_WATER = True
TURNING = 0.3  # strain whose steps are as inaccurate as those of a turn of 1 rad
FOLLOWING = 2.0  # change of the sections' velocities in half a kick over what the change of their own forces gives
SHEDDING, PULLING = 0.8, 0.6  # parts of the tail's mobility across and along it that springs leave to the wake
SHORT = 0.5  # of their length at rest: tangent and lateral direction of a section fade where they are shorter
TINY = 1e-30  # m2/s2, so that a tail at rest divides by no zero


def present(body: Body, world: World) -> bool:
    """Return True if the water has inertia and the body sections."""
    return world.added_mass is not None and body.sections is not None


def make_cache(body: Body, world: World, kind) -> Pack:
    """Frames of the sections, their velocities, forces and mobilities."""
    assert body.sections is not None  # else the force is not present
    nodes, first, share, upper, lower, *_ = body.sections
    count, edges = len(first) - 1, np.concatenate([upper, lower])
    carry = share[:, None] * body.inverse_mass[nodes]
    give = np.add.reduceat(share[:, None] * carry, first[:-1])
    turn = body.inverse_mass[edges].sum(axis=0, keepdims=True)
    rise = body.position[upper].sum(axis=0) - body.position[lower].sum(axis=0) + [0.0, 0.0, body.sections.height]
    vectors = ("middle", "speed", "t", "n", "b", "td", "nd", "bd", "force", "later")
    numbers = ("per_length", "per_rise", "kept_t", "kept_n", "nn", "nb", "bn", "bb", "m", "q")
    return Pack(
        "reactive", carry=kind.rows(carry), give=kind.rows(give), turn=kind.rows(turn), advance=kind.numbers(1),
        short=float(SHORT**2 * (rise @ rise)),
        **{name: kind.vectors(1) for name in ("rise", "climb", "twist", "bend", "wake")},
        **{name: kind.vectors(count) for name in vectors}, **{name: kind.numbers(count) for name in numbers},
    )  # fmt: skip


@kernel
def gather(body, values, k):
    """Mean of the vectors of nodes over section k."""
    nodes, first, share = body.sections.nodes, body.sections.first, body.sections.share
    start = first[k]
    mean = share[start] * values[INDEX(nodes[start])]
    for p in range(start + 1, first[k + 1]):
        mean = fma(share[p], values[INDEX(nodes[p])], mean)
    return mean


@kernel
def scatter(body, k, force, f):
    """Distribute a force on section k over its nodes, by mass."""
    nodes, first, share = body.sections.nodes, body.sections.first, body.sections.share
    for p in range(first[k], first[k + 1]):
        i = INDEX(nodes[p])
        f[i] = fma(share[p], force, f[i])


@kernel
def between_edges(body, values):
    """Sum over the nodes at the upper edge minus that over those at the lower edge."""
    upper, lower = body.sections.upper, body.sections.lower
    found = values[INDEX(upper[0])] - values[INDEX(lower[0])]
    for p in range(1, upper.size):
        found += values[INDEX(upper[p])] - values[INDEX(lower[p])]
    return found


@kernel
def nearest(body, k):
    """First of the three sections from which the slope at section k is computed."""
    return INDEX(min(max(k - 1, 0), body.sections.slope.shape[0] - 3))


@kernel
def along(body, values, k):
    """Derivative of values (K,) of the sections along the body, at section k."""
    slope, j = body.sections.slope, nearest(body, k)
    return fma(slope[k, 2], values[j + INDEX(2)], fma(slope[k, 1], values[j + INDEX(1)], slope[k, 0] * values[j]))


@kernel
def directed(square, short):
    """Factors that make a direction of a vector of this square, and its rate of one: `per` and `kept`."""
    # With d = per v, the rate of d is per (dv - kept d (d . dv)). Where the square is below `short`, d fades smoothly:
    # a section at which the body is folded has no direction. Elsewhere d is a unit vector.
    lacking = short - square
    lacking = select(lacking > 0.0, lacking, 0.0 * lacking)
    slack = (0.5 / short) * lacking
    return 1.0 / sqrt(fma(slack, lacking, square)), fma(-2.0, slack, 1.0)  # (28)


@kernel
def set_frames(body, world, control, x, cache):
    """Store the frames of `set_directions`, and every section's resistance to acceleration (`resistance`)."""
    set_directions(body, world, control, x, cache)
    for k in range(cache.n.size):
        n, b, give, m, q = cache.n[k], cache.b[k], cache.give[k], cache.m[k], cache.q[k]
        sideways, upward = fma(m, dot(n, give * n), 1.0), fma(q, dot(b, give * b), 1.0)
        both = dot(n, give * b)
        scale = 1.0 / fma(sideways, upward, -(m * q) * (both * both))
        cache.nn[k], cache.nb[k] = (scale * m) * upward, -(scale * (m * q)) * both
        cache.bn[k], cache.bb[k] = -(scale * (m * q)) * both, (scale * q) * sideways


@kernel
def set_directions(body, world, control, x, cache):
    """Store tangent, lateral and vertical direction of every section at positions x, and its added mass over a mass."""
    # Short loops: one fish computes the roots of several sections at the same time.
    sections, light = body.sections, control.lightness[0]
    for k in range(cache.n.size):
        cache.middle[k] = gather(body, x, k)
    rise = between_edges(body, x) + vec3(0.0, 0.0, sections.height)
    cache.rise[0] = rise
    for k in range(cache.n.size):
        tangent = along(body, cache.middle, k)
        cache.per_length[k], cache.kept_t[k] = directed(dot(tangent, tangent), SHORT * SHORT)
        cache.t[k] = cache.per_length[k] * tangent
    for k in range(cache.n.size):
        side = cross(cache.t[k], rise)
        cache.per_rise[k], cache.kept_n[k] = directed(dot(side, side), cache.short)
        n = cache.per_rise[k] * side
        cache.n[k], cache.b[k] = n, cross(n, cache.t[k])
        cache.m[k] = (light * world.added_mass[0]) * sections.lateral[k]
        cache.q[k] = (light * world.added_mass[1]) * sections.vertical[k]


@kernel
def set_speeds(body, world, control, v, cache):
    """Store the velocities of the sections through the water, and the rates of their frames."""
    current = world.current[0] + control.current[0]
    for k in range(cache.n.size):
        cache.speed[k] = gather(body, v, k) - current
    cache.climb[0] = between_edges(body, v)
    set_rates(body, cache)


@kernel
def set_rates(body, cache):
    """Store the rates of the frames of the sections."""
    for k in range(cache.n.size):
        t, n = cache.t[k], cache.n[k]
        change = along(body, cache.speed, k)
        td = cache.per_length[k] * fma(-cache.kept_t[k] * dot(change, t), t, change)
        change = cross(td, cache.rise[0]) + cross(t, cache.climb[0])
        nd = cache.per_rise[k] * fma(-cache.kept_n[k] * dot(change, n), n, change)
        cache.td[k], cache.nd[k], cache.bd[k] = td, nd, cross(nd, t) + cross(n, td)


@kernel
def relieve_fin(body, cache, force):
    """Move the part of the forces on the tail fin's sections that acts along the body forward, to the peduncle."""
    # Each goes to the section before, which lies on its line of action, so that no momentum changes. A fin weighs next
    # to nothing, and these forces pass no filter: they would push it into the body. Returns the power that this adds,
    # W, over the factor on mass.
    last, power = cache.n.size - 1, zero(cache.m)
    for m in range(body.sections.fin):
        here, before = INDEX(last - m), INDEX(last - m - 1)
        chord = cache.middle[here] - cache.middle[before]
        pull = (dot(force[here], chord) / dot(chord, chord)) * chord
        force[here] = force[here] - pull
        force[before] = force[before] + pull
        power += dot(pull, cache.speed[before] - cache.speed[here])
    return power


@kernel
def push(body, world, control, cache, force, twist):
    """Compute the terms of second degree in the velocities: a force on each section, and a twist (1,) of the body."""
    # The twist acts on the nodes at the upper edge, and with the opposite sign on those at the lower one. Returns the
    # power of `relieve_fin`.
    slope, turned = body.sections.slope, zero(twist)
    for k in range(cache.n.size):
        force[k] = zero(force)
    for k in range(cache.n.size):
        t, n, b, nd, bd, speed = cache.t[k], cache.n[k], cache.b[k], cache.nd[k], cache.bd[k], cache.speed[k]
        m, q, w, y = cache.m[k], cache.q[k], dot(speed, n), dot(speed, b)
        own = force[k] - fma(m * dot(speed, nd), n, (m * w) * nd) - fma(q * dot(speed, bd), b, (q * y) * bd)  # (17)
        lost = (control.lightness[0] * world.added_mass[1]) * body.sections.narrowing[k]
        u = dot(speed, t)
        own = fma((lost * select(u < 0.0, u, 0.0 * u)) * y, b, own)  # (20)
        upward = (q * y) * speed
        side = fma(m * w, speed, cross(t, upward))
        side = cache.per_rise[k] * fma(-cache.kept_n[k] * dot(side, n), n, side)
        ahead = cross(cache.rise[0], side) + cross(upward, n)
        ahead = cache.per_length[k] * fma(-cache.kept_t[k] * dot(ahead, t), t, ahead)  # (18)
        turned += cross(side, t)
        force[k] = own
        j = nearest(body, k)
        for m in range(3):
            force[j + INDEX(m)] = fma(slope[k, INDEX(m)], ahead, force[j + INDEX(m)])
    twist[0] = turned
    return relieve_fin(body, cache, force)


@kernel
def shed(body, world, control, cache):
    """Force on the last section by the momentum that its trailing edge sheds while it moves forward, and its slope."""
    # The slope is minus the derivative of the force along n with respect to w.
    last = INDEX(cache.n.size - 1)
    t, n, speed = cache.t[last], cache.n[last], cache.speed[last]
    w, u = dot(speed, n), dot(speed, t)
    slope = (control.lightness[0] * world.added_mass[0]) * body.sections.trailing * select(u < 0.0, -u, 0.0 * u)
    swing = sqrt(fma(u, u, w * w) + TINY)
    return fma(-slope * w, n, (-0.5 * slope * (w * w) / swing) * t), slope  # (19)


@kernel
def yielding(cache):
    """Velocity, m/s, that the last section gains sideways in 1 s from 1 N along n, against its added mass."""
    last = INDEX(cache.n.size - 1)
    n = cache.n[last]
    return dot(n, accelerated(cache, last, n))


@kernel
def scatter_all(body, force, twist, f):
    """Distribute the forces of the sections and the twist over the nodes."""
    upper, lower, z = body.sections.upper, body.sections.lower, twist[0]
    for k in range(force.size):
        scatter(body, k, force[k], f)
    for p in range(upper.size):
        f[INDEX(upper[p])] += z
        f[INDEX(lower[p])] -= z


@kernel
def scatter_wake(body, cache, wake, f):
    """Distribute the force of the wake on the last section, its part along the body as in `relieve_fin`; its power."""
    last, power = cache.n.size - 1, zero(cache.m)
    for m in range(body.sections.fin):
        chord = cache.middle[INDEX(last - m)] - cache.middle[INDEX(last - m - 1)]
        pull = (dot(wake, chord) / dot(chord, chord)) * chord
        scatter(body, last - m, wake - pull, f)
        power += dot(wake - pull, cache.speed[INDEX(last - m)])
        wake = pull
    scatter(body, last - body.sections.fin, wake, f)
    return power + dot(wake, cache.speed[INDEX(last - body.sections.fin)])


@kernel
def add_force(body, world, control, x, v, f, cache):
    """Add the force of the water's inertia that does not depend on the acceleration; store the frames."""
    set_frames(body, world, control, x, cache)
    add_force_with_directions(body, world, control, v, f, cache)


@kernel
def add_lagged(body, world, control, x, v, system, cache):
    """Add the same force to `system.load`, and store what `solve_lagged` needs."""
    set_directions(body, world, control, x, cache)
    add_force_with_directions(body, world, control, v, system.load, cache)


@kernel
def add_force_with_directions(body, world, control, v, f, cache):
    """Add that force with the stored directions."""
    set_speeds(body, world, control, v, cache)
    push(body, world, control, cache, cache.force, cache.twist)
    wake, _ = shed(body, world, control, cache)
    scatter_wake(body, cache, wake, f)
    scatter_all(body, cache.force, cache.twist, f)


@kernel
def add_force_cached(body, world, control, x, v, f, cache):
    """Add the same force, and store it for `add_change`."""
    # Shedding that would stop the tail within half a step is limited to what stops it, as the drag of a face is.
    half = 0.5 * control.plans[control.row[0], H]
    set_frames(body, world, control, x, cache)
    set_speeds(body, world, control, v, cache)
    push(body, world, control, cache, cache.force, cache.twist)
    fastest = control.fastest[0]
    for k in range(cache.n.size):
        fast = TURNING * sqrt(dot(cache.td[k], cache.td[k]) + dot(cache.nd[k], cache.nd[k]))
        fastest = select(fast > fastest, fast, fastest)
    control.fastest[0] = fastest
    wake, slope = shed(body, world, control, cache)
    stopping = half * slope * yielding(cache)
    cache.advance[0] = dot(cache.speed[INDEX(cache.n.size - 1)], cache.t[INDEX(cache.n.size - 1)])
    cache.wake[0] = select(stopping > 1.0, 1.0 / stopping, 1.0) * wake
    scatter_wake(body, cache, cache.wake[0], f)
    scatter_all(body, cache.force, cache.twist, f)


@kernel
def add_change(body, world, control, x, v, f, cache):
    """Add the change of the force when the velocities become v, half a step later, at the stored frames."""
    # The change itself changes those velocities: the sections account for that by one iteration, and the shedding is
    # implicit, as if it were the only force on the tail. It pulls the tail along the body the more, the faster the
    # tail moves that way, and no filter slows that: the change of this velocity is divided as that of a force on a
    # light tail. FOLLOWING, SHEDDING and PULLING stand for what other forces add; errors are smallest with them.
    half = 0.5 * control.plans[control.row[0], H]
    set_speeds(body, world, control, v, cache)
    push(body, world, control, cache, cache.later, cache.bend)
    for k in range(cache.n.size):
        gained = accelerated(cache, k, cache.later[k] - cache.force[k])
        cache.speed[k] = fma(FOLLOWING * half, gained, cache.speed[k])
    cache.climb[0] = fma(half, cache.turn[0] * (cache.bend[0] - cache.twist[0]), cache.climb[0])
    set_rates(body, cache)
    push(body, world, control, cache, cache.later, cache.bend)
    for k in range(cache.n.size):
        cache.later[k] = cache.later[k] - cache.force[k]
    cache.bend[0] = cache.bend[0] - cache.twist[0]
    last = INDEX(cache.n.size - 1)
    t, speed = cache.t[last], cache.speed[last]
    edge = (control.lightness[0] * world.added_mass[0]) * body.sections.trailing
    change = dot(speed, t) - cache.advance[0]
    taker = last - INDEX(body.sections.fin)  # the section on which `scatter_wake` puts this part
    kept = change / fma(PULLING * half * edge * dot(t, cache.give[taker] * t), sqrt(dot(speed, speed)), 1.0)  # (26)
    cache.speed[last] = fma(kept - change, t, speed)
    wake, slope = shed(body, world, control, cache)
    given = 1.0 / fma(SHEDDING * half * slope, yielding(cache), 1.0)
    scatter_wake(body, cache, given * (wake - cache.wake[0]), f)  # (25)
    scatter_all(body, cache.later, cache.bend, f)


@kernel
def resistance(cache, k, a):
    """Force with which the water resists, if section k would have the acceleration a without it."""
    n, b = cache.n[k], cache.b[k]
    w, y = dot(a, n), dot(a, b)
    return fma(fma(cache.nn[k], w, cache.nb[k] * y), n, fma(cache.bn[k], w, cache.bb[k] * y) * b)  # (16)


@kernel
def accelerated(cache, k, force):
    """Acceleration of section k by a force that is distributed over its nodes by mass."""
    give = cache.give[k]
    return give * (force - resistance(cache, k, give * force))


@kernel
def add_reaction(body, world, control, x, v, f, cache):
    """Add to the sum f of all other forces the resistance to the acceleration that results, with the stored frames."""
    nodes, first = body.sections.nodes, body.sections.first
    for k in range(cache.n.size):
        start = first[k]
        a = cache.carry[start] * f[INDEX(nodes[start])]
        for p in range(start + 1, first[k + 1]):
            a = fma(cache.carry[INDEX(p)], f[INDEX(nodes[p])], a)
        scatter(body, k, -resistance(cache, k, a), f)


@kernel
def add_inertia(body, world, control, x, a, f, cache):
    """Add to f the added mass at positions x times the vectors a of the nodes."""
    set_frames(body, world, control, x, cache)
    for k in range(cache.n.size):
        mean, n, b = gather(body, a, k), cache.n[k], cache.b[k]
        scatter(body, k, fma(cache.m[k] * dot(mean, n), n, (cache.q[k] * dot(mean, b)) * b), f)  # (15)


@kernel
def add_system(body, world, control, x, v, a, cache):
    """Add the added mass to the matrix a, three columns for each entry of the nodes' skyline."""
    set_frames(body, world, control, x, cache)
    nodes, first, share, profile = body.sections.nodes, body.sections.first, body.sections.share, body.profile
    for k in range(cache.n.size):
        n, b = cache.n[k], cache.b[k]
        sideways, upward = cache.m[k] * n, cache.q[k] * b
        columns = (fma(n.x, sideways, b.x * upward), fma(n.y, sideways, b.y * upward), fma(n.z, sideways, b.z * upward))
        for p in range(first[k], first[k + 1]):
            for o in range(first[k], first[k + 1]):
                row, column = profile.row[nodes[p]], profile.row[nodes[o]]
                if row < column:  # above the diagonal
                    continue
                place = 3 * (profile.start[INDEX(row)] + column - profile.first[INDEX(row)])
                for axis in range(3):
                    i = INDEX(place + axis)
                    a[i] = fma(share[p] * share[o], columns[axis], a[i])


def lagged_work(body: Body, kind) -> dict:
    """Scratch memory of `solve_lagged`: shares of free nodes, also as vectors of three sections, and its results."""
    # Vectors of three sections are in the order of the matrix's rows; `top` is the first row that any of the three has.
    if body.sections is None:
        return {}
    nodes, first, share, *_ = body.sections
    share = share * (body.inverse_mass[nodes] > 0.0).any(axis=1)
    order, row, section = len(body.mass), body.profile.row[nodes], np.repeat(np.arange(len(first) - 1), np.diff(first))
    groups = (len(first) + 1) // 3
    packed = np.zeros((groups, order, 3))
    packed[section // 3, row, section % 3] = share
    size = 2 * (len(first) - 1)
    return {
        "share": kind.scalars(share), "packed": kind.rows(packed.reshape(-1, 3)),
        "top": np.array([row[section // 3 == c].min() for c in range(groups)]),
        "columns": kind.vectors(groups * order), "push": kind.vectors(3 * groups), "roots": kind.vectors(size),
        "shared": kind.numbers((3 * groups) ** 2), "lower": kind.numbers(size**2), "inverse": kind.numbers(2 * size),
        "line": kind.numbers(2 * size), "force": kind.numbers(size),
    }  # fmt: skip


@kernel
def solve_lagged(body, world, control, x, v, system, cache):
    """Add the forces of the added mass to the right-hand side of Tu's method, `system.load`, after its elimination."""
    # With A = L D L^T the matrix of one axis and s the shares of a section, columns L^-1 s of three sections are found
    # at once. Their products over D couple the sections. Then a dense system of twice the number of sections remains.
    load, columns, push, node, top = system.load, system.columns, system.push, body.profile.node, system.top
    order, inverse_pivot, none = load.size, system.inverse_pivot, zero(load)
    for c in range(top.size):
        own, means = (none, none, none), (none, none, none)
        for i in range(top[c], order):
            column = ldlt.forward(body.profile, system.matrix, system.packed, columns, c * order, top[c], i)
            inverse = inverse_pivot[INDEX(i)]
            means = add_products(means, column, inverse * load[INDEX(node[INDEX(i)])])
            own = add_products(own, column, inverse * column)
        push[INDEX(3 * c)], push[INDEX(3 * c + 1)], push[INDEX(3 * c + 2)] = means
        store_shared(system, c, c, own)
        for d in range(c):
            products = (none, none, none)
            for i in range(max(top[c], top[d]), order):
                scaled = inverse_pivot[INDEX(i)] * columns[INDEX(c * order + i)]
                products = add_products(products, columns[INDEX(d * order + i)], scaled)
            store_shared(system, c, d, products)
    solve_sections(body, v, system, cache)
    for c in range(top.size):
        p, q, r = push[INDEX(3 * c)], push[INDEX(3 * c + 1)], push[INDEX(3 * c + 2)]
        for i in range(top[c], order):
            column, z = columns[INDEX(c * order + i)], load[INDEX(node[INDEX(i)])]
            load[INDEX(node[INDEX(i)])] = fma(-column.x, p, fma(-column.y, q, fma(-column.z, r, z)))


@kernel
def add_products(sums, column, vector):
    """Add the coordinates of a column times a vector to three sums."""
    p, q, r = sums
    return fma(column.x, vector, p), fma(column.y, vector, q), fma(column.z, vector, r)


@kernel
def store_shared(system, c, d, products):
    """Store how much forces on the three sections d change the velocities of the three sections c."""
    shared, width = system.shared, 3 * system.top.size
    place = 3 * c * width + 3 * d
    for each in products:
        shared[INDEX(place)] = each.x
        shared[INDEX(place + width)] = each.y
        shared[INDEX(place + 2 * width)] = each.z
        place += 1


@kernel
def solve_sections(body, v, system, cache):
    """Replace the sections' velocities in `push` by the forces of the added mass, by L D L^T with blocks of 2 x 2."""
    # The unknowns of a section are its lateral and its vertical force over the root of its added mass.
    first, nodes, count, width = body.sections.first, body.sections.nodes, cache.n.size, 3 * system.top.size
    roots, push, lower, line = system.roots, system.push, system.lower, system.line
    inverse, force = system.inverse, system.force
    for k in range(count):
        mean = push[k]
        for p in range(first[k], first[k + 1]):
            mean = fma(-system.share[p], v[INDEX(nodes[p])], mean)
        n, b = sqrt(cache.m[k]) * cache.n[k], sqrt(cache.q[k]) * cache.b[k]
        roots[INDEX(2 * k)], roots[INDEX(2 * k + 1)] = n, b
        force[INDEX(2 * k)], force[INDEX(2 * k + 1)] = dot(mean, n), dot(mean, b)
    for k in range(count):
        n, b, own = roots[INDEX(2 * k)], roots[INDEX(2 * k + 1)], system.shared[INDEX(k * width + k)]
        y = force[INDEX(2 * k)], force[INDEX(2 * k + 1)]
        both = own * dot(n, b)
        d = fma(own, dot(n, n), 1.0), both, both, fma(own, dot(b, b), 1.0)
        for j in range(k):
            shared, p, q = system.shared[INDEX(k * width + j)], roots[INDEX(2 * j)], roots[INDEX(2 * j + 1)]
            s = shared * dot(n, p), shared * dot(n, q), shared * dot(b, p), shared * dot(b, q)
            for i in range(j):
                s = less_product(s, block(line, i), block(lower, j * count + i))
            found = times(s, block(inverse, j))
            store(line, j, s)
            store(lower, k * count + j, found)
            d = less_product(d, s, found)
            z0, z1 = force[INDEX(2 * j)], force[INDEX(2 * j + 1)]
            y = fma(-found[0], z0, fma(-found[1], z1, y[0])), fma(-found[2], z0, fma(-found[3], z1, y[1]))
        one = 1.0 / fma(d[0], d[3], -d[1] * d[1])
        store(inverse, k, (one * d[3], -one * d[1], -one * d[1], one * d[0]))
        force[INDEX(2 * k)], force[INDEX(2 * k + 1)] = y
    for k in range(count):
        i00, i01, _, i11 = block(inverse, k)
        z0, z1 = force[INDEX(2 * k)], force[INDEX(2 * k + 1)]
        force[INDEX(2 * k)], force[INDEX(2 * k + 1)] = fma(i00, z0, i01 * z1), fma(i01, z0, i11 * z1)
    for above in range(count):
        k = count - 1 - above
        x0, x1 = force[INDEX(2 * k)], force[INDEX(2 * k + 1)]
        push[INDEX(k)] = fma(x0, roots[INDEX(2 * k)], x1 * roots[INDEX(2 * k + 1)])
        for j in range(k):
            l00, l01, l10, l11 = block(lower, k * count + j)
            force[INDEX(2 * j)] = fma(-l00, x0, fma(-l10, x1, force[INDEX(2 * j)]))
            force[INDEX(2 * j + 1)] = fma(-l01, x0, fma(-l11, x1, force[INDEX(2 * j + 1)]))


@kernel
def block(a, place):
    """Block number `place` of 2 x 2 numbers, row by row."""
    k = 4 * place
    return a[INDEX(k)], a[INDEX(k + 1)], a[INDEX(k + 2)], a[INDEX(k + 3)]


@kernel
def store(a, place, s):
    """Store such a block."""
    k = 4 * place
    a[INDEX(k)], a[INDEX(k + 1)], a[INDEX(k + 2)], a[INDEX(k + 3)] = s


@kernel
def less_product(s, p, q):
    """Compute s - p q^T of such blocks."""
    return (
        fma(-p[0], q[0], fma(-p[1], q[1], s[0])), fma(-p[0], q[2], fma(-p[1], q[3], s[1])),
        fma(-p[2], q[0], fma(-p[3], q[1], s[2])), fma(-p[2], q[2], fma(-p[3], q[3], s[3])),
    )  # fmt: skip


@kernel
def times(s, q):
    """Compute s q of such blocks, for a symmetric q."""
    return (
        fma(s[0], q[0], s[1] * q[1]), fma(s[0], q[1], s[1] * q[3]),
        fma(s[2], q[0], s[3] * q[1]), fma(s[2], q[1], s[3] * q[3]),
    )  # fmt: skip


@kernel
def energy(body, world, control, x, v, f, cache):
    """Kinetic energy of the water that moves with the sections, J."""
    set_frames(body, world, control, x, cache)
    set_speeds(body, world, control, v, cache)
    total = zero(control.stiffness)
    for k in range(cache.n.size):
        w, y = dot(cache.speed[k], cache.n[k]), dot(cache.speed[k], cache.b[k])
        total = fma(0.5 * cache.m[k], w * w, fma(0.5 * cache.q[k], y * y, total))  # (14)
    return total


@kernel
def loss(body, world, control, x, v, f, cache):
    """Power that the shed wake, and the flow that leaves the narrowing rear, take from fish and moving water, W."""
    # What moving forces from the fin to the peduncle takes is a part of it.
    set_frames(body, world, control, x, cache)
    set_speeds(body, world, control, v, cache)
    wake, _ = shed(body, world, control, cache)
    relief = push(body, world, control, cache, cache.force, cache.twist)
    total = -(scatter_wake(body, cache, wake, f) + relief)
    for k in range(cache.n.size):
        lost = (control.lightness[0] * world.added_mass[1]) * body.sections.narrowing[k]
        y, u = dot(cache.speed[k], cache.b[k]), dot(cache.speed[k], cache.t[k])
        total = fma(lost * select(u < 0.0, -u, 0.0 * u), y * y, total)
    return total
