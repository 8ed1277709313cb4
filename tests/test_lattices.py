"""Infinite lattices against the closed forms of axijax.theory.

A block of the lattice is deformed homogeneously, spins blocked, and the contact law follows it step by step; the stress
is the Love-Weber mean over the balls that have all their neighbours. That is the infinite lattice, without a boundary.
Units: ball radius, mass and normal stiffness 1.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from few_balls import SCENE, jit, no_load, run, unit_params

from axijax import Scene
from axijax.core.sector import Sector, radial_distance
from axijax.core.vector import Vector, from_rows, zeros
from axijax.mechanics.contact_list import ContactList, build_contact_list
from axijax.mechanics.contacts import Law, contact_forces, geometry
from axijax.mechanics.dynamics import all_forces, initial_state, positions
from axijax.mechanics.membrane import membrane_load
from axijax.specimen.specimen import Specimen, cut_to_sector, fcc_cylinder, fcc_octagon, lattice_cylinder
from axijax.theory import (
    TAN_ANGLE_BCC,
    TAN_ANGLE_FCC,
    TAN_ANGLE_HCP,
    chain_frequency,
    contact_angle,
    dilatancy,
    elastic_constants,
    fcc_first_slip,
    fcc_general_stress,
    fcc_horizontal_opening_strain,
    fcc_isotropic_contact_force,
    fcc_p_wave_frequency,
    fcc_p_wave_speed,
    fcc_plane_strain_ratios,
    fcc_stress_ratio,
    fcc_youngs_modulus,
    inclined_contact_stress_ratio,
    post_peak_softening_rate,
    uniform_spin_frequency,
)
from axijax.triaxial.test import TriaxialTest

NEIGHBOURS = {"fcc": 12, "bcc": 8, "hcp": 12, "sc": 6}
VOLUME = {"fcc": 32**0.5, "bcc": 32 / 27**0.5, "hcp": 32**0.5, "sc": 8.0}  # per ball


def specimen(lattice, layers=5, specimen_radius=5.0):
    if lattice == "fcc":
        return fcc_cylinder(1.0, layers, specimen_radius)
    return lattice_cylinder(lattice, 1.0, layers, specimen_radius)


class Block(NamedTuple):
    """A piece of a lattice. inner: (C,) half the number of a contact's balls that have all their neighbours;
    volume: of those balls' cells [L^3]; centre: one of those balls."""

    network: ContactList
    inner: jax.Array
    volume: float
    centre: int


def block(lattice, sector=None) -> Block:
    sector = sector or Sector(1)
    network = build_contact_list(cut_to_sector(specimen(lattice), sector), sector, skin=0.1)
    ends = np.asarray(network.side) != 0
    whole = ends.sum(axis=0) == NEIGHBOURS[lattice]
    assert whole.sum() >= 1
    share, weight = np.asarray(network.share), np.asarray(network.weight)
    inner = 0.5 * share * (whole[np.asarray(network.first)].astype(float) + whole[np.asarray(network.second)])
    place = np.asarray(network.positions)
    middle = np.hypot(*place[:2]) + np.abs(place[2] - place[2].mean())
    centre = int(np.where(whole, middle, np.inf).argmin())
    return Block(network, jnp.asarray(inner), float((weight * whole).sum()) * VOLUME[lattice], centre)


def love_weber(piece: Block, force, branch, volume_ratio=1.0):
    """Stress tensor (3, 3), compression positive [F/L^2]."""
    rows = [[(piece.inner * f * b).sum() for b in branch] for f in force]
    return jnp.array(rows) / (piece.volume * volume_ratio)


def moved_by(piece: Block, gradient):
    """Displacement (N,) of the homogeneous deformation x -> gradient x."""
    place = jnp.stack(list(piece.network.positions))
    return from_rows((gradient - jnp.eye(3)) @ place)


