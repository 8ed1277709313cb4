"""Commands: what a stage asks of the platens, and what of the membrane. A stage joins one of either.

All paths of a triaxial test are two conditions on axial and lateral strain and stress, one a boundary:

    platens     Moving (at a speed), Cycling (to and fro), Pressed (carry a stress)
    membrane    Held, Moved (to a stress), Line (in the q-p plane), Sideways (a lateral strain), Fluid (in the pores)

The platens are a source of velocity, so an axial stress is reached by a servo; the membrane is a source of stress, so a
lateral strain is. Either servo is made of a boundary that lets waves pass instead of throwing them back: for an error
in stress the platens give way by error / (rho c), for an error in speed the membrane presses by rho c times it. A
platen that gives way as long as there is an error leaves none; one of the membrane is taken away within a few times
that a wave takes to cross. Nothing is to be tuned: c is the specimen's wave speed, rho its density, rho c^2 its
stiffness against a wave (C11 of an FCC array).

A quantity that is led to a value (strain, axial or lateral stress) gains speed, and brakes, so that it arrives without
overshoot (`towards`). Stresses are effective, compression is positive.
"""

from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp

from axijax.core.quantity import quantity
from axijax.core.tree import pytree

STIFF = 2.0  # of a membrane that holds a lateral strain, over the specimen's stiffness
GIVING = 5.0  # times faster than what lets a wave pass, that the platens give way to an error
CATCHING = 0.5  # share of what the lateral strain of the record is off, that is taken over with each record
LASTING = 4.0  # times that a wave crosses, within which the membrane takes a lasting error away
MOST = 0.4  # share of an error in speed that the membrane may take away in one step
FASTEST = 10.0  # times the platen speed, that platens may run after a stress
QUIET = 0.25  # times the rate of stress at which the platen speed loads an elastic specimen; where none is given
BRAKE = 0.6  # of the rate at which speed is gained, at which it is lost
STIFFEST = 4.0  # of a pore fluid, Kf/porosity over the specimen's stiffness against a wave
LEAST = 1e-3  # share of the confining stress below which the membrane is not relieved


class Start(NamedTuple):
    """A specimen where a stage starts; scalars.

    shortening: of the specimen since the end of confinement [L].
    axial_strain, lateral_strain: natural [-]. axial_stress, lateral_stress, pore_pressure [F/L^2].
    stiffness: against a wave, rho c^2 [F/L^2]; impedance: rho c [F T/L^3]. axial_time, lateral_time: in which a wave
    passes the height and the radius; ramp: in which a speed is reached [T].
    lightness: rate of lateral strain that a lateral stress gives to the balls under the membrane in a unit of time, if
    nothing else acts on them [L^2/(F T^2)].
    speed: platen speed of the parameters [L/T]. confining_stress: theirs too [F/L^2].
    """

    shortening: jax.Array
    axial_strain: jax.Array
    lateral_strain: jax.Array
    axial_stress: jax.Array
    lateral_stress: jax.Array
    pore_pressure: jax.Array
    stiffness: jax.Array
    impedance: jax.Array
    axial_time: jax.Array
    lateral_time: jax.Array
    lightness: jax.Array
    ramp: jax.Array
    speed: jax.Array
    confining_stress: jax.Array


class Now(NamedTuple):
    """A specimen at t; scalars as in `Start`. closing: rate at which the platens close in [L/T]; rates: of the natural
    strains [1/T]; height at the end of confinement [L]."""

    dt: Any
    height: jax.Array
    closing: jax.Array
    shortening: jax.Array
    axial_strain: jax.Array
    axial_stress: jax.Array
    lateral_stress: jax.Array
    lateral_strain: jax.Array
    axial_rate: jax.Array
    lateral_rate: jax.Array


