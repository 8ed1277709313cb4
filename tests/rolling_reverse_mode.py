"""Reverse mode through rolling and torsion; run by the tests in a process of its own, without the fast CPU kernels.

A few balls roll on one another past the cap; the derivatives of their spins' energy by all four numbers must be
those of the tangents.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from few_balls import SCENE, few_balls, jit, no_load, still, unit_params

from axijax import Dashpot, Rolling, Torsion
from axijax.mechanics.dynamics import make_step


def main() -> None:
    height = (8 / 3) ** 0.5
    place = 0.985 * np.array([[0, 2, 1, 1], [0, 0, 3**0.5, 3**-0.5], [0, 0, 0, height]])
    rng = np.random.default_rng(0)
    velocity, spin = 1e-3 * rng.normal(size=(2, 3, 4))
    params = unit_params(damping=Dashpot(0.1), rolling=Rolling(0.5, 0.05), torsion=Torsion(0.8, 0.05))
    network, state = few_balls(params, place, velocity, 20 * spin)
    step = make_step(SCENE, still)

    def energy(numbers):
        eta, alpha, eta_tw, alpha_tw = numbers
        here = replace(params, rolling=Rolling(alpha, eta), torsion=Torsion(alpha_tw, eta_tw))
        end = jax.lax.scan(lambda s, _: (step(here, network, no_load(network), 0.05, s), None), state, None, length=40)
        return 1e3 * end[0].spin.dot(end[0].spin).sum()

    numbers = jnp.array([0.05, 0.5, 0.05, 0.8])
    back = jit(jax.grad(energy))(numbers)
    ahead = jit(jax.vmap(lambda way: jax.jvp(energy, (numbers,), (way,))[1]))(jnp.eye(4))
    assert np.abs(np.asarray(back)).min() > 1e-4
    np.testing.assert_allclose(np.asarray(back), np.asarray(ahead), rtol=1e-9)


if __name__ == "__main__":
    main()
