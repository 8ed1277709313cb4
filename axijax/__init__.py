"""axijax: differentiable discrete element triaxial tests on an axisymmetric sector, in JAX.

Importing this package switches JAX to 64-bit numbers, which a discrete element test needs by default. JAX itself is
imported with the first name that is used, so that the command line's help is quick.
"""

import os as _os
import sys as _sys
from importlib import import_module as _import_module
from typing import TYPE_CHECKING as _TYPE_CHECKING

# XLA's own log lines; what goes wrong reaches Python as an exception all the same. Left at jax's setting, every program
# read from a compilation cache prints two kilobytes of a false alarm (jax issue 38445).
_os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

if "jax" in _sys.modules:
    _sys.modules["jax"].config.update("jax_enable_x64", True)
else:
    _os.environ["JAX_ENABLE_X64"] = "1"

if _TYPE_CHECKING:
    from axijax import theory
    from axijax.core.platform import fast_cpu_kernels, plain_cpu_kernels, use_compilation_cache
    from axijax.core.sector import Sector
    from axijax.mechanics.damping import BackgroundDamping, Dashpot, LocalDamping
    from axijax.mechanics.dynamics import Scene
    from axijax.mechanics.gravity import Gravity
    from axijax.mechanics.hertz import Hertz
    from axijax.mechanics.linear import Linear, contact_stiffness
    from axijax.mechanics.membrane import Load
    from axijax.mechanics.params import Params
    from axijax.mechanics.rolling import Rolling, Torsion
    from axijax.specimen.specimen import Specimen, fcc_cylinder, fcc_octagon
    from axijax.triaxial.own_packing import packing, packing_of
    from axijax.triaxial.peak import find_peak, flat_top, peak_of
    from axijax.triaxial.prepare import Prepared, prepare
    from axijax.triaxial.random_specimen import platen_speed, random_cylinder
    from axijax.triaxial.records import Curve, SimulationError, raise_for_status
    from axijax.triaxial.stage import Stage
    from axijax.triaxial.stage_types import stage
    from axijax.triaxial.stages import simulate
    from axijax.triaxial.test import TriaxialTest

# The module that each public name is in.
_HOMES = {
    "core.platform": ("fast_cpu_kernels", "plain_cpu_kernels", "use_compilation_cache"),
    "core.sector": ("Sector",),
    "mechanics.damping": ("BackgroundDamping", "Dashpot", "LocalDamping"),
    "mechanics.dynamics": ("Scene",),
    "mechanics.gravity": ("Gravity",),
    "mechanics.hertz": ("Hertz",),
    "mechanics.linear": ("Linear", "contact_stiffness"),
    "mechanics.membrane": ("Load",),
    "mechanics.params": ("Params",),
    "mechanics.rolling": ("Rolling", "Torsion"),
    "specimen.specimen": ("Specimen", "fcc_cylinder", "fcc_octagon"),
    "triaxial.own_packing": ("packing", "packing_of"),
    "triaxial.peak": ("find_peak", "flat_top", "peak_of"),
    "triaxial.prepare": ("Prepared", "prepare"),
    "triaxial.random_specimen": ("platen_speed", "random_cylinder"),
    "triaxial.records": ("Curve", "SimulationError", "raise_for_status"),
    "triaxial.stage": ("Stage",),
    "triaxial.stage_types": ("stage",),
    "triaxial.stages": ("simulate",),
    "triaxial.test": ("TriaxialTest",),
}
# Modules that are public by themselves.
_MODULES = ("batch", "case", "checkpoint", "grading", "results", "theory")

__all__ = [
    "BackgroundDamping",
    "Curve",
    "Dashpot",
    "Gravity",
    "Hertz",
    "Linear",
    "Load",
    "LocalDamping",
    "Params",
    "Prepared",
    "Rolling",
    "Scene",
    "Sector",
    "SimulationError",
    "Specimen",
    "Stage",
    "Torsion",
    "TriaxialTest",
    "contact_stiffness",
    "fast_cpu_kernels",
    "fcc_cylinder",
    "fcc_octagon",
    "find_peak",
    "flat_top",
    "packing",
    "packing_of",
    "peak_of",
    "plain_cpu_kernels",
    "platen_speed",
    "prepare",
    "raise_for_status",
    "random_cylinder",
    "simulate",
    "stage",
    "theory",
    "use_compilation_cache",
]


def __dir__() -> list[str]:
    return sorted({*__all__, *_MODULES})


def __getattr__(name: str):
    for module, names in _HOMES.items():
        if name in names:
            return getattr(_import_module(f"axijax.{module}"), name)
    if name in _MODULES:
        return _import_module(f"axijax.{name}")
    raise AttributeError(f"module 'axijax' has no attribute '{name}'; it has {', '.join(__dir__())}")
