"""What a study returns: intervals, predictions with their bands, a verdict; as text, JSON, samples and a picture."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from axijax.core.files import write_whole
from axijax.core.shown import Card, shown
from calibrate.axes import Axis
from calibrate.library import StoredRun
from calibrate.parameters import Prior
from calibrate.posterior import WIDE_STATE, Compared
from calibrate.result import FITTED, PREDICTED, _without_nan
from calibrate.sampling import Sample
from calibrate.study_verdict import (
    MATERIAL_RATIO,
    MATERIAL_VOLUME,
    Precision,
    Verdict,
    direction_table,
    verdicts,
)

if TYPE_CHECKING:
    from calibrate.study import StudyTest

DRAWS = 1000
SHARES = (0.025, 0.5, 0.975)
LEAST_INSIDE = 0.75  # share of fitted data within their 95 % band; neighbouring windows differ alike


@shown
@dataclass(frozen=True)
class Prediction:
    """One test: data and what is predicted, at S strains; compression positive, R and volumetric strain [-].

    held_out: whether it was predicted only. ratio, volume: (S,) data, ratio_band, volume_band: (3, S) of 2.5, 50, 97.5
    %, packing scatter of the data included. volume and its band are None where it was not measured.
    ratio_rms: root mean square of ln R, volume_rms: of the volumetric strain, median against data [-].
    chance: that data of the model itself would lie farther from it; inside: share of the data within the band.
    peak, peak_strain, dilatancy: (3,) 2.5, 50, 97.5 % of the largest R, its strain and the largest -d eps_v/d eps_1.
    slack: factor by which the covariance had to be widened, 1 where the model reaches the data.
    """

    name: str
    held_out: bool
    strain: np.ndarray
    ratio: np.ndarray
    ratio_band: np.ndarray
    volume: np.ndarray | None
    volume_band: np.ndarray | None
    ratio_rms: float
    volume_rms: float
    chance: float
    inside: float
    peak: np.ndarray
    peak_strain: np.ndarray
    dilatancy: np.ndarray
    slack: float
    notes: tuple[str, ...] = ()


@shown
@dataclass(frozen=True)
class StudyFit:
    """Result of a study of P parameters.

    intervals: {name: (2.5, 50, 97.5 %)}. samples: {name: (n,)} equally weighted. bounds: of the box. priors as given.
    predictions: one for each test. verdicts: why it has not converged; empty where it has. notes: what else is to be
    known. precisions: of what each parameter's uncertainty is made. directions: of the posterior, widest first.
    evidence: log of the mean likelihood over the box, for choosing between models with the same data; effective,
    pareto_k: of the samples. runs: the library's that were used; made: new ones; failed: sentences. seconds: of the new
    runs together.
    """

    intervals: Mapping[str, tuple[float, float, float]]
    bounds: Mapping[str, tuple[float, float]]
    units: Mapping[str, str]
    samples: Mapping[str, np.ndarray]
    correlation: np.ndarray
    predictions: tuple[Prediction, ...]
    verdicts: tuple[Verdict, ...]
    notes: tuple[str, ...]
    precisions: Mapping[str, Precision]
    directions: list[dict]
    evidence: float
    effective: float
    pareto_k: float
    runs: int
    made: int
    failed: tuple[str, ...]
    seconds: float

    @property
    def converged(self) -> bool:
        return not self.verdicts

    @property
    def status(self) -> str:
        return "converged" if self.converged else "not converged: " + "; ".join(each.words for each in self.verdicts)

    @property
    def estimate(self) -> dict[str, float]:
        """The medians."""
        return {name: middle for name, (_, middle, _) in self.intervals.items()}

    @property
    def warnings(self) -> tuple[str, ...]:
        return tuple(each.sentence for each in self.verdicts)

    def _card(self) -> Card:
        found = {
            name: f"{middle:.4g} (95 %: {low:.4g} to {high:.4g})"
            for name, (low, middle, high) in self.intervals.items()
        }
        missed = {
            f"{test.name}, {'predicted' if test.held_out else 'fitted'}": f"R misses by {100 * test.ratio_rms:.2g} %"
            for test in self.predictions
        }
        rows = {"status": self.status, **found, **missed, "runs": f"{self.runs}, {self.made} of them new"}
        return Card("StudyFit", rows, brief=("status", *found))

    def __str__(self) -> str:
        rows = [f"fit {self.status}"]
        for name, (low, middle, high) in self.intervals.items():
            unit = f" {self.units[name]}" if self.units[name] else ""
            bounds = self.bounds[name]
            rows.append(
                f"  {name} = {middle:.4g}{unit}   (with 95 % between {low:.4g} and {high:.4g}; sought between "
                f"{bounds[0]:.3g} and {bounds[1]:.3g})"
            )
        for test in self.predictions:
            volume = "" if test.volume is None else f", volumetric strain by {100 * test.volume_rms:.2g} % of strain"
            rows.append(
                f"  {test.name}: {'predicted, not fitted; ' if test.held_out else ''}R misses by "
                f"{100 * test.ratio_rms:.2g} %{volume} (root mean square); {100 * test.inside:.0f} % of the data are "
                "within the 95 % band"
            )
        rows.append(
            f"  {self.runs} runs, each on a packing of its own, {self.made} of them new"
            + (f", {len(self.failed)} failed" if self.failed else "")
        )
        rows += [f"  warning: {each.sentence}" for each in self.verdicts]
        rows += [f"  note: {text}" for text in self.notes]
        return "\n".join(rows)

    def told(self) -> dict:
        """Everything but the samples, for JSON."""
        return {
            "status": self.status,
            "verdicts": [{"name": v.name, "sentence": v.sentence} for v in self.verdicts],
            "estimate": self.estimate,
            "interval_95": {name: (low, high) for name, (low, _, high) in self.intervals.items()},
            "sought_between": dict(self.bounds),
            "units": dict(self.units),
            "correlation": self.correlation.tolist(),
            "directions": self.directions,
            "uncertainty_made_of": {
                name: {"now": p.now, "packings_of_the_data": p.scatter, "surface": p.surface, "relative": p.relative}
                for name, p in self.precisions.items()
            },
            "tests": [_told(test) for test in self.predictions],
            "runs": self.runs,
            "new_runs": self.made,
            "failed_runs": list(self.failed),
            "seconds_of_new_runs": self.seconds,
            "effective_samples": self.effective,
            "pareto_k": self.pareto_k,
            "log_evidence": self.evidence,
            "notes": list(self.notes),
        }

    def save(self, path: Path | str, identity: Mapping[str, str] | None = None) -> Path:
        """Write everything but the samples as JSON, with what was fitted to what; returns the path."""
        told = self.told() | ({} if identity is None else {"identity": dict(identity)})
        text = json.dumps(_without_nan(told), indent=2, allow_nan=False) + "\n"
        write_whole(Path(path), lambda target: target.write_text(text))
        return Path(path)

    def save_samples(self, path: Path | str) -> Path:
        """Write the samples as CSV, a column for each parameter; returns the path."""
        table = np.column_stack(list(self.samples.values()))
        head = ",".join(self.samples)
        write_whole(
            Path(path), lambda target: np.savetxt(target, table, "%.8g", ",", header=head, comments="")
        )  # fmt: skip
        return Path(path)

    def draw(self, path: Path | str) -> Path:
        """Write a picture of data, fits and predictions with their bands; returns the path."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        figure = Figure(figsize=(4.6 * len(self.predictions), 6.4), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(2, len(self.predictions), squeeze=False, sharex="col")
        for column, test in zip(axes.T, self.predictions, strict=True):
            rows = [("stress ratio R [-]", test.ratio, test.ratio_band, 1.0)]
            if test.volume is not None and test.volume_band is not None:
                rows.append(("volumetric strain [%]\n(compression positive)", test.volume, test.volume_band, 100.0))
            for panel, (label, data, band, factor) in zip(column, rows, strict=False):
                colour = PREDICTED if test.held_out else FITTED
                panel.fill_between(
                    100 * test.strain, factor * band[0], factor * band[2], color=colour, alpha=0.25, label="95 % band"
                )
                panel.plot(100 * test.strain, factor * band[1], color=colour, label="median")
                panel.plot(100 * test.strain, factor * data, "k.", ms=4, label="data")
                panel.set(ylabel=label)
            column[0].set(title=f"{test.name}: {'predicted' if test.held_out else 'fitted'}")
            column[0].legend(frameon=False, fontsize=9)
            column[-1].set(xlabel="axial strain [%]")
        write_whole(Path(path), lambda target: figure.savefig(target, dpi=150))
        return Path(path)


