"""Structured meshes of tetrahedra, and the masses of their nodes.

A mesh is a grid of cells, each split into six tetrahedra round its diagonal (Kuhn 1960): one for each order in which a
path along the edges can go from one end of the diagonal to the other. Neighbouring cells agree on the diagonal of the
face they share, so the mesh conforms. Where a cross-section shrinks to a line or a point, nodes coincide and are made
one; a path that would visit it twice has lost its tetrahedron, and what remains conforms as before.
"""

from itertools import permutations
from typing import NamedTuple

import numpy as np

from fish_env.checks import check_names, finite_array, is_whole, node_array, positive_array

RULES = ("quarter", "uniform")


class Mesh(NamedTuple):
    """A body of tetrahedra lofted through rectangular cross-sections."""

    position: np.ndarray  # (N,3) m
    tets: np.ndarray  # (T,4) of positive volume
    faces: np.ndarray  # (F,4) surface, counter-clockwise seen from outside; a triangle gives its third node twice
    number: np.ndarray  # (I,J,K) the node at each grid point: station, place across, place upward


def box(size, cells, mirrored=False) -> tuple[np.ndarray, np.ndarray]:
    """A block of cells, from x = 0 on and centred on y = z = 0.

    Args:
        size: length, width and height, (3,) m.
        cells: their numbers along x, y and z, (3,).
        mirrored: the mesh is its own mirror image in the planes y = 0 and z = 0; the cells along y and z must then be
            even in number.

    Returns:
        positions (N,3) m and tetrahedra (T,4).

    Raises:
        ValueError: for a size that is not positive, or a number of cells that is not allowed.
    """
    length, width, height = positive_array(size, (3,), "size (m)")
    along, across, upward = _cells(cells, (False, mirrored, mirrored))
    ends = np.full(along + 1, 0.5)
    return grid(np.linspace(0.0, length, along + 1), ends * width, ends * height, across, upward, mirrored)[:2]


def grid(stations, widths, depths, cells_y, cells_z, mirrored=True) -> Mesh:
    """A body lofted through a row of rectangular cross-sections.

    Args:
        stations: x of the cross-sections, (I,) m, rising or falling.
        widths: half their width along y, (I,) m, zero or positive; zero only where the neighbours have some.
        depths: half their height along z, (I,) m, as the widths.
        cells_y: number of cells across, even if mirrored.
        cells_z: number of cells upward, even if mirrored.
        mirrored: the mesh is its own mirror image in the planes y = 0 and z = 0.

    Raises:
        ValueError: naming the station that is not allowed, or the number of cells.
    """
    stations = np.asarray(stations)
    count = stations.size
    stations = finite_array(stations, (count,), "stations (m)")
    widths = positive_array(widths, (count,), "widths (m)", zero=True)
    depths = positive_array(depths, (count,), "depths (m)", zero=True)
    _, cells_y, cells_z = _cells((max(1, count - 1), cells_y, cells_z), (False, mirrored, mirrored))
    forward = _direction(stations)
    for name, half in (("widths", widths), ("depths", depths)):
        for i in np.flatnonzero((half[1:] == 0) & (half[:-1] == 0)):
            raise ValueError(f"{name} are zero at stations {i} and {i + 1}; there must be a volume between them")
    number, kept = _numbers(widths == 0, depths == 0, cells_y, cells_z)
    across, upward = np.linspace(-1.0, 1.0, cells_y + 1), np.linspace(-1.0, 1.0, cells_z + 1)
    x = np.empty((*number.shape, 3))
    x[..., 0] = stations[:, None, None]
    x[..., 1] = widths[:, None, None] * across[:, None]
    x[..., 2] = depths[:, None, None] * upward
    tets = _kuhn(number, mirrored)
    faces = _surface(number)
    if not forward:
        tets[:, [2, 3]] = tets[:, [3, 2]]
        faces = faces[:, ::-1]
    return Mesh(x.reshape(-1, 3)[kept], tets, _polygons(faces), number)


