"""Decisions that the members of a vmap take together."""

import jax
import jax.numpy as jnp
import numpy as np

from axijax.core.together import all_of_batch


def test_it_is_true_where_all_members_are():
    values = jnp.array([[True, True, True], [True, False, True]])
    assert bool(all_of_batch(jnp.array(True))) and not bool(all_of_batch(jnp.array(False)))
    for jitted in (lambda f: f, jax.jit):
        np.testing.assert_array_equal(jitted(jax.vmap(all_of_batch))(values[0]), [True] * 3)
        np.testing.assert_array_equal(jitted(jax.vmap(all_of_batch))(values[1]), [False] * 3)
        np.testing.assert_array_equal(jitted(jax.vmap(jax.vmap(all_of_batch)))(values), np.zeros((2, 3)))


def test_it_leaves_derivatives_of_what_it_chooses():
    def chosen(x):
        return jax.lax.cond(all_of_batch(x > 1), lambda: x**2, lambda: jnp.where(x > 1, x**2, 3 * x))

    x = jnp.array([0.5, 2.0, 3.0])
    for derivative in (jax.grad(chosen), jax.jacfwd(chosen)):
        np.testing.assert_allclose(jax.jit(jax.vmap(derivative))(x), [3.0, 4.0, 6.0])
        assert float(derivative(2.0)) == 4.0
