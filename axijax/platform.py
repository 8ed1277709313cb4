"""How XLA compiles for the CPU. Nothing here runs unless it is called."""

import os

FUSION_OPTION = "xla_cpu_use_multi_output_fusion"


def fast_cpu_kernels() -> bool:
    """Let XLA's CPU compiler make all results of a contact in one loop: four to five times as many ball-steps a second.

    Call it before the first JAX computation of the process; returns whether it took effect. The command line calls it
    by itself. It acts on every program of the process, and in the XLA of jax 0.10 it has a defect that ends the
    process: reverse mode (`jax.grad`, `jax.vjp`) through a scan that gathers by index, which a test is. Forward mode
    is right and fast. Leave it out in a process that needs reverse mode.
    """
    from jax._src import xla_bridge

    flags = os.environ.get("XLA_FLAGS", "")
    if FUSION_OPTION in flags:
        return True
    if xla_bridge.backends_are_initialized():
        return False
    os.environ["XLA_FLAGS"] = f"{flags} --xla_backend_extra_options={FUSION_OPTION}=true".strip()
    return True


def fast_cpu_kernels_are_on() -> bool:
    """Whether this process was told to use the fast kernels, so that reverse mode would end it."""
    return FUSION_OPTION in os.environ.get("XLA_FLAGS", "")
