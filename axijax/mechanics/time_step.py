"""The critical time step of a network, from its stiffest modes (host, SciPy's sparse eigenvalue solver)."""

import numpy as np

from axijax.mechanics.contact_list import ContactList
from axijax.mechanics.dynamics import Scene, terms_of
from axijax.mechanics.dynamics import spins as scene_spins
from axijax.mechanics.linearised import Operators, closed_contacts, coordinates, linearised, plates
from axijax.mechanics.params import Params

# Largest share of the critical time step that is accepted, and the share taken by default. Past the limit nothing
# blows up: the Coulomb cap bounds the motion and the peak silently falls, so the limit is kept at arm's length.
SAFE_STEP = 0.8
DEFAULT_STEP = 0.6


def critical_time_step(
    scene: Scene, params: Params, network: ContactList, touching_within: float = 1e-3, accuracy: float | None = None
) -> float:
    """Largest stable time step 2/omega (sqrt(1 + xi^2) - xi) of the actual network [T] (host).

    The least over all modes of the linearised system with every contact stuck, translations and spins together:
    frequency omega, damping ratio xi from the dashpots, which lower the limit (O'Sullivan & Bray 2004 for the
    undamped part). Found by a sparse eigenvalue solver. With dashpots it need not be the fastest mode's: where
    ks < kn they damp spins more. Contacts count as closed where the gap is below touching_within of the ball's radius.
    accuracy: relative, of a squared frequency; None: 1e-6, or 1e-3 where that takes long.

    A stiffness that depends on the load is that at the load to come: `hertz.OVERLOAD` times the mean contact force
    under the confining stress, or at the overlap of the network where that is deeper. A scene with a term that
    stiffens, or with a material that does not say how stiff it is, is linearised by `axijax.mechanics.linearised`,
    which takes longer: a program is compiled.
    """
    operators = None
    if not any(term.stiffens for term in terms_of(params)):
        operators = springs_and_dashpots(scene, params, network, touching_within)
    if operators is None:
        operators = linearised(scene, params, network, touching_within)
    # Beside a margin of 0.8 three digits are enough where more would take minutes.
    return _limit(operators, accuracy or (1e-6 if network.radius.size < 3000 else 1e-3))


