"""Bodies out of their shape: twisted, or turned inside out."""

from collections.abc import Callable

import numpy as np

from fish_env.physics.fish import ElasticObject


def twist(thing: ElasticObject, turns=0.5) -> np.ndarray:
    """Turn an object about x, by so many turns from end to end; returns positions (N,3) m."""
    x = thing.body.position
    angle = 2.0 * np.pi * turns * (x[:, 0] - x[:, 0].min()) / thing.length
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([x[:, 0], c * x[:, 1] - s * x[:, 2], s * x[:, 1] + c * x[:, 2]], axis=1)


def invert(thing: ElasticObject) -> np.ndarray:
    """Turn an object inside out, in the plane z = 0, with noise of a hundredth; returns positions (N,3) m."""
    noise = np.random.default_rng(1).standard_normal(thing.body.position.shape)
    return thing.body.position * [1.0, 1.0, -1.0] + 0.01 * np.ptp(thing.body.position[:, 2]) * noise


DISTORTIONS: dict[str, Callable[[ElasticObject], np.ndarray]] = {"twisted": twist, "inverted": invert}


def distort(thing: ElasticObject, how: str) -> np.ndarray:
    """Twist or invert an object; returns positions (N,3) m, or raises ValueError for one that cannot be."""
    # An object in a plane or on a line cannot; nor can one of springs alone be inverted, which are at rest in its
    # mirror image too.
    body = thing.body
    if not np.ptp(body.position, axis=0).all():
        raise ValueError(f"the {thing.name} lies in a plane or on a line and cannot be {how}; give a solid object")
    if how == "inverted" and body.tets is None and body.compartments is None:
        raise ValueError(
            f"the {thing.name} is at rest inside out too, since springs do not tell it from its mirror image; give an "
            "object of tetrahedra or with gas"
        )
    return DISTORTIONS[how](thing)
