"""The critical time step against lattice dynamics and against the step itself, and what is refused."""

import warnings
from dataclasses import replace
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from axijax import Dashpot, LocalDamping, Params, Scene, theory
from axijax.core.sector import Sector
from axijax.core.status import UNSTABLE
from axijax.core.vector import Vector
from axijax.mechanics.contact_list import build_contact_list
from axijax.mechanics.dynamics import initial_state, make_step, positions
from axijax.mechanics.membrane import Load, membrane_load
from axijax.mechanics.time_step import SAFE_STEP, critical_time_step
from axijax.specimen.specimen import Specimen, cut_to_sector, fcc_octagon
from axijax.triaxial.records import CHATTER, SimulationError
from axijax.triaxial.test import TriaxialTest

RADIUS, STIFFNESS, DENSITY = 20.0, 1.5e9, 2000.0
MASS = 4 / 3 * np.pi * RADIUS**3 * DENSITY
UNIT = (MASS / STIFFNESS) ** 0.5  # sqrt(m/K)
SCENE = Scene()
QUARTER, FULL, RIGID = Sector(4), Sector(1), Sector(4, "rigid")


@lru_cache
def octagon_network(sector, layers=25, half_width=9):
    return build_contact_list(cut_to_sector(fcc_octagon(RADIUS, layers, half_width), sector), sector)


def limit(network, scene=SCENE, damping=None, **params):
    """Critical time step over sqrt(m/K), undamped by default."""
    return critical_time_step(scene, Params(damping=damping, **params), network) / UNIT


def loose(points, **options):
    """ContactList of balls at points (3, N) [L] in the full cylinder; a platen far off touches two others."""
    points = np.concatenate([points, [[0, 0], [0, 0], [-500, 500]]], 1)
    zone = np.ones(points.shape[1], bool)
    return build_contact_list(Specimen(points, RADIUS, -520.0, 520.0, zone), FULL, **options)


def cubic_block(lattice, size):
    """size^3 cells of a simple or a body-centred cubic lattice of touching balls."""
    edge = 2 * RADIUS * (1.0 if lattice == "sc" else 2 / 3**0.5)
    grid = np.stack(np.meshgrid(*[np.arange(size)] * 3, indexing="ij")).reshape(3, -1).astype(float)
    points = grid if lattice == "sc" else np.concatenate([grid, grid + 0.5], 1)
    skin = 0.1 * RADIUS
    return loose(edge * (points - (size - 1) / 2), skin=skin)


def test_the_octagon_undamped():
    """PHYSICS 3.5: 0.3197 sqrt(m/K) by an independent program, just above the lattice's 0.3162."""
    lattice = theory.lattice_critical_time_step("fcc", MASS, STIFFNESS, STIFFNESS)
    assert float(lattice) / UNIT == pytest.approx(0.1**0.5, rel=1e-12)
    full = limit(octagon_network(FULL))
    assert full == pytest.approx(0.3197, abs=5e-5)
    assert full > 0.1**0.5


def test_the_quarter_has_the_modes_of_the_full_cylinder_that_it_can_have():
    """Those alike in every sector: no faster than the fastest of all, and here hardly slower."""
    assert limit(octagon_network(FULL)) <= limit(octagon_network(QUARTER)) < 0.3201


def test_without_rotation():
    assert 0.5 < limit(octagon_network(QUARTER), Scene(rotation=False)) < 0.5 * 1.005


def test_without_friction_nothing_but_the_normal_springs_counts():
    """FCC's translation mode sqrt(8 kn/m): 2 / sqrt(8)."""
    assert 0.5**0.5 < limit(octagon_network(QUARTER), friction=None) < 0.5**0.5 * 1.02


