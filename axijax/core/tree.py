"""Dataclasses as pytrees whose structure knows their class.

JAX's own `register_dataclass` gives trees of different classes with fields of the same names equal structures (seen in
0.10.1), so that a program compiled for one material could run for another. Parts that can stand in one another's place,
materials, kinds of damping, terms and paths, are registered by this one instead.
"""

import dataclasses
from typing import TypeVar

import jax
from jax.tree_util import GetAttrKey

Class = TypeVar("Class", bound=type)


def pytree(cls: Class) -> Class:
    """Register a frozen dataclass as a pytree of its fields; those with metadata {"static": True} are static."""
    fields = dataclasses.fields(cls)
    data = [f.name for f in fields if not f.metadata.get("static")]
    static = [f.name for f in fields if f.metadata.get("static")]

    def flatten(tree):
        return [getattr(tree, name) for name in data], (cls, *(getattr(tree, name) for name in static))

    def flatten_with_keys(tree):
        children, aux = flatten(tree)
        return [(GetAttrKey(name), child) for name, child in zip(data, children, strict=True)], aux

    def unflatten(aux, children):
        made = object.__new__(cls)
        for name, value in (*zip(data, children, strict=True), *zip(static, aux[1:], strict=True)):
            object.__setattr__(made, name, value)
        return made

    jax.tree_util.register_pytree_with_keys(cls, flatten_with_keys, unflatten, flatten)
    return cls
