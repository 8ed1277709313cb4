"""Reverse mode through rolling and torsion; run by the tests in a process of its own, without the fast CPU kernels.

A few balls roll on one another past the cap; the derivatives of their spins' energy by all four numbers must be
those of the tangents.
"""

import jax
import jax.numpy as jnp
import numpy as np
from few_balls import SCENE, few_balls, jit, no_load, still, unit_params

from axijax import Dashpot, Rolling, Torsion
from axijax.mechanics.dynamics import make_step

NUMBERS = jnp.array([0.05, 0.5, 0.05, 0.8])  # eta, alpha, eta_tw, alpha_tw


def energy(numbers):
    """Of the spins of four balls, a while after they were set spinning."""
    eta, alpha, eta_tw, alpha_tw = numbers
    height = (8 / 3) ** 0.5
    place = 0.985 * np.array([[0, 2, 1, 1], [0, 0, 3**0.5, 3**-0.5], [0, 0, 0, height]])
    velocity, spin = 1e-3 * np.random.default_rng(0).normal(size=(2, 3, 4))
    params = unit_params(damping=Dashpot(0.1), rolling=Rolling(alpha, eta), torsion=Torsion(alpha_tw, eta_tw))
    network, state = few_balls(params, place, velocity, 20 * spin)
    step = make_step(SCENE, still)
    load = no_load(network)
    end = jax.lax.scan(lambda s, _: (step(params, network, load, 0.05, s), None), state, None, length=40)[0]
    return 1e3 * end.spin.dot(end.spin).sum()


def main() -> None:
    back = jit(jax.grad(energy))(NUMBERS)
    ahead = jit(jax.vmap(lambda way: jax.jvp(energy, (NUMBERS,), (way,))[1]))(jnp.eye(4))
    assert np.abs(np.asarray(back)).min() > 1e-4
    np.testing.assert_allclose(np.asarray(back), np.asarray(ahead), rtol=1e-9)


if __name__ == "__main__":
    main()
