"""Programs compiled in haste: most of a test's time goes into compiling a program that then runs for a second.

XLA's older emitters without optimisation compile a test's programs in a third of the time; they run at two thirds of
the speed. Results differ in rounding only.
"""

import os
from contextlib import contextmanager
from functools import cache, partial

import jax
from jax._src import compiler

_plain = compiler.get_compile_options


@cache
def _older_emitters() -> dict:
    """XLA's option for them, if this version has it."""
    options = {"xla_cpu_use_fusion_emitters": False}
    try:
        jax.jit(lambda x: x + 1, compiler_options=options).lower(1.0).compile()
    except (RuntimeError, ValueError):
        return {}
    return options


def _get(options: dict, *args, env_options_overrides=None, **keywords):
    return _plain(*args, env_options_overrides={**options, **(env_options_overrides or {})}, **keywords)


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
        jax.config.update("jax_disable_most_optimizations", on)
        compiler.get_compile_options = partial(_get, _older_emitters()) if on else _plain
        # Processes that a test starts compile as it does, or their results would differ in the last bits.
        flags = os.environ.get("XLA_FLAGS", "").replace(_flags(), "").strip()
        os.environ["XLA_FLAGS"] = f"{flags} {_flags()}" if on else flags
    return was


def _flags() -> str:
    """Of XLA, which do the same to a process of its own."""
    options = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": "true"}
    return " ".join(f"--{name}={str(value).lower()}" for name, value in {**options, **_older_emitters()}.items())
