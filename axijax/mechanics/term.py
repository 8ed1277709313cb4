"""The term protocol: the forces on the balls are a sum of terms, each in a file of its own.

Contacts, walls and lateral load make a triaxial test; more are added to `Params.terms`, from outside the package too.
Dynamics, energy ledger, snapshot, checkpoint and critical time step loop over the terms of a scene in their order
(`axijax.mechanics.dynamics.terms_of`); Python composes them while tracing, so what is compiled is one program.

A term that is a parameter of a test is a frozen dataclass registered by `axijax.core.tree.pytree`, whose numbers are
declared with `axijax.core.quantity.quantity`.
"""

import operator
from functools import reduce
from typing import TYPE_CHECKING, Any, NamedTuple

import jax

from axijax.core.vector import Vector
from axijax.mechanics.contact_list import ContactList

if TYPE_CHECKING:
    from axijax.core.sector import Sector
    from axijax.mechanics.params import Params
    from axijax.mechanics.state import State


STICKING = 1e30  # friction coefficient at which nothing slips; inf times no force would be no number


class Memory(NamedTuple):
    """What a term carries from step to step; pytrees, or None.

    contact: of (C,) arrays in the frame of each contact's first ball, which go with their contact through a rebuild of
        the contact list; those of a contact that the new list does not hold are dropped, of a new one zero.
    ball: of anything else, kept as it is.
    """

    contact: Any = None
    ball: Any = None


class Push(NamedTuple):
    """What a term does at one moment.

    force, moment: on each ball, (N,) vectors [F], [F L]; None for none.
    memory: one step later.
    detail: what was found on the way, for records and for the term's own energies.
    """

    force: Vector | None
    moment: Vector | None = None
    memory: Memory = Memory()
    detail: Any = None


class Spent(NamedTuple):
    """Energy that passes through a term during the step about t; scalars of one sector [F L].

    work: done on the balls from outside. damping: lost to dashpots. friction: lost to slip, see `Term.pending`.
    """

    work: Any = 0.0
    damping: Any = 0.0
    friction: Any = 0.0


class Stored(NamedTuple):
    """Elastic energy half a step before a state's positions; scalars of one sector [F L]."""

    normal_springs: Any = 0.0
    shear_springs: Any = 0.0


class Term:
    """One physical effect. `params` are those of the test, `network` holds balls and contact list, `state` the motion
    at t, `dt` is the time step."""

    # Whether it can make the motion stiffer or more viscous than contacts and walls do; if so the critical time step is
    # found from the linearised forces (`axijax.mechanics.linearised`). Springs in its memory are seen there if `forces`
    # lets them grow by this step's motion before it takes their force, as contacts do.
    stiffens = True
    # Whether it acts between balls that are listed as a possible contact and do not touch, or keeps memory for them. If
    # so steps see the whole contact list, which takes twice as long in a random packing (`mechanics.tight_list`).
    acts_apart = True

    def check(self, sector: "Sector") -> None:
        """Raise ValueError where it makes no sense in a sector."""

    def init(self, params: "Params", network: ContactList) -> Memory:
        """The memory before the first step."""
        return Memory()

    def forces(self, params: "Params", network: ContactList, dt, state: "State", memory: Memory) -> Push:
        """Forces at t, from positions at t and velocities at t - dt/2."""
        raise NotImplementedError

    def stuck(self) -> "Term":
        """Itself with no cap on its springs, for the critical time step."""
        return self

    def spent(
        self, params: "Params", network: ContactList, dt, state: "State", memory: Memory, push: Push, mean: "State"
    ) -> Spent:
        """Energy that passes through it during the step about t. memory: before the step; push: its `forces`; mean: a
        state whose velocities, spins and platen speeds are the means over the step."""
        return Spent()

    def stored(self, params: "Params", network: ContactList, dt, state: "State", memory: Memory, push: Push) -> Stored:
        """Elastic energy at t - dt/2; arguments as for `spent`."""
        return Stored()

    def pending(self, params: "Params", network: ContactList, dt, state: "State", memory: Memory, push: Push):
        """What the slip of the step before t has lost and `spent` has not booked yet, since only the forces at t tell
        [F L]."""
        return 0.0


def share_of_sector(network: ContactList, power: jax.Array) -> jax.Array:
    """Sum over the balls of what each contributes to one sector; power: (N,)."""
    return (power * network.weight).sum()


def total(pushes: tuple[Push, ...], kind: str) -> Vector | None:
    """Sum of the pushes' "force" or "moment" on the balls, in their order; None where none has any."""
    vectors = [getattr(push, kind) for push in pushes if getattr(push, kind) is not None]
    return reduce(operator.add, vectors) if vectors else None
