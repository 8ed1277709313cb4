"""Closed forms that the simulator is held against.

Every function is pure and differentiable with `jax.grad`. Arguments are Python numbers, NumPy or JAX arrays
that broadcast, and each result has the broadcast shape unless its docstring gives another.
Balls are equal solid spheres with linear contact springs, the vertical along a cube axis (c axis in HCP);
"axial" means vertical, "confining" horizontal. Compressive stress, shortening and overlap are positive.
Units: radius [L], mass [M], stiffness (normal kn, tangential ks) [M T^-2], stress [M L^-1 T^-2], gravity
[L T^-2]; friction f = tan(phi), strain, tan_angle = tan(th) and every ratio [-]; others with their function.
A Python number outside a formula's range raises ValueError: "positive" excludes 0, "not negative" allows
it. Arrays and traced values are never checked, so that a formula can stand inside `jit`.

[Thornton 1979] Geotechnique 29, 441-459; [Rowe 1962] Proc. R. Soc. A 269, 500-527; [Luding 2008] Granular
Matter 10, 235-246; [Schwager & Poeschel 2007] Granular Matter 9, 465-469; [Chung & Ooi 2011] Granular Matter
13, 643-656; [O'Sullivan & Bray 2004] Eng. Computations 21, 278-303. No paper: derived as named, and tested.
"""

import jax.numpy as jnp

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

# The two modes of which one is the fastest, (spin, translation), as (a, b) of omega^2 = (a kn + b ks) / mass.
# A lattice's spin mode is the uniform one, (10/3) z; in a pair the shear mode carries the spin along.
_FASTEST_MODES = {
    "fcc": ((0.0, 40.0), (8.0, 8.0)),
    "bcc": ((0.0, 80 / 3), (16 / 3, 32 / 3)),
    "sc": ((0.0, 20.0), (4.0, 8.0)),
    "pair": ((0.0, 7.0), (2.0, 0.0)),
}

# Arguments that must be greater than 0; the others may be 0.
_POSITIVE = {"angular_frequency", "contact_elevation", "contacts_per_ball", "effective_mass", "mass"}
_POSITIVE |= {"effective_modulus", "normal_stiffness", "radius", "reduced_radius", "stiffness", "stiffness_factor"}
_POSITIVE |= {"confining_stress", "density", "tan_angle"}


def _are_numbers(*values):
    return all(isinstance(value, (int, float)) for value in values)


def _require(name, value, low=0.0, below=float("inf")):
    if _are_numbers(value, low, below) and not low <= value < below:
        upper = f" < {below:.6g}" if below < float("inf") else ""
        raise ValueError(f"{name} is {value}, but this formula needs {low:.6g} <= {name}{upper}.")


def _require_positive(name, value):
    if _are_numbers(value) and not value > 0:
        raise ValueError(f"{name} is {value}, but this formula needs {name} > 0.")


def _check_signs(**arguments):
    for name, value in arguments.items():
        (_require_positive if name in _POSITIVE else _require)(name, value)


def _look_up(table, lattice):
    if lattice not in table:
        raise ValueError(f"lattice is {lattice!r}, but it must be one of {', '.join(table)}.")
    return table[lattice]


# ---- Strength of rigid balls that cannot rotate ----


def fcc_stress_ratio(friction):
    """Axial over confining stress R [-] of FCC at failure, 2(1+f)/(1-f) (Thornton 1979, triaxial compression).
    Raises ValueError unless 0 <= friction < 1, where the array locks."""
    _require("friction", friction, below=1)
    return 2 * (1 + friction) / (1 - friction)


def fcc_friction(stress_ratio):
    """Friction [-] at which FCC fails at this axial over confining stress, (R-2)/(R+2) (inverse of Thornton 1979,
    triaxial compression). Raises ValueError unless stress_ratio >= 2."""
    _require("stress_ratio", stress_ratio, low=2)
    return (stress_ratio - 2) / (stress_ratio + 2)