def test_one_pair():
    """Two balls rolling against each other, omega^2 = 7 ks/m: 2/sqrt(7) sqrt(m/K)."""
    pair = loose(np.array([[-RADIUS, RADIUS], [0, 0], [0, 0]]))
    assert limit(pair) == pytest.approx(2 / 7**0.5, rel=1e-9)
    assert pytest.approx(0.756, abs=5e-4) == 2 / 7**0.5
    assert limit(pair, normal_stiffness=9 * STIFFNESS) == pytest.approx(2 / 18**0.5, rel=1e-9), "now the normal mode"


@pytest.mark.parametrize(("lattice", "known"), [("bcc", 0.3873), ("sc", 0.4472)])
def test_other_cubic_lattices(lattice, known):
    """From above, and closer the larger the block: its surface has fewer contacts."""
    expected = float(theory.lattice_critical_time_step(lattice, MASS, STIFFNESS, STIFFNESS)) / UNIT
    assert expected == pytest.approx(known, abs=5e-5)
    small, large = (limit(cubic_block(lattice, size)) / expected - 1 for size in (4, 9))
    assert 0 < large < 0.03 and large < 0.35 * small


@pytest.mark.parametrize("damping_ratio", [0.0, 0.05, 0.3])
@pytest.mark.parametrize("stiffness_ratio", [1.0, 0.5, 2 / 7, 0.2, 0.1])
def test_stiffness_ratio_and_dashpots(stiffness_ratio, damping_ratio):
    """Against the lattice's two modes. Around ks/kn = 0.2 dashpots make the spin mode the worst although it is not
    the fastest: there 2/omega (sqrt(1 + xi^2) - xi) of the fastest mode alone is up to 46 % too long."""
    expected = theory.lattice_critical_time_step("fcc", MASS, STIFFNESS, stiffness_ratio * STIFFNESS, damping_ratio)
    found = limit(octagon_network(QUARTER), damping=Dashpot(damping_ratio), shear_stiffness=stiffness_ratio * STIFFNESS)
    assert 1 < found / (float(expected) / UNIT) < 1.035


@pytest.mark.parametrize(("damping_ratio", "known"), [(0.05, 0.25), (0.1, 0.21), (0.3, 0.105)])
def test_dashpots_lower_the_limit(damping_ratio, known):
    """The lattice's values of PHYSICS 3.5, given to two or three figures; the octagon is 2 % above at most."""
    assert limit(octagon_network(QUARTER), damping=Dashpot(damping_ratio)) == pytest.approx(known, rel=0.03)


# Scenes whose step is linearised: sector, scene, and what of the parameters differs from the paper's.
LINEARISED = {
    "undamped": (QUARTER, Scene(), {"damping_ratio": 0.0}),
    "dashpots": (QUARTER, Scene(), {"damping_ratio": 0.1}),
    "strong dashpots": (QUARTER, Scene(), {"damping_ratio": 0.3}),
    "full cylinder": (FULL, Scene(), {"damping_ratio": 0.05}),
    "rigid planes": (RIGID, Scene(), {"damping_ratio": 0.1}),
    "no rotation": (QUARTER, Scene(rotation=False), {"damping_ratio": 0.1}),
    "soft shear": (QUARTER, Scene(), {"damping_ratio": 0.3, "shear_stiffness": 0.2 * STIFFNESS}),
    "stiff shear": (QUARTER, Scene(), {"damping_ratio": 0.05, "shear_stiffness": 3 * STIFFNESS}),
}


def still(params, network, dt, state, push, section):
    """A drive that holds the platens."""
    return jnp.zeros(2, push.dtype)


def squeezed(sector, scene, layers=5):
    """ContactList and state of a small octagon with every contact closed and nothing near the Coulomb limit."""
    network = octagon_network(sector, layers, 3)
    place = positions(network, initial_state(scene, Params(), network, jnp.zeros(2)))
    platens = jnp.array([0.0, RADIUS * (2 + (layers - 1) * 2**0.5)])
    state = initial_state(scene, Params(), network, platens)
    middle = platens.mean()
    shrink = Vector(place.x, place.y, place.z - middle) * -1e-6
    return network, state._replace(displacement=shrink, platens=middle + (platens - middle) * (1 - 2e-6))


