"""The usual stages of a laboratory, by name: `stage("compression", lateral="constant_volume", axial_strain=0.01)`.

The same names and numbers stand in the [[stage]] tables of a case file.
"""

import jax

from axijax.core.quantity import declared
from axijax.triaxial.commands import (
    Cycling,
    Fluid,
    Held,
    Line,
    Membrane,
    Moved,
    Moving,
    Platens,
    Pressed,
    Sideways,
)
from axijax.triaxial.stage import Stage, Until

# What the platens do, by name, and the fields that each takes beside Until's; and what the membrane does.
TYPES: dict[str, tuple[str, ...]] = {
    "compression": ("speed",),
    "extension": ("speed",),
    "hold": (),
    "cycles": ("first", "second", "cycles", "of", "speed"),
    "axial_stress": ("axial_stress", "stress_rate"),
    "lateral_stress": ("lateral_stress", "stress_rate"),
    "isotropic": ("lateral_stress", "stress_rate"),
    "anisotropic": ("lateral_stress", "k", "stress_rate"),
}
LATERAL: dict[str, tuple[str, ...]] = {
    "constant": (),
    "constant_p": (),
    "line": ("dq_dp",),
    "constant_volume": (),
    "fluid": ("fluid_modulus", "porosity"),
    "k0": (),
}
LED = ("lateral_stress", "isotropic", "anisotropic")  # types that lead the membrane themselves
DIRECTIONS = {"compression": 1.0, "extension": -1.0, "hold": 0.0}  # of the platens
SHARES = {"constant_volume": -0.5, "k0": 0.0}  # of the lateral strain in the axial one
OPTIONAL = ("speed", "stress_rate", "cycles", "of")  # fields that may be left out
CRITERIA = tuple(declared(Until))


def stage(type: str, lateral: str = "constant", **numbers) -> Stage:
    """A stage by the name of what its platens do (`TYPES`) and of what its membrane does (`LATERAL`).

    compression, extension: at a speed. hold: the platens stay. cycles: between two limits of axial strain, or of
        deviator stress (of="deviator_stress"), so many times.
    axial_stress: the axial stress is led to a value. lateral_stress: the lateral stress is, the axial stress stays.
    isotropic, anisotropic: both are, on a straight line, to s1 = s3, and to s3 = k s1.
    numbers: of the commands (`axijax.triaxial.commands`), and where it ends (`Until`), each by its name.

    Raises ValueError for names that are not known or would do nothing, and for numbers that make no sense.
    """
    for what, name, known in (("type", type, TYPES), ("lateral", lateral, LATERAL)):
        if name not in known:
            raise ValueError(f"{what} = {name!r}: must be one of {', '.join(known)}.")
    if type in LED and lateral != "constant":
        raise ValueError(f"lateral = '{lateral}': type = '{type}' leads the lateral stress itself; leave it out.")
    taken = (*TYPES[type], *LATERAL[lateral], *CRITERIA)
    for name in numbers:
        if name not in taken:
            raise ValueError(f"{name} = {numbers[name]!r}: a stage of type '{type}' takes {', '.join(taken)}.")
    for name in (*TYPES[type], *LATERAL[lateral]):
        if name not in OPTIONAL and numbers.get(name) is None:
            which = f"lateral = '{lateral}'" if name in LATERAL[lateral] else f"type = '{type}'"
            raise ValueError(f"a stage of {which} needs its {name}.")
    given = {name: value for name, value in numbers.items() if value is not None}

    def take(*names):
        return {name: given[name] for name in names if name in given}

    platens, membrane = _platens(type, take), _membrane(type, lateral, take)
    made = Stage(platens, membrane, Until(**take(*CRITERIA)))
    made.check()
    return made


def _platens(type: str, take) -> Platens:
    if type in DIRECTIONS:
        return Moving(DIRECTIONS[type], **take("speed"))
    if type == "cycles":
        return Cycling(**take("first", "second", "cycles", "speed", "of"))
    if type == "axial_stress":
        return Pressed(**take("axial_stress", "stress_rate"))
    if type == "lateral_stress":
        return Pressed()
    lateral, axial = _targets(take)
    return Pressed(axial, along=lateral, **take("stress_rate"))


def _targets(take):
    """Lateral and axial stress at the end of an isotropic or anisotropic stage."""
    lateral, k = take("lateral_stress")["lateral_stress"], take("k").get("k", 1.0)
    if not isinstance(k, jax.core.Tracer) and not k > 0:
        raise ValueError(f"k = {k}: must be positive.")
    return lateral, lateral / k


def _membrane(type: str, lateral: str, take) -> Membrane:
    if type in LED:
        along = None if type == "lateral_stress" else _targets(take)[1]
        return Moved(along=along, **take("lateral_stress", "stress_rate"))
    if lateral in ("constant_p", "line"):
        return Line(**take("dq_dp"))
    if lateral == "fluid":
        return Fluid(**take("fluid_modulus", "porosity"))
    return Held() if lateral == "constant" else Sideways(SHARES[lateral])