def fcc_general_stress(friction, rate_x, rate_y):
    """Principal stresses (x, y, z) [-], shape (3, ...), of FCC failing at the extension rates (2a, 2b, -(a+b)):
    (1 - 2af/C, 1 - 2bf/C, 2 + 2(a+b)f/C), C = sqrt(1.5(a^2+b^2)+ab) (Thornton 1979, general stress state);
    a = rate_x and b = rate_y, in any one unit, are along the horizontal contacts. Raises ValueError unless they are
    not negative (else those contacts close), not both 0, and 0 <= friction < C/(2 max(a, b)), where x or y unloads."""
    _check_signs(rate_x=rate_x, rate_y=rate_y)
    if _are_numbers(rate_x, rate_y) and rate_x == rate_y == 0:
        raise ValueError("rate_x and rate_y are both 0, but one of them must be greater than 0.")
    slip_rate = (1.5 * (rate_x**2 + rate_y**2) + rate_x * rate_y) ** 0.5
    if _are_numbers(rate_x, rate_y):
        _require("friction", friction, below=slip_rate / (2 * max(rate_x, rate_y)))
    shed_x, shed_y = 2 * friction * rate_x / slip_rate, 2 * friction * rate_y / slip_rate
    return jnp.stack(jnp.broadcast_arrays(1 - shed_x, 1 - shed_y, 2 + shed_x + shed_y))


def fcc_plane_strain_ratios(friction):
    """(szz/sxx, syy/sxx) [-] of FCC failing with y held: 2(sqrt3 + sqrt2 f) and sqrt3, over sqrt3 - 2 sqrt2 f
    (Thornton 1979, plane strain). Raises ValueError unless 0 <= friction < sqrt(3/8)."""
    _require("friction", friction, below=(3 / 8) ** 0.5)
    lateral = 3**0.5 - 8**0.5 * friction
    return 2 * (3**0.5 + 2**0.5 * friction) / lateral, 3**0.5 / lateral


def inclined_contact_stress_ratio(tan_angle, friction):
    """Axial over confining stress R [-] carried by contacts at th from the vertical, t = tan th, horizontal contacts
    open: 2 cot th cot(th - phi) = 2(1+f t)/(t(t-f)) (Thornton 1979; Rowe 1962).
    Raises ValueError unless tan_angle is positive and 0 <= friction < tan_angle."""
    _check_signs(tan_angle=tan_angle)
    _require("friction", friction, below=tan_angle)
    return 2 * (1 + friction * tan_angle) / (tan_angle * (tan_angle - friction))


def dilatancy(tan_angle):
    """D = 1 - d(volumetric strain)/d(axial strain) [-], 2 cot^2 th, of those contacts; D > 1 is expansion (Rowe
    1962). Raises ValueError unless tan_angle is positive."""
    _check_signs(tan_angle=tan_angle)
    return 2 / tan_angle**2


def rowe_stress_dilatancy(contact_elevation, friction):
    """Stress ratio over dilatancy R/D = tan(beta + phi)/tan(beta) [-] of contacts beta [rad] above the horizontal
    (Rowe 1962). Raises ValueError unless friction is not negative and 0 < beta < pi/2 - phi."""
    _check_signs(friction=friction, contact_elevation=contact_elevation)
    friction_angle = jnp.arctan(friction)
    if _are_numbers(friction):
        _require("contact_elevation", contact_elevation, below=float(jnp.pi / 2 - friction_angle))
    return jnp.tan(contact_elevation + friction_angle) / jnp.tan(contact_elevation)


def contact_angle(axial_strain, tan_angle=TAN_ANGLE_FCC):
    """Angle th [rad] from the vertical of rigid balls' contacts, an engineering axial strain after they stood at
    tan_angle: cos th = (1 - eps) cos th0, in FCC (1-eps)/sqrt2 (Thornton 1979).
    Raises ValueError unless 0 <= eps < 1 - 1/(2 cos th0), where th = 60 degrees and balls two layers apart touch."""
    _check_signs(tan_angle=tan_angle)
    _require("axial_strain", axial_strain, below=1 - 0.5 * (1 + tan_angle**2) ** 0.5)
    return jnp.arccos((1 - axial_strain) / jnp.sqrt(1 + tan_angle**2))


