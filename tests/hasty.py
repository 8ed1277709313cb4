"""Programs compiled in haste: most of a test's time goes into compiling a program that then runs for a second.

XLA's older emitters without optimisation compile a test's programs in a third of the time; they run at two thirds of
the speed. Results differ in rounding only.
"""

import os
from contextlib import contextmanager
from functools import cache

import jax
from jax._src import compiler

HASTE = {
    "xla_backend_optimization_level": 0,
    "xla_llvm_disable_expensive_passes": True,
    "xla_cpu_use_fusion_emitters": False,
}
_plain = compiler.get_compile_options


@contextmanager
def hasty(on: bool = True):
    """Within it programs are compiled in haste, or thoroughly; those compiled before in the other way are forgotten."""
    before = _switch(on)
    try:
        yield
    finally:
        _switch(before)


def _switch(on: bool) -> bool:
    was = compiler.get_compile_options is not _plain
    if on != was:
        jax.clear_caches()
        # Processes that a test starts compile as it does, or their results would differ in the last bits.
        ours = _flags()
        flags = os.environ.get("XLA_FLAGS", "").replace(ours, "").strip()
        os.environ["XLA_FLAGS"] = f"{flags} {ours}" if on else flags
        compiler.get_compile_options = _in_haste if on else _plain
    return was


def _in_haste(*args, env_options_overrides=None, **keywords):
    return _plain(*args, env_options_overrides={**_known(), **(env_options_overrides or {})}, **keywords)


@cache
def _known() -> dict:
    """Those options that this version of XLA has; asked for the first time while programs are compiled thoroughly."""

    def has(name: str) -> bool:
        try:
            jax.jit(lambda x: x + 1, compiler_options={name: HASTE[name]}).lower(1.0).compile()
        except (RuntimeError, ValueError):
            return False
        return True

    return {name: value for name, value in HASTE.items() if has(name)}


def _flags() -> str:
    return " ".join(f"--{name}={str(value).lower()}" for name, value in _known().items())
