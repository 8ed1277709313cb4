"""Waves in regular arrays, their modes, the critical time step, and how quasi-static a shear is."""

import jax.numpy as jnp

from axijax.theory.arguments import check_signs, look_up, require

# The two modes of which one is the fastest, (spin, translation), as (a, b) of omega^2 = (a kn + b ks) / mass.
# A lattice's spin mode is the uniform one, (10/3) z; in a pair the shear mode carries the spin along.
_FASTEST_MODES = {
    "fcc": ((0.0, 40.0), (8.0, 8.0)),
    "bcc": ((0.0, 80 / 3), (16 / 3, 32 / 3)),
    "sc": ((0.0, 20.0), (4.0, 8.0)),
    "pair": ((0.0, 7.0), (2.0, 0.0)),
}


def chain_frequency(wavenumber, mass, normal_stiffness, radius):
    """Angular frequency [rad T^-1] of the longitudinal wave q [rad L^-1] on a row of touching balls,
    2 sqrt(kn/m)|sin(q r)| (lattice dynamics). Raises ValueError unless mass, kn and radius are positive."""
    check_signs(mass=mass, normal_stiffness=normal_stiffness, radius=radius)
    return 2 * jnp.sqrt(normal_stiffness / mass) * jnp.abs(jnp.sin(wavenumber * radius))


def fcc_p_wave_speed(mass, normal_stiffness, tangential_stiffness, radius):
    """Speed [L T^-1] of FCC's long compression waves along the cube axis: 2 r sqrt((kn+ks)/m) (lattice dynamics).
    Raises ValueError unless mass, kn and radius are positive, or if ks is negative."""
    check_signs(mass=mass, normal_stiffness=normal_stiffness, radius=radius, tangential_stiffness=tangential_stiffness)
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
    check_signs(contacts_per_ball=contacts_per_ball, mass=mass, tangential_stiffness=tangential_stiffness)
    return jnp.sqrt(10 / 3 * contacts_per_ball * tangential_stiffness / mass)


def fcc_translation_frequency(mass, normal_stiffness, tangential_stiffness):
    """Angular frequency [rad T^-1] of FCC's horizontal layers moving up and down in antiphase, sqrt(8(kn+ks)/m): the
    fastest mode without spin while ks <= kn (lattice dynamics).
    Raises ValueError unless mass and kn are positive, or if ks is negative."""
    check_signs(mass=mass, normal_stiffness=normal_stiffness, tangential_stiffness=tangential_stiffness)
    return jnp.sqrt(8 * (normal_stiffness + tangential_stiffness) / mass)


def modal_damping_ratio(angular_frequency, damping_ratio, mass, stiffness):
    """Damping ratio xi = (c/k) omega/2 [-] of a mode omega [rad T^-1] whose contacts all have springs k and dashpots
    c = 2 beta sqrt(k m/2), beta = damping_ratio (stiffness-proportional damping).
    Raises ValueError unless omega, mass and stiffness are positive, or if beta is negative."""
    check_signs(angular_frequency=angular_frequency, damping_ratio=damping_ratio, mass=mass, stiffness=stiffness)
    return damping_ratio * angular_frequency * jnp.sqrt(mass / (2 * stiffness))


def _largest_stable_step(squared_frequency, damping_rate):
    # Root of omega^2 dt^2 + 2 (2 xi omega) dt = 4 in the form that is infinite for a mode without stiffness.
    return 4 / (damping_rate + jnp.sqrt(damping_rate**2 + 4 * squared_frequency))


def critical_time_step(angular_frequency, damping_ratio=0.0):
    """Largest stable step [T] of central differences for a mode omega [rad T^-1] (O'Sullivan & Bray 2004) of damping
    ratio xi, dashpots taken at the last half step: (2/omega)(sqrt(1+xi^2) - xi) (stability polynomial).
    Raises ValueError unless omega is positive, or if xi is negative."""
    check_signs(angular_frequency=angular_frequency, damping_ratio=damping_ratio)
    return _largest_stable_step(angular_frequency**2, 2 * damping_ratio * angular_frequency)


def lattice_critical_time_step(lattice, mass, normal_stiffness, tangential_stiffness, damping_ratio=0.0, rotation=True):
    """Largest stable step [T] over all modes of "fcc", "bcc", "sc" or a "pair", all contacts sticking, dashpots as in
    `modal_damping_ratio`; `rotation=False` leaves out spins (O'Sullivan & Bray 2004; lattice dynamics).
    Raises ValueError for another lattice, unless mass and kn are positive, if ks or damping_ratio is negative, or
    without rotation if ks > kn, where yet another mode is the fastest."""
    spin, translation = look_up(_FASTEST_MODES, lattice)
    check_signs(mass=mass, normal_stiffness=normal_stiffness)
    check_signs(tangential_stiffness=tangential_stiffness, damping_ratio=damping_ratio)
    if not rotation:
        require("normal_stiffness", normal_stiffness, low=tangential_stiffness)

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
    check_signs(strain_rate=strain_rate, radius=radius, density=density, confining_stress=confining_stress)
    return 2 * strain_rate * radius * jnp.sqrt(density / confining_stress)
