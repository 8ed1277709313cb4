"""The ground that the program stands on: JAX itself, and what importing costs."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest


@pytest.mark.parametrize("rows", [16385, 32769])
def test_jitted_vmap_of_a_small_product_then_a_sum(rows):
    """jax 0.10.2 silently miscompiles this on the CPU; the package excludes it, and this is the canary."""
    rng = np.random.default_rng(0)
    matrices, vectors = rng.normal(size=(rows, 3, 3)), rng.normal(size=(rows, 3))
    product = jax.jit(lambda a, b: jax.vmap(lambda m, v: m @ v)(a, b).sum(axis=0))
    np.testing.assert_allclose(
        product(jnp.asarray(matrices), jnp.asarray(vectors)), np.einsum("nij,nj->i", matrices, vectors), rtol=1e-9
    )


def test_import_leaves_heavy_packages_alone():
    """jax-md takes seconds to import, matplotlib and xarray one each: only what uses them imports them."""
    heavy = ("jax_md", "matplotlib", "xarray", "optax", "pydantic", "typer")
    code = f"import sys, axijax, calibrate; print([m for m in {heavy} if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