def post_peak_softening_rate(friction, axial_strain=0.0, tan_angle=TAN_ANGLE_FCC):
    """d(ln R)/d(axial strain) [-] (negative) of the stress ratio of inclined contacts along `contact_angle`; FCC at
    its peak: -2 - 2/cos(2 phi) (Thornton 1979). Raises ValueError as those two formulas do."""
    _require("friction", friction, below=tan_angle)
    tangent = jnp.tan(contact_angle(axial_strain, tan_angle))
    tangent_rate = (1 + tangent**2) / (tangent * (1 - axial_strain))
    return (friction / (1 + friction * tangent) - 1 / tangent - 1 / (tangent - friction)) * tangent_rate


# ---- Linear springs before the peak ----


def fcc_isotropic_contact_force(confining_stress, radius):
    """Normal force N0 [M L T^-2] at every contact of FCC under the isotropic stress s3, sqrt2 s3 r^2 (equilibrium).
    Raises ValueError unless radius is positive, or if confining_stress is negative."""
    _check_signs(confining_stress=confining_stress, radius=radius)
    return 2**0.5 * confining_stress * radius**2


def elastic_constants(lattice, normal_stiffness, tangential_stiffness, radius):
    """(C11, C12, C44) [M L^-1 T^-2] in cube axes of "fcc", "bcc" or "sc", all contacts sticking: (2r)^2/volume times
    the sum over contacts of kn nnnn + ks (nn delta - nnnn), n the contact normal (uniform deformation).
    Raises ValueError for another lattice, unless kn and radius are positive, or if ks is negative."""
    factors = _look_up(_ELASTIC_CONSTANTS, lattice)
    _check_signs(normal_stiffness=normal_stiffness, radius=radius, tangential_stiffness=tangential_stiffness)
    return tuple((a * normal_stiffness + b * tangential_stiffness) / radius for a, b in factors)


def fcc_youngs_modulus(normal_stiffness, tangential_stiffness, radius):
    """E along the cube axis [M L^-1 T^-2], (sqrt2 kn/r)(1+3 lam)/(3+lam), lam = ks/kn (elastic constants).
    Raises ValueError unless kn and radius are positive, or if ks is negative."""
    _check_signs(normal_stiffness=normal_stiffness, radius=radius, tangential_stiffness=tangential_stiffness)
    ratio = tangential_stiffness / normal_stiffness
    return 2**0.5 * normal_stiffness / radius * (1 + 3 * ratio) / (3 + ratio)


def fcc_poissons_ratio(stiffness_ratio):
    """Lateral extension over axial shortening [-] along the cube axis, (1-lam)/(3+lam), lam = ks/kn (elastic
    constants). Raises ValueError if stiffness_ratio is negative."""
    _check_signs(stiffness_ratio=stiffness_ratio)
    return (1 - stiffness_ratio) / (3 + stiffness_ratio)


def fcc_first_slip(friction, stiffness_ratio=1.0):
    """(R at the first slip of FCC's inclined contacts, dR/d(axial strain) after it over that before) [-], lam = ks/kn:
    1 + f(1+3 lam)/(2 lam - f(1+lam)) and (1+f)(3+lam)/((3-f)(1+3 lam)); for lam = 1 (1+f)/(1-f) and (1+f)/(3-f)
    (equilibrium of Thornton's array with springs). Raises ValueError unless 0 <= friction < 1 and stiffness_ratio is
    positive and at least friction, below which the horizontal contacts open before any slip."""
    _require("friction", friction, below=1)
    _require_positive("stiffness_ratio", stiffness_ratio)
    _require("stiffness_ratio", stiffness_ratio, low=friction)
    rise = friction * (1 + 3 * stiffness_ratio) / (2 * stiffness_ratio - friction * (1 + stiffness_ratio))
    return 1 + rise, (1 + friction) * (3 + stiffness_ratio) / ((3 - friction) * (1 + 3 * stiffness_ratio))