def towards(left, rate, top, ramp, dt):
    """The rate one step later of what is to go `left` further, and whether it arrives with that step.

    It gains speed by at most `top` within two thirds of the time `ramp`, loses it at 0.6 of that rate, arrives at rest.
    """
    gain = 1.5 * top / ramp * dt
    away = jnp.abs(left)
    wanted = jnp.sign(left) * jnp.minimum(top, jnp.sqrt(2 * BRAKE * gain / dt * jnp.maximum(away, 1e-300)))
    faster = rate + jnp.clip(wanted - rate, -gain, gain)
    there = away <= jnp.abs(faster) * dt + gain * dt
    return jnp.where(there, jnp.where(there, left, 0.0) / dt, faster), there


class Way(NamedTuple):
    """Of a stress that is led to a value: the share of the way that is done, its rate [1/T], whether it is there."""

    share: jax.Array
    rate: jax.Array
    there: jax.Array

    def further(self, stress_rate, start: Start, now: Now, *changes) -> "Way":
        """One step later; changes: of the stresses that are led together, of which the larger goes at the rate that is
        given, or at a quarter of that at which the platen speed loads an elastic specimen [F/L^2]."""
        if stress_rate is None:
            stress_rate = QUIET * start.stiffness * 2 * start.speed / now.height
        whole = jnp.abs(jnp.stack(changes)).max()
        rate, there = towards(
            1 - self.share, self.rate, stress_rate / jnp.where(whole > 0, whole, 1.0), start.ramp, now.dt
        )
        # What has arrived stays, and does not begin the next step with the rate of its last.
        share = jnp.where(there, 1.0, self.share + rate * now.dt)
        return Way(share, jnp.where(there, 0.0, rate), self.there | there)


def _at_its_start(start: Start) -> Way:
    nothing = jnp.zeros_like(start.axial_stress)
    return Way(nothing, nothing, jnp.zeros((), bool))


class Platens:
    """What a command for the platens is to a stage."""

    def begin(self, start: Start) -> Any:
        """Its memory at the start."""
        return None

    def closing(self, now: Now, start: Start, memory) -> tuple[jax.Array, Any, Any]:
        """Rate at which the platens close in at t + dt/2 [L/T], its memory then, and the error of its servo [F/L^2],
        None without one."""
        raise NotImplementedError

    def finished(self, memory) -> Any:
        """Whether it has reached what it leads to; None where it leads nowhere."""
        return None


@pytree
@dataclass(frozen=True)
class Moving(Platens):
    """Platens at a speed, inward for compression; 0 holds them."""

    direction: jax.Array | float = 1.0
    speed: jax.Array | float | None = quantity(
        None, "speed of each platen; left out: parameters.platen_speed", "L/T", above=0.0, optional=True
    )

    def closing(self, now, start, memory):
        top = 2 * (start.speed if self.speed is None else self.speed)
        gain = 1.5 * top / start.ramp * now.dt
        return now.closing + jnp.clip(self.direction * top - now.closing, -gain, gain), memory, None


@pytree
@dataclass(frozen=True)
class Cycling(Platens):
    """Platens to and fro between two limits, of axial strain or of deviator stress s1 - s3, so many times, or once to
    the first limit where there is no second."""

    first: jax.Array | float = quantity(0.0, "first limit of the cycles", "", least=-jnp.inf)
    second: jax.Array | float = quantity(0.0, "second limit of the cycles", "", least=-jnp.inf)
    cycles: jax.Array | int = quantity(
        1, "number of cycles, each to the first limit and the second", "-", least=1, whole=True
    )
    speed: jax.Array | float | None = quantity(
        None, "speed of each platen; left out: parameters.platen_speed", "L/T", above=0.0, optional=True
    )
    of: Literal["axial_strain", "deviator_stress"] = field(default="axial_strain", metadata={"static": True})

    def begin(self, start):
        return jnp.zeros((), jnp.int32)

    def closing(self, now, start, memory):
        top = 2 * (start.speed if self.speed is None else self.speed)
        limit = jnp.where(memory % 2 == 0, self.first, self.second)
        if self.of == "axial_strain":
            left = limit * now.height - now.shortening
        else:  # the softer the specimen, the earlier it brakes
            left = (limit - (now.axial_stress - now.lateral_stress)) / start.stiffness * now.height
        rate, there = towards(left, now.closing, top, start.ramp, now.dt)
        done = memory >= 2 * self.cycles
        return jnp.where(done, 0.0, rate), memory + (there & ~done), None

    def finished(self, memory):
        return memory >= 2 * self.cycles


