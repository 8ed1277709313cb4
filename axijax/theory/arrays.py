"""Regular arrays of equal balls: strength and dilatancy of rigid ones, linear springs before the peak."""

import jax.numpy as jnp

from axijax.theory.arguments import are_numbers, check_signs, look_up, require, require_positive

# Tangent of the angle between the inclined contacts and the vertical.
TAN_ANGLE_FCC = 1.0
TAN_ANGLE_BCC = 2**0.5
TAN_ANGLE_HCP = 0.5**0.5

# (C11, C12, C44) in cube axes, each as the factors (a, b) of (a kn + b ks) / radius.
_ELASTIC_CONSTANTS = {
    "fcc": ((2**-0.5, 2**-0.5), (8**-0.5, -(8**-0.5)), (8**-0.5, 8**-0.5)),
    "bcc": ((3**0.5 / 6, 3**0.5 / 3), (3**0.5 / 6, -(3**0.5) / 6), (3**0.5 / 6, 3**0.5 / 12)),
    "sc": ((0.5, 0.0), (0.0, 0.0), (0.0, 0.25)),
}


# ---- Strength of rigid balls that cannot rotate ----


def fcc_stress_ratio(friction):
    """Axial over confining stress R [-] of FCC at failure, 2(1+f)/(1-f) (Thornton 1979, triaxial compression).
    Raises ValueError unless 0 <= friction < 1, where the array locks."""
    require("friction", friction, below=1)
    return 2 * (1 + friction) / (1 - friction)


def fcc_friction(stress_ratio):
    """Friction [-] at which FCC fails at this axial over confining stress, (R-2)/(R+2) (inverse of Thornton 1979,
    triaxial compression). Raises ValueError unless stress_ratio >= 2."""
    require("stress_ratio", stress_ratio, low=2)
    return (stress_ratio - 2) / (stress_ratio + 2)


def fcc_general_stress(friction, rate_x, rate_y):
    """Principal stresses (x, y, z) [-], shape (3, ...), of FCC failing at the extension rates (2a, 2b, -(a+b)):
    (1 - 2af/C, 1 - 2bf/C, 2 + 2(a+b)f/C), C = sqrt(1.5(a^2+b^2)+ab) (Thornton 1979, general stress state);
    a = rate_x and b = rate_y, in any one unit, are along the horizontal contacts. Raises ValueError unless they are
    not negative (else those contacts close), not both 0, and 0 <= friction < C/(2 max(a, b)), where x or y unloads."""
    check_signs(rate_x=rate_x, rate_y=rate_y)
    if are_numbers(rate_x, rate_y) and rate_x == rate_y == 0:
        raise ValueError("rate_x and rate_y are both 0, but one of them must be greater than 0.")
    slip_rate = (1.5 * (rate_x**2 + rate_y**2) + rate_x * rate_y) ** 0.5
    if are_numbers(rate_x, rate_y):
        require("friction", friction, below=slip_rate / (2 * max(rate_x, rate_y)))
    shed_x, shed_y = 2 * friction * rate_x / slip_rate, 2 * friction * rate_y / slip_rate
    return jnp.stack(jnp.broadcast_arrays(1 - shed_x, 1 - shed_y, 2 + shed_x + shed_y))


def fcc_plane_strain_ratios(friction):
    """(szz/sxx, syy/sxx) [-] of FCC failing with y held: 2(sqrt3 + sqrt2 f) and sqrt3, over sqrt3 - 2 sqrt2 f
    (Thornton 1979, plane strain). Raises ValueError unless 0 <= friction < sqrt(3/8)."""
    require("friction", friction, below=(3 / 8) ** 0.5)
    lateral = 3**0.5 - 8**0.5 * friction
    return 2 * (3**0.5 + 2**0.5 * friction) / lateral, 3**0.5 / lateral


