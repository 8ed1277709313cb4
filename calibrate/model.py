"""A simulator seen by a fit: coordinates in, a curve and its tangents out, every run counted and timed.

The simulator is anything with `params` (as axijax.mechanics.dynamics.Params) and a pure `simulate(params)` that returns
the fields axial_strain, stress_ratio and so on of `axijax.Curve` with a status; `TriaxialTest` is the real one.
"""

import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from axijax.core.status import described
from calibrate.parameters import ParameterSet

LARGEST = 1e3  # largest |dR/dz|, z the log or logit of the parameter, that is still taken for a physical sensitivity
FIELDS = ("axial_strain", "stress_ratio", "virial_ratio", "core_ratio", "volumetric_strain", "void_ratio")


class RunFailed(RuntimeError):  # noqa: N818
    """A run that gave no usable curve; the message says why."""


@dataclass
class Cost:
    """What has been spent: runs for a value, passes for value and tangents, seconds on each, forward equivalents.

    forward_equivalents: runs, with a pass of value and n tangents counted as 1 + n * tangent_cost.
    """

    runs: int = 0
    passes: int = 0
    tangents: int = 0
    run_seconds: float = 0.0
    pass_seconds: float = 0.0
    tangent_cost: float = 1.0

    @property
    def forward_equivalents(self) -> float:
        return self.runs + self.passes + self.tangent_cost * self.tangents


class Model:
    """Curves of a simulator over P named parameters.

    simulator: see the module; parameters: made by ParameterSet.of, or names.
    hold_time_step: as in ParameterSet.params.
    tangent_cost: what one tangent costs in runs, for the count [-]; measure it with `measure_tangent_cost`.
    """

    def __init__(
        self,
        simulator: Any,
        parameters: ParameterSet | Sequence[str] | str,
        hold_time_step: bool = True,
        tangent_cost: float = 1.0,
    ):
        if not isinstance(parameters, ParameterSet):
            parameters = ParameterSet.of(simulator.params, parameters)
        self.simulator, self.parameters, self.hold_time_step = simulator, parameters, hold_time_step
        self.cost = Cost(tangent_cost=tangent_cost)
        self._counting = threading.Lock()  # `run` may be called by several threads
        self._value = jax.jit(self.curve)
        self._pass = jax.jit(self._value_and_tangents)

    def check_stiffest(self) -> None:
        """Raise ValueError where the limits let the stiffness pass the one for which the test's time step was chosen,
        or the friction of a lattice the one at which it locks."""
        lattice = getattr(getattr(self.simulator, "specimen", None), "zone_rule", "") == "given"
        softer_only = ("normal_stiffness", "shear_stiffness", "shear_modulus", "poisson_ratio")
        for name, upper in zip(self.parameters.names, self.parameters.upper, strict=True):
            reference = self.parameters.reference[name]
            if lattice and name == "friction" and upper >= 1:
                raise ValueError(
                    f"upper bound of friction = {upper:g}: a regular array locks at 1 and above, so it must be below "
                    "1; random specimens alone may go above."
                )
            if not self.hold_time_step and name in softer_only and upper > reference * (1 + 1e-9):
                raise ValueError(
                    f"upper bound of {name} = {upper:g} is above the test's own {reference:g}, for which its time step "
                    "was chosen: build the test with the stiffest value allowed, or keep hold_time_step."
                )

    def params(self, coordinates):
        """Params of these (P,) coordinates."""
        return self.parameters.params(self.simulator.params, coordinates, self.hold_time_step)

    def curve(self, coordinates):
        """Fields of the curve as a dict with `status`, pure and traceable."""
        run = self.simulator.simulate(self.params(coordinates))
        return {name: jnp.asarray(getattr(run, name)) for name in FIELDS if hasattr(run, name)} | {
            "status": jnp.asarray(getattr(run, "status", 0))
        }

    def _value_and_tangents(self, coordinates, directions):
        def outputs(z):
            fields = self.curve(z)
            return fields, fields.pop("status")

        def one(direction):
            fields, tangents, status = jax.jvp(outputs, (coordinates,), (direction,), has_aux=True)
            return (fields, status), tangents

        if directions.shape[0] == 1:  # no batch axis, which would only cost
            (fields, status), tangents = one(directions[0])
            return fields | {"status": status}, {name: value[None] for name, value in tangents.items()}
        # The value does not depend on the direction, so it is computed once.
        (fields, status), tangents = jax.vmap(one, out_axes=(None, 0))(directions)
        return fields | {"status": status}, tangents

    def run(self, coordinates) -> SimpleNamespace:
        """The curve at (P,) coordinates, as NumPy arrays. Raises RunFailed where the run is not sound."""
        start = time.perf_counter()
        fields = self._finished(self._value, jnp.asarray(coordinates, float))
        with self._counting:
            self.cost.runs += 1
            self.cost.run_seconds += time.perf_counter() - start
        return self._sound(fields)

    def run_with_tangents(self, coordinates, directions=None) -> tuple[SimpleNamespace, SimpleNamespace]:
        """The curve and its tangents in one pass: fields of (T,) and of (D, T).

        directions: (D, P) in coordinates; None takes one along each parameter. Raises RunFailed like `run`; tangents
        that are not finite are returned as they are.
        """
        directions = np.eye(len(self.parameters)) if directions is None else np.asarray(directions, float)
        start = time.perf_counter()
        fields, tangents = self._finished(self._pass, jnp.asarray(coordinates, float), jnp.asarray(directions))
        self.cost.passes += 1
        self.cost.tangents += len(directions)
        self.cost.pass_seconds += time.perf_counter() - start
        return self._sound(fields), SimpleNamespace(**tangents)

    @staticmethod
    def _finished(function, *arguments):
        return jax.tree.map(np.asarray, jax.block_until_ready(function(*arguments)))

    @staticmethod
    def _sound(fields: Mapping[str, np.ndarray]) -> SimpleNamespace:
        curve = SimpleNamespace(**fields)
        if wrong := described(int(curve.status)):
            raise RunFailed(f"the run went wrong: {wrong}")
        if not np.isfinite(curve.stress_ratio).all():
            raise RunFailed("the run went wrong: its stress ratio is not finite; lower time_step")
        return curve

    def measure_tangent_cost(self, coordinates=None, repeats: int = 3) -> float:
        """Cost of one tangent in runs, (pass - run) / (run * tangents), of the fastest of alternating runs; stored [-].

        coordinates: (P,) where, by default the reference. repeats: timed runs of each kind.
        """
        z = self.parameters.coordinates() if coordinates is None else np.asarray(coordinates, float)
        directions = np.eye(len(self.parameters))
        plain: list[float] = []
        full: list[float] = []
        for _ in range(repeats + 1):  # the first compiles
            for times, call in (
                (plain, lambda: self._finished(self._value, jnp.asarray(z))),
                (full, lambda: self._finished(self._pass, jnp.asarray(z), jnp.asarray(directions))),
            ):
                start = time.perf_counter()
                call()
                times.append(time.perf_counter() - start)
        value = min(plain[1:])  # other programs on the machine only add
        self.cost.tangent_cost = max(0.0, (min(full[1:]) - value) / value / len(directions))
        return self.cost.tangent_cost