@lru_cache
def linearised_step(sector, scene):
    """Function (params, dt) -> the matrix that one step multiplies a small disturbance of a squeezed specimen with."""
    network, state = squeezed(sector, scene, 3 if sector is FULL else 5)
    balls = jnp.zeros(network.radius.shape)
    step = make_step(scene, still)
    flat, shape = ravel_pytree((state.displacement, state.velocity, state.spin, state.spring))

    @jax.jit
    def matrix(params, dt):
        def one_step(moved):
            displacement, velocity, spin, spring = shape(moved)
            before = state._replace(displacement=displacement, velocity=velocity, spin=spin).with_spring(spring)
            after = step(params, network, Load(balls, jnp.ones(())), dt, before)
            return ravel_pytree((after.displacement, after.velocity, after.spin, after.spring))[0]

        return jax.jacfwd(one_step)(flat)

    return network, matrix


@pytest.mark.parametrize("case", LINEARISED)
def test_the_step_itself_amplifies_just_above_the_limit_and_not_below(case):
    """The largest eigenvalue of the linearised `make_step`, an independent way to the same limit."""
    sector, scene, changes = LINEARISED[case]
    params = Params(friction=1e6, **changes)
    network, matrix = linearised_step(sector, scene)
    critical = critical_time_step(scene, params, network)

    def growth(dt):
        return np.abs(np.linalg.eigvals(np.asarray(matrix(params, dt)))).max()

    # A frequency 1 % above what a step resolves grows by 2 % a step at least; the squeeze itself changes 1e-3.
    assert growth(0.995 * critical) < 1.005
    assert growth(1.01 * critical) > 1.015


def test_a_disturbance_blows_up_above_the_limit_and_not_below():
    """A confined block whose contacts always stick, against the same block disturbed by 1e-14 of a radius per step."""
    undamped = Params(friction=1e6, damping_ratio=0.0)
    test = TriaxialTest(fcc_octagon(layers=3, half_width=3), params=undamped)
    confined, _ = test.confine()
    network, scene = test.network, test.scene
    start = initial_state(scene, undamped, network, confined.platens)._replace(displacement=confined.displacement)
    load = membrane_load(test.membrane, positions(network, start), *start.platens)
    noise = np.random.default_rng(1).standard_normal((3, network.radius.size)) * np.asarray(network.free)
    step = make_step(scene, still)

    @jax.jit
    def run(params, dt, size):
        state = start._replace(velocity=Vector(*(jnp.asarray(row) * size / dt for row in noise)))
        advance = partial(step, params, network, load, dt)
        return jax.lax.scan(lambda s, _: (advance(s), None), state, None, length=400)[0]

    for params in (undamped, replace(undamped, damping_ratio=0.1)):
        critical = critical_time_step(scene, params, network)
        spread = []
        for dt in (0.98 * critical, 1.02 * critical):
            calm, disturbed = run(params, dt, 0.0), run(params, dt, 1e-14 * RADIUS)
            spread.append(float(jnp.abs(disturbed.spin.x - calm.spin.x).max()) * dt / 1e-14)
        assert spread[0] < 100
        assert not spread[1] < 1e10


@pytest.mark.parametrize("damping", [Dashpot(), LocalDamping(), None])
def test_a_step_above_the_safe_one_is_refused_with_the_limit(damping):
    default = TriaxialTest(fcc_octagon(layers=3, half_width=3), params=Params(damping=damping))
    critical = critical_time_step(default.scene, default.params, default.network)
    assert default.prepared.time_step < SAFE_STEP * critical
    accepted = replace(default, time_step=0.999 * SAFE_STEP * critical)
    assert accepted.prepared.time_step == 0.999 * SAFE_STEP * critical
    with pytest.raises(ValueError) as caught:
        replace(default, time_step=1.001 * SAFE_STEP * critical).prepared  # noqa: B018
    for number in (1.001 * SAFE_STEP * critical, SAFE_STEP * critical, critical):
        assert f"{number:.4g}" in str(caught.value)


