"""Other materials and surroundings of an elastic object: of a new one, or of those of a tank while they move."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from fish_env.checks import finite_array, frozen, positive_array
from fish_env.physics.body import fix_where, scale_body, with_rates
from fish_env.physics.engine import Engine
from fish_env.physics.fish import ElasticObject
from fish_env.physics.records import Body, World
from fish_env.physics.tank import Tank
from fish_env.physics.tank_options import too_long
from fish_env.soft.conditions import present


def change_body(thing: ElasticObject, stiffness=1.0, damping=1.0, mass=1.0, inner_mass=1.0, pressure=1.0) -> Body:
    """A new body of an object with factors on its materials, which `Tank.change` describes.

    Under another pressure, natural lengths of springs remain, so that the object changes its size. ValueError for a
    factor that is not positive (damping and pressure may be zero), or for gas or an inner layer that there is not.
    """
    positive_array([stiffness, mass, inner_mass], (3,), "factors on stiffness, mass and inner mass")
    positive_array([damping, pressure], (2,), "factors on damping and pressure", zero=True)
    body, inner = scale_body(thing.body, stiffness, damping, mass), getattr(thing, "inner", np.zeros(0, np.int64))
    gas, factor = body.compartments, np.ones((len(body.mass), 1))
    if pressure != 1.0 and gas is None:
        raise ValueError(f"pressure is {pressure:g}, and {thing.name!r} has no gas; leave it 1")
    if inner_mass != 1.0 and not inner.size:
        raise ValueError(f"inner_mass is {inner_mass:g}, and {thing.name!r} names no inner nodes; leave it 1")
    if pressure == inner_mass == 1.0:
        return body
    if gas is not None:
        weaker = gas._replace(gas=gas.gas * pressure, ambient=gas.ambient * pressure) if pressure else None
        body = body._replace(compartments=weaker)  # without gas it may lie flat
    factor[inner] = inner_mass
    return with_rates(body._replace(mass=body.mass * factor[:, 0], inverse_mass=body.inverse_mass / factor))


def change_world(world: World, gravity=None, restitution=None) -> World:
    """Surroundings with another gravity, (3,) m/s2, and restitution of all walls, 0 to 1; None leaves it."""
    if gravity is not None:
        world = world._replace(gravity=finite_array(gravity, (3,), "gravity (m/s2)"))
    if restitution is not None:
        part = float(finite_array(restitution, (), "restitution"))
        if not 0.0 <= part <= 1.0 or world.planes is None:
            raise ValueError(f"restitution is {part}; give a number from 0 to 1, to a tank with walls")
        world = world._replace(planes=np.column_stack([world.planes[:, :4], np.full(len(world.planes), part)]))
    return world


def change(tank: Tank, gravity, restitution, factors: tuple[float, ...]) -> None:
    """`Tank.change`."""
    made, held = getattr(tank, "_made", tank._own), present(tank).held
    own = change_body(replace(tank.fish, body=made), *factors)
    body, world = fix_where(own, held) if held.any() else own, change_world(tank.world, gravity, restitution)
    fish = replace(tank.fish, body=body)
    if reason := too_long(fish, world, tank.integrator, tank.dt):
        warnings.warn(f"{tank.integrator.name!r} may fail on {tank.fish.name!r} now: {reason}", stacklevel=3)
    tank._made, tank._own = made, frozen(own)
    tank._set_read_only(fish=frozen(fish), world=frozen(world))
    if tank._engine is not None:
        tank._engine = Engine(tank)
    tank.pack.set(mass=np.array(own.mass))
