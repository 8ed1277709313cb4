"""The elastic answer of a finite lattice by statics: bonds, balls that move and turn, plates and a membrane; no time.

Written with SciPy alone, apart from the program: what it takes from there are the places of the balls, the zone and the
areas of the membrane's cells. Every bond sticks. Two motions, the platens alone and the membrane alone, give the
matrix S of (ds1, ds3) = S (de1, de3), natural strains, from which all elastic paths follow (`Answer`).
"""

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import cg
from scipy.spatial import cKDTree


class Answer(NamedTuple):
    """Moduli [F/L^2] and ratios [-] of a specimen with (ds1, ds3) = S (de1, de3)."""

    matrix: np.ndarray

    @property
    def drained_modulus(self):
        """ds1/de1 at constant s3: Young's modulus."""
        (a, b), (c, d) = self.matrix
        return a - b * c / d

    @property
    def k0(self):
        """ds3/ds1 without lateral strain."""
        return self.matrix[1, 0] / self.matrix[0, 0]

    @property
    def bulk_modulus(self):
        """dp/dev where s1 = s3."""
        axial, lateral = np.linalg.solve(self.matrix, [1.0, 1.0])
        return 1 / (axial + 2 * lateral)

    def _undrained(self):
        return self.matrix @ [1.0, -0.5]

    @property
    def undrained_modulus(self):
        """dq/de1 at constant volume."""
        axial, lateral = self._undrained()
        return axial - lateral

    @property
    def undrained_dp_dq(self):
        """dp/dq at constant volume."""
        axial, lateral = self._undrained()
        return (axial + 2 * lateral) / 3 / (axial - lateral)

    @property
    def constant_p_modulus(self):
        """dq/de1 at constant p."""
        axial, _ = np.linalg.solve(self.matrix, [1.0, -0.5])
        return 1.5 / axial


def infinite(c11, c12) -> Answer:
    """Of a cubic crystal along its axis."""
    return Answer(np.array([[c11, 2 * c12], [c12, c11 + c12]]))


def whole(network, state, areas, zone):
    """A sector of a test as it stands: the full cylinder, areas of its cells, closed bonds and balls on the plates, for
    `elastic`. areas, zone: (N,) of the sector's balls."""
    order, on_axis = network.sector.order, np.asarray(network.weight) < 1
    place = np.asarray(network.positions) + np.asarray(state.displacement)
    number, count = {}, 0
    for ball in range(place.shape[1]):
        for turn in range(1 if on_axis[ball] else order):
            number[ball, turn] = count
            count += 1

    def at(ball, turn):
        return number[ball, 0 if on_axis[ball] else turn % order]

    positions, cells, outer = np.empty((3, count)), np.empty(count), np.empty(count, bool)
    for (ball, turn), row in number.items():
        x, y, z = place[:, ball]
        cos, sin = np.cos(2 * np.pi * turn / order), np.sin(2 * np.pi * turn / order)
        positions[:, row] = cos * x - sin * y, sin * x + cos * y, z
        cells[row], outer[row] = areas[ball], zone[ball]
    radius, pairs = float(network.radius[0]), set()
    for first, second, image in zip(*map(np.asarray, (network.first, network.second, network.image)), strict=True):
        for turn in range(order):
            pair = sorted((at(first, turn), at(second, turn + image)))
            if image >= 0 and np.sqrt(((positions[:, pair[0]] - positions[:, pair[1]]) ** 2).sum()) < 2 * radius:
                pairs.add(tuple(pair))
    bottom, top = np.asarray(state.platens)
    made = SimpleNamespace(
        positions=positions, radius=np.full(count, radius), bottom=bottom, top=top, membrane_zone=outer
    )
    held = [np.flatnonzero(positions[2] - radius < bottom), np.flatnonzero(positions[2] + radius > top)]
    return made, cells, np.array(sorted(pairs)).T, held