def fcc_horizontal_opening_strain(friction, confining_stress, normal_stiffness, radius):
    """Axial strain [-] from the isotropic state where FCC's horizontal contacts open and R peaks, for any ks/kn >= f:
    (N0/(r kn)) (3+f)/(2(1-f)) (equilibrium of Thornton's array with springs).
    Raises ValueError unless 0 <= friction < 1 and kn and radius are positive, or if confining_stress is negative."""
    _require("friction", friction, below=1)
    _check_signs(normal_stiffness=normal_stiffness)
    force = fcc_isotropic_contact_force(confining_stress, radius)
    return force / (radius * normal_stiffness) * (3 + friction) / (2 * (1 - friction))


def stretched_stress_ratio(axial_strain, stiffness_factor, curve_strain, curve_stress_ratio):
    """R [-] at axial_strain once kn and ks are multiplied by c, read off one curve R(eps) (two shapes (n,)), as
    R(eps; c kn) = R(c eps; kn): quasi-static at small strain, stiffness enters as eps kn/s3 (dimensional analysis).
    NaN where c eps leaves the curve. Raises ValueError unless stiffness_factor is positive."""
    _check_signs(stiffness_factor=stiffness_factor)
    strain = stiffness_factor * axial_strain
    return jnp.interp(strain, curve_strain, curve_stress_ratio, left=jnp.nan, right=jnp.nan)


def stiffness_sensitivity(curve_strain, curve_stress_ratio):
    """dR/d(log kn) = eps dR/d(eps) [-], shape (n,), at fixed ks/kn, from one curve R(eps) (two shapes (n,)): the
    derivative of `stretched_stress_ratio` at c = 1, by differences of second order. Raises nothing."""
    return curve_strain * jnp.gradient(curve_stress_ratio, curve_strain)


# ---- One contact ----


def impact_duration(effective_mass, normal_stiffness):
    """Time in contact [T] without damping, pi sqrt(m*/kn), m* = m1 m2/(m1+m2) [M] (half an oscillation).
    Raises ValueError unless both are positive."""
    _check_signs(effective_mass=effective_mass, normal_stiffness=normal_stiffness)
    return jnp.pi * jnp.sqrt(effective_mass / normal_stiffness)


def impact_maximum_overlap(normal_speed, effective_mass, normal_stiffness):
    """Largest overlap [L] without damping, v sqrt(m*/kn), v the approach speed [L T^-1] (energy balance).
    Raises ValueError unless m* and kn are positive, or if v is negative."""
    _check_signs(normal_speed=normal_speed, effective_mass=effective_mass, normal_stiffness=normal_stiffness)
    return normal_speed * jnp.sqrt(effective_mass / normal_stiffness)


def hertz_impact_maximum_overlap(normal_speed, effective_mass, reduced_radius, effective_modulus):
    """Largest overlap [L] of a Hertzian impact without damping, (15 m* v^2 / (16 sqrt(R*) E*))^(2/5), where
    R* = r1 r2/(r1+r2) [L] and E* = G/(1-nu) for balls of one material [M L^-1 T^-2] (energy balance; Johnson 1985).
    Raises ValueError unless m*, R* and E* are positive, or if v is negative."""
    _check_signs(normal_speed=normal_speed, effective_mass=effective_mass)
    _check_signs(reduced_radius=reduced_radius, effective_modulus=effective_modulus)
    return (15 * effective_mass * normal_speed**2 / (16 * reduced_radius**0.5 * effective_modulus)) ** 0.4


