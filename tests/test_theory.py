"""Each closed form against its limits, published values, an independent formula, or an integration of its equations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from axijax import theory

jax.config.update("jax_enable_x64", True)

FRICTIONS = [0.0, 0.05, 0.12278, 0.2, 0.3, 0.7]
PAPER_STRESS_RATIOS = [(0.05, 2.21053), (0.12278, 2.55986), (0.2, 3.0), (0.25, 3.33333), (0.3, 3.71429)]
TAN_ANGLES = [theory.TAN_ANGLE_FCC, theory.TAN_ANGLE_BCC, theory.TAN_ANGLE_HCP]


def integrate(rate, start, duration, event=None):
    """Solution of an initial value problem, stopped where event falls to or rises through zero after the start."""
    if event is not None:
        event.terminal = True
    return solve_ivp(rate, (0, duration), start, events=event, rtol=1e-11, atol=1e-13, method="DOP853")


# ---- Strength ----


@pytest.mark.parametrize(("friction", "expected"), PAPER_STRESS_RATIOS)
def test_fcc_stress_ratio_has_the_published_values(friction, expected):
    assert theory.fcc_stress_ratio(friction) == pytest.approx(expected, abs=5e-6)
    assert theory.fcc_friction(expected) == pytest.approx(friction, abs=1e-6)


@pytest.mark.parametrize("friction", FRICTIONS)
def test_fcc_friction_inverts_the_stress_ratio(friction):
    assert theory.fcc_friction(theory.fcc_stress_ratio(friction)) == pytest.approx(friction, abs=1e-14)


@pytest.mark.parametrize("friction", FRICTIONS)
def test_fcc_stress_ratio_gradient(friction):
    assert jax.grad(theory.fcc_stress_ratio)(friction) == pytest.approx(4 / (1 - friction) ** 2, rel=1e-13)


@pytest.mark.parametrize("friction", FRICTIONS)
def test_general_stress_under_equal_lateral_rates_is_triaxial_compression(friction):
    x, y, z = theory.fcc_general_stress(friction, 0.7, 0.7)
    assert x == y
    assert z / x == pytest.approx(theory.fcc_stress_ratio(friction), rel=1e-14)


@pytest.mark.parametrize(("rate_x", "rate_y"), [(1.0, 0.0), (1.0, 0.3), (0.2, 5.0)])
def test_general_stress_from_the_forces_of_eight_sliding_contacts(rate_x, rate_y):
    """Force n - f (slip direction) at every inclined contact, normals kept, summed into a stress."""
    friction = 0.3
    rates = np.diag([2 * rate_x, 2 * rate_y, -(rate_x + rate_y)])
    stress = np.zeros((3, 3))
    for signs in np.ndindex(2, 2, 2):
        normal = np.where(signs, 1, -1) * np.array([0.5, 0.5, 0.5**0.5])
        slip = rates @ normal
        assert normal @ slip == pytest.approx(0, abs=1e-14)  # the contacts neither open nor overlap
        stress += np.outer(normal - friction * slip / np.linalg.norm(slip), normal) / 2
    expected = np.diag(theory.fcc_general_stress(friction, rate_x, rate_y))
    np.testing.assert_allclose(stress, expected, atol=1e-14)


def test_general_stress_does_not_depend_on_the_rate_unit_and_swaps_x_with_y():
    x, y, z = theory.fcc_general_stress(0.2, 1.0, 0.4)
    np.testing.assert_allclose(theory.fcc_general_stress(0.2, 30.0, 12.0), [x, y, z], rtol=1e-14)
    np.testing.assert_allclose(theory.fcc_general_stress(0.2, 0.4, 1.0), [y, x, z], rtol=1e-14)


def test_plane_strain_has_the_published_values():
    np.testing.assert_allclose(theory.fcc_plane_strain_ratios(0.3), [4.8812, 1.9604], atol=5e-5)
    np.testing.assert_allclose(theory.fcc_plane_strain_ratios(0.0), [2, 1], rtol=1e-14)


@pytest.mark.parametrize("friction", [0.0, 0.12278, 0.3, 0.6])
def test_plane_strain_is_the_general_stress_with_one_direction_held(friction):
    x, y, z = theory.fcc_general_stress(friction, 1.0, 0.0)
    np.testing.assert_allclose(theory.fcc_plane_strain_ratios(friction), [z / x, y / x], rtol=1e-13)


@pytest.mark.parametrize("friction", FRICTIONS)
def test_inclined_contacts_at_45_degrees_are_thorntons_array(friction):
    ratio = theory.inclined_contact_stress_ratio(theory.TAN_ANGLE_FCC, friction)
    assert ratio == pytest.approx(theory.fcc_stress_ratio(friction), rel=1e-14)


@pytest.mark.parametrize(("friction", "expected"), [(0, 1.0), (0.05, 1.11), (0.12278, 1.2852), (0.3, 1.8077)])
def test_bcc_stress_ratio(friction, expected):
    ratio = theory.inclined_contact_stress_ratio(theory.TAN_ANGLE_BCC, friction)
    assert ratio == pytest.approx(expected, abs=5e-5)


def test_frictionless_hcp_stress_ratio():
    assert theory.inclined_contact_stress_ratio(theory.TAN_ANGLE_HCP, 0.0) == pytest.approx(4)


def test_tan_angles_from_the_geometry_of_the_layers():
    """Horizontal over vertical offset of the nearest balls of the next layer, in radii."""
    assert pytest.approx(np.hypot(1, 1) / np.sqrt(2)) == theory.TAN_ANGLE_FCC
    assert pytest.approx(np.hypot(1, 1) / 1) == theory.TAN_ANGLE_BCC
    assert pytest.approx((2 / np.sqrt(3)) / np.sqrt(8 / 3)) == theory.TAN_ANGLE_HCP


@pytest.mark.parametrize("tan_angle", TAN_ANGLES)
def test_dilatancy_from_the_geometry_of_one_contact(tan_angle):
    """Height cos(th) and width sin(th) of a contact that turns: volumetric strain from both, by differentiation."""
    angle = np.arctan(tan_angle)

    def strains(turn):
        axial = -jnp.log(jnp.cos(angle + turn))
        lateral = -jnp.log(jnp.sin(angle + turn))
        return jnp.array([axial, axial + 2 * lateral])

    axial_rate, volumetric_rate = jax.jacfwd(strains)(0.0)
    assert theory.dilatancy(tan_angle) == pytest.approx(1 - float(volumetric_rate / axial_rate), rel=1e-12)


def test_dilatancy_of_the_lattices():
    assert [theory.dilatancy(t) for t in TAN_ANGLES] == pytest.approx([2, 1, 4])


@pytest.mark.parametrize("tan_angle", TAN_ANGLES)
@pytest.mark.parametrize("friction", [0.0, 0.05, 0.12278, 0.3, 0.6])
def test_stress_ratio_is_dilatancy_times_rowes_ratio(tan_angle, friction):
    elevation = np.pi / 2 - np.arctan(tan_angle)
    product = theory.dilatancy(tan_angle) * theory.rowe_stress_dilatancy(elevation, friction)
    assert theory.inclined_contact_stress_ratio(tan_angle, friction) == pytest.approx(float(product), rel=1e-13)


def test_rowes_ratio_is_least_at_the_critical_elevation():
    """Rowe's minimum energy ratio: tan^2(45 deg + phi/2), at beta = 45 deg - phi/2."""
    friction = 0.3
    angle = np.arctan(friction)
    critical = np.pi / 4 - angle / 2
    assert theory.rowe_stress_dilatancy(critical, friction) == pytest.approx(np.tan(np.pi / 4 + angle / 2) ** 2)
    assert jax.grad(theory.rowe_stress_dilatancy)(critical, friction) == pytest.approx(0, abs=1e-13)
    assert theory.rowe_stress_dilatancy(critical + 0.1, friction) > theory.rowe_stress_dilatancy(critical, friction)