def test_a_safe_step_of_the_tests_parameters_is_not_one_of_others():
    """`run` looks at the limit of the parameters that it is given; a ball ten times stiffer is refused."""
    test = TriaxialTest(fcc_octagon(layers=3, half_width=3))
    with pytest.raises(ValueError, match="critical time step"):
        test.run(replace(test.params, normal_stiffness=10 * STIFFNESS, shear_stiffness=10 * STIFFNESS))


SMALL, OF_THE_PAPER = (15, 7), (25, 9)  # layers and half width of an octagon


@lru_cache
def peak(damping, step, friction, boundary="periodic", axial_strain=0.006, size=SMALL):
    """Peak stress ratio of a quarter at a step in sqrt(m/K), and the error that was raised, if any.

    Any warning, such as that of chatter before the peak, is an error here. Past the peak the platens go three times as
    fast: what can chatter then moves more.
    """
    test = TriaxialTest(
        fcc_octagon(layers=size[0], half_width=size[1]),
        Sector(4, boundary),
        params=Params(friction=friction, damping=damping, platen_speed=0.01 if axial_strain < 0.01 else 0.03),
        axial_strain=axial_strain,
        time_step=step * UNIT,
        tolerance=1e-5,
        allow_unsafe_step=True,
    )
    try:
        return float(test.run().curve.stress_ratio.max()), None
    except SimulationError as error:
        return float(error.curve.stress_ratio.max()), error


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("damping", "step", "friction"),
    [
        (LocalDamping(), 0.30, 0.3),
        (LocalDamping(), 0.32, 0.12278),
        (Dashpot(0.3), 0.15, 0.3),
        (Dashpot(0.3), 0.18, 0.05),
    ],
)
def test_the_guard_catches_the_silent_wrong_peaks(damping, step, friction):
    """PHYSICS 3.5: past the limit the Coulomb cap hides the instability; the peak is finite, plausible and wrong."""
    wrong, error = peak(damping, step, friction)
    right, none = peak(Dashpot(), 0.1, friction)
    assert none is None
    assert 1 < wrong < 0.99 * right, "wrong, without any other sign"
    assert error is not None and int(error.curve.status) == UNSTABLE
    assert "lower time_step" in str(error)
    assert error.curve.chatter.max() > 10 * CHATTER


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("damping", "step", "friction", "boundary", "axial_strain"),
    [
        (LocalDamping(), 0.24, 0.3, "periodic", 0.006),  # the limit is 0.245, and past it contacts may chatter indeed
        (LocalDamping(), 0.24, 0.05, "periodic", 0.006),
        (LocalDamping(), 0.24, 0.12278, "periodic", 0.05),
        (LocalDamping(), 0.24, 0.12278, "rigid", 0.006),
        (Dashpot(0.05), 0.15, 0.02, "periodic", 0.006),
        (Dashpot(0.05), 0.15, 0.12278, "rigid", 0.006),
        (Dashpot(0.05), 0.15, 0.3, "periodic", 0.05),
        (Dashpot(0.05), 0.15, 0.9, "periodic", 0.02),
        (Dashpot(0.3), 0.08, 0.3, "periodic", 0.006),
    ],
)
def test_the_guard_raises_no_false_alarm(damping, step, friction, boundary, axial_strain):
    size = OF_THE_PAPER if boundary == "rigid" else SMALL
    assert peak(damping, step, friction, boundary, axial_strain, size)[1] is None


@pytest.mark.slow
def test_local_damping_at_a_quarter_has_the_right_peak():
    """0.25 sqrt(m/K) at f = 0.3 lies just above the limit with local damping, 0.3199 / sqrt(1.7) = 0.245: contacts may
    chatter on the way up, of which `run` warns, and are quiet at the peak, which is right."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found, error = peak(LocalDamping(), 0.25, 0.3)
    assert error is None
    assert found == pytest.approx(peak(Dashpot(), 0.1, 0.3)[0], rel=3e-3)
