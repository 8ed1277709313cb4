"""One test with many parameter sets, in one pure function."""

import jax
import jax.numpy as jnp
import numpy as np

from axijax.mechanics.params import Params
from axijax.triaxial.records import Curve
from axijax.triaxial.test import TriaxialTest


def simulate_many(test: TriaxialTest, params: Params) -> Curve:
    """The curves of K parameter sets, fields with a leading axis K: pure, for jax.jit, jax.jvp and jax.grad.

    Each leaf of `params` is one number, shared by all, or has the leading axis K (friction per ball: (K, N)). One test
    after another on a CPU, all at once on a GPU; spread over the devices of this process where it has several (a CPU
    has as many as `jax_num_cpu_devices` says, one by default: `run_batch` needs no more than one to use all cores).

    Look at `status` of what comes back, or call `raise_for_status`. Raises ValueError where the leading axes differ.
    """
    leaves, structure = jax.tree.flatten(params)
    batched = [np.ndim(leaf) > 0 for leaf in leaves]
    sizes = {np.shape(leaf)[0] for leaf, has in zip(leaves, batched, strict=True) if has}
    if len(sizes) != 1:
        wrong = "none has one" if not sizes else f"found {', '.join(map(str, sorted(sizes)))}"
        raise ValueError(f"params: its fields must be single numbers or have one and the same leading axis; {wrong}.")
    (size,) = sizes
    devices = jax.local_devices()[:size]
    stacked = [jnp.asarray(leaf) for leaf, has in zip(leaves, batched, strict=True) if has]
    shared = [leaf for leaf, has in zip(leaves, batched, strict=True) if not has]

    def one(mine):
        rows, rest = iter(mine), iter(shared)
        return test.simulate(jax.tree.unflatten(structure, [next(rows if has else rest) for has in batched]))

    def many(rows):
        return jax.lax.map(one, rows) if jax.default_backend() == "cpu" else jax.vmap(one)(rows)

    if len(devices) == 1:
        return many(stacked)
    # Every device takes as many; the last ones repeat the first set.
    short = -size % len(devices)
    padded = [jnp.concatenate([leaf, jnp.broadcast_to(leaf[:1], (short, *leaf.shape[1:]))]) for leaf in stacked]
    mesh = jax.sharding.Mesh(np.array(devices), ("test",))
    axis = jax.sharding.PartitionSpec("test")
    spread = jax.shard_map(many, mesh=mesh, in_specs=(axis,), out_specs=axis, check_vma=False)
    return jax.tree.map(lambda values: values[:size], spread(padded))