def inclined_contact_stress_ratio(tan_angle, friction):
    """Axial over confining stress R [-] carried by contacts at th from the vertical, t = tan th, horizontal contacts
    open: 2 cot th cot(th - phi) = 2(1+f t)/(t(t-f)) (Thornton 1979; Rowe 1962).
    Raises ValueError unless tan_angle is positive and 0 <= friction < tan_angle."""
    check_signs(tan_angle=tan_angle)
    require("friction", friction, below=tan_angle)
    return 2 * (1 + friction * tan_angle) / (tan_angle * (tan_angle - friction))


def dilatancy(tan_angle):
    """D = 1 - d(volumetric strain)/d(axial strain) [-], 2 cot^2 th, of those contacts; D > 1 is expansion (Rowe
    1962). Raises ValueError unless tan_angle is positive."""
    check_signs(tan_angle=tan_angle)
    return 2 / tan_angle**2


def rowe_stress_dilatancy(contact_elevation, friction):
    """Stress ratio over dilatancy R/D = tan(beta + phi)/tan(beta) [-] of contacts beta [rad] above the horizontal
    (Rowe 1962). Raises ValueError unless friction is not negative and 0 < beta < pi/2 - phi."""
    check_signs(friction=friction, contact_elevation=contact_elevation)
    friction_angle = jnp.arctan(friction)
    if are_numbers(friction):
        require("contact_elevation", contact_elevation, below=float(jnp.pi / 2 - friction_angle))
    return jnp.tan(contact_elevation + friction_angle) / jnp.tan(contact_elevation)


def contact_angle(axial_strain, tan_angle=TAN_ANGLE_FCC):
    """Angle th [rad] from the vertical of rigid balls' contacts, an engineering axial strain after they stood at
    tan_angle: cos th = (1 - eps) cos th0, in FCC (1-eps)/sqrt2 (Thornton 1979).
    Raises ValueError unless 0 <= eps < 1 - 1/(2 cos th0), where th = 60 degrees and balls two layers apart touch."""
    check_signs(tan_angle=tan_angle)
    require("axial_strain", axial_strain, below=1 - 0.5 * (1 + tan_angle**2) ** 0.5)
    return jnp.arccos((1 - axial_strain) / jnp.sqrt(1 + tan_angle**2))


def post_peak_softening_rate(friction, axial_strain=0.0, tan_angle=TAN_ANGLE_FCC):
    """d(ln R)/d(axial strain) [-] (negative) of the stress ratio of inclined contacts along `contact_angle`; FCC at
    its peak: -2 - 2/cos(2 phi) (Thornton 1979). Raises ValueError as those two formulas do."""
    require("friction", friction, below=tan_angle)
    tangent = jnp.tan(contact_angle(axial_strain, tan_angle))
    tangent_rate = (1 + tangent**2) / (tangent * (1 - axial_strain))
    return (friction / (1 + friction * tangent) - 1 / tangent - 1 / (tangent - friction)) * tangent_rate


# ---- Linear springs before the peak ----


def fcc_isotropic_contact_force(confining_stress, radius):
    """Normal force N0 [M L T^-2] at every contact of FCC under the isotropic stress s3, sqrt2 s3 r^2 (equilibrium).
    Raises ValueError unless radius is positive, or if confining_stress is negative."""
    check_signs(confining_stress=confining_stress, radius=radius)
    return 2**0.5 * confining_stress * radius**2


def elastic_constants(lattice, normal_stiffness, tangential_stiffness, radius):
    """(C11, C12, C44) [M L^-1 T^-2] in cube axes of "fcc", "bcc" or "sc", all contacts sticking: (2r)^2/volume times
    the sum over contacts of kn nnnn + ks (nn delta - nnnn), n the contact normal (uniform deformation).
    Raises ValueError for another lattice, unless kn and radius are positive, or if ks is negative."""
    factors = look_up(_ELASTIC_CONSTANTS, lattice)
    check_signs(normal_stiffness=normal_stiffness, radius=radius, tangential_stiffness=tangential_stiffness)
    return tuple((a * normal_stiffness + b * tangential_stiffness) / radius for a, b in factors)


