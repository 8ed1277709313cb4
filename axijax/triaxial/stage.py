"""A stage of a test: a command for the platens, one for the membrane, and where it ends.

    TriaxialTest(specimen, stages=(
        stage("isotropic", lateral_stress=1e5),
        stage("compression", lateral="constant_volume", axial_strain=0.01),
        stage("extension", deviator_stress=0.0),
    ))

`axijax.stage` (`axijax.triaxial.stage_types`) names the usual ones, in Python as in the [[stage]] tables of a case
file; `Stage` itself takes any two commands of `axijax.triaxial.commands`, or of your own.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from axijax.core.quantity import check_values, quantity
from axijax.core.tree import pytree
from axijax.mechanics.dynamics import positions
from axijax.mechanics.membrane import lateral_force
from axijax.mechanics.state import State
from axijax.triaxial.commands import (
    CATCHING,
    LEAST,
    QUIET,
    STIFFEST,
    Cycling,
    Fluid,
    Held,
    Membrane,
    Moved,
    Moving,
    Now,
    Platens,
    Pressed,
    Start,
)
from axijax.triaxial.paths import Path, wave_speed

# Shares of the confining stress: below the first the specimen bears no stress any more; a servo may be off by the
# second, and must be within the third before a stress counts as reached.
NOTHING, ASTRAY, REACHED = 0.01, 0.3, 1e-3
SHORTENED = 6  # records of a stage that may come early, so that one of them comes as it ends

ENDED = {
    2: "the lateral stress has fallen to nothing: the specimen has liquefied, or is pulled apart",
    3: "the axial stress has fallen to nothing: the platens come off",
    4: "the specimen cannot follow: the stress or strain that is asked for is outside its strength",
}


@pytree
@dataclass(frozen=True)
class Until:
    """Where a stage ends: within a step after one of these is reached, from whichever side it comes.

    That is the step after which a record is made, since the record before tells when: by secants through the last two.
    Where a stress scatters from record to record it may come up to one record later.
    """

    axial_strain: jax.Array | float | None = quantity(
        None, "axial strain at which the stage ends, since the end of confinement", "-", least=-1.0, below=0.5,
        optional=True, coordinate="linear",
    )  # fmt: skip
    stress_ratio: jax.Array | float | None = quantity(
        None, "stress ratio s1/s3 at which the stage ends", "-", above=0.0, optional=True
    )
    deviator_stress: jax.Array | float | None = quantity(
        None, "s1 - s3 at which the stage ends", "F/L^2", least=-jnp.inf, optional=True, coordinate="linear"
    )
    mean_stress: jax.Array | float | None = quantity(
        None, "p = (s1 + 2 s3)/3 at which the stage ends", "F/L^2", above=0.0, optional=True
    )
    volumetric_strain: jax.Array | float | None = quantity(
        None, "volumetric strain in this stage at which it ends", "-", least=-1.0, below=1.0, optional=True,
        coordinate="linear",
    )  # fmt: skip
    time: jax.Array | float | None = quantity(
        None, "time after which the stage ends in any case", "T", above=0.0, optional=True
    )

    def given(self) -> dict[str, Any]:
        """Those that are there, by name."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if getattr(self, f.name) is not None}


class Looked(NamedTuple):
    """What the last record has shown. time: of it in the stage, negative before the first [T]. beyond: how far each of
    Until's was beyond its limit, in their units. short: how many records have come early."""

    time: jax.Array
    beyond: tuple[jax.Array, ...]
    short: jax.Array


class StageMemory(NamedTuple):
    """Where the stage started, and what its commands remember. volume: at its first record; zero before [L^3]."""

    start: Start
    volume: jax.Array
    platens: Any
    membrane: Any
    last: Looked


def _inward(network, load, state):
    """The membrane's force on each ball for a lateral stress of one (N,) [L^2], and its moment about the axis, negative
    [L^3]."""
    place = positions(network, state)
    inward = lateral_force(1.0, load, place)
    return inward, (network.weight * inward.dot(place)).sum()


