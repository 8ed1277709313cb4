"""Gathers by index whose transpose is a gather as well, so that reverse mode scatters nothing.

JAX's transpose of a gather is a scatter-add: on a CPU one number after the other, and of one-dimensional arrays the end
of the process under `axijax.fast_cpu_kernels` (XLA's multi-output fusion, in `symbolic_map.cc`). Where it is known what
is gathered from where, the same sum can be gathered: `linear` is a linear function together with its transpose, in
which jvp, vmap, jit and scan see nothing new.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

# Of indices that are known to be places: XLA then neither clamps them nor makes an array of its own of each, counted
# from the end where it is negative.
IN_BOUNDS: Any = {"mode": "promise_in_bounds", "wrap_negative_indices": False}
Arrays = Sequence[jax.Array]
Linear = Callable[[Arrays, Arrays], Arrays]


def linear(function: Linear, transpose: Linear, fixed: Arrays, values: Arrays) -> list[jax.Array]:
    """function(fixed, values), whose transpose in reverse mode is transpose(fixed, cotangents).

    function: linear in the values; transpose: takes what has the shapes of its results to the shapes of the values, and
        must be its exact transpose. Both are known by name, so define them once, in a module.
    fixed: arrays that they are not linear in, as indices and tables; where one of these has a tangent, it and the rest
        are differentiated as JAX does it.
    """
    return _linear.bind(*fixed, *values, function=function, transpose=transpose, number=len(fixed))


def _apply(*arrays, function, transpose, number):
    return list(function(arrays[:number], arrays[number:]))


def _forward(primals, tangents, *, number, **functions):
    fixed, moving = primals[:number], tangents[number:]
    if not all(isinstance(each, ad.Zero) or each.dtype == jax.dtypes.float0 for each in tangents[:number]):
        plain = partial(_apply, number=number, **functions)
        return jax.jvp(plain, tuple(primals), tuple(map(ad.instantiate_zeros, tangents)))
    results = _linear.bind(*primals, number=number, **functions)
    return results, _linear.bind(*fixed, *map(ad.instantiate_zeros, moving), number=number, **functions)


def _backward(cotangents, *arrays, function, transpose, number):
    filled = map(ad.instantiate_zeros, cotangents)
    back = _linear.bind(*arrays[:number], *filled, function=transpose, transpose=function, number=number)
    return [None] * number + back


@dataclass(frozen=True)
class _Batched:
    """One of the functions for a batch of values, and of what is fixed where `axes` says so."""

    function: Linear
    axes: tuple[int | None, ...]

    def __call__(self, fixed, values):
        return jax.vmap(self.function, in_axes=(self.axes, 0))(tuple(fixed), tuple(values))


def _batch(arrays, axes, *, function, transpose, number):
    size = next(each.shape[axis] for each, axis in zip(arrays, axes, strict=True) if axis is not None)

    def moved(place, array, axis):
        if axis is not None:
            return jnp.moveaxis(array, axis, 0)
        return array if place < number else jnp.broadcast_to(array, (size, *array.shape))

    arrays = [moved(place, *each) for place, each in enumerate(zip(arrays, axes, strict=True))]
    along = tuple(None if axis is None else 0 for axis in axes[:number])
    functions = _Batched(function, along), _Batched(transpose, along)
    results = _linear.bind(*arrays, function=functions[0], transpose=functions[1], number=number)
    return results, [0] * len(results)


def _shapes(*arrays, **params):
    shapes = jax.eval_shape(lambda *inside: _apply(*inside, **params), *arrays)
    return [jax.core.ShapedArray(each.shape, each.dtype) for each in shapes]


_linear = Primitive("axijax_linear")
_linear.multiple_results = True
_linear.def_impl(_apply)
_linear.def_abstract_eval(_shapes)
ad.primitive_jvps[_linear] = _forward
ad.primitive_transposes[_linear] = _backward
batching.primitive_batchers[_linear] = _batch
mlir.register_lowering(_linear, mlir.lower_fun(_apply, multiple_results=True))


def taken(values: Arrays, index: jax.Array, place: jax.Array, there: jax.Array) -> list[jax.Array]:
    """values[index] of arrays (M,), where it is known at which place of the result each of them is; (C,) each.

    index: (C,) int. place: (M,) int, of each value in the result; there: (M,) bool, whether it is there at all. A value
    that several places hold is given its derivative by the one that is named; those of the others must be zero.
    """
    return linear(_take, _give_back, (index, place, there), values)


def _take(fixed, values):
    index, _, _ = fixed
    return [each.at[index].get(**IN_BOUNDS) for each in values]


def _give_back(fixed, values):
    _, place, there = fixed
    return [jnp.where(there, each.at[place].get(**IN_BOUNDS), 0) for each in values]


def gathered(values: Arrays, index: jax.Array) -> list[jax.Array]:
    """values[index] of arrays (M,), for any index; the shape of the index each.

    The transpose sorts the index and takes one value after the other for each of the M: for what is not done in every
    step.
    """
    return linear(_gather, _sum_gathered, (index, jnp.arange(values[0].size, dtype=index.dtype)), values)


def _gather(fixed, values):
    index, _ = fixed
    return [each.at[index].get(**IN_BOUNDS) for each in values]


def added(values: jax.Array, index: jax.Array, size: int, moment: jax.Array) -> jax.Array:
    """Sums (size,) of the values at each index, in their order; values and index of one shape.

    moment: any number of the run, not negative, that is only known when it runs. The one scatter that is left is in a
    branch of its own that depends on it, and always taken: XLA fuses across everything but a branch.
    """
    return linear(_add, _take_added, (index, jax.lax.stop_gradient(moment), jnp.zeros(size, jnp.int8)), [values])[0]


def _add(fixed, values):
    index, moment, places = fixed
    empty = jnp.zeros(places.shape, values[0].dtype)
    return [jax.lax.cond(moment < 0, lambda _: empty, lambda new: empty.at[index].add(new), values[0])]


def _take_added(fixed, values):
    return _gather(fixed[:2], values)


def _sum_gathered(fixed, values):
    index, places = fixed
    order = jnp.argsort(index.ravel())
    values = [each.ravel().at[order].get(**IN_BOUNDS) for each in values]
    ordered = index.ravel()[order]
    first, after = (jnp.searchsorted(ordered, places, side=side) for side in ("left", "right"))

    def further(carry):
        row, sums = carry
        here = jnp.minimum(first + row, order.size - 1)
        found = [each.at[here].get(**IN_BOUNDS) for each in values]
        return row + 1, [jnp.where(first + row < after, old + new, old) for old, new in zip(sums, found, strict=True)]

    start = jnp.zeros((), first.dtype), [jnp.zeros(places.shape, each.dtype) for each in values]
    return jax.lax.while_loop(lambda carry: (first + carry[0] < after).any(), further, start)[1]
