"""One contact: impacts with and without damping, a ball that slides and rolls on a plane."""

import jax.numpy as jnp

from axijax.theory.arguments import check_signs, require


def impact_duration(effective_mass, normal_stiffness):
    """Time in contact [T] without damping, pi sqrt(m*/kn), m* = m1 m2/(m1+m2) [M] (half an oscillation).
    Raises ValueError unless both are positive."""
    check_signs(effective_mass=effective_mass, normal_stiffness=normal_stiffness)
    return jnp.pi * jnp.sqrt(effective_mass / normal_stiffness)


def impact_maximum_overlap(normal_speed, effective_mass, normal_stiffness):
    """Largest overlap [L] without damping, v sqrt(m*/kn), v the approach speed [L T^-1] (energy balance).
    Raises ValueError unless m* and kn are positive, or if v is negative."""
    check_signs(normal_speed=normal_speed, effective_mass=effective_mass, normal_stiffness=normal_stiffness)
    return normal_speed * jnp.sqrt(effective_mass / normal_stiffness)


def hertz_impact_maximum_overlap(normal_speed, effective_mass, reduced_radius, effective_modulus):
    """Largest overlap [L] of a Hertzian impact without damping, (15 m* v^2 / (16 sqrt(R*) E*))^(2/5), where
    R* = r1 r2/(r1+r2) [L] and E* = G/(1-nu) for balls of one material [M L^-1 T^-2] (energy balance; Johnson 1985).
    Raises ValueError unless m*, R* and E* are positive, or if v is negative."""
    check_signs(normal_speed=normal_speed, effective_mass=effective_mass)
    check_signs(reduced_radius=reduced_radius, effective_modulus=effective_modulus)
    return (15 * effective_mass * normal_speed**2 / (16 * reduced_radius**0.5 * effective_modulus)) ** 0.4


def hertz_impact_duration(normal_speed, effective_mass, reduced_radius, effective_modulus):
    """Time in contact [T] of that impact, 2 sqrt(pi) Gamma(7/5)/Gamma(9/10) = 2.9432 times the largest overlap over the
    speed, which is 2.8683 (m*^2 / (R* E*^2 v))^(1/5). Raises ValueError as `hertz_impact_maximum_overlap`."""
    overlap = hertz_impact_maximum_overlap(normal_speed, effective_mass, reduced_radius, effective_modulus)
    return 2.9432751843247043 * overlap / normal_speed


def local_damping_restitution(local_damping):
    """Rebound over approach speed [-], sqrt((1-a)/(1+a)), of an impact along a coordinate axis whose force is damped
    by -a|F| sign(v) (energy balance). Raises ValueError unless 0 <= local_damping < 1."""
    require("local_damping", local_damping, below=1)
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
    check_signs(damping_ratio=damping_ratio)
    return jnp.exp(-2 * damping_ratio * _dashpot_phase(damping_ratio))


def dashpot_duration(damping_ratio, effective_mass, normal_stiffness):
    """Time in contact [T] of that impact, 2 sqrt(m*/kn) arccos(xi)/sqrt(1-xi^2) (Schwager & Poeschel 2007).
    Raises ValueError unless m* [M] and kn are positive, or if damping_ratio is negative."""
    check_signs(damping_ratio=damping_ratio, effective_mass=effective_mass, normal_stiffness=normal_stiffness)
    return 2 * jnp.sqrt(effective_mass / normal_stiffness) * _dashpot_phase(damping_ratio)


def sticking_velocity_ratio(stiffness_ratio):
    """Tangential surface velocity after an undamped impact without slip over that before [-]: -1 at ks/kn = 2/7,
    cos(pi sqrt(3.5 ks/kn)) (Luding 2008). Raises ValueError if stiffness_ratio is negative."""
    check_signs(stiffness_ratio=stiffness_ratio)
    return jnp.cos(jnp.pi * jnp.sqrt(3.5 * stiffness_ratio))


def gross_sliding_impact(friction, restitution, normal_speed, radius):
    """(tangential speed lost [L T^-1], spin gained [rad T^-1], least surface speed for it [L T^-1]) of a ball that
    slides throughout its impact on a fixed plate at the normal speed v [L T^-1]: f(1+e)v, 5f(1+e)v/(2r) and
    3.5f(1+e)v (Chung & Ooi 2011, tests 4 and 5); for two equal balls v is half the relative speed.
    Raises ValueError unless radius is positive, or if f, e or v is negative."""
    check_signs(friction=friction, restitution=restitution, normal_speed=normal_speed, radius=radius)
    lost = friction * (1 + restitution) * normal_speed
    return lost, 2.5 * lost / radius, 3.5 * lost


def incline_accelerations(angle, friction, gravity, radius):
    """(acceleration down the slope [L T^-2], angular acceleration [rad T^-2]) of a solid ball let go on a plane at
    the angle b [rad]: rolling if tan b <= 3.5 f, 5/7 g sin b and that over r; else sliding, g(sin b - f cos b)
    and 5 f g cos b/(2r) (equations of motion).
    Raises ValueError unless 0 <= angle < pi/2 and radius is positive, or if friction or gravity is negative."""
    require("angle", angle, below=jnp.pi / 2)
    check_signs(friction=friction, gravity=gravity, radius=radius)
    # Friction per weight: what the ball needs to roll, or the Coulomb limit where that is less.
    share = jnp.minimum(2 / 7 * jnp.sin(angle), friction * jnp.cos(angle))
    return gravity * (jnp.sin(angle) - share), 2.5 * gravity * share / radius


def slide_to_roll(initial_speed, friction, gravity):
    """(time [T], speed [L T^-1], distance [L]) at which a solid ball sent off at v0 [L T^-1], sliding without spin,
    begins to roll: 2 v0/(7 f g), 5/7 v0, 12 v0^2/(49 f g); infinite without friction (momentum balance).
    Raises ValueError if initial_speed, friction or gravity is negative."""
    check_signs(initial_speed=initial_speed, friction=friction, gravity=gravity)
    decay = jnp.asarray(friction * gravity)
    return 2 * initial_speed / (7 * decay), 5 / 7 * initial_speed, 12 * initial_speed**2 / (49 * decay)
