"""Derivatives of a target, and whether to believe them.

Forward mode: value and all tangents in one pass. A tangent of a long run of a chaotic system may be exact and useless,
or (local damping) wrong from the start, while the value looks smooth; so a gradient never comes without its health:
agreement with central differences of the same run over a sweep of h, and the growth of the tangent with strain.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np

from calibrate.model import LARGEST, Model, RunFailed, jacobian_of

STEPS = (1e-2, 1e-3, 1e-4)  # h of the sweep, relative to the value (for friction to f(1 - f)): steps in the coordinate
AGREEMENT = 1e-2  # largest relative disagreement of the target's derivative that counts as agreement
APART = 0.1  # relative disagreement of the curves' derivatives at which they have parted
SHORTEST = 0.25  # share of the run below which a limited strain range is of no use

RULE = (
    f"use: the target's derivative agrees with the best central difference to {AGREEMENT:g} relative (of the largest "
    f"component) and no |dR/d log p| exceeds {LARGEST:g}. Use up to strain x: it does not, but the curve's derivative, "
    f"averaged over a tenth of the run, stays within {APART:.0%} of the differences up to x, at least {SHORTEST:.0%} "
    "of the run. Fall back on differences: otherwise."
)


@dataclass(frozen=True)
class Health:
    """Whether a gradient can be believed; S steps h, P parameters, T records.

    verdict: "use", "use up to strain x" or "fall back", by RULE.
    usable_strain: x of the second verdict; the run's end for "use", 0 for "fall back" [-].
    disagreement: by parameter, |jvp - difference| / scale of the target at its best h [-]; best_step: that h in the
        coordinate (relative change of a scale, df = h f (1 - f) for friction).
    sweep: by parameter, {h: disagreement}; NaN where a run of the pair failed.
    differences: by parameter, {h: d target / d value, (M,)}.
    largest_tangent: largest |dR/dz| of the run [-]; growth: e-folds per 1 % strain of |dR/dz| over the run's second
    half. strain, norm: (T,), strain and root sum of squares of dR/dz over the parameters.
    """

    verdict: str
    usable_strain: float
    disagreement: Mapping[str, float]
    best_step: Mapping[str, float]
    sweep: Mapping[str, Mapping[float, float]]
    differences: Mapping[str, Mapping[float, np.ndarray]]
    largest_tangent: float
    growth: float
    strain: np.ndarray
    norm: np.ndarray

    @property
    def healthy(self) -> bool:
        return self.verdict == "use"

    def __str__(self) -> str:
        agree = ", ".join(f"{n} {d:.1e} at h = {self.best_step[n]:g}" for n, d in self.disagreement.items())
        return (
            f"{self.verdict} (disagreement with central differences: {agree}; largest |dR/d log p| "
            f"{self.largest_tangent:.3g}, growing by {self.growth:.2g} e-folds per 1 % strain)"
        )


@dataclass(frozen=True)
class Gradient:
    """Value and derivatives of a target of M numbers.

    value: () or (M,). by_value: {name: d value / d parameter}, per unit of the parameter.
    by_coordinate: the same per unit of its log (of its logit for friction). health: None only where it was not asked
    for.
    """

    value: np.ndarray
    by_value: Mapping[str, np.ndarray]
    by_coordinate: Mapping[str, np.ndarray]
    health: Health | None

    def __str__(self) -> str:
        rows = [f"value {np.array2string(np.asarray(self.value), precision=6)}"]
        rows += [f"d/d {n} = {np.array2string(np.asarray(d), precision=5)}" for n, d in self.by_value.items()]
        return "\n".join([*rows, f"health: {self.health if self.health else 'not checked'}"])


def gradient(
    simulator,
    functional,
    names: Sequence[str] | str = "friction",
    values: Mapping[str, float] | None = None,
    *,
    steps: Sequence[float] = STEPS,
    check: bool = True,
    hold_time_step: bool = False,
) -> Gradient:
    """Value and derivatives of a functional of a curve, with their health.

    simulator: a TriaxialTest, or a Model made before (it keeps its compiled program from call to call).
    functional: curve -> () or (M,), such as calibrate.targets.WindowMean().
    names: parameters or aliases (f, kn, ks, ks/kn, s3, beta, rho, scale). values: where, by default the test's own.
    steps: of the h sweep, relative; costs two runs each and parameter.
    hold_time_step: raise the density with the stiffness, as ParameterSet.params; not by default, so that d/d log kn is
        that of the stiffness alone.

    Raises ValueError for names and values that make no sense, RunFailed where the run itself is not sound.
    """
    model = simulator if isinstance(simulator, Model) else Model(simulator, names, hold_time_step)
    z = model.parameters.coordinates(values)
    curve, tangents = model.run_with_tangents(z)
    target = (
        functional
        if hasattr(functional, "predict")
        else SimpleNamespace(predict=lambda c: jnp.atleast_1d(functional(c)))
    )
    value, jacobian = jacobian_of(target, curve, tangents)
    shape = (lambda a: a.reshape(())) if value.size == 1 else (lambda a: a)
    physical = model.parameters.values(z)
    rate = {name: model.parameters.about_of(name).coordinate_rate(physical[name]) for name in model.parameters.names}
    by_coordinate = {name: shape(jacobian[:, p]) for p, name in enumerate(model.parameters.names)}
    health = gradient_health(model, target, z, curve, tangents, jacobian, steps=steps) if check else None
    return Gradient(shape(value), {n: d / rate[n] for n, d in by_coordinate.items()}, by_coordinate, health)


def gradient_health(model: Model, target, z, curve, tangents, jacobian, *, steps: Sequence[float] = STEPS) -> Health:
    """Compare tangents with central differences of the same runs; see `gradient` for the arguments.

    jacobian: (M, P) of the target in coordinates, from the tangents.
    """
    names = model.parameters.names
    strain = curve.axial_strain
    norm = np.sqrt((np.nan_to_num(tangents.stress_ratio, nan=np.inf, posinf=np.inf, neginf=np.inf) ** 2).sum(axis=0))
    sweep: dict[str, dict[float, float]] = {}
    differences: dict[str, dict[float, np.ndarray]] = {}
    best: dict[str, float] = {}
    agree: dict[str, float] = {}
    usable: list[float] = []
    physical = model.parameters.values(z)
    for p, name in enumerate(names):
        sweep[name], differences[name] = {}, {}
        parted: dict[float, float] = {}
        for h in steps:
            try:
                up, down = (model.run(z + sign * h * np.eye(len(z))[p]) for sign in (1, -1))
            except RunFailed:
                sweep[name][h] = np.nan
                continue
            pair = [np.asarray(target.predict(run)) for run in (up, down)]
            slope = (pair[0] - pair[1]) / (2 * h)
            scale = max(np.abs(slope).max(), 1e-12 * np.abs(pair[0]).max() / h)  # what rounding alone can make
            gap = np.abs(jacobian[:, p] - slope).max() / scale
            sweep[name][h] = float(gap) if np.isfinite(gap) else np.inf
            differences[name][h] = slope / model.parameters.about_of(name).coordinate_rate(physical[name])
            parted[h] = _parting_strain(
                strain, tangents.stress_ratio[p], (up.stress_ratio - down.stress_ratio) / (2 * h)
            )
        finite = {h: gap for h, gap in sweep[name].items() if not np.isnan(gap)}
        best[name] = min(finite, key=lambda h: finite[h]) if finite else np.nan
        agree[name] = finite[best[name]] if finite else np.inf
        usable.append(max(parted.values(), default=0.0))
    largest = float(norm.max())
    # A tangent that has run away cannot be used from where it did, however a noisy difference compares.
    runaway = np.flatnonzero(~(norm <= LARGEST))
    limit = min([*usable, strain[runaway[0]] if runaway.size else strain[-1]])
    if max(agree.values()) <= AGREEMENT and largest <= LARGEST:
        verdict, limit = "use", float(strain[-1])
    elif limit >= SHORTEST * strain[-1]:
        verdict = f"use up to strain {limit:.2g}"
    else:
        verdict, limit = "fall back", 0.0
    return Health(verdict, float(limit), agree, best, sweep, differences, largest, _growth(strain, norm), strain, norm)


def _parting_strain(strain, tangent, difference) -> float:
    """Strain up to which tangent and difference, averaged over a tenth of the run, stay within APART of the larger
    of the local and the typical difference."""
    width = max(1, len(strain) // 10)
    kernel = np.ones(width) / width

    def smooth(values):
        padded = np.pad(values, (width // 2, width - 1 - width // 2), mode="edge")
        return np.convolve(padded, kernel, mode="valid")

    with np.errstate(over="ignore", invalid="ignore"):
        gap = np.abs(smooth(tangent) - smooth(difference))
        size = np.maximum(np.abs(smooth(difference)), 0.3 * np.sqrt(np.mean(difference**2)))
        bad = np.flatnonzero(~(gap <= APART * np.maximum(size, 1e-300)))
    return float(strain[bad[0]] if bad.size else strain[-1])


def _growth(strain, norm) -> float:
    """E-folds per 1 % strain of the tangent over the second half of the run."""
    half = strain > 0.5 * strain[-1]
    size = np.clip(norm[half], 1e-300, 1e300)
    return float(np.polyfit(strain[half], np.log(size), 1)[0] / 100) if half.sum() > 2 else float("nan")
