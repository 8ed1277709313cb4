"""The lateral load of a specimen as a term: the membrane's cells, or constant forces, times the confining stress."""

import jax

from axijax.membrane import Load, lateral_force
from axijax.neighbors import Network
from axijax.term import Push, Spent, Term, share_of_sector


class LateralTerm(Term):
    """Horizontal forces of `axijax.membrane.lateral_force`. The load is held between records."""

    stiffens = False

    def __init__(self, stress: jax.Array | float, load: Load | None):
        self.stress, self.load = stress, load

    def forces(self, network: Network, dt, state, memory) -> Push:
        assert self.load is not None
        return Push(lateral_force(self.stress, self.load, network.positions + state.displacement))

    def spent(self, network, dt, state, memory, push, mean) -> Spent:
        return Spent(work=dt * share_of_sector(network, push.force.dot(mean.velocity)))
