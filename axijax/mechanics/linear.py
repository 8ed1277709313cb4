"""Linear contacts: springs of constant stiffness, between balls and against plates."""

from dataclasses import dataclass
from numbers import Real

import jax
import jax.numpy as jnp

from axijax.core.quantity import quantity
from axijax.core.tree import pytree
from axijax.mechanics.contact_list import ContactList
from axijax.mechanics.contacts import Law
from axijax.mechanics.material import Material
from axijax.mechanics.walls import Wall


@pytree
@dataclass(frozen=True)
class Linear(Material):
    """Linear springs (Cundall & Strack 1979), by default those of Cui & O'Sullivan (2005); plates are like balls.

    Stiffnesses are the contact's, not the ball's; `contact_stiffness` makes one of the other.
    """

    normal_stiffness: jax.Array | float = quantity(
        1.5e9, "normal stiffness of a contact", "F/L", above=0.0, symbols=("kn",)
    )
    shear_stiffness: jax.Array | float = quantity(
        1.5e9, "tangential stiffness of a contact", "F/L", above=0.0, symbols=("ks",)
    )

    def contact_law(self, network: ContactList) -> Law:
        friction = self.contact_friction(network) if self.frictional else None
        stiffness = self.normal_stiffness, self.shear_stiffness
        beta = self.kind_of_damping.viscosity_ratio
        if beta is None:
            return Law(*stiffness, friction, None, None)
        reduced_mass = self.reduced_mass(network)
        return Law(*stiffness, friction, *(2 * beta * jnp.sqrt(k * reduced_mass) for k in stiffness))

    def wall_law(self, network: ContactList) -> Wall:
        stiffness = self.normal_stiffness
        shear = self.shear_stiffness if self.rough_walls else None
        beta = self.kind_of_damping.viscosity_ratio
        if beta is None:
            return Wall(stiffness, None, shear, None)
        mass = self.mass(network)
        viscosity = [None if k is None else 2 * beta * jnp.sqrt(k * mass) for k in (stiffness, shear)]
        return Wall(stiffness, viscosity[0], shear, viscosity[1])

    def confined_stiffness(self, network, stress):
        return self.normal_stiffness, self.shear_stiffness

    def stiffness_over(self, reference):
        return jnp.maximum(
            self.normal_stiffness / reference.normal_stiffness, self.shear_stiffness / reference.shear_stiffness
        )

    def stiffest(self, network, stress, touching_within):
        normal, shear = float(self.normal_stiffness), float(self.shear_stiffness)
        return normal, shear, lambda balls, area, overlap: (normal, shear)


def contact_stiffness(first, second=None):
    """Stiffness of a contact, normal or tangential, from those of its balls [F/L]: springs in series, k1 k2/(k1 + k2).

    second: left out, both balls are alike and it is half of theirs; infinite for a rigid partner. Numbers or arrays
        that broadcast, traced ones too.

    `Params` and case files hold the contact's. Other codes: PFC's linear model is given the balls' kn and ks, in
    series. YADE's FrictMat makes its own mean of moduli, kn = 2 E1 r1 E2 r2/(E1 r1 + E2 r2), which is 2 E r of each
    ball in series and E r for equal ones. LAMMPS (`gran/hooke`, `granular hooke`) is given the contact's.

    Raises ValueError for a plain number that is not positive.
    """
    second = first if second is None else second
    for value in (first, second):
        if isinstance(value, Real) and not value > 0:
            raise ValueError(f"stiffness = {value!r} of a ball: must be positive.")
    return 1 / (1 / first + 1 / second)