def lumped_mass(position, tets, density, rule="quarter") -> np.ndarray:
    """Masses of the nodes, (N,) kg, of tetrahedra (T,4) between positions (N,3) m.

    Args:
        position: (N,3) m.
        tets: (T,4), of positive volume.
        density: kg/m3, positive: one number or (T,).
        rule: "quarter" gives each corner a quarter of its tetrahedra's masses; "uniform" gives all nodes the same.

    Raises:
        ValueError: for an unknown rule, a density that is not positive, or a tetrahedron that is flat or inverted.
    """
    check_names("unknown rule", RULES, rule)
    position = finite_array(position, (len(position), 3), "position (m)")
    tets = node_array(tets, 4, len(position), "tetrahedra")
    volume = np.linalg.det(position[tets[:, 1:]] - position[tets[:, :1]]) / 6
    for t in np.flatnonzero(~(volume > 0)):
        raise ValueError(f"tetrahedron {t} has the volume {volume[t]:g} m3; give elements of positive volume")
    mass = volume * positive_array(density, volume.shape if np.ndim(density) else (), "density (kg/m3)")
    if rule == "uniform":
        return np.full(len(position), mass.sum() / len(position))
    return np.bincount(tets.ravel(), np.repeat(mass / 4, 4), minlength=len(position))


def _cells(cells, even) -> tuple[int, ...]:
    """Whole numbers of cells along the three axes, even where they must be."""
    for count, paired, axis in zip(cells, even, "xyz", strict=True):
        if not (is_whole(count) and count >= 1):
            raise ValueError(f"there are {count!r} cells along {axis}; give a whole number, at least 1")
        if paired and count % 2:
            raise ValueError(f"there are {count} cells along {axis}; a mirrored mesh has an even number")
    return tuple(map(int, cells))


def _direction(stations) -> bool:
    """True if the stations rise; ValueError unless they rise or fall throughout."""
    steps = np.diff(stations)
    if not steps.size:
        raise ValueError("there is one station; give at least two")
    wrong = np.flatnonzero(~(steps * np.sign(steps[0]) > 0))
    if wrong.size:
        raise ValueError(f"stations turn back or stand still at number {wrong[0] + 1}; give them in order")
    return bool(steps[0] > 0)


def _numbers(thin, flat, cells_y, cells_z) -> tuple[np.ndarray, np.ndarray]:
    """Node at each grid point (I,J,K), and which grid point each node is, (N,): thin stations (I,) have no width."""
    points = np.arange(thin.size * (cells_y + 1) * (cells_z + 1)).reshape(thin.size, cells_y + 1, cells_z + 1)
    points[thin] = points[thin, :1]
    points[flat] = points[flat][:, :, :1]
    kept, number = np.unique(points, return_inverse=True)
    return number.reshape(points.shape), kept


def _kuhn(number, mirrored) -> np.ndarray:
    """Tetrahedra (T,4) between the nodes (I,J,K), positive where x rises with I, without those with a node twice."""
    # Mirrored, every diagonal goes from the side nearer the middle planes outward.
    shape = np.array(number.shape) - 1
    cell = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
    turned = (2 * cell < shape) & np.array([False, mirrored, mirrored])
    paths = []
    for order in permutations(range(3)):
        at = turned.astype(int)
        corners = [number[tuple((cell + at).T)]]
        for axis in order:
            at = at.copy()
            at[:, axis] ^= 1
            corners.append(number[tuple((cell + at).T)])
        odd = np.linalg.det(np.eye(3)[list(order)]) < 0
        path = np.stack(corners, axis=1)
        inverted = turned.sum(axis=1) % 2 == (0 if odd else 1)
        path[inverted] = path[inverted][:, [0, 1, 3, 2]]
        paths.append(path)
    tets = np.stack(paths, axis=1).reshape(-1, 4)
    once = np.sort(tets, axis=1)
    return tets[(once[:, 1:] != once[:, :-1]).all(axis=1)]


def _surface(number) -> np.ndarray:
    """Quadrilaterals (F,4) on the six sides of a grid of nodes (I,J,K), outward where x rises with I."""
    sides = []
    for axis, following in ((0, (1, 2)), (1, (2, 0)), (2, (0, 1))):
        planes = np.transpose(number, (axis, *following))
        for plane, outward in ((planes[-1], True), (planes[0], False)):
            ring = np.stack([plane[:-1, :-1], plane[1:, :-1], plane[1:, 1:], plane[:-1, 1:]], axis=-1).reshape(-1, 4)
            sides.append(ring if outward else ring[:, ::-1])
    return np.concatenate(sides)


def _polygons(faces) -> np.ndarray:
    """Quadrilaterals (F,4) as they are, triangles with the third node twice, without those that are a line or point."""
    kept = []
    for face in faces.tolist():
        around = [node for node, last in zip(face, face[-1:] + face[:-1], strict=True) if node != last]
        if len(set(around)) >= 3:
            kept.append(around + around[-1:] * (4 - len(around)))
    return np.array(kept, dtype=np.int64)