def jacobian_of(target, curve, tangents) -> tuple[np.ndarray, np.ndarray]:
    """(M,) prediction of a target and its (M, D) derivatives, from a curve and the tangents of D directions."""
    names = [name for name in FIELDS if hasattr(tangents, name) and hasattr(curve, name)]
    primal = {name: jnp.asarray(getattr(curve, name)) for name in names}

    def predict(fields):
        return target.predict(SimpleNamespace(**fields))

    value, push = jax.linearize(predict, primal)
    columns = [
        push({name: jnp.asarray(getattr(tangents, name)[d]) for name in names})
        for d in range(len(tangents.stress_ratio))
    ]
    return np.asarray(value), np.stack([np.asarray(column) for column in columns], axis=1)


def stretch_tangent(curve) -> SimpleNamespace:
    """d(curve)/d(log kn) at fixed ks/kn without a tangent run, fields of (1, T): R(eps; c kn) = R(c eps; kn), hence
    eps dR/d(eps); the volumetric strain scales as 1/c itself. Quasi-static, small strain (PHYSICS 3.3): what changes
    the geometry, such as the softening after the peak, does not stretch, so use it before and around the peak. NaN for
    a curve that turns back, since the strains where it does are given."""
    strain = curve.axial_strain
    if (np.diff(strain) <= 0).any():
        names = [name for name in FIELDS if hasattr(curve, name)]
        return SimpleNamespace(**{name: np.full((1, strain.size), np.nan) for name in names})
    fields = {"axial_strain": np.zeros_like(strain)[None]}
    for name in ("stress_ratio", "virial_ratio", "core_ratio"):
        if hasattr(curve, name):
            fields[name] = (strain * np.gradient(getattr(curve, name), strain))[None]
    if hasattr(curve, "volumetric_strain"):
        volume = curve.volumetric_strain
        fields["volumetric_strain"] = (strain * np.gradient(volume, strain) - volume)[None]
        if hasattr(curve, "void_ratio"):  # 1 + e is the volume over that of the solids
            fields["void_ratio"] = -(1 + curve.void_ratio[0]) * fields["volumetric_strain"]
    return SimpleNamespace(**fields)