@pytree
@dataclass(frozen=True)
class Pressed(Platens):
    """Platens that carry an axial stress: it is led to a value, or stays.

    along: the lateral stress to which the membrane is led meanwhile (`Moved`), so that both go in a straight line.
    """

    axial_stress: jax.Array | float | None = quantity(
        None, "axial stress to which it is led; left out: that of the start", "F/L^2", above=0.0, optional=True
    )
    stress_rate: jax.Array | float | None = quantity(
        None, "rate of the stress that is led; left out: as fast as the platen speed loads an elastic specimen",
        "F/L^2/T", above=0.0, optional=True,
    )  # fmt: skip
    along: jax.Array | float | None = None

    def begin(self, start):
        return _at_its_start(start)

    def closing(self, now, start, memory):
        way, wanted, following = memory, start.axial_stress, 0.0
        if self.axial_stress is not None:
            change = self.axial_stress - start.axial_stress
            others = [] if self.along is None else [self.along - start.lateral_stress]
            way = memory.further(self.stress_rate, start, now, change, *others)
            wanted = start.axial_stress + change * way.share
            # What an elastic specimen needs to follow; beyond that the platens give way to the error.
            following = change * (way.share - memory.share) / now.dt * now.height / start.stiffness
        error = wanted - now.axial_stress
        most = 2 * FASTEST * start.speed
        return jnp.clip(following + 2 * GIVING * error / start.impedance, -most, most), way, error

    def finished(self, memory):
        return None if self.axial_stress is None else memory.there


def lets_pass(now: Now, start: Start) -> jax.Array:
    """Lateral stress for an error in the rate of lateral strain that lets a wave pass, rho c times the radius
    [F T/L^2]. Less where that would take away more than MOST of the error in a step, and the less the longer the step:
    it comes a step late, when balls that turn back within a few steps have turned."""
    whole = start.stiffness * start.lateral_time
    share = whole * start.lightness * now.dt
    return whole * jnp.minimum((MOST / share) ** 1.5, 1.0)


def quieted(now: Now, start: Start, mean):
    """The stress by which the membrane damps what oscillates about its mean motion, or a wave between platens and
    membrane would grow; and the mean rate of lateral strain one step later."""
    mean = mean + (now.lateral_rate - mean) * now.dt / (LASTING * start.lateral_time)
    return lets_pass(now, start) * (mean - now.lateral_rate), mean


class Membrane:
    """What a command for the membrane is to a stage."""

    needs_strain = True  # whether the lateral strain is to be kept

    def begin(self, start: Start) -> Any:
        """Its memory at the start."""
        return None

    def press(self, now: Now, start: Start, memory) -> tuple[jax.Array, Any, Any, Any]:
        """Lateral stress at t + dt and its memory then, the pore pressure or None, and the error of its servo [F/L^2]
        or None."""
        raise NotImplementedError

    def stored(self, pore_pressure) -> Any:
        """Elastic energy of a pore fluid over the specimen's volume [F/L^2]."""
        return 0.0

    def finished(self, memory) -> Any:
        """As of `Platens`."""
        return None


@pytree
@dataclass(frozen=True)
class Held(Membrane):
    """The lateral stress of the start."""

    needs_strain = False

    def press(self, now, start, memory):
        return now.lateral_stress, memory, None, None