@pytree
@dataclass(frozen=True)
class Stage(Path):
    """Platens and membrane under command until a criterion is met, or both are where they lead to."""

    platens: Platens
    membrane: Membrane = Held()
    until: Until = Until()

    @property
    def _keeps_strain(self) -> bool:
        return self.membrane.needs_strain or self.until.volumetric_strain is not None

    def begin(self, params, network, load, state, push):
        loading = state.loading
        height = state.platens[1] - state.platens[0]
        pressed = dataclasses.replace(params, confining_stress=loading.lateral_stress)
        speed = wave_speed(pressed, network)
        mass = params.material.mass_per_cube * (network.weight * network.mass_cube).sum()
        density = mass / (load.section * height)
        inward, arm = _inward(network, load, state)
        each = params.material.mass(network)
        start = Start(
            shortening=loading.height - height,
            axial_strain=jnp.log(loading.height / height),
            lateral_strain=loading.lateral_strain,
            axial_stress=push.mean() / load.section,
            lateral_stress=loading.lateral_stress,
            pore_pressure=loading.pore_pressure,
            stiffness=density * speed**2,
            impedance=density * speed,
            axial_time=height / speed,
            lateral_time=jnp.sqrt(2 * load.section / network.sector.angle) / speed,
            lightness=-(network.weight * inward.dot(inward) / each).sum() / arm,
            ramp=8 * height / speed,
            speed=jnp.asarray(params.platen_speed, height.dtype),
            confining_stress=jnp.asarray(params.confining_stress, height.dtype),
        )
        nothing = jnp.zeros_like(start.axial_strain)
        last = Looked(nothing - 1, (nothing,) * len(self.until.given()), jnp.zeros((), jnp.int32))
        memory = StageMemory(start, nothing, self.platens.begin(start), self.membrane.begin(start), last)
        return loading._replace(memory=memory)

    def _now(self, params, dt, state: State, push, section) -> Now:
        loading = state.loading
        assert loading is not None
        height, closing = state.platens[1] - state.platens[0], state.platen_speeds[0] - state.platen_speeds[1]
        zero = jnp.zeros_like(closing)
        return Now(
            dt=dt,
            height=loading.height,
            closing=closing,
            shortening=loading.height - height,
            axial_strain=jnp.log(loading.height / height),
            axial_stress=push.mean() / section,
            lateral_stress=loading.lateral_stress,
            lateral_strain=loading.lateral_strain,
            axial_rate=closing / height,
            lateral_rate=zero,
        )

    def platen_speeds(self, params, network, dt, state, push, section):
        memory = state.loading.memory
        rate, _, _ = self.platens.closing(self._now(params, dt, state, push, section), memory.start, memory.platens)
        return (jnp.array([0.5, -0.5]) * rate).astype(push.dtype)

    def loading(self, params, network, load, dt, state, push, speeds):
        before, memory = state.loading, state.loading.memory
        now = self._now(params, dt, state, push, load.section)
        if self._keeps_strain:
            inward, arm = _inward(network, load, state)
            rate = -(network.weight * inward.dot(state.velocity)).sum() / arm
            now = now._replace(lateral_rate=rate, lateral_strain=now.lateral_strain + dt * rate)
        start = memory.start
        _, platens, off = self.platens.closing(now, start, memory.platens)
        stress, membrane, pressure, aside = self.membrane.press(now, start, memory.membrane)
        stress = jnp.maximum(stress, LEAST * start.confining_stress)
        errors = [jnp.abs(error) for error in (off, aside) if error is not None]
        error = jnp.stack(errors).max() if errors else jnp.zeros_like(before.error)
        closed = jnp.abs(speeds[0] - speeds[1]) * dt
        found = before._replace(
            lateral_stress=stress,
            pore_pressure=before.pore_pressure if pressure is None else pressure,
            lateral_strain=now.lateral_strain,
            path_length=before.path_length + closed / before.height,
            error=error / start.confining_stress,
            memory=memory._replace(platens=platens, membrane=membrane),
        )
        return jax.tree.map(lambda new, old: jnp.asarray(new, jnp.asarray(old).dtype), found, before)

    def recorded(self, seen, state, dt, most):
        """The lateral strain follows the volume that is recorded, from record to record; between them it is that of the
        membrane's balls, which is known at every step."""
        loading, steps = state.loading, most
        if self.until.given():
            last, steps = self._look_ahead(seen, state, dt, most)
            loading = loading._replace(memory=loading.memory._replace(last=last))
        if not self._keeps_strain:
            return loading, steps
        memory = loading.memory
        first = memory.volume == 0
        volume = jnp.where(first, seen.volume, memory.volume)
        axial = jnp.log(loading.height / seen.height) - memory.start.axial_strain
        lateral = memory.start.lateral_strain - 0.5 * (jnp.log(seen.volume / volume) + axial)
        caught = loading.lateral_strain + CATCHING * (lateral - loading.lateral_strain)
        return loading._replace(
            lateral_strain=jnp.where(first, loading.lateral_strain, caught).astype(loading.lateral_strain.dtype),
            memory=memory._replace(volume=volume.astype(memory.volume.dtype)),
        ), steps

    def fluid(self, state):
        return self.membrane.stored(state.loading.pore_pressure)

    def _look_ahead(self, seen, state, dt, most):
        """What this record shows, and the steps to the next: fewer where the last two tell that the stage ends then."""
        last = state.loading.memory.last
        beyond = tuple(now for now, _ in self._beyond(seen, state))
        left = jnp.full((), jnp.inf)
        for now, before in zip(beyond, last.beyond, strict=True):
            rate = (now - before) / (state.time - last.time)
            nearing = jnp.isfinite(rate) & (now * rate < 0) & (last.time >= 0)
            left = jnp.minimum(left, jnp.where(nearing, -now / jnp.where(nearing, rate, 1.0), jnp.inf))
        steps = jnp.ceil(jnp.minimum(jax.lax.stop_gradient(left) / dt, most) - 1e-6)
        early = (steps < most) & (last.short < SHORTENED)
        steps = jnp.where(early, jnp.maximum(steps, 1), most).astype(jnp.int32)
        found = Looked(state.time, beyond, last.short + early)
        return jax.tree.map(lambda new, old: jnp.asarray(new, old.dtype), found, last), steps

    def _beyond(self, seen, state):
        """Of each of Until's, how far it is beyond its limit now, and how far it was at the start of the stage."""
        loading = state.loading
        start = loading.memory.start
        axial, lateral = seen.stress_ratio * seen.lateral_stress, seen.lateral_stress
        measured = {
            "axial_strain": (1 - seen.height / loading.height, start.shortening / loading.height),
            "stress_ratio": (seen.stress_ratio, start.axial_stress / start.lateral_stress),
            "deviator_stress": (axial - lateral, start.axial_stress - start.lateral_stress),
            "mean_stress": ((axial + 2 * lateral) / 3, (start.axial_stress + 2 * start.lateral_stress) / 3),
            "volumetric_strain": (
                jnp.log(loading.height / seen.height) - start.axial_strain
                + 2 * (loading.lateral_strain - start.lateral_strain),
                0.0,
            ),
            "time": (state.time, 0.0),
        }  # fmt: skip
        return [tuple(each - limit for each in measured[name]) for name, limit in self.until.given().items()]

    def watch(self, seen, state):
        """A number: 0 goes on, 1 is done, more than that see ENDED."""
        loading = state.loading
        memory, start = loading.memory, loading.memory.start
        axial, lateral = seen.stress_ratio * seen.lateral_stress, seen.lateral_stress
        done = jnp.zeros((), bool)
        for now, first in self._beyond(seen, state):
            done |= jnp.isfinite(now) & (now * first <= 0)
        led = [self.platens.finished(memory.platens), self.membrane.finished(memory.membrane)]
        led = [each for each in led if each is not None]
        if led:
            done |= jnp.stack(led).all() & (loading.error < REACHED) & jnp.isfinite(seen.height)
        least = NOTHING * start.confining_stress
        code = jnp.where(done, 1, 0)
        code = jnp.where(loading.error > ASTRAY, 4, code)
        code = jnp.where(axial < least, 3, code)
        code = jnp.where(lateral < least, 2, code)
        return jnp.where(jnp.isfinite(seen.height), code, 0)

    def going(self, watched, steps):
        return watched == 0

    def failed(self, watched):
        return watched > 1

    def ended(self, watched):
        return ENDED.get(int(watched), "")

    def duration(self, start):
        bounds = [] if self.until.time is None else [float(self.until.time)]
        (low, high), axial, lateral = start.axial_strain, start.axial_stress, start.lateral_stress
        default = QUIET * start.stiffness * 2 * start.speed / start.height
        settling = 6 * start.ramp

        def leads(to, origin, given, *other):
            """A stress is led to a value: in which time, and how far the specimen may be strained by it."""
            nonlocal low, high
            way = max(abs(to - origin) if np.isfinite(origin) else 2 * to for to, origin in ((to, origin), *other))
            bounds.append(way / (default if given is None else float(given)) + settling)
            low, high = low - 10 * way / start.stiffness, high + 10 * way / start.stiffness

        if isinstance(self.membrane, Moved):
            to = float(self.membrane.lateral_stress)
            along = self.membrane.along
            leads(to, lateral, self.membrane.stress_rate, *([] if along is None else [(float(along), axial)]))
            lateral = to
        elif not isinstance(self.membrane, Held):
            lateral = np.nan
        if isinstance(self.membrane, Fluid):
            ratio = float(self.membrane.fluid_modulus) / float(self.membrane.porosity) / start.stiffness
            if ratio > STIFFEST:
                raise ValueError(
                    f"fluid_modulus over porosity is {ratio:.3g} times the specimen's stiffness: at most {STIFFEST:g} "
                    "can be followed; so stiff a fluid all but keeps the volume: take lateral = 'constant_volume'."
                )
        rate = 2 * float(getattr(self.platens, "speed", None) or start.speed) / start.height
        if isinstance(self.platens, Pressed):
            if self.platens.axial_stress is not None:
                if self.platens.along is None:
                    leads(float(self.platens.axial_stress), axial, self.platens.stress_rate)
                axial = float(self.platens.axial_stress)
        else:
            axial = np.nan
        if isinstance(self.platens, Cycling) and self.platens.of == "axial_strain":
            first, second, legs = float(self.platens.first), float(self.platens.second), 2 * int(self.platens.cycles)
            way = max(abs(first - low), abs(first - high)) + (legs - 1) * abs(second - first)
            bounds.append(way / rate + legs * start.ramp + settling)
            low = high = second
        elif self.until.axial_strain is not None and isinstance(self.platens, Moving):
            to = float(self.until.axial_strain)
            bounds.append(max(abs(to - low), abs(to - high)) / rate + 2 * start.ramp)
            low, high = min(low, to), max(high, to)
        if not bounds:
            raise ValueError(
                "a stage that ends at a stress or a volume needs a bound as well, since a specimen may be too weak to "
                "reach it: give it an axial_strain, or a time."
            )
        if set(self.until.given()) - {"axial_strain", "time"}:
            axial, lateral = np.nan, lateral if isinstance(self.membrane, Held) else np.nan
        return start._replace(axial_strain=(low, high), axial_stress=axial, lateral_stress=lateral, time=min(bounds))

    def check(self):
        for part, kind in ((self.platens, Platens), (self.membrane, Membrane), (self.until, Until)):
            if not isinstance(part, kind):
                raise ValueError(f"a stage's {kind.__name__.lower()} = {part!r}: must be a {kind.__name__}.")
        check_values(self)
        slope = getattr(self.membrane, "dq_dp", None)
        if slope is not None and -6 < float(slope) < 0:
            raise ValueError(
                f"dq_dp = {slope:g}: must be zero or more, or -6 or less; between these the lateral stress would "
                "change more than the axial stress that leads it. Lead the lateral stress: type = 'anisotropic'."
            )
        if isinstance(self.platens, Cycling) and float(self.platens.first) == float(self.platens.second):
            raise ValueError(f"first = second = {float(self.platens.first):g}: cycles need two limits that differ.")