def concluded(
    tests: "Sequence[StudyTest]", fitted: Sequence[Compared], held: Sequence[Compared], axes: Sequence[Axis],
    found: Sample, shares: np.ndarray, known: bool, precision: float | None, priors: Mapping[str, Prior],
    *, made: int, failed: Sequence[StoredRun], used: int, seconds: float, seed: int,
) -> StudyFit:  # fmt: skip
    """The result of a study whose sample has been drawn; the arguments are those of `calibrate.study`."""
    draws = found.points[found.draws(DRAWS, seed)]
    values = np.stack([axis.from_unit(draws[:, k]) for k, axis in enumerate(axes)], axis=1)
    by_name = {one.name: one for one in (*fitted, *held)}
    rng = np.random.default_rng(seed)
    slack = max(one.slack for one in fitted)
    predictions = tuple(_predicted(test, by_name[test.name], values, rng, slack) for test in tests)
    intervals = {}
    for axis, column in zip(axes, found.quantiles(SHARES).T, strict=True):
        low, middle, high = map(float, axis.from_unit(column))
        intervals[axis.label or axis.name] = low, middle, high
    names = list(intervals)
    precisions = _precisions(fitted, axes, found)
    missed = [_miss(test) for test in predictions if not test.held_out and _out_of_reach(test)]
    reasons = verdicts(axes, found, intervals, shares, precisions, missed, known, precision)
    spread = np.sqrt(np.diag(found.covariance))
    return StudyFit(
        intervals,
        {name: (axis.low, axis.high) for name, axis in zip(names, axes, strict=True)},
        {name: axis.unit for name, axis in zip(names, axes, strict=True)},
        {name: values[:, k] for k, name in enumerate(names)},
        found.covariance / np.outer(spread, spread),
        predictions,
        tuple(reasons),
        tuple(_notes(predictions, axes, found, intervals, priors, precisions, failed)),
        precisions,
        direction_table(axes, found),
        found.evidence,
        found.effective,
        found.pareto_k,
        used,
        made,
        tuple(str(run.failed) for run in failed),
        seconds,
    )