@pytree
@dataclass(frozen=True)
class Moved(Membrane):
    """A lateral stress that is led to a value.

    along: the axial stress to which the platens are led meanwhile (`Pressed`).
    """

    needs_strain = False

    lateral_stress: jax.Array | float = quantity(5.0e4, "lateral stress to which it is led", "F/L^2", above=0.0)
    stress_rate: jax.Array | float | None = quantity(
        None, "rate of the stress that is led; left out: as fast as the platen speed loads an elastic specimen",
        "F/L^2/T", above=0.0, optional=True,
    )  # fmt: skip

    along: jax.Array | float | None = None

    def begin(self, start):
        return _at_its_start(start)

    def press(self, now, start, memory):
        change = self.lateral_stress - start.lateral_stress
        others = [] if self.along is None else [self.along - start.axial_stress]
        way = memory.further(self.stress_rate, start, now, change, *others)
        return start.lateral_stress + change * way.share, way, None, None

    def finished(self, memory):
        return memory.there


@pytree
@dataclass(frozen=True)
class Line(Membrane):
    """A straight line in the q-p plane, q = s1 - s3 and p = (s1 + 2 s3)/3, from where the stage starts; by default
    p stays."""

    dq_dp: jax.Array | float | None = quantity(
        None, "slope dq/dp of the stress path; left out: constant p; 3 is constant lateral stress", "-",
        least=-jnp.inf, optional=True,
    )  # fmt: skip

    def begin(self, start):
        return jnp.zeros_like(start.lateral_stress)

    def press(self, now, start, memory):
        share = -0.5 if self.dq_dp is None else (3 - self.dq_dp) / (3 + 2 * self.dq_dp)
        wanted = start.lateral_stress + share * (now.axial_stress - start.axial_stress)
        damping, mean = quieted(now, start, memory)
        return wanted + damping, mean, None, damping


@pytree
@dataclass(frozen=True)
class Sideways(Membrane):
    """A lateral strain that goes with the axial one: 0 is K0, -1/2 constant volume (undrained)."""

    share: jax.Array | float = -0.5

    def begin(self, start):
        return start.lateral_stress

    def press(self, now, start, memory):
        # Positive where the specimen is wider than it should be.
        apart = start.lateral_strain + self.share * (now.axial_strain - start.axial_strain) - now.lateral_strain
        rate = self.share * now.axial_rate - now.lateral_rate
        error = start.stiffness * apart
        damping = lets_pass(now, start)
        # What is damped by less than half as much would swing.
        slower = jnp.minimum(2 * damping / (start.stiffness * start.lateral_time), 1.0)
        lasting = memory + STIFF * error * now.dt / (0.5 * LASTING * start.lateral_time) * slower
        pressed = lasting + STIFF * error + damping * rate
        return pressed, lasting, start.lateral_stress + start.pore_pressure - pressed, error


@pytree
@dataclass(frozen=True)
class Fluid(Membrane):
    """A pore fluid that cannot leave, u = (Kf/porosity) times the volumetric strain; the total lateral stress stays."""

    fluid_modulus: jax.Array | float = quantity(1.0e8, "bulk modulus of the pore fluid", "F/L^2", above=0.0)
    porosity: jax.Array | float = quantity(0.4, "volume of the pores over the whole", "-", above=0.0, below=1.0)

    def begin(self, start):
        return jnp.zeros_like(start.lateral_stress)

    def press(self, now, start, memory):
        axial, lateral = now.axial_strain - start.axial_strain, now.lateral_strain - start.lateral_strain
        pressure = start.pore_pressure + self.fluid_modulus / self.porosity * (axial + 2 * lateral)
        damping, mean = quieted(now, start, memory)
        return start.lateral_stress + start.pore_pressure - pressure + damping, mean, pressure, damping

    def stored(self, pore_pressure):
        return 0.5 * pore_pressure**2 * self.porosity / self.fluid_modulus
