"""What a test needs before it can run: contact list, membrane, time step and numbers of steps. As pytrees of arrays."""

import warnings
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from axijax.core.quantity import parts_of
from axijax.core.shown import shown
from axijax.mechanics.contact_list import ContactList, build_contact_list
from axijax.mechanics.contact_search import grid_for
from axijax.mechanics.dynamics import Scene
from axijax.mechanics.mass_scaling import check_quasi_static, scaled
from axijax.mechanics.membrane import Load, Membrane, build_membrane, check_load, sloping
from axijax.mechanics.params import Params, check_params
from axijax.mechanics.rebuild import LARGEST_OVERLAP, roomy_lists
from axijax.mechanics.rolling import RotationResistance
from axijax.mechanics.time_step import DEFAULT_STEP, check_step, critical_time_step
from axijax.triaxial.feasible import pressed_in
from axijax.triaxial.paths import Compression, Expected, Isotropic, Path, wave_speed
from axijax.triaxial.stage import SHORTENED

if TYPE_CHECKING:
    from axijax.triaxial.test import TriaxialTest

# The deepest overlap of a packing, in radii, over what `pressed_in` says: with five contacts a ball each bears 4.2 s3
# r^2 in the mean, and of some thousands one bears seven times as much.
DEEPEST = 30.0
MORE_RECORDS = 2 + SHORTENED  # of a stage: one at its start, one past its end, and those that come early
MOST_STEPS = 2**31 - 1  # steps are counted in 32 bits; so many take days


@dataclass(frozen=True)
class Numerics:
    """The numbers of a test that are not physics and shape what is compiled; static.

    records, record_every: the shear makes so many records and takes so many steps after each.
    refresh: find the membrane's cells again with every record; otherwise they keep their first areas.
    rebuild_every: renew the lists inside jit each time after so many records; zero keeps them.
    stage_records: of a test in stages, in place of `records`: of each stage.
    """

    records: int
    record_every: int = 50
    refresh: bool = True
    rebuild_every: int = 0
    stage_records: tuple[int, ...] = ()

    @property
    def most_steps(self) -> int:
        """Steps after confinement, at most."""
        return (sum(self.stage_records) or self.records) * self.record_every


@shown
@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Prepared:
    """A test ready to be simulated, a pytree: tests of one structure and one shape share a compiled program.

    platens: (2,) heights of the bottom and the top platen before confinement [L].
    time_step: of a step [T]. confinement, shear: the two stages' paths; `dataclasses.replace` puts in one of your own.
    stages: the paths of a test in stages, which take the place of `shear`. ramp_time: in which platens reach their
    speed [T].
    lateral_load: a constant load in place of the membrane's, or None.
    scene, numerics: static.
    """

    network: ContactList
    membrane: Membrane
    platens: jax.Array
    time_step: jax.Array | float
    confinement: Isotropic
    shear: Compression | Any  # or any other path
    lateral_load: Load | None
    scene: Scene = field(metadata={"static": True})
    numerics: Numerics = field(metadata={"static": True})
    stages: tuple[Path, ...] = ()
    ramp_time: jax.Array | float = 0.0

    @property
    def lists(self) -> tuple[ContactList, Membrane]:
        return self.network, self.membrane


def warn_of_slipping(params: Params, confining_friction: float) -> None:
    """Warn of a shear that begins with less friction than the specimen was confined with."""
    friction = params.material.friction
    least = 0.0 if friction is None else float(np.min(np.asarray(friction)))
    if least < confining_friction:
        warnings.warn(
            f"friction {least:g} is below the confining_friction {confining_friction:g}: the contacts that hold the "
            "confined specimen slip as soon as the shear begins, and the stress ratio may fall below 1; lower "
            "confining_friction, and for a random specimen compaction_friction, to at most the friction.",
            stacklevel=4,
        )