def hertz_impact_duration(normal_speed, effective_mass, reduced_radius, effective_modulus):
    """Time in contact [T] of that impact, 2 sqrt(pi) Gamma(7/5)/Gamma(9/10) = 2.9432 times the largest overlap over the
    speed, which is 2.8683 (m*^2 / (R* E*^2 v))^(1/5). Raises ValueError as `hertz_impact_maximum_overlap`."""
    overlap = hertz_impact_maximum_overlap(normal_speed, effective_mass, reduced_radius, effective_modulus)
    return 2.9432751843247043 * overlap / normal_speed


def local_damping_restitution(local_damping):
    """Rebound over approach speed [-], sqrt((1-a)/(1+a)), of an impact along a coordinate axis whose force is damped
    by -a|F| sign(v) (energy balance). Raises ValueError unless 0 <= local_damping < 1."""
    _require("local_damping", local_damping, below=1)
    return jnp.sqrt((1 - local_damping) / (1 + local_damping))


def _dashpot_phase(damping_ratio):
    """arccos(x)/sqrt(1-x^2), which continues smoothly past x = 1 as arccosh(x)/sqrt(x^2-1)."""
    h = 1 - jnp.asarray(damping_ratio)
    # Each branch gets an argument from its own domain everywhere: an unused NaN would still spoil the gradient.
    under, over = jnp.where(h > 0.01, 1 - h, 0.0), jnp.where(h < -0.01, 1 - h, 2.0)
    near = 1.0
    for order in (6, 5, 4, 3, 2, 1):
        near = 1 + near * h * order / (2 * order + 1)
    phase = jnp.where(h > 0.01, jnp.arccos(under) / jnp.sqrt(1 - under**2), near)
    return jnp.where(h < -0.01, jnp.arccosh(over) / jnp.sqrt(over**2 - 1), phase)


def dashpot_restitution(damping_ratio):
    """Rebound over approach speed [-] of a spring and dashpot c = 2 xi sqrt(kn m*) that part when their force falls
    to zero, so that they never pull: exp(-2 xi arccos(xi)/sqrt(1-xi^2)), xi >= 1 too (Schwager & Poeschel 2007).
    Raises ValueError if damping_ratio xi is negative."""
    _check_signs(damping_ratio=damping_ratio)
    return jnp.exp(-2 * damping_ratio * _dashpot_phase(damping_ratio))


def dashpot_duration(damping_ratio, effective_mass, normal_stiffness):
    """Time in contact [T] of that impact, 2 sqrt(m*/kn) arccos(xi)/sqrt(1-xi^2) (Schwager & Poeschel 2007).
    Raises ValueError unless m* [M] and kn are positive, or if damping_ratio is negative."""
    _check_signs(damping_ratio=damping_ratio, effective_mass=effective_mass, normal_stiffness=normal_stiffness)
    return 2 * jnp.sqrt(effective_mass / normal_stiffness) * _dashpot_phase(damping_ratio)


def sticking_velocity_ratio(stiffness_ratio):
    """Tangential surface velocity after an undamped impact without slip over that before [-]: -1 at ks/kn = 2/7,
    cos(pi sqrt(3.5 ks/kn)) (Luding 2008). Raises ValueError if stiffness_ratio is negative."""
    _check_signs(stiffness_ratio=stiffness_ratio)
    return jnp.cos(jnp.pi * jnp.sqrt(3.5 * stiffness_ratio))


def gross_sliding_impact(friction, restitution, normal_speed, radius):
    """(tangential speed lost [L T^-1], spin gained [rad T^-1], least surface speed for it [L T^-1]) of a ball that
    slides throughout its impact on a fixed plate at the normal speed v [L T^-1]: f(1+e)v, 5f(1+e)v/(2r) and
    3.5f(1+e)v (Chung & Ooi 2011, tests 4 and 5); for two equal balls v is half the relative speed.
    Raises ValueError unless radius is positive, or if f, e or v is negative."""
    _check_signs(friction=friction, restitution=restitution, normal_speed=normal_speed, radius=radius)
    lost = friction * (1 + restitution) * normal_speed
    return lost, 2.5 * lost / radius, 3.5 * lost