def test_contact_angle_follows_rigid_balls_of_the_squeezed_layers():
    """Layers sqrt(2)(1 - eps) radii apart: the inclined contact stays two radii long."""
    for strain in (0.0, 0.01, 0.1, 0.29):
        angle = theory.contact_angle(strain)
        assert 2 * jnp.cos(angle) == pytest.approx(2**0.5 * (1 - strain), rel=1e-14)
    assert theory.contact_angle(0.0) == pytest.approx(np.pi / 4)
    assert theory.contact_angle(1 - 0.5**0.5 - 1e-12) == pytest.approx(np.pi / 3)


@pytest.mark.parametrize("tan_angle", TAN_ANGLES)
def test_contact_angle_starts_at_the_given_one(tan_angle):
    assert jnp.tan(theory.contact_angle(0.0, tan_angle)) == pytest.approx(tan_angle)


@pytest.mark.parametrize("friction", FRICTIONS)
def test_softening_rate_at_the_fcc_peak(friction):
    expected = -2 - 2 / np.cos(2 * np.arctan(friction))
    assert theory.post_peak_softening_rate(friction) == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize("tan_angle", TAN_ANGLES)
@pytest.mark.parametrize("strain", [0.0, 0.03, 0.12])
def test_softening_rate_is_the_derivative_along_the_contact_angle(tan_angle, strain):
    friction = 0.3

    def log_ratio(strain):
        angle = theory.contact_angle(strain, tan_angle)
        return jnp.log(2 / jnp.tan(angle) / jnp.tan(angle - jnp.arctan(friction)))

    rate = theory.post_peak_softening_rate(friction, strain, tan_angle)
    assert rate == pytest.approx(float(jax.grad(log_ratio)(strain)), rel=1e-12)


# ---- Linear springs ----

# Contact normals of the lattices in cube axes, one of each opposite pair, and the volume of a ball's cell in radii^3.
LATTICES = {
    "fcc": ([(1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1)], 4 * 2**0.5),
    "bcc": ([(1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1)], 32 / 3**1.5),
    "sc": ([(1, 0, 0), (0, 1, 0), (0, 0, 1)], 8),
}


def contact_normals(lattice):
    normals = np.array(LATTICES[lattice][0], float)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def contact_stiffness(normal, kn, ks):
    return ks * np.eye(3) + (kn - ks) * np.outer(normal, normal)


def lattice_stress(lattice, kn, ks, radius, strain):
    """Stress of the uniformly strained lattice from its contact forces, no ball turning."""
    force_moment = np.zeros((3, 3))
    for normal in contact_normals(lattice):
        branch = 2 * radius * normal
        force_moment += np.outer(contact_stiffness(normal, kn, ks) @ strain @ branch, branch)
    return force_moment / (LATTICES[lattice][1] * radius**3)


