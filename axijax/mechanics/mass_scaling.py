"""Mass scaling ball by ball: small balls are made heavier, so that they do not set the time step of all others.

What a quasi-static test passes through does not depend on masses; its time step does, being 2/omega of the fastest
mode (sqrt(1 + xi^2) - xi), and in a wide grading that is a mode of some small balls. So each ball gets the mass, and
with it the moment of inertia, that its own critical time step asks for. With k_i the stiffness of ball i against its
own motion, no ball is lighter than

    m_i = c k_i,    c such that the critical time step is `times` that of true masses,

and those that are heavier keep their true mass. Were all others held, its own critical step would be 2 sqrt(m_i/k_i);
for two that move against each other k/2 (u - v)^2 is at most k u^2 + k v^2 (Gershgorin), so 2 sqrt(c/2) is a lower
bound of the step without dashpots. Contacts come and go during a test: no k_i is taken for less than is usual for its
size, the area on which balls of mean size can touch it. Scaled densities in quasi-static tests: Thornton & Antony 1998,
Cui & O'Sullivan 2005; ball by ball: PFC's differential density scaling, YADE's `densityScaling`.

How quasi-static a test is, the inertial number says: the time in which the confining stress s3 moves a ball of
diameter d and mass m by about d, over that in which the strain does. From m d/t^2 = s3 d^2 the first is
sqrt(m/(s3 d)), or d sqrt(rho/s3) as it is usually written without the factor sqrt(pi/6) (GDR MiDi 2004); with a mass
factor_i times the true one

    I_i = rate d_i sqrt(rho factor_i/s3).

Scaled masses leave a test's results as they are while this stays small for every ball (Sheng, Lawrence & Thornton 2004
say so of the unbalanced force, which it sets).
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from axijax import theory
from axijax.mechanics.contact_list import ContactList, with_mass_factor
from axijax.mechanics.damping import BackgroundDamping
from axijax.mechanics.dynamics import Scene
from axijax.mechanics.dynamics import spins as scene_spins
from axijax.mechanics.linearised import closed_contacts, plates
from axijax.mechanics.params import Params
from axijax.mechanics.time_step import critical_time_step

QUASI_STATIC = 1e-3  # largest inertial number of any ball
NEAR = 0.01  # within which the time step comes to what is asked for
ROUGH = 1e-3  # accuracy of squared frequencies, of which scaled masses make many alike, hard to tell apart
TRIALS = 20  # of c; each brings the step nearer by its own error, and three or four do


def scaled(scene: Scene, params: Params, network: ContactList, times: float) -> ContactList:
    """The network with masses for a critical time step `times` as long as with true ones, to 1 % (host).

    Masses follow from the network's contacts and from the stiffness in `params`, and are constants from then on: no
    derivative passes through them, and another stiffness has the same masses and another critical step.

    Raises ValueError where damping acts on masses.
    """
    if isinstance(params.material.damping, BackgroundDamping):
        raise ValueError(
            f"mass_scaling = {times:g}: damping in proportion to mass would hold scaled balls back more than true ones "
            "and add strength; take damping = 'dashpot' or 'local', or leave mass_scaling out."
        )
    network = with_mass_factor(network, None)
    true = np.asarray(params.material.mass(network), float)
    wanted = times * critical_time_step(scene, params, network, accuracy=ROUGH)
    stiffness = usual_stiffness(scene, params, network)
    # The lower bound of the step, or nearly so, from which it is approached.
    least = stiffness * (true / stiffness).min() * 2 * times**2
    for _ in range(TRIALS):
        factor = np.round(np.maximum(least / true, 1.0), 3)  # what no rounding of another machine changes
        found = with_mass_factor(network, jnp.asarray(factor, network.dtype))
        step = critical_time_step(scene, params, found, accuracy=ROUGH)
        if abs(step / wanted - 1) < NEAR:
            return found
        least = least * (wanted / step) ** 2
    raise ValueError(
        f"mass_scaling = {times:g}: no masses were found for a critical time step of {wanted:.4g}; the nearest is "
        f"{step:.4g}. Something stiff acts on the balls that does not depend on their masses: leave mass_scaling out."
    )


def inertial_numbers(params: Params, network: ContactList, rate: float) -> np.ndarray:
    """Inertial number of each ball, by its diameter and the mass that it has, (N,) [-]; rate: of axial strain [1/T]."""
    number = theory.inertial_number(rate, network.radius, params.density, params.confining_stress)
    return np.asarray(number if network.mass_factor is None else number * jnp.sqrt(network.mass_factor))


def check_quasi_static(params: Params, network: ContactList, rate: float, times: float) -> None:
    """Raise ValueError where masses are scaled and the inertial number of any ball is above QUASI_STATIC."""
    numbers = inertial_numbers(params, network, rate)
    worst = numbers.argmax()
    if numbers[worst] > QUASI_STATIC:
        raise ValueError(
            f"mass_scaling = {times:g}: balls of radius {float(network.radius[worst]):.4g} would have an inertial "
            f"number of {numbers[worst]:.2g}, and above {QUASI_STATIC:g} a test is not quasi-static: lower "
            f"mass_scaling, or platen_speed to {QUASI_STATIC / numbers[worst]:.2g} of what it is."
        )


def usual_stiffness(scene: Scene, params: Params, network: ContactList, touching_within: float = 1e-3) -> np.ndarray:
    """Stiffness of each ball against its own motion, or what is usual for its size where that is more, (N,) [F/L].

    Of a material that does not say how stiff it is, in arbitrary units, by size alone.
    """
    radius = np.asarray(network.radius, float)
    room = (radius + radius.mean()) ** 2
    found = params.material.stiffest(network, params.confining_stress, touching_within)
    if found is None:
        return room
    own = own_stiffness(scene, params, network, found, touching_within)
    return np.maximum(own, room * (own / room)[own > 0].mean())


def own_stiffness(
    scene: Scene, params: Params, network: ContactList, constants: Any, touching_within: float
) -> np.ndarray:
    """Largest stiffness of each ball against its own motion, translation and spin, all others held; (N,) [F/L].

    constants: what `Material.stiffest` says. Spins count as omega r sqrt(0.4), whose inertia is the mass.
    """
    material, (pressed, held, of_wall) = params.material, constants
    closed = closed_contacts(network, touching_within) & (np.asarray(network.image) >= 0)
    slot = np.asarray(network.slot)
    side = np.where(closed[slot], np.asarray(network.side, float), 0.0)
    cos, sin = np.asarray(network.slot_cos, float), np.asarray(network.slot_sin, float)
    x, y, z = (np.asarray(network.branch, float) / np.asarray(network.distance, float))[:, slot]
    normal = side * np.stack([cos * x - sin * y, sin * x + cos * y, z])
    along, across = (np.where(side != 0, np.broadcast_to(k, closed.shape)[slot], 0.0) for k in (pressed, held))
    rows = zip(along, across * material.frictional, normal.swapaxes(0, 1), strict=True)
    own = np.sum([_of_contacts(*row) for row in rows], axis=0)
    for plate in plates(network, touching_within):
        along, across = of_wall(plate.balls, plate.area, -plate.gap[plate.balls])
        across = across * (getattr(material, plate.friction) is not None)
        own[plate.balls] += _of_contacts(along, across, np.repeat(plate.normal[:, None], plate.balls.size, axis=1))
    return np.linalg.eigvalsh(own if scene_spins(scene, params) else own[:, :3, :3])[:, -1]


def _of_contacts(along, across, normal: np.ndarray) -> np.ndarray:
    """(N, 6, 6) stiffness of one contact a ball, normal and tangential (N,) or numbers; normal: (3, N)."""
    x, y, z = normal
    none = np.zeros_like(x)
    outer = np.einsum("in,jn->nij", normal, normal)
    plane = np.eye(3) * (normal**2).sum(0)[:, None, None] - outer
    turn = np.moveaxis(np.array([[none, -z, y], [z, none, -x], [-y, x, none]]), 2, 0)
    along, across = (np.broadcast_to(k, x.shape)[:, None, None] for k in (along, across))
    arm = across * turn / 0.4**0.5
    return np.block([[along * outer + across * plane, arm], [-arm, across * plane / 0.4]])
