"""axijax: differentiable discrete element triaxial tests on an axisymmetric sector, in JAX.

Importing this package switches JAX to 64-bit numbers, which a discrete element test needs by default. JAX itself is
imported with the first name that is used, so that the command line's help is quick.
"""

import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

# XLA's own log lines; what goes wrong reaches Python as an exception all the same. Left at jax's setting, every program
# read from a compilation cache prints two kilobytes of a false alarm (jax issue 38445).
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", True)
else:
    os.environ["JAX_ENABLE_X64"] = "1"

if TYPE_CHECKING:
    from axijax import theory
    from axijax.curve import Curve, SimulationError, raise_for_status
    from axijax.damping import BackgroundDamping, Dashpot, LocalDamping
    from axijax.dynamics import Scene
    from axijax.hertz import Hertz
    from axijax.linear import Linear
    from axijax.packing import Specimen, fcc_cylinder, fcc_octagon
    from axijax.params import Params
    from axijax.platform import fast_cpu_kernels, use_compilation_cache
    from axijax.random_packing import platen_speed, random_cylinder
    from axijax.sector import Sector
    from axijax.triaxial import TriaxialTest

__all__ = [
    "BackgroundDamping",
    "Curve",
    "Dashpot",
    "Hertz",
    "Linear",
    "LocalDamping",
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
    "use_compilation_cache",
]

# The module that each name is in; any other name is that of a module.
_HOMES = {
    "curve": ("Curve", "SimulationError", "raise_for_status"),
    "damping": ("BackgroundDamping", "Dashpot", "LocalDamping"),
    "dynamics": ("Scene",),
    "hertz": ("Hertz",),
    "linear": ("Linear",),
    "params": ("Params",),
    "packing": ("Specimen", "fcc_cylinder", "fcc_octagon"),
    "platform": ("fast_cpu_kernels", "use_compilation_cache"),
    "random_packing": ("platen_speed", "random_cylinder"),
    "sector": ("Sector",),
    "triaxial": ("TriaxialTest",),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"axijax.{module}"), name)
    try:
        return import_module(f"axijax.{name}")
    except ModuleNotFoundError as error:
        if error.name != f"axijax.{name}":
            raise
    raise AttributeError(f"module 'axijax' has no attribute '{name}'")
