"""Anchors, gravity, air and walls against their twins."""

import naive
import numpy as np
import pytest
import small_bodies
from hypothesis import given
from hypothesis import strategies as st
from small_bodies import ALL, close

from fish_env.forces import anchors, contact, gravity
from fish_env.world import make_anchors

seeds = st.integers(0, 2**32 - 1)


@given(seed=seeds)
def test_world_equals_its_twins(seed):
    """Anchors, gravity and air, and walls at work are those of the textbook's formulas; so are the impacts."""
    rng = np.random.default_rng(seed)
    x, v = small_bodies.shaken(ALL, rng)
    world, f = small_bodies.world_with_all(ALL, offset=0.07), np.zeros((20, 3))
    anchors.add_force(world.anchors, x, v, f)
    close(f, naive.anchor_force(world.anchors, x, v))
    assert anchors.energy(world.anchors, x) == pytest.approx(naive.anchor_energy(world.anchors, x), rel=1e-12)
    f[:] = 0.0
    gravity.add_force(ALL.mass, world.gravity, world.viscosity, v, f)
    close(f, ALL.mass[:, None] * world.gravity - world.viscosity * v)
    assert gravity.energy(ALL.mass, world.gravity, x) == pytest.approx(naive.weight_energy(ALL, world, x), rel=1e-12)
    v[0, 2], f = -0.1, rng.normal(size=x.shape)
    f[0] = [0.0, 0.0, -1.0]  # onto the walls, behind which it is
    wanted = naive.with_reaction(world.planes, x, v, f)
    assert np.abs(wanted - f).max() > 0
    contact.add_reaction(world.planes, x, v, f)
    close(f, wanted)
    wanted, before, h = naive.bounce(ALL, world, 0.005, x, v), v.copy(), 0.005
    contact.bounce(world.planes, ALL.inverse_mass, world.gravity, h, x, v)
    close(v, wanted)
    assert (v != before).any()
    assert np.sum(v**2, axis=1) @ ALL.mass < np.sum(before**2, axis=1) @ ALL.mass


def test_anchor_at_its_point():
    """An anchor with a length whose node is at its very point has no direction, and pulls nowhere."""
    x, f = np.zeros((1, 3)), np.zeros((1, 3))
    anchor = make_anchors([0], np.zeros(3), 5.0, 1.0, 0.3, [1.0, 0.0, 0.0])
    anchors.add_force(anchor, x, np.zeros((1, 3)), f)
    stiffness, damping = np.zeros((3, 3)), np.zeros((3, 3))
    anchors.add_jacobian(anchor, x, np.zeros((1, 3)), stiffness, damping)
    assert not f.any() and not stiffness.any() and not damping.any()