def deformed(law, piece: Block, before, after, spring):
    """Stress and springs once the deformation gradient has gone from `before` to `after` in one step."""
    there, here = moved_by(piece, after), moved_by(piece, before)
    contacts = contact_forces(law, piece.network, 1.0, there, there - here, None, spring)
    branch = geometry(piece.network, there).branch
    return love_weber(piece, contacts.force, branch, jnp.linalg.det(after)), contacts.spring


stress_after = jit(deformed)
forces_on = jit(all_forces, static_argnums=0)


def unstrained(piece: Block) -> Vector:
    return zeros(piece.network.first.shape, piece.network.dtype)


def test_specimens_are_the_lattices_that_they_are_called():
    """Contacts per inner ball, their length, balls per volume, turns that fit, and the platens' touch."""
    for lattice, orders in (("fcc", (1, 2, 4)), ("bcc", (1, 2, 4)), ("sc", (1, 2, 4)), ("hcp", (1, 3))):
        made = specimen(lattice, 9, 9.0)
        for order in orders:
            assert len(cut_to_sector(made, Sector(order))) < len(made) / order + 10
        network = build_contact_list(made, Sector(1), skin=0.05)
        number = (np.asarray(network.side) != 0).sum(axis=0)
        inner = ~made.membrane_zone & (made.positions[2] > 2) & (made.positions[2] < made.top - 2)
        if lattice != "sc":
            inner &= np.hypot(*made.positions[:2]) < 6
        assert (number[inner] == NEIGHBOURS[lattice]).all() and inner.sum() > 20
        touching = np.asarray(network.distance)[np.asarray(network.image) >= 0]
        np.testing.assert_allclose(touching, 2.0, rtol=1e-12)
        # Each layer's volume per ball: balls of the inner disc, to the accuracy of counting them.
        assert made.positions[2].min() == pytest.approx(1.0) and made.positions[2].max() == pytest.approx(made.top - 1)
        assert made.membrane_zone.any() and not made.membrane_zone[np.hypot(*made.positions[:2]) < 4].any()
    with pytest.raises(ValueError, match="lattice = 'diamond': must be one of bcc, hcp, sc"):
        lattice_cylinder("diamond")
    with pytest.raises(ValueError, match="specimen_radius"):
        lattice_cylinder("sc", 1.0, 3, 2.0)


# Small strain.


