"""Fins and eyes for looks: weighted sums of the points of a skin, so that they move with it. The physics has none."""

import numpy as np

UP, DOWN = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])
LEFT, RIGHT = np.array([0.0, 1.0, -0.35]), np.array([0.0, -1.0, -0.35])
EYE_STATION, EYE_HEIGHT = 0.085, 0.35  # body lengths behind the nose; slope of the line of sight above the horizontal


def fins(weights: np.ndarray, points: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Fins on back, belly and flanks of a skin at rest, points (V,3) = weights (V,N) @ nodes, m.

    Returns:
        weights of their points (P,N), and quadrilaterals (R,4) that number them from V on.
    """
    shapes = (  # side, opposite side, stations of the root, height and sweep of each ray; all in body lengths
        (UP, DOWN, (0.27, 0.58), (0.0, 0.085, 0.075, 0.05, 0.035, 0.03, 0.022, 0.0), (0.03, 0.075)),
        (DOWN, UP, (0.58, 0.72), (0.0, 0.055, 0.04, 0.025, 0.0), (0.03, 0.05)),
        (DOWN, UP, (0.36, 0.41), (0.0, 0.05, 0.02), (0.05, 0.06)),
        (LEFT, RIGHT, (0.215, 0.255), (0.02, 0.095, 0.06, 0.02), (0.05, 0.09)),
        (RIGHT, LEFT, (0.215, 0.255), (0.02, 0.095, 0.06, 0.02), (0.05, 0.09)),
    )
    rows, quads = [], []
    for side, opposite, (start, stop), heights, (sweep, sweep_end) in shapes:
        base = len(weights) + sum(map(len, rows))
        stations = np.linspace(start, stop, len(heights))
        rows.append(sheet(weights, points, length, side, opposite, stations, heights, (sweep, sweep_end)))
        quads += [(base + 2 * k, base + 2 * k + 1, base + 2 * k + 3, base + 2 * k + 2) for k in range(len(heights) - 1)]
    return np.concatenate(rows), np.array(quads)


def sheet(weights, points, length, side, opposite, stations, heights, sweep) -> np.ndarray:
    """Weights (2K,N) of a fin of K rays: root and tip of each in turn."""
    backwards = weights[points[:, 0].argmin()] - weights[points[:, 0].argmax()]
    rows = []
    for station, height, back in zip(stations, heights, np.linspace(sweep[0], sweep[1], len(heights)), strict=True):
        root, far = outermost(points, length, station, side), outermost(points, length, station, opposite)
        thickness = np.linalg.norm(points[root] - points[far]) / length
        out = (weights[root] - weights[far]) / max(thickness, 0.01)
        rows += [weights[root], weights[root] + height * out + back * backwards]
    return np.array(rows)


def eyes(weights: np.ndarray, points: np.ndarray, length: float) -> np.ndarray:
    """Weights (2,N) of the left and the right eye."""
    sight = [np.array([0.0, side, EYE_HEIGHT]) for side in (1.0, -1.0)]
    return weights[[outermost(points, length, EYE_STATION, direction) for direction in sight]]


def outermost(points, length, station, direction) -> int:
    """The point furthest out in a direction among those about `station` body lengths behind the nose."""
    behind = (points[:, 0].max() - points[:, 0]) / length
    return int((points @ direction / length - 4.0 * np.abs(behind - station)).argmax())
