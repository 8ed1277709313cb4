"""What all materials of balls have in common; `axijax.mechanics.linear` and `axijax.mechanics.hertz` are the two that
come with it.

A material is a tree of parts, and a part that is None is not there: not compiled, not stored, not differentiated. So
`Linear(friction=None)` has no tangential springs and nothing spins, and `Linear(damping=None)` no dashpots.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp

from axijax.core.quantity import part, quantity
from axijax.mechanics.damping import UNDAMPED, Damping, Dashpot
from axijax.mechanics.rolling import Rolling, Torsion

if TYPE_CHECKING:
    from axijax.mechanics.contact_list import ContactList
    from axijax.mechanics.contacts import ContactLaw
    from axijax.mechanics.walls import WallLaw


@dataclass(frozen=True, kw_only=True)
class Material:
    """Parts that every material has; frictional balls with dashpots in their contacts by default.

    A subclass, from outside the package too, adds its own parameters with `quantity` and defines the methods below, of
    which `stiffest` only saves time and `stiffness_over` serves fits of stiffnesses alone;
    `axijax.core.tree.pytree` makes it one.
    """

    friction: jax.Array | float | None = quantity(
        0.12278,
        "Coulomb coefficient between balls; a scene without friction has none",
        "-",
        symbols=("f", "mu"),
        coordinate="logit",
        per_ball=True,
        optional=True,
    )
    density: jax.Array | float = quantity(2000.0, "density of the balls", "M/L^3", above=0.0, symbols=("rho",))
    platen_friction: jax.Array | float | None = quantity(
        None,
        "Coulomb coefficient between balls and platens; left out: smooth, inf: glued",
        "-",
        infinite=True,
        optional=True,
    )
    plane_friction: jax.Array | float | None = quantity(
        None,
        "Coulomb coefficient between balls and rigid sector planes; none: smooth, inf: glued",
        "-",
        infinite=True,
        optional=True,
    )
    damping: Damping | None = Dashpot()
    rolling: Rolling | None = part(Rolling, "resistance to rolling")
    torsion: Torsion | None = part(Torsion, "resistance to spinning about the contact's normal")

    @property
    def frictional(self) -> bool:
        """Whether contacts carry tangential springs."""
        return self.friction is not None

    @property
    def rough_walls(self) -> bool:
        """Whether any wall carries tangential springs."""
        return self.platen_friction is not None or self.plane_friction is not None

    @property
    def kind_of_damping(self) -> Damping:
        return UNDAMPED if self.damping is None else self.damping

    @property
    def mass_per_cube(self):
        """True mass of a ball over its radius cubed [M/L^3], for weights; what resists motion is `mass`."""
        return self.density * (4 / 3) * jnp.pi

    def mass(self, network: "ContactList"):
        """Mass of each ball as it resists motion, (N,) [M]; 0.4 radius^2 times it is the moment of inertia. The true
        one, times the network's mass factor where there is one."""
        # In the order in which packings were always made, whose balls are heavier too: another rounds another way.
        if network.mass_factor is None:
            return self.mass_per_cube * network.radius**3
        return self.density * network.mass_factor * (4 / 3) * jnp.pi * network.radius**3

    def reduced_mass(self, network: "ContactList"):
        """m1 m2/(m1 + m2) of the contacts' balls, (C,) or one number where all balls are alike [M]."""
        return self.mass_per_cube * network.pair_cube

    def contact_friction(self, network: "ContactList"):
        """Friction coefficient of the contacts: one, or the mean of the two balls' where given per ball [-]."""
        friction: Any = self.friction
        if jnp.ndim(friction) == 0:
            return friction
        first, second = network.numbers_at_ends(friction)
        return 0.5 * (first + second)

    def contact_law(self, network: "ContactList") -> "ContactLaw":
        """The law of the contacts of balls."""
        raise NotImplementedError

    def wall_law(self, network: "ContactList") -> "WallLaw":
        """The law of the balls' contacts with plates, all of the balls' material."""
        raise NotImplementedError

    def confined_stiffness(self, network: "ContactList", stress) -> tuple[Any, Any]:
        """Normal and tangential tangent stiffness [F/L] of the mean contact under a confining stress."""
        raise NotImplementedError

    def stiffest(self, network: "ContactList", stress, touching_within: float):
        """For the critical time step (host): tangent stiffness of the contacts if closed, normal and tangential, (C,)
        or numbers, and that of the contacts of one plate, both, as a function of the balls that touch it, its area and
        their overlaps [F/L]. None where it is to be found from the forces, which takes longer; so of a subclass that
        changes the law of `Linear` or `Hertz`."""
        return None

    def stiffness_over(self, reference: "Material"):
        """How many times stiffer than a reference of the same kind, by the larger of normal and tangential [-]: with so
        many times its density the reference's time step serves."""
        raise NotImplementedError

    def turning_over(self, reference: "Material"):
        """How many times larger the resistances to rotation are over the tangential stiffness than a reference's, or 1
        where none is larger [-]."""
        pairs = (self.rolling, reference.rolling), (self.torsion, reference.torsion)
        ratios = [
            mine.ratio_and_friction()[0] / other.ratio_and_friction()[0]
            for mine, other in pairs
            if mine is not None and other is not None
        ]
        return jnp.asarray([1.0, *ratios]).max()

    # What the dashpots' coefficients 2 beta sqrt(k m*) are multiplied by, k being the tangent stiffness.
    dashpot_factor = 1.0