def prepare(test: "TriaxialTest") -> Prepared:
    """Contact list, membrane, time step and paths of a test (host).

    Raises ValueError for specimens, parameters and steps that make no sense together.
    """
    cut, sector, params = test.cut, test.sector, test.params
    check_params(params, len(cut))
    warn_of_slipping(params, test.confining_friction)
    for term in params.terms:
        term.check(sector)
    if params.material.plane_friction is not None and sector.boundary != "rigid":
        raise ValueError(
            f"plane_friction = {params.material.plane_friction}: would do nothing between periodic sector planes; "
            "leave it out, or take boundary = 'rigid'."
        )
    for part in parts_of(params.material):
        if isinstance(part, RotationResistance) and not (test.scene.rotation and params.material.frictional):
            raise ValueError(
                f"{type(part).__name__.lower()} = {part!r}: would do nothing where no ball spins (friction None, or "
                "Scene(rotation=False)); leave it out."
            )
    if cut.zone_rule == "exposure" or test.rebuild_every:
        # A random specimen was made under stress, which presses soft balls into one another.
        soft = cut.zone_rule == "exposure"
        overlap = min(max(0.05, DEEPEST * pressed_in(cut.radius, params)), LARGEST_OVERLAP) if soft else 0.05
        network, membrane = roomy_lists(cut, sector, test.dtype, overlap)
        if test.rebuild_every:
            network = replace(network, grid=grid_for(network))
    else:
        network = build_contact_list(cut, sector, dtype=test.dtype)
        membrane = build_membrane(cut, sector, dtype=test.dtype)
    if test.scene.membrane != "radial":
        if test.lateral_load is not None:
            raise ValueError(
                f"scene membrane = '{test.scene.membrane}': would do nothing beside a lateral_load, which takes the "
                "membrane's place; leave out one of them."
            )
        membrane = sloping(membrane, cut, tied=test.scene.membrane == "tied")
    if test.mass_scaling is not None:
        network = scaled(test.scene, params, network, test.mass_scaling)
        check_masses(test, params, network)
    step = test.time_step
    if step is None or not test.allow_unsafe_step:
        limit = critical_time_step(test.scene, params, network)
        step = DEFAULT_STEP * limit if step is None else step
        check_step(step, limit)
    ramp = float(8 * cut.height / wave_speed(params, network))
    speed = float(params.platen_speed)
    durations = _durations(test, params, network, ramp)
    duration = max(durations, default=test.axial_strain * cut.height / (2 * speed) + ramp / 2)
    if not duration / step <= MOST_STEPS:
        goal = "a stage" if durations else f"axial_strain = {test.axial_strain:g}"
        raise ValueError(
            f"{goal} takes {duration / step:.2g} steps of {step:.3g} at platen_speed = "
            f"{speed:g}: at most {MOST_STEPS:.2g} can be counted; raise platen_speed or stop at a smaller strain."
        )
    if test.lateral_load is not None:
        check_load(test.lateral_load, cut)
    return Prepared(
        network=network,
        membrane=membrane,
        platens=jnp.asarray([cut.bottom, cut.top]),
        time_step=float(step),
        confinement=Isotropic(
            float(test.confining_friction) if test.confining_friction > 0 else None, test.tolerance, test.confine_steps
        ),
        shear=Compression(ramp),
        # What is constant does not age.
        lateral_load=None if test.lateral_load is None else replace(test.lateral_load, stale=0.0),
        scene=test.scene,
        numerics=Numerics(
            records=int(np.ceil(duration / step / test.record_every)) + 1,  # one at the start and one at the end
            record_every=test.record_every,
            refresh=test.refresh,
            rebuild_every=test.rebuild_every,
            stage_records=tuple(int(np.ceil(each / step / test.record_every)) + MORE_RECORDS for each in durations),
        ),
        stages=test.stages,
        ramp_time=ramp,
    )


def check_masses(test: "TriaxialTest", params: Params, network: ContactList) -> None:
    """Raise ValueError where masses are scaled and a test with these parameters would not be quasi-static."""
    if test.mass_scaling is not None:
        given = [getattr(getattr(path, "platens", None), "speed", None) for path in test.stages or (None,)]
        fastest = max(float(params.platen_speed if speed is None else speed) for speed in given)
        check_quasi_static(params, network, 2 * fastest / test.cut.height, test.mass_scaling)


def _durations(test: "TriaxialTest", params: Params, network: ContactList, ramp: float) -> list[float]:
    """How long the stages of a test take at most [T]. Raises ValueError where one makes no sense, or has no end."""
    stress, height = float(params.confining_stress), test.cut.height
    density = float(np.sum(params.material.mass_per_cube * network.weight * network.mass_cube)) / (
        height * float(network.sector.angle) / 2 * float(np.hypot(*test.cut.positions[:2]).max()) ** 2
    )
    stiffness = density * float(wave_speed(params, network)) ** 2
    now = Expected(height, (0.0, 0.0), stress, stress, float(params.platen_speed), stiffness, ramp)
    found = []
    for number, path in enumerate(test.stages, 1):
        if not isinstance(path, Path):
            raise ValueError(f"stages: stage {number} is {path!r}: must be an axijax.stage(..), or a path of your own.")
        try:
            path.check()
            now = path.duration(now)
        except ValueError as error:
            raise ValueError(f"stage {number}: {error}") from None
        found.append(float(now.time))
    return found
