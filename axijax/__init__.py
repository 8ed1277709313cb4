"""axijax: differentiable discrete element triaxial tests on an axisymmetric sector, in JAX.

Importing this package switches JAX to 64-bit numbers, which a discrete element test needs by default.
"""

import jax

jax.config.update("jax_enable_x64", True)

from axijax import theory  # noqa: E402
from axijax.dynamics import Params, Scene  # noqa: E402
from axijax.packing import Specimen, fcc_cylinder, fcc_octagon  # noqa: E402
from axijax.platform import fast_cpu_kernels  # noqa: E402
from axijax.random_packing import platen_speed, random_cylinder  # noqa: E402
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
    "platen_speed",
    "raise_for_status",
    "random_cylinder",
    "theory",
]
