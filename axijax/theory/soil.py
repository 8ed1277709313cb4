"""Stresses, angles and stress-dilatancy as soil mechanics names them, for triaxial tests: compression positive, s1
axial, s3 confining, R = s1/s3, d = -d(volumetric strain)/d(axial strain), D = 1 + d. Angles in [rad].

Expansion is d > 0. Nothing here is of balls; for regular arrays of them see `axijax.theory.arrays`.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from axijax.theory.arguments import require, require_positive


def mean_stress(axial_stress, confining_stress):
    """p = (s1 + 2 s3)/3, in the unit of the two stresses (Roscoe, Schofield & Wroth 1958). Raises nothing."""
    return (axial_stress + 2 * confining_stress) / 3


def deviatoric_stress(axial_stress, confining_stress):
    """q = s1 - s3, in the unit of the two stresses (Roscoe, Schofield & Wroth 1958). Raises nothing."""
    return axial_stress - confining_stress


def friction_angle(stress_ratio):
    """Mobilised friction angle [rad], sin(phi) = (R - 1)/(R + 1): the tangent from the origin to Mohr's circle;
    negative in extension, R < 1. Raises ValueError if stress_ratio is negative."""
    require("stress_ratio", stress_ratio)
    return jnp.arcsin((stress_ratio - 1) / (stress_ratio + 1))


def stress_ratio_of(angle):
    """R [-] at which a friction angle [rad] is mobilised, tan^2(pi/4 + phi/2): the inverse of `friction_angle`. Raises
    ValueError unless -pi/2 <= angle < pi/2."""
    require("angle", angle, low=-float(jnp.pi) / 2, below=float(jnp.pi) / 2)
    return jnp.tan(jnp.pi / 4 + angle / 2) ** 2


def dilatancy_angle(dilatancy_rate):
    """Angle of dilatancy psi [rad] in triaxial compression, sin(psi) = d/(2 + d) (Vermeer & de Borst 1984, Heron 29(3);
    with total strain for plastic). Raises ValueError unless dilatancy_rate > -1, where the section no longer grows."""
    if isinstance(dilatancy_rate, int | float):
        require_positive("dilatancy_rate + 1", dilatancy_rate + 1)
    return jnp.arcsin(dilatancy_rate / (2 + dilatancy_rate))


def rowe_stress_ratio(angle, dilatancy_rate):
    """R [-] = K D of Rowe's stress-dilatancy, K = tan^2(pi/4 + phi/2) (Rowe 1962, triaxial compression); phi between
    that of sliding grains, dense sand before its peak, and that at constant volume. Raises ValueError as
    `stress_ratio_of`."""
    return stress_ratio_of(angle) * (1 + dilatancy_rate)


class Envelope(NamedTuple):
    """A line s tan(phi) + c over Mohr's circles. angle: phi [rad]. cohesion: c, in the unit of the stresses."""

    angle: float
    cohesion: float


def mohr_envelope(axial_stress, confining_stress) -> Envelope:
    """The straight envelope of Mohr's circles, two shapes (n,): least squares of their tops (s1 - s3)/2 over their
    middles (s1 + s3)/2, on a line of slope sin(phi) and intercept c cos(phi). Through the origin where all circles have
    one confining stress, within a thousandth: they do not tell a cohesion. Raises ValueError where no line of a slope
    from 0 to below 1 fits."""
    s1, s3 = np.atleast_1d(np.asarray(axial_stress, float)), np.atleast_1d(np.asarray(confining_stress, float))
    middle, top = (s1 + s3) / 2, (s1 - s3) / 2
    if np.ptp(s3) <= 1e-3 * s3.max():
        slope, intercept = float(middle @ top / (middle @ middle)), 0.0
    else:
        slope, intercept = (float(each) for each in np.polyfit(middle, top, 1))
    if not 0 <= slope < 1:
        raise ValueError(f"the circles' tops rise by {slope:.3g} over their middles: no envelope has such a slope.")
    return Envelope(float(np.arcsin(slope)), float(intercept / np.sqrt(1 - slope**2)))