@pytest.mark.parametrize("lattice", LATTICES)
def test_elastic_constants_from_the_contact_forces(lattice):
    kn, ks, radius = 3.0, 0.7, 1.3
    c11, c12, c44 = theory.elastic_constants(lattice, kn, ks, radius)
    axial = lattice_stress(lattice, kn, ks, radius, np.diag([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(axial, np.diag([c12, c12, c11]), atol=1e-14)
    shear = np.array([[0, 0.5, 0], [0.5, 0, 0], [0, 0, 0]])  # engineering shear strain 1
    np.testing.assert_allclose(lattice_stress(lattice, kn, ks, radius, shear), 2 * c44 * shear, atol=1e-14)


@pytest.mark.parametrize("tangential_stiffness", [0.0, 0.5, 2.0, 3.0])
def test_fcc_modulus_and_poissons_ratio_from_the_inverse_of_the_elastic_constants(tangential_stiffness):
    kn, radius = 2.0, 1.7
    c11, c12, _ = theory.elastic_constants("fcc", kn, tangential_stiffness, radius)
    compliance = np.linalg.inv(np.full((3, 3), c12) + (c11 - c12) * np.eye(3))
    modulus = theory.fcc_youngs_modulus(kn, tangential_stiffness, radius)
    assert modulus == pytest.approx(1 / compliance[0, 0], rel=1e-13)
    poissons_ratio = theory.fcc_poissons_ratio(tangential_stiffness / kn)
    assert poissons_ratio == pytest.approx(-compliance[0, 1] / compliance[0, 0], abs=1e-14)


def test_fcc_modulus_with_equal_stiffnesses():
    assert theory.fcc_youngs_modulus(3.0, 3.0, 0.5) == pytest.approx(2**0.5 * 3.0 / 0.5)
    assert theory.fcc_poissons_ratio(1.0) == 0
    assert theory.fcc_poissons_ratio(0.0) == pytest.approx(1 / 3)


def test_isotropic_contact_force_gives_the_stress_back():
    stress, radius = 5e4, 20.0
    force = theory.fcc_isotropic_contact_force(stress, radius)
    normals = contact_normals("fcc")
    balance = 2 * radius * force * np.einsum("ci,cj->ij", normals, normals) / (4 * 2**0.5 * radius**3)
    np.testing.assert_allclose(balance, stress * np.eye(3), atol=1e-9)


def spring_array_curve(friction, kn, ks, radius, confining_stress, final_strain, steps=40000):
    """Axial strain and stress ratio of Thornton's array with springs, lateral stress kept, by small increments.

    Inclined normals (+-1/2, +-1/2, +-1/sqrt2); uniform axial shortening and lateral extension; no ball turns.
    """
    inclined = horizontal = 2**0.5 * confining_stress * radius**2
    shear = 0.0
    strain_step = final_strain / steps
    strains, ratios = [], []
    for step in range(steps):
        sliding = shear >= friction * inclined * (1 - 1e-12)
        # Forces per unit of shortening e and lateral extension g: normal kn r (e - g), shear ks r (e + g).
        shear_e, shear_g = (friction * kn, -friction * kn) if sliding else (ks, ks)
        closed = horizontal > 0
        # Lateral stress in units of 1/(2 sqrt2 r^2): inclined - shear + horizontal.
        by_e = kn - shear_e
        by_g = -kn - shear_g - (2 * kn if closed else 0)
        extension = -by_e / by_g * strain_step
        inclined += kn * radius * (strain_step - extension)
        shear += radius * (shear_e * strain_step + shear_g * extension)
        horizontal = max(horizontal - 2 * kn * radius * extension, 0) if closed else 0
        lateral = (inclined - shear + horizontal) / (2 * 2**0.5 * radius**2)
        axial = (2 * inclined + 2 * shear) / (2 * 2**0.5 * radius**2)
        strains.append((step + 1) * strain_step)
        ratios.append(axial / lateral)
        if not closed:
            break
    return np.array(strains), np.array(ratios)


@pytest.mark.parametrize(
    ("friction", "stiffness_ratio"), [(0.05, 1.0), (0.3, 1.0), (0.3, 0.5), (0.2, 2.0), (0.3, 0.32)]
)
def test_spring_array_slips_bends_and_opens_where_the_formulas_say(friction, stiffness_ratio):
    kn, radius, stress = 1.5e9, 20.0, 5e4
    opening = theory.fcc_horizontal_opening_strain(friction, stress, kn, radius)
    strain, ratio = spring_array_curve(friction, kn, stiffness_ratio * kn, radius, stress, 1.05 * opening)
    modulus = theory.fcc_youngs_modulus(kn, stiffness_ratio * kn, radius)
    slip_ratio, factor = theory.fcc_first_slip(friction, stiffness_ratio)
    slip_strain = (slip_ratio - 1) * stress / modulus
    before, after = strain < 0.99 * slip_strain, (strain > slip_strain + 0.01 * opening) & (strain < 0.99 * opening)
    np.testing.assert_allclose(ratio[before], 1 + modulus / stress * strain[before], rtol=1e-9)
    slope = np.diff(ratio[after]) / np.diff(strain[after])
    if after.sum() > 1:
        np.testing.assert_allclose(slope, factor * modulus / stress, rtol=1e-6)
    assert strain[-1] == pytest.approx(opening, rel=2e-4)
    assert ratio[-1] == pytest.approx(theory.fcc_stress_ratio(friction), rel=2e-4)


@pytest.mark.parametrize("friction", FRICTIONS)
@pytest.mark.parametrize("stiffness_ratio", [0.7, 1.0, 1.4])
def test_two_straight_pieces_meet_the_peak_at_the_opening_strain(friction, stiffness_ratio):
    kn, radius, stress = 2.0, 0.9, 1e-3
    slope = theory.fcc_youngs_modulus(kn, stiffness_ratio * kn, radius) / stress
    slip_ratio, factor = theory.fcc_first_slip(friction, stiffness_ratio)
    opening = theory.fcc_horizontal_opening_strain(friction, stress, kn, radius)
    peak = slip_ratio + factor * slope * (opening - (slip_ratio - 1) / slope)
    assert peak == pytest.approx(theory.fcc_stress_ratio(friction), rel=1e-13)


@pytest.mark.parametrize("friction", FRICTIONS)
def test_first_slip_with_equal_stiffnesses(friction):
    expected = (1 + friction) / (1 - friction), (1 + friction) / (3 - friction)
    assert theory.fcc_first_slip(friction) == pytest.approx(expected, rel=1e-14)


def test_stiffer_springs_stretch_the_strain_axis():
    friction, stress, radius, kn = 0.3, 5e4, 20.0, 1.5e9
    soft = spring_array_curve(friction, kn, kn, radius, stress, 2e-3, 2000)
    stiff = spring_array_curve(friction, 2 * kn, 2 * kn, radius, stress, 1e-3, 2000)
    inside = stiff[0] > soft[0][0]
    stretched = theory.stretched_stress_ratio(stiff[0][inside], 2.0, *soft)
    np.testing.assert_allclose(stretched, stiff[1][inside], rtol=1e-9)


def test_stretch_leaves_the_curve_as_nan():
    strain = jnp.linspace(0, 0.01, 5)
    assert jnp.isnan(theory.stretched_stress_ratio(0.009, 2.0, strain, 1 + strain))


def test_stiffness_sensitivity_is_the_derivative_of_the_stretch():
    strain = np.linspace(0, 0.01, 2001)
    ratio = 1 + 2 * strain / (strain + 0.002)
    expected = strain * 2 * 0.002 / (strain + 0.002) ** 2
    np.testing.assert_allclose(theory.stiffness_sensitivity(strain, ratio)[1:-1], expected[1:-1], atol=1e-5)
    middle = strain[1000] + 0.5 * (strain[1] - strain[0])  # between two points, where interpolation is smooth

    def ratio_of_log_stiffness(log_factor):
        return theory.stretched_stress_ratio(middle, jnp.exp(log_factor), jnp.asarray(strain), jnp.asarray(ratio))

    assert jax.grad(ratio_of_log_stiffness)(0.0) == pytest.approx(middle * 0.004 / (middle + 0.002) ** 2, rel=1e-5)


# ---- One contact ----


def impact(effective_mass, stiffness, dashpot, speed, local_damping=0.0):
    """(time in contact, rebound over approach speed, largest overlap), stopped where the force falls to zero."""

    def force(state):
        return stiffness * state[0] + dashpot * state[1]

    def rate(time, state):
        damped = force(state) + local_damping * abs(force(state)) * np.sign(state[1])
        return [state[1], -damped / effective_mass]

    def turned(time, state):
        return state[1]

    def released(time, state):
        return force(state)

    released.direction = -1
    loading = integrate(rate, [0.0, speed], 100.0, turned)
    unloading = integrate(rate, loading.y[:, -1], 100.0, released)
    return loading.t[-1] + unloading.t[-1], -unloading.y[1, -1] / speed, loading.y[0, -1]


def test_undamped_impact():
    mass, stiffness, speed = 0.8, 5.0, 0.3
    duration, restitution, overlap = impact(mass, stiffness, 0.0, speed)
    assert theory.impact_duration(mass, stiffness) == pytest.approx(duration, rel=1e-9)
    assert theory.impact_maximum_overlap(speed, mass, stiffness) == pytest.approx(overlap, rel=1e-9)
    assert restitution == pytest.approx(1, rel=1e-9)


@pytest.mark.parametrize("local_damping", [0.1, 0.3, 0.7])
def test_locally_damped_impact(local_damping):
    _, restitution, _ = impact(0.8, 5.0, 0.0, 0.3, local_damping)
    assert theory.local_damping_restitution(local_damping) == pytest.approx(restitution, rel=1e-8)


@pytest.mark.parametrize("damping_ratio", [0.05, 0.3, 0.9, 0.995, 1.0, 1.005, 1.5, 3.0])
def test_dashpot_impact_without_tension(damping_ratio):
    mass, stiffness = 0.8, 5.0
    duration, restitution, _ = impact(mass, stiffness, 2 * damping_ratio * np.sqrt(stiffness * mass), 0.3)
    assert theory.dashpot_restitution(damping_ratio) == pytest.approx(restitution, rel=1e-7)
    assert theory.dashpot_duration(damping_ratio, mass, stiffness) == pytest.approx(duration, rel=1e-7)


def test_dashpot_impact_limits():
    mass, stiffness = 0.8, 5.0
    assert theory.dashpot_restitution(0.0) == 1
    assert theory.dashpot_duration(0.0, mass, stiffness) == pytest.approx(theory.impact_duration(mass, stiffness))
    assert theory.dashpot_restitution(1.0) == pytest.approx(np.exp(-2), rel=1e-15)
    # Contact kept until the overlap is zero, the force pulling at the end, dissipates more.
    unclamped = np.exp(-np.pi * 0.3 / np.sqrt(1 - 0.3**2))
    assert theory.dashpot_restitution(0.3) > unclamped


@pytest.mark.parametrize("damping_ratio", [0.0, 0.3, 0.99, 0.9999, 1.0, 1.01, 2.0])
def test_dashpot_restitution_has_a_gradient_everywhere(damping_ratio):
    """With g = arccos(x)/sqrt(1-x^2), which solves (1-x^2) g' = x g - 1; at x = 1, g' = -1/3."""
    half_duration = theory.dashpot_duration(damping_ratio, 1.0, 1.0) / 2
    slope = -1 / 3
    if damping_ratio != 1:
        slope = (damping_ratio * half_duration - 1) / (1 - damping_ratio**2)
    expected = -2 * (half_duration + damping_ratio * slope) * theory.dashpot_restitution(damping_ratio)
    assert jax.grad(theory.dashpot_restitution)(damping_ratio) == pytest.approx(float(expected), rel=1e-9)


def oblique_impact(friction, kn, ks, normal_speed, tangential_speed, dashpot=0.0, steps=20000):
    """Unit ball on a plate, capped incremental spring: (tangential velocity, surface velocity, spin) afterwards."""
    overlap, approach, tangential, spin, spring = 0.0, normal_speed, tangential_speed, 0.0, 0.0
    step = 1.2 * np.pi / np.sqrt(kn) / steps
    while True:
        normal_force = kn * overlap + dashpot * approach
        if normal_force < 0:
            return tangential, tangential - spin, spin
        cap = friction * normal_force
        spring = min(max(spring, -cap / ks), cap / ks)
        approach -= normal_force * step
        tangential -= ks * spring * step
        spin += 2.5 * ks * spring * step
        overlap += approach * step
        spring += (tangential - spin) * step


@pytest.mark.parametrize("stiffness_ratio", [0.1, 2 / 7, 0.5, 1.0])
def test_sticking_oblique_impact(stiffness_ratio):
    """Spring, tangential velocity and spin of a unit ball on a plate, over half a period of the normal spring."""

    def rate(time, state):
        spring, tangential, spin = state
        force = stiffness_ratio * spring
        return [tangential - spin, -force, 2.5 * force]

    end = integrate(rate, [0.0, 1.0, 0.0], theory.impact_duration(1.0, 1.0)).y[:, -1]
    assert theory.sticking_velocity_ratio(stiffness_ratio) == pytest.approx(end[1] - end[2], abs=1e-8)


def test_two_sevenths_reverses_the_surface_velocity():
    assert theory.sticking_velocity_ratio(2 / 7) == pytest.approx(-1, abs=1e-14)
    assert theory.sticking_velocity_ratio(0.0) == 1


@pytest.mark.parametrize("damping_ratio", [0.0, 0.3])
def test_gross_sliding_impact(damping_ratio):
    # A dashpot pushes from the first touch, and a stiff tangential spring is needed to slide that early.
    friction, normal_speed, kn, ks = 0.2, 0.6, 4.0, 400.0
    restitution = float(theory.dashpot_restitution(damping_ratio))
    lost, spin, least = theory.gross_sliding_impact(friction, restitution, normal_speed, 1.0)
    dashpot = 2 * damping_ratio * np.sqrt(kn)
    tangential, surface, found_spin = oblique_impact(friction, kn, ks, normal_speed, 1.5 * least, dashpot)
    assert 1.5 * least - tangential == pytest.approx(lost, rel=1e-3)
    assert found_spin == pytest.approx(spin, rel=1e-3)
    assert surface == pytest.approx(0.5 * least, rel=1e-3)


def test_gross_sliding_lasts_only_above_the_least_surface_speed():
    lost, spin, least = theory.gross_sliding_impact(0.2, 1.0, 0.6, 1.0)
    assert least - lost - spin == pytest.approx(0, abs=1e-15)  # the surface has just come to rest
    tangential, _, _ = oblique_impact(0.2, 4.0, 4.0, 0.6, 0.8 * least)
    assert 0.8 * least - tangential < 0.99 * lost


def test_gross_sliding_spin_scales_with_the_radius():
    lost, spin, _ = theory.gross_sliding_impact(0.2, 0.5, 0.6, 2.0)
    # An impulse J at the radius r changes speed by J/m and spin by J r/(2/5 m r^2).
    assert spin == pytest.approx(lost * 2.0 / (0.4 * 2.0**2))


@pytest.mark.parametrize("friction", [0.1, 0.2])
@pytest.mark.parametrize("angle", [0.1, 0.3, 0.5, 1.2])
def test_ball_on_an_incline_obeys_newton_and_coulomb(angle, friction):
    gravity, radius = 9.81, 0.3
    acceleration, angular = map(float, theory.incline_accelerations(angle, friction, gravity, radius))
    friction_force = gravity * np.sin(angle) - acceleration  # per mass
    assert angular * 0.4 * radius**2 == pytest.approx(friction_force * radius, rel=1e-12)
    limit = friction * gravity * np.cos(angle)
    if np.tan(angle) <= 3.5 * friction:
        assert acceleration == pytest.approx(5 / 7 * gravity * np.sin(angle), rel=1e-12)
        assert acceleration == pytest.approx(radius * angular, rel=1e-12)
        assert friction_force <= limit
    else:
        assert friction_force == pytest.approx(limit, rel=1e-12)
        assert acceleration > radius * angular


def test_frictionless_incline():
    acceleration, angular = theory.incline_accelerations(0.4, 0.0, 9.81, 0.3)
    assert acceleration == pytest.approx(9.81 * np.sin(0.4))
    assert angular == 0


def test_slide_to_roll():
    speed, friction, gravity, radius = 2.0, 0.3, 9.81, 0.1

    def rate(time, state):
        return [state[1], -friction * gravity, 2.5 * friction * gravity / radius]

    def rolling(time, state):
        return state[1] - radius * state[2]

    motion = integrate(rate, [0.0, speed, 0.0], 10.0, rolling)
    time, final_speed, distance = theory.slide_to_roll(speed, friction, gravity)
    assert time == pytest.approx(motion.t[-1], rel=1e-10)
    assert distance == pytest.approx(motion.y[0, -1], rel=1e-10)
    assert final_speed == pytest.approx(motion.y[1, -1], rel=1e-10)


def test_without_friction_a_ball_never_rolls():
    time, _, distance = theory.slide_to_roll(2.0, 0.0, 9.81)
    assert jnp.isinf(time) and jnp.isinf(distance)


# ---- Waves and time steps ----


# Wave vectors, over one radius, at which neighbouring layers (in SC neighbouring balls) move in antiphase.
FASTEST_WAVES = {
    "fcc": np.pi * np.array([0, 0, 2**-0.5]),
    "bcc": np.pi * np.array([0, 0, 3**0.5 / 2]),
    "sc": np.pi * np.array([0.5, 0.5, 0.5]),
}


def dynamical_matrix(lattice, wave, kn, ks):
    """Squared frequencies are its eigenvalues: displacement and spin of a unit ball under Bloch's phase, (6, 6)."""
    matrix = np.zeros((6, 6), complex)
    for normal in contact_normals(lattice):
        phase = np.exp(2j * wave @ normal)
        turn = np.cross(np.eye(3), normal).T  # spin, times the radius, to surface velocity
        slip = np.hstack([(phase - 1) * np.eye(3), -(phase + 1) * turn])
        matrix += slip.conj().T @ contact_stiffness(normal, kn, ks) @ slip
    inertia = np.sqrt([1, 1, 1, 0.4, 0.4, 0.4])
    return matrix / np.outer(inertia, inertia)


def test_chain_frequency_from_a_ring_of_balls():
    count, mass, kn, radius = 12, 0.7, 3.0, 0.5
    ring = 2 * np.eye(count) - np.roll(np.eye(count), 1, axis=0) - np.roll(np.eye(count), -1, axis=0)
    wavenumber = np.pi * np.arange(count) / (count * radius)
    frequency = theory.chain_frequency(wavenumber, mass, kn, radius)
    expected = np.sqrt(np.maximum(np.linalg.eigvalsh(kn / mass * ring), 0))
    np.testing.assert_allclose(np.sort(frequency), expected, atol=1e-7)


@pytest.mark.parametrize("wavenumber", [0.1, 0.8, 2.0, np.pi / 2**0.5])
def test_fcc_p_wave_is_a_lattice_mode(wavenumber):
    kn, ks = 1.0, 0.4
    wave = np.array([0, 0, wavenumber])
    polarised = np.eye(6)[2]
    squared = dynamical_matrix("fcc", wave, kn, ks) @ polarised
    frequency = theory.fcc_p_wave_frequency(wavenumber, 1.0, kn, ks, 1.0)
    np.testing.assert_allclose(squared, frequency**2 * polarised, atol=1e-12)


def test_fcc_p_wave_speed_is_the_long_wave_limit_and_that_of_the_elastic_solid():
    mass, kn, ks, radius = 0.7, 3.0, 1.1, 0.5
    speed = theory.fcc_p_wave_speed(mass, kn, ks, radius)
    assert theory.fcc_p_wave_frequency(1e-4, mass, kn, ks, radius) / 1e-4 == pytest.approx(float(speed), rel=1e-8)
    slope = jax.grad(theory.fcc_p_wave_frequency)(1e-9, mass, kn, ks, radius)
    assert slope == pytest.approx(float(speed), rel=1e-12)
    density = mass / (4 * 2**0.5 * radius**3)
    assert speed == pytest.approx(np.sqrt(theory.elastic_constants("fcc", kn, ks, radius)[0] / density), rel=1e-13)


def test_fcc_translation_frequency_is_the_shortest_p_wave():
    mass, kn, ks, radius = 0.7, 3.0, 1.1, 0.5
    shortest = theory.fcc_p_wave_frequency(np.pi / (2**0.5 * radius), mass, kn, ks, radius)
    assert theory.fcc_translation_frequency(mass, kn, ks) == pytest.approx(float(shortest), rel=1e-13)


@pytest.mark.parametrize("lattice", LATTICES)
def test_uniform_spin_is_a_lattice_mode(lattice):
    ks = 0.6
    contacts = 2 * len(contact_normals(lattice))
    spin_block = dynamical_matrix(lattice, np.zeros(3), 1.0, ks)[3:, 3:]
    squared = theory.uniform_spin_frequency(contacts, 1.0, ks) ** 2
    np.testing.assert_allclose(spin_block, squared * np.eye(3), atol=1e-12)


@pytest.mark.parametrize("rotation", [True, False])
@pytest.mark.parametrize("stiffness_ratio", [1.0, 0.5, 2 / 7, 0.1])
@pytest.mark.parametrize("lattice", LATTICES)
def test_no_wave_in_the_lattice_is_faster_than_its_critical_time_step_allows(lattice, stiffness_ratio, rotation):
    waves = np.random.default_rng(0).uniform(-np.pi, np.pi, (300, 3))
    free = slice(6 if rotation else 3)
    fastest = max(
        np.linalg.eigvalsh(dynamical_matrix(lattice, wave, 1.0, stiffness_ratio)[free, free])[-1]
        for wave in [*waves, np.zeros(3), FASTEST_WAVES[lattice]]
    )
    step = theory.lattice_critical_time_step(lattice, 1.0, 1.0, stiffness_ratio, rotation=rotation)
    assert fastest == pytest.approx(float(4 / step**2), rel=1e-12)


@pytest.mark.parametrize(
    ("lattice", "stiffness_ratio", "expected"),
    [
        ("fcc", 1, 0.3162),
        ("bcc", 1, 0.3873),
        ("sc", 1, 0.4472),
        ("pair", 1, 0.756),
        ("fcc", 0.8, 0.3536),
        ("fcc", 0.5, 0.4472),
        ("fcc", 2 / 7, 0.5916),
    ],
)
def test_lattice_critical_time_steps(lattice, stiffness_ratio, expected):
    step = theory.lattice_critical_time_step(lattice, 1.0, 1.0, stiffness_ratio)
    assert step == pytest.approx(expected, abs=6e-5 if lattice != "pair" else 5e-4)
    scaled = theory.lattice_critical_time_step(lattice, 3.0, 2.0, 2.0 * stiffness_ratio)
    assert scaled == pytest.approx(float(step) * np.sqrt(3.0 / 2.0), rel=1e-13)


def test_lattice_critical_time_step_without_rotation():
    assert theory.lattice_critical_time_step("fcc", 1.0, 1.0, 1.0, rotation=False) == pytest.approx(0.5)
    assert theory.lattice_critical_time_step("pair", 1.0, 1.0, 1.0, rotation=False) == pytest.approx(2**0.5)


@pytest.mark.parametrize("stiffness_ratio", [0.05, 0.24, 0.26, 1.0])
def test_fcc_step_is_that_of_the_faster_of_spin_and_translation(stiffness_ratio):
    spin = theory.uniform_spin_frequency(12, 1.0, stiffness_ratio)
    translation = theory.fcc_translation_frequency(1.0, 1.0, stiffness_ratio)
    assert (spin > translation) == (stiffness_ratio > 0.25)
    step = theory.lattice_critical_time_step("fcc", 1.0, 1.0, stiffness_ratio)
    assert step == pytest.approx(float(theory.critical_time_step(jnp.maximum(spin, translation))), rel=1e-13)


def test_pair_step_from_its_two_modes():
    """Two unit balls and one contact: 6 modes of displacement along and across, and two spins."""
    kn, ks = 1.0, 0.6
    along, across = np.array([1.0, -1, 0, 0]), np.array([1.0, -1, 1, 1])
    for vector, stiffness, inertia in ((along, kn, [1, 1]), (across, ks, [1, 1, 0.4, 0.4])):
        vector = vector[: len(inertia)] / np.sqrt(inertia)
        frequency = np.sqrt(np.linalg.eigvalsh(stiffness * np.outer(vector, vector))[-1])
        bound = theory.critical_time_step(float(frequency))
        assert theory.lattice_critical_time_step("pair", 1.0, kn, ks) <= bound * (1 + 1e-12)
    assert theory.lattice_critical_time_step("pair", 1.0, kn, ks) == pytest.approx(float(bound), rel=1e-12)


def test_a_lattice_without_tangential_springs_has_no_spin_limit():
    step = theory.lattice_critical_time_step("fcc", 1.0, 1.0, 0.0, damping_ratio=0.1)
    assert step == theory.lattice_critical_time_step("fcc", 1.0, 1.0, 0.0, damping_ratio=0.1, rotation=False)


def amplification(omega, damping_ratio, step):
    """Largest multiplier of a step of central differences with the dashpot at the last half step."""
    kick = np.array([[1, 0], [-(omega**2) * step, 1 - 2 * damping_ratio * omega * step]])
    drift = np.array([[1, step], [0, 1]])
    return np.abs(np.linalg.eigvals(drift @ kick)).max()


@pytest.mark.parametrize("damping_ratio", [0.0, 0.05, 0.22, 1.0, 1.34])
def test_critical_time_step_is_where_the_scheme_starts_to_grow(damping_ratio):
    omega = 3.7
    step = float(theory.critical_time_step(omega, damping_ratio))
    assert step == pytest.approx(2 / omega * (np.sqrt(1 + damping_ratio**2) - damping_ratio), rel=1e-13)
    assert amplification(omega, damping_ratio, 0.999 * step) <= 1 + 1e-12
    assert amplification(omega, damping_ratio, 1.001 * step) > 1 + 1e-4


@pytest.mark.parametrize(
    ("damping_ratio", "modal", "expected"), [(0.05, 0.22, 0.25), (0.1, 0.45, 0.21), (0.3, 1.34, 0.105)]
)
def test_dashpots_lower_the_fcc_step_to_the_published_values(damping_ratio, modal, expected):
    spin = theory.uniform_spin_frequency(12, 1.0, 1.0)
    xi = theory.modal_damping_ratio(spin, damping_ratio, 1.0, 1.0)
    assert xi == pytest.approx(modal, abs=5e-3)
    step = theory.lattice_critical_time_step("fcc", 1.0, 1.0, 1.0, damping_ratio)
    assert step == pytest.approx(float(theory.critical_time_step(spin, xi)), rel=1e-13)
    assert step == pytest.approx(expected, abs=5.5e-3)


def test_modal_damping_of_a_pair_is_the_contacts_own():
    """For two equal balls the mode of the normal spring is the impact that damping_ratio was defined by."""
    mass, kn = 0.7, 3.0
    assert theory.modal_damping_ratio(np.sqrt(2 * kn / mass), 0.3, mass, kn) == pytest.approx(0.3)


@pytest.mark.parametrize("stiffness_ratio", [1.0, 0.3, 0.1])
@pytest.mark.parametrize("lattice", LATTICES)
def test_damped_lattice_step_against_the_quadratic_eigenvalue_problem(lattice, stiffness_ratio):
    """At the limit some wave has det(K dt^2 + 2 C dt - 4 M) = 0, and none has it at a smaller dt."""
    damping_ratio = 0.2
    dashpots = 2 * damping_ratio * np.sqrt(np.array([1.0, stiffness_ratio]) / 2)
    steps = []
    for wave in [*np.random.default_rng(1).uniform(-np.pi, np.pi, (200, 3)), np.zeros(3), FASTEST_WAVES[lattice]]:
        stiffness = dynamical_matrix(lattice, wave, 1.0, stiffness_ratio)
        damping = dynamical_matrix(lattice, wave, *dashpots)
        companion = np.block([[np.zeros((6, 6)), np.eye(6)], [stiffness / 4, damping / 2]])
        steps.append(1 / np.linalg.eigvals(companion).real.max())
    step = theory.lattice_critical_time_step(lattice, 1.0, 1.0, stiffness_ratio, damping_ratio)
    assert min(steps) == pytest.approx(float(step), rel=1e-10)


# ---- Arguments ----

OUT_OF_RANGE = [
    (theory.fcc_stress_ratio, (-0.1,), "friction"),
    (theory.fcc_stress_ratio, (1.0,), "friction"),
    (theory.fcc_stress_ratio, (float("nan"),), "friction"),
    (theory.fcc_stress_ratio, (np.float64(1.2),), "friction"),
    (theory.fcc_friction, (1.9,), "stress_ratio"),
    (theory.fcc_general_stress, (0.2, -1.0, 1.0), "rate_x"),
    (theory.fcc_general_stress, (0.2, 0, 0), "both 0"),
    (theory.fcc_general_stress, (0.62, 1.0, 0.0), "friction"),
    (theory.fcc_plane_strain_ratios, (0.62,), "friction"),
    (theory.inclined_contact_stress_ratio, (0.0, 0.0), "tan_angle"),
    (theory.inclined_contact_stress_ratio, (0.5, 0.5), "friction"),
    (theory.dilatancy, (0,), "tan_angle"),
    (theory.rowe_stress_dilatancy, (1.4, 0.3), "contact_elevation"),
    (theory.rowe_stress_dilatancy, (0.0, 0.3), "contact_elevation"),
    (theory.contact_angle, (0.2929,), "axial_strain"),
    (theory.contact_angle, (-0.01,), "axial_strain"),
    (theory.post_peak_softening_rate, (1.0,), "friction"),
    (theory.fcc_isotropic_contact_force, (1.0, 0.0), "radius"),
    (theory.fcc_isotropic_contact_force, (-1.0, 1.0), "confining_stress"),
    (theory.elastic_constants, ("hcp", 1.0, 1.0, 1.0), "lattice is 'hcp'"),
    (theory.elastic_constants, ("sc", 0.0, 1.0, 1.0), "normal_stiffness"),
    (theory.fcc_youngs_modulus, (1.0, -1.0, 1.0), "tangential_stiffness"),
    (theory.fcc_poissons_ratio, (-0.1,), "stiffness_ratio"),
    (theory.fcc_first_slip, (1.0,), "friction"),
    (theory.fcc_first_slip, (0.3, 0.2), "stiffness_ratio"),
    (theory.fcc_first_slip, (0.0, 0.0), "stiffness_ratio"),
    (theory.fcc_horizontal_opening_strain, (1.0, 1.0, 1.0, 1.0), "friction"),
    (theory.stretched_stress_ratio, (0.1, 0.0, np.arange(2.0), np.arange(2.0)), "stiffness_factor"),
    (theory.impact_duration, (0.0, 1.0), "effective_mass"),
    (theory.impact_maximum_overlap, (-1.0, 1.0, 1.0), "normal_speed"),
    (theory.local_damping_restitution, (1.0,), "local_damping"),
    (theory.dashpot_restitution, (-0.1,), "damping_ratio"),
    (theory.dashpot_duration, (0.1, 1.0, 0.0), "normal_stiffness"),
    (theory.sticking_velocity_ratio, (-0.1,), "stiffness_ratio"),
    (theory.gross_sliding_impact, (0.1, -0.5, 1.0, 1.0), "restitution"),
    (theory.incline_accelerations, (1.6, 0.1, 9.81, 1.0), "angle"),
    (theory.slide_to_roll, (-1.0, 0.1, 9.81), "initial_speed"),
    (theory.chain_frequency, (1.0, 0.0, 1.0, 1.0), "mass"),
    (theory.fcc_p_wave_speed, (1.0, 1.0, -1.0, 1.0), "tangential_stiffness"),
    (theory.fcc_p_wave_frequency, (1.0, 1.0, 1.0, 1.0, 0.0), "radius"),
    (theory.uniform_spin_frequency, (0, 1.0, 1.0), "contacts_per_ball"),
    (theory.fcc_translation_frequency, (0.0, 1.0, 1.0), "mass"),
    (theory.modal_damping_ratio, (1.0, -0.1, 1.0, 1.0), "damping_ratio"),
    (theory.critical_time_step, (0.0,), "angular_frequency"),
    (theory.lattice_critical_time_step, ("hcp", 1.0, 1.0, 1.0), "lattice is 'hcp'"),
    (theory.lattice_critical_time_step, ("fcc", 1.0, 1.0, 1.5, 0.0, False), "normal_stiffness"),
]


@pytest.mark.parametrize(("formula", "arguments", "message"), OUT_OF_RANGE)
def test_a_number_out_of_range_is_refused_by_name(formula, arguments, message):
    with pytest.raises(ValueError, match=message):
        formula(*arguments)


def test_arrays_and_traced_values_pass_unchecked():
    assert theory.fcc_stress_ratio(np.array([0.0, 2.0])).shape == (2,)
    assert jax.jit(theory.fcc_stress_ratio)(2.0) == -6


ON_ARRAYS = [
    (theory.fcc_stress_ratio, ()),
    (lambda f: theory.fcc_friction(2 + f), ()),
    (theory.fcc_general_stress, (1.0, 0.5)),
    (lambda f: theory.inclined_contact_stress_ratio(theory.TAN_ANGLE_BCC, f), ()),
    (lambda f: theory.rowe_stress_dilatancy(0.7, f), ()),
    (lambda f: theory.contact_angle(f / 4), ()),
    (theory.post_peak_softening_rate, (0.02,)),
    (theory.fcc_first_slip, ()),
    (theory.fcc_plane_strain_ratios, ()),
    (theory.fcc_horizontal_opening_strain, (1.0, 100.0, 1.0)),
    (theory.local_damping_restitution, ()),
    (theory.dashpot_restitution, ()),
    (theory.dashpot_duration, (1.0, 1.0)),
    (theory.sticking_velocity_ratio, ()),
    (theory.gross_sliding_impact, (0.5, 1.0, 1.0)),
    (theory.incline_accelerations, (0.1, 9.81, 1.0)),
    (lambda ks: theory.elastic_constants("bcc", 1.0, ks, 1.0), ()),
    (lambda ks: theory.lattice_critical_time_step("bcc", 1.0, 1.0, ks, 0.1), ()),
    (lambda xi: theory.critical_time_step(2.0, xi), ()),
    (lambda q: theory.chain_frequency(q, 1.0, 1.0, 1.0), ()),
]


@pytest.mark.parametrize(("formula", "rest"), ON_ARRAYS)
def test_numpy_arrays_jit_and_gradient_agree_with_numbers(formula, rest):
    values = np.array([0.1, 0.25, 0.4])
    one_by_one = np.stack([np.asarray(formula(float(value), *rest)) for value in values], axis=-1)
    np.testing.assert_allclose(np.asarray(formula(values, *rest)), one_by_one, rtol=1e-14)
    compiled = jax.jit(lambda value: jnp.asarray(formula(value, *rest)))
    np.testing.assert_allclose(compiled(jnp.asarray(values)), one_by_one, rtol=1e-12)
    tangent = jax.jacfwd(lambda value: jnp.asarray(formula(value, *rest)))(0.25)
    step = 1e-6
    difference = (np.asarray(formula(0.25 + step, *rest)) - np.asarray(formula(0.25 - step, *rest))) / (2 * step)
    np.testing.assert_allclose(tangent, difference, rtol=1e-6, atol=1e-8)


def test_inertial_number_is_the_time_of_a_push_over_that_of_the_shear():
    """sqrt(m/(s3 d)) up to the shape of a ball: a cube of side d moves by d/2 in sqrt(density/s3) d under s3."""
    rate, radius, density, stress = 2 * 0.01 / 718.82, 20.0, 2000.0, 5e4  # the paper's test
    side, force, mass = 2 * radius, stress * 4 * radius**2, density * 8 * radius**3
    push = np.sqrt(2 * (side / 2) / (force / mass))
    assert theory.inertial_number(rate, radius, density, stress) == pytest.approx(rate * push, rel=1e-12)
    assert rate * push == pytest.approx(2.2e-4, rel=0.02)
    with pytest.raises(ValueError, match="density"):
        theory.inertial_number(rate, radius, 0.0, stress)