def incline_accelerations(angle, friction, gravity, radius):
    """(acceleration down the slope [L T^-2], angular acceleration [rad T^-2]) of a solid ball let go on a plane at
    the angle b [rad]: rolling if tan b <= 3.5 f, 5/7 g sin b and that over r; else sliding, g(sin b - f cos b)
    and 5 f g cos b/(2r) (equations of motion).
    Raises ValueError unless 0 <= angle < pi/2 and radius is positive, or if friction or gravity is negative."""
    _require("angle", angle, below=jnp.pi / 2)
    _check_signs(friction=friction, gravity=gravity, radius=radius)
    # Friction per weight: what the ball needs to roll, or the Coulomb limit where that is less.
    share = jnp.minimum(2 / 7 * jnp.sin(angle), friction * jnp.cos(angle))
    return gravity * (jnp.sin(angle) - share), 2.5 * gravity * share / radius


def slide_to_roll(initial_speed, friction, gravity):
    """(time [T], speed [L T^-1], distance [L]) at which a solid ball sent off at v0 [L T^-1], sliding without spin,
    begins to roll: 2 v0/(7 f g), 5/7 v0, 12 v0^2/(49 f g); infinite without friction (momentum balance).
    Raises ValueError if initial_speed, friction or gravity is negative."""
    _check_signs(initial_speed=initial_speed, friction=friction, gravity=gravity)
    decay = jnp.asarray(friction * gravity)
    return 2 * initial_speed / (7 * decay), 5 / 7 * initial_speed, 12 * initial_speed**2 / (49 * decay)


# ---- Waves and the critical time step ----


def chain_frequency(wavenumber, mass, normal_stiffness, radius):
    """Angular frequency [rad T^-1] of the longitudinal wave q [rad L^-1] on a row of touching balls,
    2 sqrt(kn/m)|sin(q r)| (lattice dynamics). Raises ValueError unless mass, kn and radius are positive."""
    _check_signs(mass=mass, normal_stiffness=normal_stiffness, radius=radius)
    return 2 * jnp.sqrt(normal_stiffness / mass) * jnp.abs(jnp.sin(wavenumber * radius))


def fcc_p_wave_speed(mass, normal_stiffness, tangential_stiffness, radius):
    """Speed [L T^-1] of FCC's long compression waves along the cube axis: 2 r sqrt((kn+ks)/m) (lattice dynamics).
    Raises ValueError unless mass, kn and radius are positive, or if ks is negative."""
    _check_signs(mass=mass, normal_stiffness=normal_stiffness, radius=radius, tangential_stiffness=tangential_stiffness)
    return 2 * radius * jnp.sqrt((normal_stiffness + tangential_stiffness) / mass)


def fcc_p_wave_frequency(wavenumber, mass, normal_stiffness, tangential_stiffness, radius):
    """Angular frequency [rad T^-1] of such a wave q [rad L^-1] of any length: 2 sqrt(2(kn+ks)/m)|sin(q r/sqrt2)|
    (lattice dynamics). Raises ValueError as `fcc_p_wave_speed`."""
    half_spacing = radius / 2**0.5
    speed = fcc_p_wave_speed(mass, normal_stiffness, tangential_stiffness, radius)
    return speed / half_spacing * jnp.abs(jnp.sin(wavenumber * half_spacing))


def uniform_spin_frequency(contacts_per_ball, mass, tangential_stiffness):
    """Angular frequency [rad T^-1] at which all balls of a cubic or HCP lattice spin to and fro together, centres at
    rest, sqrt((10/3) z ks/m), z contacts per ball (lattice dynamics).
    Raises ValueError unless z and mass are positive, or if ks is negative."""
    _check_signs(contacts_per_ball=contacts_per_ball, mass=mass, tangential_stiffness=tangential_stiffness)
    return jnp.sqrt(10 / 3 * contacts_per_ball * tangential_stiffness / mass)