def springs_and_dashpots(
    scene: Scene, params: Params, network: ContactList, touching_within: float
) -> Operators | None:
    """What `axijax.mechanics.linearised.linearised` finds of contacts, their resistance to rotation, and walls, written
    by hand; None where the material does not say how stiff it is."""
    material = params.material
    found = material.stiffest(network, params.confining_stress, touching_within)
    if found is None:
        return None
    normal_constant, shear_constant, wall_constants = found
    radius = np.asarray(network.radius, float)
    closed = closed_contacts(network, touching_within)
    first, second = np.asarray(network.first)[closed], np.asarray(network.second)[closed]
    normal = (np.asarray(network.branch) / np.asarray(network.distance))[:, closed]
    cos, sin = np.asarray(network.cos, float)[closed], np.asarray(network.sin, float)[closed]
    share_of_contact = np.asarray(network.share, float)[closed]
    mass = float(np.asarray(material.density)) * 4 / 3 * np.pi * radius**3
    if network.mass_factor is not None:
        mass = mass * np.asarray(network.mass_factor, float)
    spins = scene_spins(scene, params)
    share = np.asarray(network.weight, float)
    scale, free = coordinates(network, mass, spins)
    count = radius.size
    constants = [np.broadcast_to(k, network.first.shape)[closed] for k in (normal_constant, shear_constant)]
    stiffness = constants[0], constants[1] * material.frictional
    beta = float(np.asarray(material.kind_of_damping.viscosity_ratio or 0.0)) * material.dashpot_factor
    reduced = 1 / (1 / mass[first] + 1 / mass[second])
    turns, arms = material.torsion or material.rolling, radius[first] * radius[second]
    # Resistance to torsion and to rolling, over the radii's product.
    turning = [
        constants[1] * (0.0 if part is None else float(np.asarray(part.ratio_and_friction()[0])))
        for part in (material.torsion, material.rolling)
    ]
    viscosity = [2 * beta * np.sqrt(constant * reduced) for constant in stiffness]

    # Ball-plate contacts as springs to the ground.
    ground = []
    for plate in plates(network, touching_within):
        balls = plate.balls
        pressed, held = wall_constants(balls, plate.area, -plate.gap[balls])
        both = pressed, held * (getattr(material, plate.friction) is not None)
        ground.append((balls, plate.normal, both, [2 * beta * np.sqrt(k * mass[balls]) for k in both]))

    def turned(vectors, sine):
        x, y, z = vectors
        return np.stack([cos * x - sine * y, sine * x + cos * y, z])

    def collect(balls, vectors):
        return np.stack([np.bincount(balls, row, count) for row in vectors])

    def apply(vector, normal_constant, shear_constant, viscous):
        motion = (vector.reshape(-1, count) * scale * free).reshape(-1, 3, count)
        relative = motion[0][:, first] - turned(motion[0][:, second], sin)
        if spins:
            surface = radius * motion[1]
            relative -= np.cross(surface[:, first] + turned(surface[:, second], sin), normal, axis=0)
        along = (relative * normal).sum(0) * normal
        force = share_of_contact * (normal_constant * along + shear_constant * (relative - along))
        result = np.zeros_like(motion)
        result[0] = collect(first, force) - collect(second, turned(force, -sin))
        if spins:
            arm = np.cross(force, normal, axis=0)
            result[1] = radius * (collect(first, arm) + collect(second, turned(arm, -sin)))
            if not viscous and turns:
                relative = motion[1][:, first] - turned(motion[1][:, second], sin)
                along = (relative * normal).sum(0) * normal
                moment = share_of_contact * arms * (turning[0] * along + turning[1] * (relative - along))
                result[1] += collect(first, moment) - collect(second, turned(moment, -sin))
        for balls, inward, *constants in ground:
            direction = inward[:, None]
            pressed, held = constants[viscous]
            along = inward @ motion[0][:, balls] * direction
            slip = motion[0][:, balls] - along
            if spins:
                slip -= np.cross(surface[:, balls], direction, axis=0)
            force = share[balls] * (pressed * along + held * slip)
            result[0][:, balls] += force
            if spins:
                result[1][:, balls] += radius[balls] * np.cross(force, direction, axis=0)
        return (result.reshape(-1, count) * scale * free).ravel()

    def stiff(vector):
        return apply(vector, *stiffness, viscous=False)

    def viscous(vector):
        return apply(vector, *viscosity, viscous=True)

    return Operators(scale.size, stiff, viscous)


def _limit(operators: Operators, accuracy: float) -> float:
    """The critical time step of a linearised scene [T]."""
    from scipy.sparse.linalg import LinearOperator, eigsh

    size, stiff, viscous = operators
    start = np.random.default_rng(0).standard_normal(size)

    def fastest(action):
        operator = LinearOperator((size, size), action, dtype=float)
        return eigsh(operator, k=1, which="LA", v0=start, tol=accuracy)[1][:, 0]

    # At the limit dt a mode changes sign at every step, (dt^2 K + 2 dt C) u = 4 M u. Any u gives an upper bound; that
    # of the largest eigenvalue at the last bound gives a better one, until none does. Without dashpots the first is it.
    mode = fastest(stiff)
    step = np.inf
    while True:
        square, rate = mode @ stiff(mode), mode @ viscous(mode)
        if square <= 0:
            raise ValueError("critical time step: no contact is closed, so there is no frequency to resolve.")
        last, step = step, float(4 / (rate + np.sqrt(rate**2 + 4 * square)))
        if rate == 0 or step > last * (1 - accuracy):
            return min(step, last)
        mode = fastest(lambda vector, dt=step: dt * stiff(vector) + 2 * viscous(vector))


def check_step(step, limit: float) -> None:
    """Raise ValueError where a time step [T] is longer than SAFE_STEP of the critical one."""
    if step > SAFE_STEP * limit * (1 + 1e-9):
        raise ValueError(
            f"time_step = {step:.4g}: must be at most {SAFE_STEP:g} of the critical time step {limit:.4g}, that is "
            f"{SAFE_STEP * limit:.4g}; beyond it contacts chatter and the strength falls without any other sign."
        )
