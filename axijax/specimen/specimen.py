"""Specimens: regular arrays of uniform spheres, whole or cut to a sector.

A specimen is plain NumPy data, made once on the host. Lengths in consistent units [L].
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from axijax.core.sector import Sector, plane_normals
from axijax.core.shown import Card, ball_picture, shown

ZoneRule = Literal["given", "exposure"]


@shown
@dataclass(frozen=True)
class Specimen:
    """Balls between two plates, as made (no overlap needed, none allowed beyond rounding).

    positions: (3, N) ball centres [L], z along the specimen's axis.
    radius: (N,) ball radii [L].
    bottom, top: heights of the two platens' inner faces [L].
    membrane_zone: (N,) bool, the outer balls that carry the membrane.
    name: what it is, for labels.
    zone_rule: "given" for a zone that is kept, or "exposure" for the outer balls found by
        `axijax.mechanics.outer_balls.outer_balls`,
        which are found again as the specimen deforms, and whose mean distance from the axis is Rm.

    Raises ValueError where an array has the wrong shape, is empty or not finite, a radius is not positive, a
    ball's centre is outside the platens, or no ball is in the membrane zone.
    """

    positions: np.ndarray
    radius: np.ndarray
    bottom: float
    top: float
    membrane_zone: np.ndarray
    name: str = "specimen"
    zone_rule: ZoneRule = "given"

    def __post_init__(self) -> None:
        positions = np.array(self.positions, float)  # its own, whatever becomes of the caller's
        if positions.ndim != 2 or positions.shape[0] != 3 or positions.shape[1] == 0:
            raise ValueError(
                f"specimen positions have shape {positions.shape}: must be (3, N) with at least one ball; "
                "an empty specimen cannot be tested."
            )
        count = positions.shape[1]
        radius = np.asarray(self.radius, float)
        if radius.shape not in ((), (count,)):
            raise ValueError(f"specimen radius has shape {radius.shape}: must be one number or ({count},).")
        radius = np.broadcast_to(radius, (count,)).copy()
        zone = np.array(self.membrane_zone, bool)
        if self.zone_rule not in ("given", "exposure"):
            raise ValueError(f"specimen zone_rule = {self.zone_rule!r}: must be 'given' or 'exposure'.")
        if not np.isfinite(positions).all():
            raise ValueError(f"specimen positions hold {np.sum(~np.isfinite(positions))} values that are not finite.")
        if not (np.isfinite(radius).all() and (radius > 0).all()):
            raise ValueError(f"specimen radius holds {radius.min()!r}: every radius must be positive and finite [L].")
        if not (np.isfinite([self.bottom, self.top]).all() and self.bottom < self.top):
            raise ValueError(f"specimen bottom = {self.bottom!r}, top = {self.top!r}: bottom must be below top.")
        if (positions[2] < self.bottom).any() or (positions[2] > self.top).any():
            raise ValueError(
                "specimen: a ball's centre lies outside the platens "
                f"(z from {positions[2].min():g} to {positions[2].max():g}, platens at {self.bottom:g}, {self.top:g})."
            )
        if zone.shape != (count,) or not zone.any():
            raise ValueError(
                f"specimen membrane_zone has shape {zone.shape} and {zone.sum()} balls: it must be (N,) and mark at "
                "least one outer ball, or there is nothing for the membrane to press on."
            )
        for name, value in (("positions", positions), ("radius", radius), ("membrane_zone", zone)):
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return self.positions.shape[1]

    @property
    def height(self) -> float:
        """Distance between the platens [L]."""
        return self.top - self.bottom

    def _card(self) -> Card:
        small, large = float(self.radius.min()), float(self.radius.max())
        rows = {
            "balls": str(len(self)),
            "radius [L]": f"{small:.4g}" if small == large else f"{small:.4g} to {large:.4g}",
            "height [L]": f"{self.height:.4g}",
            "name": self.name,
            "balls that carry the membrane": str(int(self.membrane_zone.sum())),
        }
        picture = ball_picture(self.positions, self.radius, self.bottom, self.top)
        return Card("Specimen", rows, picture, ("name", "balls", "radius [L]", "height [L]"))

    def select(self, which: np.ndarray) -> "Specimen":
        """The balls given by a mask or by indices, the platens as they are."""
        return replace(
            self,
            positions=self.positions[:, which],
            radius=self.radius[which],
            membrane_zone=self.membrane_zone[which],
        )


def cut_to_sector(specimen: Specimen, sector: Sector) -> Specimen:
    """The part of a full cylinder that lies in the sector 0 <= theta < 2*pi/n.

    Periodic planes keep the balls whose centre is inside, plus those on the axis; a centre on a plane counts
    once (theta = 0). Rigid planes keep the balls that lie wholly inside: there is no room for the others. Of a random
    specimen that was made between the planes all are kept.

    Raises ValueError where the specimen is not the same after a turn by 2*pi/n (periodic planes), or nothing is left.
    """
    positions, radius = specimen.positions, specimen.radius
    if sector.boundary == "rigid":
        depth = plane_normals(sector) @ positions[:2]
        if specimen.zone_rule == "exposure" and (depth > -radius).all():
            return specimen  # compacted between these planes, into which its balls press, soft ones deeply
        kept = (depth > radius * (1 - 1e-9)).all(axis=0) & (sector.angle_of(positions) < sector.angle)
        if not kept.any():
            raise ValueError(
                f"sector order = {sector.order} with rigid planes: no ball of '{specimen.name}' lies wholly between "
                "them; use fewer sectors."
            )
        return specimen.select(kept)
    turned = sector.rotate(positions, 1)
    distance, _ = cKDTree(positions.T).query(turned.T)
    if distance.max() > 1e-6 * radius.min():
        raise ValueError(
            f"sector order = {sector.order}: '{specimen.name}' is not the same after a turn by 2*pi/{sector.order} "
            f"(a ball is off by {distance.max():.3g}); an FCC prism with a vertical cube axis takes n = 1, 2 or 4."
        )
    return specimen.select((sector.home_image(positions) == 0) | sector.on_axis(positions, radius))


def fcc_octagon(radius: float = 20.0, layers: int = 25, half_width: int = 9, diagonal: int | None = None) -> Specimen:
    """FCC prism of octagonal section with a vertical cube axis; the defaults are the paper's 1672 balls.

    Layers 0, 2, 4.. fill the odd sites |x|, |y| <= half_width, |x| + |y| <= diagonal (in ball radii), layers
    1, 3, 5.. the even sites |x|, |y| <= half_width - 1, |x| + |y| <= diagonal - 2 (Itasca 2002; Cui &
    O'Sullivan 2005, figure 3). diagonal defaults to the even number just below sqrt(2) * half_width.
    """
    check_positive("radius", radius)
    _whole("layers", layers, 1)
    _whole("half_width", half_width, 3)
    if half_width % 2 == 0:
        raise ValueError(f"half_width = {half_width}: must be odd, so that the large layers end on a ball.")
    if diagonal is None:
        diagonal = 2 * int(np.sqrt(2) * half_width / 2)
    _whole("diagonal", diagonal, half_width + 1)

    def filled(x, y, layer):
        cut = layer % 2
        side = np.maximum(np.abs(x), np.abs(y)) <= half_width - cut
        return side & (np.abs(x) + np.abs(y) <= diagonal - 2 * cut)

    return _fcc(radius, layers, half_width, filled, f"FCC octagon, {layers} layers")


def fcc_cylinder(radius: float = 20.0, layers: int = 25, specimen_radius: float = 200.0) -> Specimen:
    """FCC prism of circular section with a vertical cube axis: every ball within specimen_radius [L]."""
    check_positive("radius", radius)
    check_positive("specimen_radius", specimen_radius)
    _whole("layers", layers, 1)
    limit = specimen_radius / radius - 1.0
    if limit < 2:
        raise ValueError(
            f"specimen_radius = {specimen_radius!r}: must be at least 3 ball radii ({3 * radius:g}), or no ball is "
            "left inside the membrane."
        )

    def filled(x, y, layer):
        return x**2 + y**2 <= limit**2 * (1 + 1e-12)

    return _fcc(radius, layers, int(limit) + 1, filled, f"FCC cylinder, {layers} layers")


def _fcc(radius: float, layers: int, half_width: int, filled, name: str) -> Specimen:
    """[001] layers sqrt(2) radii apart, neighbours just touching, platens touching the end layers.

    filled(x, y, layer) tells which sites, in ball radii, hold a ball. The membrane zone is every ball that
    lacks one of its four neighbours within its own layer.
    """
    parts, zones = [], []
    for layer in range(layers):
        start = 1 - layer % 2  # odd sites in the even layers, even sites in the odd ones
        sites = np.concatenate([np.arange(-start, -half_width - 2, -2)[::-1], np.arange(start or 2, half_width + 2, 2)])
        x, y = (axis.ravel() for axis in np.meshgrid(sites, sites, indexing="ij"))
        x, y = x[filled(x, y, layer)], y[filled(x, y, layer)]
        neighbours = sum(filled(x + dx, y + dy, layer).astype(int) for dx, dy in ((2, 0), (-2, 0), (0, 2), (0, -2)))
        zones.append(neighbours < 4)
        parts.append(np.stack([radius * x, radius * y, np.full(x.shape, radius * (1 + layer * np.sqrt(2)))]))
    return Specimen(
        positions=np.concatenate(parts, axis=1),
        radius=np.array(radius, float),
        bottom=0.0,
        top=float(radius * (2 + (layers - 1) * np.sqrt(2))),
        membrane_zone=np.concatenate(zones),
        name=name,
    )


# Lattices of touching balls in horizontal layers, in ball radii: the two shortest steps within a layer, the shift of
# every second layer, and the distance of the layers.
_LAYERED = {
    "bcc": (((4 / 3**0.5, 0.0), (0.0, 4 / 3**0.5)), (2 / 3**0.5, 2 / 3**0.5), 2 / 3**0.5),
    "hcp": (((2.0, 0.0), (1.0, 3**0.5)), (1.0, 3**-0.5), (8 / 3) ** 0.5),
    "sc": (((2.0, 0.0), (0.0, 2.0)), (0.0, 0.0), 2.0),
}


def lattice_cylinder(lattice: str, radius: float = 20.0, layers: int = 25, specimen_radius: float = 200.0) -> Specimen:
    """Prism of circular section of a "bcc", "hcp" or "sc" lattice: every site whose ball is within specimen_radius [L].

    A cube axis (the c axis in HCP) is vertical and goes through a ball of the lowest layer, so that sectors of order
    1, 2 or 4 fit (1 or 3 in HCP). Neighbours just touch, and so do the platens and the end layers. The membrane zone
    is every ball that lacks one of its nearest sites within its own layer.
    """
    if lattice not in _LAYERED:
        raise ValueError(f"lattice = {lattice!r}: must be one of {', '.join(_LAYERED)}; FCC has `fcc_cylinder`.")
    check_positive("radius", radius)
    check_positive("specimen_radius", specimen_radius)
    _whole("layers", layers, 1)
    steps, shift, spacing = _LAYERED[lattice]
    limit = specimen_radius / radius - 1.0
    if limit < 3:
        raise ValueError(
            f"specimen_radius = {specimen_radius!r}: must be at least 4 ball radii ({4 * radius:g}), or no ball is "
            "left inside the membrane."
        )
    reach = int(limit) + 2
    a, b = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1), indexing="ij")
    sites = np.stack([a.ravel(), b.ravel()])
    near = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)] + [(1, -1), (-1, 1)] * (lattice == "hcp"))

    def inside(sites, layer):
        x, y = np.array(steps).T @ sites.reshape(2, -1) + (layer % 2) * np.array(shift)[:, None]
        return np.stack([x, y]), (x**2 + y**2 <= limit**2 * (1 + 1e-12))

    parts, zones = [], []
    for layer in range(layers):
        place, kept = inside(sites, layer)
        complete = np.all([inside(sites + step[:, None], layer)[1] for step in near], axis=0)
        zones.append(~complete[kept])
        height = np.full(kept.sum(), radius * (1 + layer * spacing))
        parts.append(np.concatenate([radius * place[:, kept], height[None]]))
    return Specimen(
        positions=np.concatenate(parts, axis=1),
        radius=np.array(radius, float),
        bottom=0.0,
        top=float(radius * (2 + (layers - 1) * spacing)),
        membrane_zone=np.concatenate(zones),
        name=f"{lattice.upper()} cylinder, {layers} layers",
    )


def check_positive(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0):
        raise ValueError(f"{name} = {value!r}: must be positive and finite.")


def _whole(name: str, value: int, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"{name} = {value!r}: must be a whole number >= {least}.")
