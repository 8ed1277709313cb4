"""How uniform and isotropic a packing is, and what its number of balls and contacts allows (host, NumPy).

Two halves of a specimen never agree to the last digit. A sector counts what belongs to it alone: its images are copies,
and say nothing more.
"""

from typing import NamedTuple

import numpy as np

from axijax.core.sector import Sector
from axijax.core.vector import Vector
from axijax.mechanics.contact_list import ContactList
from axijax.mechanics.observe import in_core
from axijax.specimen.fabric import inside_balls, sample_points
from axijax.specimen.specimen import Specimen

ISOTROPIC, SCATTERS = 0.05, 2.0  # the core's stress ratio is within the first plus so many standard errors of one
SKIN = 2.0  # mean radii below membrane and platens that trends are looked for within


class CoreStress(NamedTuple):
    """Stress of the inner core, rho < Rm/2 and the middle 60 % of the height.

    ratio: vertical over mean horizontal stress [-]. contacts: of the sector that bear it. error: by which the ratio of
    an isotropic packing with so many independent contacts misses one, as a standard error [-]; eleven packings of 600
    balls scattered by 0.7 of it.
    """

    ratio: float
    contacts: int
    error: float

    @property
    def limit(self) -> float:
        """How far from one the ratio may be [-]."""
        return ISOTROPIC + SCATTERS * self.error


def core_stress(network: ContactList, force: Vector, normal: Vector, place: Vector, radius, platens) -> CoreStress:
    """Love-Weber stress of the core by its contacts' forces and normals, (C,) vectors; NaN where there are none.

    radius: Rm [L]; platens: (2,) heights [L].
    """
    arm = np.asarray(network.radius * in_core(place, radius, platens))
    arm = np.asarray(network.share) * (arm[network.first] + arm[network.second])
    vertical = np.asarray(force.z * normal.z) * arm
    horizontal = np.asarray(force.x * normal.x + force.y * normal.y) * arm / 2
    if not horizontal.sum() > 0:
        return CoreStress(np.nan, 0, np.nan)
    error = np.sqrt(((vertical - horizontal) ** 2).sum()) / horizontal.sum()
    contacts = int(np.count_nonzero((vertical != 0) | (horizontal != 0)))
    return CoreStress(float(vertical.sum() / horizontal.sum()), contacts, float(error))


class Trends(NamedTuple):
    """Differences between halves of equal volume below the skin: the outer less the inner one, the middle of the height
    less the ends.

    void_ratio: (2,) [-]. size: (2,) of the mean radius, over the mean of all [-].
    size_error: (2,) standard errors of these in a packing that is uniform [-].
    """

    void_ratio: tuple[float, float]
    size: tuple[float, float]
    size_error: tuple[float, float]


def trends(cut: Specimen, sector: Sector, radius: float) -> Trends:
    """Of a sector's balls; radius: Rm [L]. NaN where half of it holds no ball."""
    skin = SKIN * cut.radius.mean()
    width, half, middle = radius - skin, cut.height / 2 - skin, (cut.bottom + cut.top) / 2
    if not (width > 0 and half > 0):
        return Trends(*[(np.nan, np.nan)] * 3)
    points = sample_points(sector, width, middle - half, middle + half)
    solid = inside_balls(points, cut, sector)

    def halves(place):
        """Whether in the second half of either kind, and whether below the skin at all."""
        rho, above = np.hypot(place[0], place[1]), np.abs(place[2] - middle)
        return (rho > width / 2**0.5, above < half / 2), (rho < width) & (above < half)

    void, size, error = [], [], []
    of_points, (of_balls, inside) = halves(points)[0], halves(cut.positions)
    for second, other in zip(of_points, of_balls, strict=True):
        share = [solid[~second].mean(), solid[second].mean()]
        radii = [cut.radius[inside & ~other], cut.radius[inside & other]]
        if min(share) == 0 or min(map(len, radii)) < 2:
            return Trends(*[(np.nan, np.nan)] * 3)
        void.append(1 / share[1] - 1 / share[0])
        size.append((radii[1].mean() - radii[0].mean()) / cut.radius.mean())
        error.append(np.sqrt(sum(part.var(ddof=1) / len(part) for part in radii)) / cut.radius.mean())
    return Trends(*((float(radial), float(axial)) for radial, axial in (void, size, error)))
