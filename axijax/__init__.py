"""axijax: differentiable discrete element triaxial tests on an axisymmetric sector, in JAX.

Importing this package switches JAX to 64-bit numbers, which a discrete element test needs by default.
"""

import os

# XLA's own log lines; what goes wrong reaches Python as an exception all the same. Left at jax's setting, every program
# read from a compilation cache prints two kilobytes of a false alarm (jax issue 38445).
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

import jax

jax.config.update("jax_enable_x64", True)

from axijax import theory  # noqa: E402
from axijax.dynamics import Params, Scene  # noqa: E402
from axijax.packing import Specimen, fcc_cylinder, fcc_octagon  # noqa: E402
from axijax.platform import fast_cpu_kernels, use_compilation_cache  # noqa: E402
from axijax.sector import Sector  # noqa: E402
from axijax.triaxial import Curve, SimulationError, TriaxialTest, raise_for_status  # noqa: E402

__all__ = [
    "Curve",
    "Params",
    "Scene",
    "Sector",
    "SimulationError",
    "Specimen",
    "TriaxialTest",
    "fast_cpu_kernels",
    "fcc_cylinder",
    "fcc_octagon",
    "raise_for_status",
    "theory",
    "use_compilation_cache",
]
