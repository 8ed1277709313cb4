"""The lateral load of a specimen as a term: the membrane's cells, or constant forces, times the lateral stress."""

from axijax.mechanics.membrane import Load, lateral_force
from axijax.mechanics.term import Push, Spent, Term, share_of_sector


class LateralTerm(Term):
    """Forces of `axijax.mechanics.membrane.lateral_force`. The load is held between records."""

    stiffens = False
    acts_apart = False

    def __init__(self, load: Load | None):
        self.load = load

    def forces(self, params, network, dt, state, memory) -> Push:
        assert self.load is not None
        return Push(lateral_force(state.lateral_stress(params), self.load, network.positions + state.displacement))

    def spent(self, params, network, dt, state, memory, push, mean) -> Spent:
        return Spent(work=dt * share_of_sector(network, push.force.dot(mean.velocity)))
