"""Curves made comparable: the mean logarithm of R and the mean volumetric strain over some twenty windows of strain.

A curve of a random packing scatters from record to record, and what single records say is not known better than that.
Simulated curves are read at the strains that were measured and then averaged like the data, so that what averaging
does to a curve is in both. The logarithm, because the scatter of R grows with R.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calibrate.measured import MeasuredCurve

WINDOWS = 22
LABORATORY_RATIO, LABORATORY_VOLUME = 0.025, 0.02
LEAST_NOISE = 1e-3  # relative, of R, and this share of the range of the volumetric strain: what is never known better


@dataclass(frozen=True)
class Nodes:
    """Windows of strain for one measured curve of M points; S windows, D = S or 2 S numbers.

    strain: (S,) their mean strains [-]. averages: (S, M) of the measured points. measured: the M strains.
    values: (D,) the data, log R and behind it the volumetric strain. noise: (D, D) covariance of their measurement.
    """

    strain: np.ndarray
    averages: np.ndarray
    measured: np.ndarray
    values: np.ndarray
    noise: np.ndarray

    @property
    def with_volume(self) -> bool:
        return self.values.size > self.strain.size

    @property
    def reach(self) -> float:
        """Strain that a run must reach [-]."""
        return float(self.measured[-1])

    def of(self, curve: Any) -> np.ndarray:
        """(D,) numbers of a simulated curve, NaN where it ends before the data."""
        strain = np.asarray(curve.axial_strain, float)
        read = {"left": None, "right": np.nan}
        ratio = self.averages @ np.interp(self.measured, strain, np.asarray(curve.stress_ratio, float), **read)
        with np.errstate(invalid="ignore", divide="ignore"):
            found = [np.log(ratio)]
        if self.with_volume:
            volume = np.asarray(curve.volumetric_strain, float)
            found.append(self.averages @ np.interp(self.measured, strain, volume, **read))
        return np.concatenate(found)

    def split(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Stress ratios and volumetric strains of (.., D) numbers."""
        count = self.strain.size
        return np.exp(values[..., :count]), (values[..., count:] if self.with_volume else None)


def nodes_of(curve: MeasuredCurve, windows: int = WINDOWS) -> Nodes:
    """Windows for a measured curve, narrow where it begins and wide at its end.

    The uncertainties of the points are the curve's where it says that they are real (`sigma_known`), and else what its
    points scatter from one to the next.
    """
    strain = curve.axial_strain
    averages = _averages(strain, min(windows, strain.size))
    ratio = averages @ curve.stress_ratio
    sigma = _sigma(curve.stress_ratio, curve.ratio_sigma, curve.sigma_known)
    noise = [_spread(averages, sigma) / np.outer(ratio, ratio) + LEAST_NOISE**2 * np.eye(ratio.size)]
    values = [np.log(ratio)]
    if curve.volumetric_strain is not None:
        values.append(averages @ curve.volumetric_strain)
        sigma = _sigma(curve.volumetric_strain, curve.volume_sigma, curve.sigma_known)
        floor = max(LEAST_NOISE * float(np.ptp(curve.volumetric_strain)), 1e-6)
        noise.append(_spread(averages, sigma) + floor**2 * np.eye(ratio.size))
    size = ratio.size
    covariance = np.zeros((len(noise) * size,) * 2)
    for k, block in enumerate(noise):
        covariance[k * size : (k + 1) * size, k * size : (k + 1) * size] = block
    return Nodes(averages @ strain, averages, strain, np.concatenate(values), covariance)


def of_a_laboratory(nodes: Nodes) -> Nodes:
    """The same with the scatter of a laboratory's tests among themselves in its noise: 2.5 % of ln R, and 0.02 of the
    axial strain, which is 0.04 in the dilatancy along half of the curve (PHYSICS 7); of a slow change along the curve,
    so that neighbouring windows differ alike."""
    apart = np.abs(np.log(nodes.strain[:, None] / nodes.strain))
    size = nodes.strain.size
    alike = np.exp(-apart)
    added = np.zeros_like(nodes.noise)
    ratio = np.maximum(np.abs(nodes.values[:size]), 0.1)
    added[:size, :size] = LABORATORY_RATIO**2 * alike * np.outer(ratio, ratio)
    if nodes.with_volume:
        added[size:, size:] = LABORATORY_VOLUME**2 * alike * np.outer(nodes.strain, nodes.strain)
    return replace(nodes, noise=nodes.noise + added)


def _averages(strain: np.ndarray, count: int) -> np.ndarray:
    """(S, M) means over windows of the curve that joins M points by lines."""
    first, last = float(strain[0]), float(strain[-1])
    edges = first + (last - first) * np.linspace(0.0, 1.0, count + 1) ** 2
    shares = (np.arange(16) + 0.5) / 16
    at = edges[:-1, None] + np.diff(edges)[:, None] * shares
    place = np.clip(np.searchsorted(strain, at, side="right") - 1, 0, strain.size - 2)
    weight = (at - strain[place]) / np.diff(strain)[place]
    found = np.zeros((count, strain.size))
    rows = np.repeat(np.arange(count), shares.size)
    np.add.at(found, (rows, place.ravel()), (1 - weight).ravel() / shares.size)
    np.add.at(found, (rows, place.ravel() + 1), weight.ravel() / shares.size)
    return found


def _sigma(values: np.ndarray, given: Any, known: bool) -> np.ndarray:
    """(M,) standard uncertainty of the points."""
    if known or values.size < 8:
        return np.broadcast_to(np.asarray(given, float), values.shape)
    # Of values with independent scatter s the second differences have sqrt(6) s, and 1.65 s as median size. Where the
    # data were thinned out, so that the curve itself bends between points, this is too large, which is the safe side.
    return np.full(values.shape, float(np.median(np.abs(np.diff(values, 2)))) / 1.65)


def _spread(averages: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    return (averages * sigma**2) @ averages.T
