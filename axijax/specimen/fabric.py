"""What a packing looks like inside: contacts, rattlers, fabric and density, whole and in profiles (host, NumPy).

Each contact appears once from either of its balls, so that every sum over a ball's own contacts is complete, and a
sector counts what belongs to it. Directions are radial, circumferential and vertical at the contact: these are the
same for all images.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from axijax.core.images import directed_pairs
from axijax.core.sector import Sector, plane_normals
from axijax.specimen.specimen import Specimen


class Pairs(NamedTuple):
    """Directed pairs of balls, each seen from either side; ball i against image k of ball j.

    first, second, image: (P,) int. apart: (3, P) from the image of j to i [L]. overlap: (P,) negative for a gap [L].
    """

    first: np.ndarray
    second: np.ndarray
    image: np.ndarray
    apart: np.ndarray
    overlap: np.ndarray


def pairs_within(positions: np.ndarray, radius: np.ndarray, sector: Sector, gap: float = 0.0) -> Pairs:
    """All pairs, images included, whose surfaces are less than `gap` apart [L]; positions (3, N), radius (N,)."""
    i, j, k = directed_pairs(positions, radius, gap, sector, sector.on_axis(positions, radius))
    return measured(Pairs(i, j, k, np.zeros((3, i.size)), np.zeros(i.size)), positions, radius, sector)


def measured(pairs: Pairs, positions: np.ndarray, radius: np.ndarray, sector: Sector) -> Pairs:
    """The same pairs at other positions or radii."""
    i, j, k = pairs[:3]
    apart = positions[:, i] - sector.rotate(positions[:, j], k)
    return Pairs(i, j, k, apart, radius[i] + radius[j] - np.sqrt((apart**2).sum(0)))


class Contacts(NamedTuple):
    """Statistics of the touching contacts.

    coordination_number: mean number of contacts of a ball with others [-].
    mechanical_coordination_number: the same among the balls that carry load, contacts with rattlers left out [-].
    rattler_fraction: share of balls with fewer than two contacts, platens, planes and membrane counted as one each [-].
    anisotropy: vertical minus mean horizontal component of the fabric tensor <n n> [-].
    """

    coordination_number: float
    mechanical_coordination_number: float
    rattler_fraction: float
    anisotropy: float


def contact_statistics(cut: Specimen, sector: Sector) -> Contacts:
    """Contacts of a sector's balls where they are."""
    pairs = pairs_within(cut.positions, cut.radius, sector)
    count = len(cut)
    z = cut.positions[2]
    held = cut.membrane_zone.astype(int) + (z - cut.radius < cut.bottom) + (z + cut.radius > cut.top)
    if sector.boundary == "rigid":
        held = held + (plane_normals(sector) @ cut.positions[:2] < cut.radius).sum(0)
    rattles = np.zeros(count, bool)
    while True:  # a ball held by a rattler alone is one too
        loaded = ~rattles[pairs.first] & ~rattles[pairs.second]
        now = held + np.bincount(pairs.first[loaded], minlength=count) < 2
        if (now == rattles).all():
            break
        rattles = now
    normal = pairs.apart / np.sqrt((pairs.apart**2).sum(0))
    square = (normal**2).mean(axis=1) if pairs.first.size else np.full(3, np.nan)
    return Contacts(
        pairs.first.size / count,
        loaded.sum() / max((~rattles).sum(), 1),
        float(rattles.mean()),
        float(square[2] - (square[0] + square[1]) / 2),
    )


def sample_points(sector: Sector, radius: float, bottom: float, top: float, number: int = 1 << 16) -> np.ndarray:
    """Evenly spread points of a sector of this radius between two heights (a Sobol sequence), (3, number) [L]."""
    from scipy.stats import qmc  # takes long to import

    u = qmc.Sobol(3, scramble=False).random(number).T + 0.5 / number
    rho, theta = radius * np.sqrt(u[0]), sector.angle * u[1]
    return np.stack([rho * np.cos(theta), rho * np.sin(theta), bottom + (top - bottom) * u[2]])


def inside_balls(points: np.ndarray, cut: Specimen, sector: Sector) -> np.ndarray:
    """Which points (3, P) lie in a ball of the sector or in an image of one; (P,) bool."""
    tree = cKDTree(points.T)
    inside = np.zeros(points.shape[1], bool)
    for k in range(sector.images):
        centres = sector.rotate(cut.positions, k)
        for found in tree.query_ball_point(centres.T, cut.radius):
            inside[found] = True
    return inside


class Profile(NamedTuple):
    """Density and fabric in bins of a distance; (B,) arrays.

    edges: (B + 1,) of the bins [L]. solid_fraction [-]. contacts: number of contacts. radial, circumferential,
    vertical: mean squares of the contact normals' components, which sum to one; NaN where there is no contact [-].
    """

    edges: np.ndarray
    solid_fraction: np.ndarray
    contacts: np.ndarray
    radial: np.ndarray
    circumferential: np.ndarray
    vertical: np.ndarray


def profiles(cut: Specimen, sector: Sector, radius: float, bins: int = 12) -> tuple[Profile, Profile]:
    """Profiles from the axis to `radius`, and from either sector plane to the middle between them (host).

    Middle 80 % of the height. Distances from the planes are along the normal, and go to half the chord at radius/2.
    """
    middle, half = (cut.bottom + cut.top) / 2, 0.4 * cut.height
    points = sample_points(sector, radius, middle - half, middle + half)
    solid = inside_balls(points, cut, sector)
    pairs = pairs_within(cut.positions, cut.radius, sector)
    normal = pairs.apart / np.sqrt((pairs.apart**2).sum(0))
    place = cut.positions[:, pairs.first] - normal * (cut.radius[pairs.first] - pairs.overlap / 2)
    kept = np.abs(place[2] - middle) < half
    place, normal = place[:, kept], normal[:, kept]
    rho = np.hypot(place[0], place[1])
    cos, sin = place[:2] / np.where(rho > 0, rho, 1.0)
    square = np.stack([cos * normal[0] + sin * normal[1], cos * normal[1] - sin * normal[0], normal[2]]) ** 2

    def binned(of_points, of_contacts, edges):
        number = np.histogram(of_points, edges)[0]
        share = np.histogram(of_points, edges, weights=solid.astype(float))[0] / np.where(number > 0, number, np.nan)
        contacts = np.histogram(of_contacts, edges)[0] / 2  # each appears from either side
        sums = [np.histogram(of_contacts, edges, weights=row)[0] / 2 for row in square]
        return Profile(edges, share, contacts, *(row / np.where(contacts > 0, contacts, np.nan) for row in sums))

    def from_plane(p):
        r, theta = np.hypot(p[0], p[1]), np.mod(sector.angle_of(p), sector.angle)
        near = np.minimum(theta, sector.angle - theta)
        return r * np.sin(np.minimum(near, np.pi / 2))

    across = radius / 2 * np.sin(min(sector.angle / 2, np.pi / 2))
    return (
        binned(np.hypot(points[0], points[1]), rho, np.linspace(0, radius, bins + 1)),
        binned(from_plane(points), from_plane(place), np.linspace(0, across, bins + 1)),
    )
