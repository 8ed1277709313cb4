"""Closed forms that the simulator is held against.

Every function is pure and differentiable with `jax.grad`. Arguments are Python numbers, NumPy or JAX arrays
that broadcast, and each result has the broadcast shape unless its docstring gives another.
Balls are equal solid spheres with linear contact springs, the vertical along a cube axis (c axis in HCP);
"axial" means vertical, "confining" horizontal. Compressive stress, shortening and overlap are positive.
Units: radius [L], mass [M], stiffness (normal kn, tangential ks) [M T^-2], stress [M L^-1 T^-2], gravity
[L T^-2]; friction f = tan(phi), strain, tan_angle = tan(th) and every ratio [-]; others with their function.
A Python number outside a formula's range raises ValueError: "positive" excludes 0, "not negative" allows
it. Arrays and traced values are never checked, so that a formula can stand inside `jit`.

By subject: `axijax.theory.arrays` (strength and stiffness of regular arrays), `contact` (one contact), `waves` (waves,
critical time step), `soil` (what soil mechanics reads off a test); all names are here too.

[Thornton 1979] Geotechnique 29, 441-459; [Rowe 1962] Proc. R. Soc. A 269, 500-527; [Luding 2008] Granular
Matter 10, 235-246; [Schwager & Poeschel 2007] Granular Matter 9, 465-469; [Chung & Ooi 2011] Granular Matter
13, 643-656; [O'Sullivan & Bray 2004] Eng. Computations 21, 278-303. No paper: derived as named, and tested.
"""

from axijax.theory.arrays import (
    TAN_ANGLE_BCC,
    TAN_ANGLE_FCC,
    TAN_ANGLE_HCP,
    contact_angle,
    dilatancy,
    elastic_constants,
    fcc_first_slip,
    fcc_friction,
    fcc_general_stress,
    fcc_horizontal_opening_strain,
    fcc_isotropic_contact_force,
    fcc_plane_strain_ratios,
    fcc_poissons_ratio,
    fcc_stress_ratio,
    fcc_youngs_modulus,
    inclined_contact_stress_ratio,
    post_peak_softening_rate,
    rowe_stress_dilatancy,
    stiffness_sensitivity,
    stretched_stress_ratio,
)
from axijax.theory.contact import (
    dashpot_duration,
    dashpot_restitution,
    gross_sliding_impact,
    hertz_impact_duration,
    hertz_impact_maximum_overlap,
    impact_duration,
    impact_maximum_overlap,
    incline_accelerations,
    local_damping_restitution,
    slide_to_roll,
    sticking_velocity_ratio,
)
from axijax.theory.soil import (
    Envelope,
    deviatoric_stress,
    dilatancy_angle,
    friction_angle,
    mean_stress,
    mohr_envelope,
    rowe_stress_ratio,
    stress_ratio_of,
)
from axijax.theory.waves import (
    chain_frequency,
    critical_time_step,
    fcc_p_wave_frequency,
    fcc_p_wave_speed,
    fcc_translation_frequency,
    inertial_number,
    lattice_critical_time_step,
    modal_damping_ratio,
    uniform_spin_frequency,
)

__all__ = [
    "TAN_ANGLE_BCC",
    "TAN_ANGLE_FCC",
    "TAN_ANGLE_HCP",
    "Envelope",
    "chain_frequency",
    "contact_angle",
    "critical_time_step",
    "dashpot_duration",
    "dashpot_restitution",
    "deviatoric_stress",
    "dilatancy",
    "dilatancy_angle",
    "elastic_constants",
    "fcc_first_slip",
    "fcc_friction",
    "fcc_general_stress",
    "fcc_horizontal_opening_strain",
    "fcc_isotropic_contact_force",
    "fcc_p_wave_frequency",
    "fcc_p_wave_speed",
    "fcc_plane_strain_ratios",
    "fcc_poissons_ratio",
    "fcc_stress_ratio",
    "fcc_translation_frequency",
    "fcc_youngs_modulus",
    "friction_angle",
    "gross_sliding_impact",
    "hertz_impact_duration",
    "hertz_impact_maximum_overlap",
    "impact_duration",
    "impact_maximum_overlap",
    "incline_accelerations",
    "inclined_contact_stress_ratio",
    "inertial_number",
    "lattice_critical_time_step",
    "local_damping_restitution",
    "mean_stress",
    "modal_damping_ratio",
    "mohr_envelope",
    "post_peak_softening_rate",
    "rowe_stress_dilatancy",
    "rowe_stress_ratio",
    "slide_to_roll",
    "sticking_velocity_ratio",
    "stiffness_sensitivity",
    "stress_ratio_of",
    "stretched_stress_ratio",
    "uniform_spin_frequency",
]