def fcc_translation_frequency(mass, normal_stiffness, tangential_stiffness):
    """Angular frequency [rad T^-1] of FCC's horizontal layers moving up and down in antiphase, sqrt(8(kn+ks)/m): the
    fastest mode without spin while ks <= kn (lattice dynamics).
    Raises ValueError unless mass and kn are positive, or if ks is negative."""
    _check_signs(mass=mass, normal_stiffness=normal_stiffness, tangential_stiffness=tangential_stiffness)
    return jnp.sqrt(8 * (normal_stiffness + tangential_stiffness) / mass)


def modal_damping_ratio(angular_frequency, damping_ratio, mass, stiffness):
    """Damping ratio xi = (c/k) omega/2 [-] of a mode omega [rad T^-1] whose contacts all have springs k and dashpots
    c = 2 beta sqrt(k m/2), beta = damping_ratio (stiffness-proportional damping).
    Raises ValueError unless omega, mass and stiffness are positive, or if beta is negative."""
    _check_signs(angular_frequency=angular_frequency, damping_ratio=damping_ratio, mass=mass, stiffness=stiffness)
    return damping_ratio * angular_frequency * jnp.sqrt(mass / (2 * stiffness))


def _largest_stable_step(squared_frequency, damping_rate):
    # Root of omega^2 dt^2 + 2 (2 xi omega) dt = 4 in the form that is infinite for a mode without stiffness.
    return 4 / (damping_rate + jnp.sqrt(damping_rate**2 + 4 * squared_frequency))


def critical_time_step(angular_frequency, damping_ratio=0.0):
    """Largest stable step [T] of central differences for a mode omega [rad T^-1] (O'Sullivan & Bray 2004) of damping
    ratio xi, dashpots taken at the last half step: (2/omega)(sqrt(1+xi^2) - xi) (stability polynomial).
    Raises ValueError unless omega is positive, or if xi is negative."""
    _check_signs(angular_frequency=angular_frequency, damping_ratio=damping_ratio)
    return _largest_stable_step(angular_frequency**2, 2 * damping_ratio * angular_frequency)


def lattice_critical_time_step(lattice, mass, normal_stiffness, tangential_stiffness, damping_ratio=0.0, rotation=True):
    """Largest stable step [T] over all modes of "fcc", "bcc", "sc" or a "pair", all contacts sticking, dashpots as in
    `modal_damping_ratio`; `rotation=False` leaves out spins (O'Sullivan & Bray 2004; lattice dynamics).
    Raises ValueError for another lattice, unless mass and kn are positive, if ks or damping_ratio is negative, or
    without rotation if ks > kn, where yet another mode is the fastest."""
    spin, translation = _look_up(_FASTEST_MODES, lattice)
    _check_signs(mass=mass, normal_stiffness=normal_stiffness)
    _check_signs(tangential_stiffness=tangential_stiffness, damping_ratio=damping_ratio)
    if not rotation:
        _require("normal_stiffness", normal_stiffness, low=tangential_stiffness)

    def step(a, b):
        # Springs and dashpots load these modes in the same proportions (a, b), so damping keeps their shape.
        squared_frequency = (a * normal_stiffness + b * tangential_stiffness) / mass
        weighted_roots = a * jnp.sqrt(normal_stiffness) + b * jnp.sqrt(tangential_stiffness)
        return _largest_stable_step(squared_frequency, damping_ratio * weighted_roots * jnp.sqrt(2 / mass))

    return jnp.minimum(step(*spin), step(*translation)) if rotation else step(*translation)


def inertial_number(strain_rate, radius, density, confining_stress):
    """Inertial number of a shear [-], rate 2 r sqrt(density / s3): quasi-static below about 1e-3 (GDR MiDi 2004).
    strain_rate, axial [1/T]; density of the balls [M L^-3].
    Raises ValueError unless radius, density and confining_stress are positive, or if strain_rate is negative."""
    _check_signs(strain_rate=strain_rate, radius=radius, density=density, confining_stress=confining_stress)
    return 2 * strain_rate * radius * jnp.sqrt(density / confining_stress)
