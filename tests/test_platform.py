"""The ground that the program stands on: JAX itself, and what importing costs."""

import subprocess
import sys
import warnings
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from axijax import Params, Sector, TriaxialTest, fcc_octagon
from axijax.core import platform
from axijax.core.platform import plain_cpu_kernels
from axijax.core.vector import zeros
from axijax.mechanics.contact_list import build_contact_list
from axijax.mechanics.contacts import contact_forces


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


def results_of_loops(**options):
    """How many results each loop of a compiled contact law has."""
    network = build_contact_list(fcc_octagon(layers=5, half_width=3), Sector(1))
    law = Params(friction=0.3).material.contact_law(network)
    still, springs = zeros(network.radius.shape, float), zeros(network.first.shape, float)
    program = jax.jit(partial(contact_forces, law, network, 1e-3), compiler_options=options)
    text = program.lower(still, still, still, springs).compile().as_text()
    return [line.split(" fusion(")[0].count("f64[") for line in text.splitlines() if " fusion(" in line]


def test_xla_still_makes_all_results_of_a_contact_in_one_loop():
    """The canary of `fast_cpu_kernels`: an undocumented option, which another jaxlib may drop without a word."""
    together = sum(number for number in results_of_loops() if number > 1)
    assert together >= 9, "force, moment arm and spring of a contact"
    assert max(results_of_loops(**plain_cpu_kernels())) == 1, "and a program of its own can do without"


def test_a_process_without_the_fast_kernels_says_so_once(monkeypatch):
    test = TriaxialTest(fcc_octagon(layers=5, half_width=3))
    monkeypatch.setattr(platform, "_warned_of_slowness", False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        jax.eval_shape(test.confine)  # with them
    monkeypatch.delenv("XLA_FLAGS")
    with pytest.warns(UserWarning, match=r"slower than it could: call axijax\.fast_cpu_kernels\(\)") as said:
        jax.eval_shape(test.simulate, test.params)
        jax.eval_shape(lambda params: test.simulate(params).stress_ratio, test.params)
    assert len(said) == 1