def _predicted(test, one: Compared, values: np.ndarray, rng, slack: float) -> Prediction:
    if test.held_out:  # where the fitted ones are missed, others are as well
        one = replace(one, slack=slack)
    drawn = one.predictive(values, rng)
    ratio, volume = one.nodes.split(one.nodes.values)
    ratios, volumes = one.nodes.split(drawn)
    band = np.quantile(ratios, SHARES, axis=0)
    inside = [(band[0] <= ratio) & (ratio <= band[2])]
    volume_band, volume_rms, dilatancy = None, float("nan"), np.full(3, np.nan)
    smooth, smooth_volume = one.nodes.split(one.surface.numbers(one.expected(values)[0]))
    if volume is not None and volumes is not None and smooth_volume is not None:
        volume_band = np.quantile(volumes, SHARES, axis=0)
        inside.append((volume_band[0] <= volume) & (volume <= volume_band[2]))
        volume_rms = float(np.sqrt(((volume_band[1] - volume) ** 2).mean()))
        dilatancy = np.quantile((-np.gradient(smooth_volume, one.nodes.strain, axis=1)).max(1), SHARES)
    notes: tuple[str, ...] = ()
    if one.state is not None and abs(one.state) > WIDE_STATE:
        notes = (
            f"{test.name}: its void ratio {test.void_ratio:g} is {2 * abs(one.state):.1f} standard deviations from the "
            "packings'; what is said of it is carried on along a line: pack to its void ratio.",
        )
    return Prediction(
        test.name, test.held_out, one.nodes.strain, ratio, band, volume, volume_band,
        float(np.sqrt((np.log(band[1] / ratio) ** 2).mean())), volume_rms, one.chance(values),
        float(np.concatenate(inside).mean()), np.quantile(smooth.max(1), SHARES),
        np.quantile(one.nodes.strain[smooth.argmax(1)], SHARES), dilatancy, one.slack, notes,
    )  # fmt: skip


def _matters(test: Prediction) -> bool:
    return test.ratio_rms > MATERIAL_RATIO or test.volume_rms > MATERIAL_VOLUME


def _out_of_reach(test: Prediction) -> bool:
    """Whether the data are missed by what matters, be it seen by the components or by the band alone."""
    return _matters(test) and (test.slack > 1 or test.inside < LEAST_INSIDE)


def _miss(test: Prediction) -> str:
    worst = int(np.abs(np.log(test.ratio_band[1] / test.ratio)).argmax())
    volume = "" if test.volume is None else f", volumetric strain by {100 * test.volume_rms:.2g} % of strain"
    return (
        f"'{test.name}' is out of reach: the nearest curves miss R by {100 * test.ratio_rms:.2g} %{volume} (root mean "
        f"square), most at {100 * test.strain[worst]:.2g} % strain, where R is {test.ratio[worst]:.3g} and "
        f"{test.ratio_band[1][worst]:.3g} is made."
    )