def fcc_youngs_modulus(normal_stiffness, tangential_stiffness, radius):
    """E along the cube axis [M L^-1 T^-2], (sqrt2 kn/r)(1+3 lam)/(3+lam), lam = ks/kn (elastic constants).
    Raises ValueError unless kn and radius are positive, or if ks is negative."""
    check_signs(normal_stiffness=normal_stiffness, radius=radius, tangential_stiffness=tangential_stiffness)
    ratio = tangential_stiffness / normal_stiffness
    return 2**0.5 * normal_stiffness / radius * (1 + 3 * ratio) / (3 + ratio)


def fcc_poissons_ratio(stiffness_ratio):
    """Lateral extension over axial shortening [-] along the cube axis, (1-lam)/(3+lam), lam = ks/kn (elastic
    constants). Raises ValueError if stiffness_ratio is negative."""
    check_signs(stiffness_ratio=stiffness_ratio)
    return (1 - stiffness_ratio) / (3 + stiffness_ratio)


def fcc_first_slip(friction, stiffness_ratio=1.0):
    """(R at the first slip of FCC's inclined contacts, dR/d(axial strain) after it over that before) [-], lam = ks/kn:
    1 + f(1+3 lam)/(2 lam - f(1+lam)) and (1+f)(3+lam)/((3-f)(1+3 lam)); for lam = 1 (1+f)/(1-f) and (1+f)/(3-f)
    (equilibrium of Thornton's array with springs). Raises ValueError unless 0 <= friction < 1 and stiffness_ratio is
    positive and at least friction, below which the horizontal contacts open before any slip."""
    require("friction", friction, below=1)
    require_positive("stiffness_ratio", stiffness_ratio)
    require("stiffness_ratio", stiffness_ratio, low=friction)
    rise = friction * (1 + 3 * stiffness_ratio) / (2 * stiffness_ratio - friction * (1 + stiffness_ratio))
    return 1 + rise, (1 + friction) * (3 + stiffness_ratio) / ((3 - friction) * (1 + 3 * stiffness_ratio))


def fcc_horizontal_opening_strain(friction, confining_stress, normal_stiffness, radius):
    """Axial strain [-] from the isotropic state where FCC's horizontal contacts open and R peaks, for any ks/kn >= f:
    (N0/(r kn)) (3+f)/(2(1-f)) (equilibrium of Thornton's array with springs).
    Raises ValueError unless 0 <= friction < 1 and kn and radius are positive, or if confining_stress is negative."""
    require("friction", friction, below=1)
    check_signs(normal_stiffness=normal_stiffness)
    force = fcc_isotropic_contact_force(confining_stress, radius)
    return force / (radius * normal_stiffness) * (3 + friction) / (2 * (1 - friction))


def stretched_stress_ratio(axial_strain, stiffness_factor, curve_strain, curve_stress_ratio):
    """R [-] at axial_strain once kn and ks are multiplied by c, read off one curve R(eps) (two shapes (n,)), as
    R(eps; c kn) = R(c eps; kn): quasi-static at small strain, stiffness enters as eps kn/s3 (dimensional analysis).
    NaN where c eps leaves the curve. Raises ValueError unless stiffness_factor is positive."""
    check_signs(stiffness_factor=stiffness_factor)
    strain = stiffness_factor * axial_strain
    return jnp.interp(strain, curve_strain, curve_stress_ratio, left=jnp.nan, right=jnp.nan)


def stiffness_sensitivity(curve_strain, curve_stress_ratio):
    """dR/d(log kn) = eps dR/d(eps) [-], shape (n,), at fixed ks/kn, from one curve R(eps) (two shapes (n,)): the
    derivative of `stretched_stress_ratio` at c = 1, by differences of second order. Raises nothing."""
    return curve_strain * jnp.gradient(curve_stress_ratio, curve_strain)
