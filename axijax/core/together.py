"""Decisions that the members of a `jax.vmap` take together.

Where its predicate has a batch axis, a `lax.cond` becomes a select, and every member pays for both of its branches. A
predicate without one leaves it a branch: so where one branch would be right for all, take it unless all may have the
other.
"""

import jax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir


def all_of_batch(predicate: jax.Array) -> jax.Array:
    """A () bool: the same; inside `jax.vmap` whether it is true of all members, without a batch axis. It has no
    derivative."""
    return _all.bind(predicate)


def _reduced(values, axes):
    return _all.bind(values[0].all(axis=axes[0])), None


_all = Primitive("axijax_all_of_batch")  # the identity
_all.def_impl(lambda value: value)
_all.def_abstract_eval(lambda value: value)
ad.primitive_jvps[_all] = lambda primals, tangents: (_all.bind(*primals), tangents[0])
batching.primitive_batchers[_all] = _reduced
mlir.register_lowering(_all, lambda _context, value: [value])