@pytest.mark.parametrize("stiffness_ratio", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("lattice", ["fcc", "bcc", "sc"])
def test_elastic_constants(lattice, stiffness_ratio):
    """C11, C12, C44, and nothing else than cubic symmetry allows."""
    piece = block(lattice)
    law = Law(1.0, stiffness_ratio, 1e6, None, None)
    pressed = (1 - 1e-6) * np.eye(3)
    start, _ = stress_after(law, piece, pressed, pressed, unstrained(piece))

    def change(strain):
        strain = 1e-8 * np.asarray(strain, float)
        after, _ = stress_after(law, piece, pressed, pressed - strain, unstrained(piece))
        return np.asarray(after - start) / 1e-8

    c11, c12, c44 = (float(c) for c in elastic_constants(lattice, 1.0, stiffness_ratio, 1.0))
    # FCC's cube axes are at 45 degrees to x and y, which are along its horizontal contacts.
    turn = np.eye(3)
    if lattice == "fcc":
        turn[:2, :2] = np.sqrt(0.5) * np.array([[1, 1], [-1, 1]])
    scale = c11 + c44
    for axis in np.eye(3):
        stress = turn @ change(turn.T @ np.diag(axis) @ turn) @ turn.T
        np.testing.assert_allclose(stress, np.diag(np.where(axis > 0, c11, c12)), atol=1e-5 * scale)
    for i, j in ((0, 1), (1, 2), (0, 2)):
        shear = np.zeros((3, 3))
        shear[i, j] = shear[j, i] = 0.5
        stress = turn @ change(turn.T @ shear @ turn) @ turn.T
        np.testing.assert_allclose(stress, 2 * c44 * shear, atol=1e-5 * scale)


@pytest.mark.parametrize("lattice, order", [("fcc", 1), ("fcc", 4), ("bcc", 4), ("sc", 4), ("hcp", 1), ("hcp", 3)])
def test_isotropic_compression_gives_the_stress_of_the_contact_force(lattice, order):
    """Contact force N everywhere: the stress z N 2r / (6 V) on all sides (FCC: N / (sqrt2 r^2)), in a sector as in the
    full cylinder."""
    piece = block(lattice, Sector(order))
    law, pressed = Law(1.0, 0.8, 0.3, None, None), (1 - 1e-4) * np.eye(3)
    stress, _ = stress_after(law, piece, pressed, pressed, unstrained(piece))
    n = 2e-4
    expected = NEIGHBOURS[lattice] * n * 2 * (1 - 1e-4) / (6 * VOLUME[lattice] * (1 - 1e-4) ** 3)
    if lattice == "fcc":
        assert n == pytest.approx(float(fcc_isotropic_contact_force(expected, 1.0)), rel=3e-4)
    # Within a sector only what all images share is defined: the vertical and the mean horizontal stress.
    stress = np.asarray(stress)
    if order > 1:
        stress = np.diag([0.5 * (stress[0, 0] + stress[1, 1])] * 2 + [stress[2, 2]])
    np.testing.assert_allclose(stress, expected * np.eye(3), atol=1e-9 * expected)


@pytest.mark.parametrize("lattice", ["fcc", "bcc", "hcp", "sc"])
def test_uniform_spin_mode(lattice):
    """All balls turned by a small angle about any axis: moment -I omega^2 angle, omega^2 = (10/3) z ks/m."""
    piece = block(lattice)
    params = unit_params(friction=1e6, shear_stiffness=0.7)
    network = piece.network
    dt, angle = 0.1, 1e-9
    omega = float(uniform_spin_frequency(NEIGHBOURS[lattice], 1.0, 0.7))
    for axis in np.eye(3):
        state = initial_state(SCENE, params, network, [-99.0, 99.0])._replace(
            displacement=moved_by(piece, (1 - 1e-5) * np.eye(3)),
            spin=from_rows(np.outer(axis, np.full(network.radius.size, angle / dt))),
        )
        moment = forces_on(SCENE, params, network, no_load(network), dt, state).moment
        found = np.asarray(moment)[:, piece.centre]
        # The overlap shortens the arm, once in the slip and once in the moment.
        expected = -0.4 * ((1 - 1e-5) * omega) ** 2 * angle * axis
        np.testing.assert_allclose(found, expected, atol=1e-8 * angle)


# Waves.


@pytest.mark.parametrize("share", [0.02, 0.3, 0.7, 1.0])
def test_p_wave_of_fcc_from_the_force_on_a_ball(share):
    """Layers displaced as cos(q z): the force on a ball is -m omega^2 times its displacement, for waves from far longer
    than a layer (omega = c_P q) to the shortest (antiphase layers, the fastest translation)."""
    piece, ratio = block("fcc"), 0.8
    scene, params = Scene(rotation=False), unit_params(friction=1e6, shear_stiffness=ratio)
    network, dt, amplitude = piece.network, 0.1, 1e-9
    q = share * np.pi / np.sqrt(2)
    z = np.asarray(network.positions.z)
    wave = amplitude * np.cos(q * (z - z[piece.centre]))
    pressed = moved_by(piece, (1 - 1e-7) * np.eye(3))
    up = Vector(jnp.zeros_like(z), jnp.zeros_like(z), jnp.asarray(wave))
    rest = initial_state(scene, params, network, [-99.0, 99.0])
    state = rest._replace(displacement=pressed + up, velocity=up * (1 / dt))
    force = np.asarray(forces_on(scene, params, network, no_load(network), dt, state).resultant)[:, piece.centre]
    omega = float(fcc_p_wave_frequency(q, 1.0, 1.0, ratio, 1.0))
    np.testing.assert_allclose(force, [0, 0, -(omega**2) * amplitude], atol=2e-6 * amplitude)
    if share == 0.02:
        speed = float(fcc_p_wave_speed(1.0, 1.0, ratio, 1.0))
        assert np.sqrt(-force[2] / amplitude) / q == pytest.approx(speed, rel=2e-3)


@pytest.mark.parametrize("mode", [1, 4, 9])
def test_standing_wave_on_a_chain_between_platens(mode):
    """Nine balls in a row between platens: each mode swings at 2 sqrt(kn/m) |sin(q r)|, as the leapfrog maps it to
    sin(omega' dt/2) = omega dt/2, to rounding over many periods."""
    count, dt, amplitude = 9, 0.3, 1e-4
    params = unit_params(friction=None)
    squeeze = 0.01
    q = np.pi * mode / (2 * (count + 1))
    omega = float(chain_frequency(q, 1.0, 1.0, 1.0))
    omega = 2 / dt * np.arcsin(omega * dt / 2)
    rest = 1 - squeeze + np.arange(count) * (2 - squeeze)
    top = 2 * count - (count + 1) * squeeze
    shape = amplitude * np.sin(2 * q * np.arange(1, count + 1))
    made = Specimen(np.stack([0 * rest, 0 * rest, rest + shape]), 1.0, 0.0, top, np.ones(count, bool))
    network = build_contact_list(made, Sector(1))
    state = initial_state(SCENE, params, network, [0.0, top])
    before = shape * (1 - np.cos(omega * dt)) / dt
    state = state._replace(velocity=from_rows([0 * rest, 0 * rest, before]))
    steps = 1000
    end = run(params, network, no_load(network), dt, steps, state)
    found = np.asarray(positions(network, end).z) - rest
    np.testing.assert_allclose(found, shape * np.cos(omega * dt * steps), atol=1e-9 * amplitude * steps)


# Strength: the way of a lattice through first slip, peak and softening.

CONFINING = 1e-6  # in units of kn/r: nearly rigid balls


class Way(NamedTuple):
    """stretch: (T, 3) along x, y, z; stress: (T, 3) normal stresses there, compression positive [F/L^2]; off: (T,)
    how far the confining stress is from what was asked for [-]."""

    stretch: np.ndarray
    stress: np.ndarray
    off: np.ndarray


@jax.jit
def _way(law, piece: Block, first, axial, sideways):
    """Stretches along z as given, along x such that s_xx stays CONFINING, along y by `sideways` times the change along
    x."""

    def step(carry, z):
        before, spring = carry

        def stress(x):
            after = jnp.stack([x, before[1] + sideways * (x - before[0]), z])
            tensor, new = deformed(law, piece, jnp.diag(before), jnp.diag(after), spring)
            return tensor[0, 0] / CONFINING - 1, (tensor, new, after)

        def newton(x, _):
            off, slope, _ = jax.jvp(stress, (x,), (jnp.ones(()),), has_aux=True)
            return x - off / slope, None

        x = jax.lax.scan(newton, before[0], None, length=12)[0]
        off, (tensor, spring, after) = stress(x)
        return (after, spring), (after, jnp.diagonal(tensor), off)

    return jax.lax.scan(step, (first, unstrained(piece)), axial)[1]


def way(law, piece, first, axial_strain, sideways=1.0) -> Way:
    first = jnp.asarray(first, float)
    axial = first[2] * (1 - jnp.asarray(axial_strain))
    found = Way(*(np.asarray(a) for a in _way(law, piece, first, axial, sideways)))
    assert np.abs(found.off).max() < 1e-6, "the confining stress is held"
    return found


def isotropic(lattice):
    """Stretches at which the lattice carries CONFINING on all sides."""
    force = CONFINING * 6 * VOLUME[lattice] / (2 * NEIGHBOURS[lattice])
    return np.full(3, 1 - force / 2)


@pytest.mark.parametrize("friction, ratio", [(0.12278, 1.0), (0.3, 1.0), (0.3, 0.6)])
def test_fcc_before_the_peak(friction, ratio):
    """Three straight lines: slope E/s3; after the first slip at R = (1+f)/(1-f) the slope falls by (1+f)/(3-f) (for
    ks = kn); at the strain where the horizontal contacts open the peak 2(1+f)/(1-f) is reached."""
    opening = float(fcc_horizontal_opening_strain(friction, CONFINING, 1.0, 1.0))
    strain = np.linspace(0, 1.2 * opening, 301)
    found = way(Law(1.0, ratio, friction, None, None), block("fcc"), isotropic("fcc"), strain)
    R = found.stress[:, 2] / found.stress[:, 0]
    slip, drop = (float(value) for value in fcc_first_slip(friction, ratio))
    slope = float(fcc_youngs_modulus(1.0, ratio, 1.0)) / CONFINING
    peak = float(fcc_stress_ratio(friction))
    assert R[0] == pytest.approx(1.0, abs=1e-5)

    def line(low, high):
        part = (low < R) & (high > R) & (strain < opening)
        assert part.sum() > 10
        fitted = np.polyfit(strain[part], R[part], 1)
        np.testing.assert_allclose(np.polyval(fitted, strain[part]), R[part], rtol=2e-5)
        return fitted

    sticking = line(1.0, slip - 0.02)
    sliding = line(slip + 0.02, peak - 0.02)
    assert sticking[0] == pytest.approx(slope, rel=1e-4)
    assert sliding[0] / sticking[0] == pytest.approx(drop, rel=1e-4)
    meeting = (sliding[1] - sticking[1]) / (sticking[0] - sliding[0])
    assert np.polyval(sticking, meeting) == pytest.approx(slip, rel=1e-4)
    assert (peak - sliding[1]) / sliding[0] == pytest.approx(opening, rel=1e-4)
    np.testing.assert_allclose(R[strain > 1.02 * opening], peak, rtol=5e-5)


STRENGTHS = [("fcc", TAN_ANGLE_FCC, f) for f in (0.0, 0.12278, 0.3)]
STRENGTHS += [("bcc", TAN_ANGLE_BCC, f) for f in (0.0, 0.12278, 0.3)]
STRENGTHS += [("hcp", TAN_ANGLE_HCP, f) for f in (0.0, 0.12278, 0.3)]


@pytest.mark.parametrize("lattice, tan_angle, friction", STRENGTHS)
def test_strength_and_softening_of_inclined_contacts(lattice, tan_angle, friction):
    """R = 2 (1+f t)/(t (t-f)) at the peak (frictionless FCC, BCC, HCP: 2, 1, 4) and all the way down, t following the
    strain to 2 %; dilatancy 2/t^2; softening rate at the peak, FCC -2 - 2/cos(2 phi)."""
    strain = np.concatenate([np.linspace(0, 1e-4, 100), np.linspace(1.1e-4, 0.02, 100)])
    found = way(Law(1.0, 1.0, friction, None, None), block(lattice), isotropic(lattice), strain)
    R = found.stress[:, 2] / found.stress[:, 0]
    np.testing.assert_allclose(found.stress[:, 1], found.stress[:, 0], rtol=1e-6)
    moving = slice(60, None)
    angle = contact_angle(jnp.asarray(strain), tan_angle)
    expected = np.asarray(inclined_contact_stress_ratio(jnp.tan(angle), friction))
    np.testing.assert_allclose(R[moving], expected[moving], rtol=5e-5)
    peak = float(inclined_contact_stress_ratio(tan_angle, friction))
    assert R.max() == pytest.approx(peak, rel=5e-5) or lattice == "bcc"
    if friction == 0:
        assert R[60] == pytest.approx({"fcc": 2.0, "bcc": 1.0, "hcp": 4.0}[lattice], rel=5e-4)
    late = slice(100, None)
    rate = np.gradient(np.log(R[late]), strain[late])
    middle = 0.5 * (strain[100] + strain[-1])
    slope = np.polyval(np.polyfit(strain[late][1:-1], rate[1:-1], 2), [0.0, middle])
    np.testing.assert_allclose(
        slope, [float(post_peak_softening_rate(friction, e, tan_angle)) for e in (0.0, middle)], rtol=2e-3
    )
    if lattice == "fcc":
        assert slope[0] == pytest.approx(-2 - 2 / np.cos(2 * np.arctan(friction)), rel=2e-3)
    logs = -np.log(found.stretch[late])
    shrinking = np.gradient(logs.sum(axis=1), logs[:, 2])
    np.testing.assert_allclose(1 - shrinking[1:-1], dilatancy(np.tan(angle[late]))[1:-1], rtol=2e-3)


@pytest.mark.parametrize("friction", [0.0, 0.12278, 0.3])
@pytest.mark.parametrize("rate_y", [0.0, 0.4, 1.0])
def test_fcc_in_a_general_stress_state(friction, rate_y):
    """Extension rates (2, 2b, -(1+b)); b = 0 is plane strain, at f = 0.3 s_zz/s_xx = 4.8812 and s_yy/s_xx = 1.9604. The
    horizontal contacts are open from the start, or those along y would keep what they carried."""
    force, gap = 2**0.5 * CONFINING, 2e-6
    first = 1 + np.array([gap, gap, -(force + gap)])
    strain = np.linspace(0, 3e-5, 200)
    found = way(Law(1.0, 1.0, friction, None, None), block("fcc"), first, strain, rate_y)
    stress = found.stress[-1] / found.stress[-1, 0]
    expected = np.asarray(fcc_general_stress(friction, 1.0, rate_y))
    np.testing.assert_allclose(stress, expected / expected[0], rtol=3e-4)
    if rate_y == 0:
        np.testing.assert_allclose(stress[[2, 1]], fcc_plane_strain_ratios(friction), rtol=3e-4)
        if friction == 0.3:
            np.testing.assert_allclose(stress[[2, 1]], [4.8812, 1.9604], rtol=3e-4)


# A whole specimen in balance.


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 4])
def test_forces_on_platens_and_membrane_are_the_contacts_stress(order):
    """Virial theorem on a confined octagon: the contacts' f_z l_z add up to platen force times the end balls' distance,
    their horizontal part to the sum of membrane force times radius, in a sector as in the whole."""
    test = TriaxialTest(fcc_octagon(layers=3, half_width=3), Sector(order), tolerance=1e-8)
    state, _ = test.confine()
    network, params, scene = test.network, replace(test.params, friction=None, damping=None), Scene(rotation=False)
    still_state = state._replace(velocity=zeros(network.radius.shape, network.dtype))
    load = membrane_load(test.membrane, positions(network, state), *state.platens)
    forces = forces_on(scene, params, network, load, test.prepared.time_step, still_state)
    branch, force = geometry(network, state.displacement).branch, forces.contacts.force
    place = positions(network, state)
    vertical = float((network.share * force.z * branch.z).sum())
    horizontal = float((network.share * (force.x * branch.x + force.y * branch.y)).sum())
    weight = np.asarray(network.weight)
    bottom, top = (np.asarray(push) * weight for push in forces.platen_push)
    assert bottom.sum() == pytest.approx(top.sum(), rel=1e-6)
    z = np.asarray(place.z)
    assert vertical == pytest.approx((top * z).sum() - (bottom * z).sum(), rel=1e-6)
    radial = float((radial_distance(place) * load.lateral).sum()) * params.confining_stress
    assert horizontal == pytest.approx(radial, rel=1e-6)
    assert top.sum() == pytest.approx(params.confining_stress * float(load.section), rel=1e-6)