def _precisions(fitted: Sequence[Compared], axes: Sequence[Axis], found: Sample) -> dict[str, Precision]:
    """What the standard deviations are made of, each source by leaving it out of the linear picture at the median."""
    middle = found.mean[None]
    steps = 0.02 * np.eye(len(axes))
    points = np.clip(np.concatenate([middle, middle + steps, middle - steps]), 0, 1)
    values = np.stack([axis.from_unit(points[:, k]) for k, axis in enumerate(axes)], axis=1)
    information = 1e-6 * np.eye(len(axes))
    score = {"scatter": np.zeros((len(axes),) * 2), "surface": np.zeros((len(axes),) * 2)}
    count = len(axes)
    for one in fitted:
        mean, variance = one.expected(values)
        moved = np.array([points[1 + k, k] - points[1 + count + k, k] for k in range(count)])
        slopes = (mean[1 : 1 + count] - mean[1 + count :]) / moved[:, None]
        inverse = np.linalg.inv(one.covariance(variance[:1])[0])
        gain = slopes @ inverse
        information += gain @ slopes.T
        factor = one.slack / one.weight
        score["scatter"] += factor * gain @ np.diag(one.surface.scatter / one.packings) @ gain.T
        score["surface"] += factor * gain @ np.diag(variance[0]) @ gain.T
    whole = np.linalg.inv(information)
    parts = {name: np.diag(whole @ middle_part @ whole) for name, middle_part in score.items()}
    result = {}
    packings = min(one.packings for one in fitted)
    for k, axis in enumerate(axes):
        column = axis.from_unit(found.points[:, k])
        relative = axis.about.coordinate != "linear"
        column = np.log(column) if relative else column
        now = float(np.sqrt(found.weights @ (column - found.weights @ column) ** 2))
        share = {name: float(np.clip(part[k] / whole[k, k], 0, 1)) for name, part in parts.items()}
        result[axis.label or axis.name] = Precision(
            now, now * np.sqrt(share["scatter"]), now * np.sqrt(share["surface"]), packings, relative
        )
    return result


def _notes(predictions, axes, found, intervals, priors, precisions, failed) -> list[str]:
    told = [note for test in predictions for note in test.notes]
    for axis in axes:
        prior, name = priors.get(axis.name), axis.label or axis.name
        if prior is None:
            continue
        low, _, high = intervals[name]
        near = [float(axis.about.from_coordinate(axis.coordinate(prior.value) + side * 2 * prior.spread))
                for side in (-1, 1)]  # fmt: skip
        if low > near[1] or high < near[0]:
            told.append(
                f"the data contradict the prior of {name}: {low:.4g} to {high:.4g} against {near[0]:.4g} to "
                f"{near[1]:.4g} (95 % each)."
            )
    for name, each in precisions.items():
        if np.isfinite(each.packings) and each.scatter > 0.5 * each.now:
            half = each.packings_for(0.5 * each.now)
            size = f"{100 * each.scatter:.2g} %" if each.relative else f"{each.scatter:.2g}"
            more = f"; the mean of {np.ceil(half):.0f} packings would halve the interval" if half else ""
            told.append(
                f"{name}: the scatter of the data's {each.packings:g} packing(s) alone leaves +-{size} (one standard "
                f"deviation){more}."
            )
    for test in predictions:
        if test.slack > 1 and not test.held_out and not _matters(test):
            told.append(
                f"{test.name}: the model misses the data by more than scatter explains, by {100 * test.ratio_rms:.2g} "
                "% of R, which is no more than laboratories differ; the intervals were widened by as much."
            )
        if test.ratio.argmax() == len(test.ratio) - 1:
            told.append(f"{test.name}: the data still rise at their end, so the peak is not in them.")
    if failed:
        told.append(f"{len(failed)} runs failed and are left out, the last because {failed[-1].failed}")
    return told


def _told(test: Prediction) -> dict:
    angle = np.degrees(np.arcsin((test.peak - 1) / (test.peak + 1)))
    return {
        "name": test.name,
        "held_out": test.held_out,
        "rms_relative_R": test.ratio_rms,
        "rms_volumetric_strain": test.volume_rms,
        "chance_of_a_larger_misfit": test.chance,
        "share_inside_band": test.inside,
        "covariance_widened_by": test.slack,
        "peak_R": test.peak.tolist(),
        "peak_friction_angle_degrees": angle.tolist(),
        "strain_at_peak": test.peak_strain.tolist(),
        "dilatancy": test.dilatancy.tolist(),
        "axial_strain": test.strain.tolist(),
        "R": test.ratio.tolist(),
        "R_band": test.ratio_band.tolist(),
        "volumetric_strain": None if test.volume is None else test.volume.tolist(),
        "volumetric_strain_band": None if test.volume_band is None else test.volume_band.tolist(),
    }