def elastic(specimen, areas, kn: float, ks: float, bonds=None, held=None, stress: float = 0.0) -> tuple[Answer, Answer]:
    """A full cylinder of equal FCC balls between smooth plates: what platens and membrane feel of it, and its core
    alone (within half of Rm and the middle 60 % of the height; strains of the balls, stresses of the bonds).

    specimen: anything with positions, radius, bottom, top and membrane_zone of a `Specimen`.
    areas: (N,) of the membrane's cells [L^2]. bonds: (2, B) closed ones; None for all that touch. held: the balls on
    the bottom and on the top plate; None for all of the end layers. stress: at which it stands [F/L^2].
    """
    place, radius, count = specimen.positions, float(specimen.radius[0]), specimen.positions.shape[1]
    if bonds is None:
        bonds = cKDTree(place.T).query_pairs(2.001 * radius, output_type="ndarray").T
    if held is None:
        held = [np.flatnonzero(np.abs(place[2] - end) < 1.001 * radius) for end in (specimen.bottom, specimen.top)]
    first, second = bonds
    normal = place[:, first] - place[:, second]
    normal = (normal / np.sqrt((normal**2).sum(0))).T
    # Of a bond: slip = u1 - u2 - (t1 + t2) x n with t = radius times turn, along n and across.
    eye = np.broadcast_to(np.eye(3), (len(normal), 3, 3))
    cross = np.zeros((len(normal), 3, 3))  # t -> t x n
    x, y, z = normal.T
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 0] = z, -y, -z
    cross[:, 1, 2], cross[:, 2, 0], cross[:, 2, 1] = x, y, -x
    rows = np.concatenate([eye, -eye, -cross, -cross], axis=2)  # (B, 3, 12)
    spring = kn * normal[:, :, None] * normal[:, None] + ks * (eye - normal[:, :, None] * normal[:, None])
    stiff = np.einsum("bki,bkl,blj->bij", rows, spring, rows)
    numbers = np.concatenate(
        [3 * ball[:, None] + np.arange(3) + turn for turn in (0, 3 * count) for ball in (first, second)], axis=1
    )
    at = np.repeat(numbers, 12, axis=1).ravel(), np.tile(numbers, (1, 12)).ravel()
    matrix = sparse.coo_matrix((stiff.ravel(), at), shape=(6 * count,) * 2).tocsr()
    on_plate = np.concatenate([3 * balls + 2 for balls in held])
    plate = np.zeros(6 * count)
    plate[on_plate] = kn
    matrix = (matrix + sparse.diags(plate)).tocsr()

    rho = np.hypot(*place[:2])
    inward = np.zeros((count, 3))
    inward[:, :2] = -(areas / np.where(rho > 0, rho, 1.0) * place[:2]).T
    height, zone = specimen.top - specimen.bottom, rho[specimen.membrane_zone]
    middle = 0.5 * (zone.min() + zone.max())
    outward = np.zeros((2, 6 * count))
    for row, pick in zip(outward, (zone.min(), zone.max()), strict=True):
        # All balls at that distance move alike.
        balls = np.flatnonzero(specimen.membrane_zone & (np.abs(rho - pick) < 1e-6 * radius))
        for axis in (0, 1):
            row[3 * balls + axis] = place[axis, balls] / rho[balls] / balls.size

    core = (rho < 0.5 * middle) & (np.abs(place[2] - place[2].mean()) < 0.3 * height)
    inside = core[first].astype(float) + core[second]

    def of_core(moved):
        """(e1, e3), (s1, s3), compression positive: a straight line through the displacements, and Love-Weber's sum."""
        where = np.vstack([np.ones(core.sum()), place[:, core] - place[:, core].mean(1, keepdims=True)]).T
        slopes = np.linalg.lstsq(where, moved[: 3 * count].reshape(count, 3)[core], rcond=None)[0][1:]
        force = -np.einsum("bij,bjk,bk->bi", spring, rows, moved[numbers])
        pressed = np.einsum("b,bi,bi->i", inside, normal, force) / (core.sum() * 4 * 2**0.5 * radius**2)
        across = [0.5 * (values[0] + values[1]) for values in (-np.diag(slopes), pressed)]
        return (-slopes[2, 2], across[0]), (pressed[2], across[1])

    def answer(platen: float, lateral: float):
        """(e1, e3), (s1, s3) at the boundary and in the core, with plates that close by 2 platen and this stress of the
        membrane."""
        load = np.zeros(6 * count)
        load[: 3 * count] = lateral * inward.ravel()
        for balls, sign in zip(held, (1, -1), strict=True):
            load[3 * balls + 2] += kn * sign * platen
        diagonal = matrix.diagonal()
        moved, failed = cg(
            matrix, load, rtol=1e-9, M=sparse.diags(1 / np.where(diagonal > 0, diagonal, 1.0)), maxiter=20_000
        )
        assert not failed
        force = kn * (platen * held[0].size - moved[3 * held[0] + 2].sum())
        aside = -(outward @ moved).mean() / middle
        # The section shrinks under the stress at which it stands.
        return ((2 * platen / height, aside), (force / section + 2 * stress * aside, lateral)), of_core(moved)

    section = np.pi * middle**2
    tried = [answer(1e-6 * radius, 0.0), answer(0.0, 1e-6 * kn / radius)]
    return tuple(
        Answer(np.linalg.solve(*(np.array([case[part][kind] for case in tried]) for kind in (0, 1))).T)
        for part in (0, 1)
    )
