"""What the parameters of a test do to its curve: dR/dlog p and d eps_v/dlog p against strain, and which of them a fit
could tell apart.

Of a lattice by tangents, each held against a difference of two runs; of random specimens, whose single tangents run
away from some 0.5 % strain, by differences of runs with physical steps, the mean over packings with its standard error.
Every parameter moves alone (kn without ks); compression is positive.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from axijax.core.files import write_whole
from axijax.core.palette import COLOURS
from axijax.core.parallel import parallel
from axijax.core.quantity import Quantity, present
from axijax.core.shown import Card, shown
from axijax.core.status import described
from calibrate.model import RunFailed
from calibrate.parameters import aliases
from calibrate.targets import _at

SMALL, LARGE = 1e-3, 0.1  # steps of log p: of smooth runs, and of random specimens
FRICTION = 0.05  # step of a friction of random specimens, where that is more [-]
AGREE = 0.05  # of a tangent and its difference, root mean squares
POINTS = 10  # strains, evenly on a log scale up to the end of the run
WINDOW = 0.3  # of the strain: over which values of random specimens are averaged
UNKNOWN = 1.0  # standard error of log p, a factor e, from which a direction counts as unknown
SHOWN = 0.1  # share of the largest part of a direction that is told


@dataclass(frozen=True)
class Direction:
    """Parameters moved together: a singular vector of the sensitivities over the uncertainties.

    vector: (P,) parts of log p, of length one. standard_error: of its length, from data at the table's strains [-].
    noise: that of the sensitivities' own errors over them; above a half the direction is not told from no effect.
    ratio, volume: largest change of R and of the volumetric strain where its largest part moves by 10 % [-].
    """

    vector: np.ndarray
    standard_error: float
    noise: float
    ratio: float
    volume: float

    def told(self, names: Sequence[str]) -> str:
        """A sentence."""
        parts = self.vector / self.vector[np.abs(self.vector).argmax()]
        order = [p for p in np.argsort(-np.abs(parts)) if abs(parts[p]) >= SHOWN]
        moved = ", ".join(f"{names[p]} {10 * parts[p]:+.3g} %" for p in order)
        effect = f"R moves by {self.ratio:.2g} and the volumetric strain by {100 * self.volume:.2g} % at most"
        if self.noise > 0.5:
            known = "not told from no effect by these packings"
        elif self.standard_error < UNKNOWN:
            known = f"would be known to {100 * self.standard_error:.2g} %"
        else:
            known = "would not be known"
        return f"{known}: {moved} (then {effect})"


@shown
@dataclass(frozen=True)
class Sensitivity:
    """P parameters at S strains.

    names: (P,). strain: (S,). curve: (2, S), R and volumetric strain [-]. slopes: (P, 2, S) of them by log p [-].
    errors: (P, 2, S) standard errors of the slopes from packings, NaN where there is one packing only.
    differences: (P, 2, S) of the same runs for tangents, None where the slopes are differences.
    steps: (P,) of log p. packings: specimens. sigma: (2,) uncertainties of a measured R and volumetric strain [-].
    notes: sentences on what was left out, failed or disagrees.
    """

    names: tuple[str, ...]
    strain: np.ndarray
    curve: np.ndarray
    slopes: np.ndarray
    errors: np.ndarray
    differences: np.ndarray | None
    steps: np.ndarray
    packings: int
    sigma: tuple[float, float]
    notes: tuple[str, ...] = ()

    @property
    def disagreement(self) -> np.ndarray | None:
        """(P, 2) root mean square of tangent less difference over that of the difference, which counts as no smaller
        than a thousandth of the largest parameter's [-]."""
        if self.differences is None:
            return None
        size = np.sqrt((self.differences**2).mean(axis=2))
        gap = np.sqrt(((self.slopes - self.differences) ** 2).mean(axis=2))
        return gap / np.maximum(size, 1e-3 * size.max(axis=0))

    @property
    def directions(self) -> tuple[Direction, ...]:
        """Directions of the parameters, the best known first."""
        weighted = (self.slopes / np.array(self.sigma)[None, :, None]).reshape(len(self.names), -1).T
        spread = (np.nan_to_num(self.errors) / np.array(self.sigma)[None, :, None]).reshape(len(self.names), -1).T
        _, values, right = np.linalg.svd(weighted, full_matrices=True)
        values = np.concatenate([values, np.zeros(len(self.names) - len(values))])
        found = []
        for vector, value in zip(right, values, strict=True):
            moved = np.abs(np.tensordot(vector, self.slopes, 1)).max(axis=1) * np.log(1.1) / np.abs(vector).max()
            noise = float(np.sqrt(((spread * vector) ** 2).sum()) / max(value, 1e-300))
            found.append(Direction(vector, float(1 / max(value, 1e-12)), min(noise, 1e12), *map(float, moved)))
        return tuple(found)

    @property
    def information(self) -> np.ndarray:
        """(P, P) information on log p of data at these strains, less what the slopes' own errors add to it."""
        weights = np.array(self.sigma)[None, :, None]
        slopes = (self.slopes / weights).reshape(len(self.names), -1)
        noise = ((np.nan_to_num(self.errors) / weights) ** 2).reshape(len(self.names), -1).sum(axis=1)
        values, vectors = np.linalg.eigh(slopes @ slopes.T - np.diag(noise))
        return (vectors * np.maximum(values, 0.0)) @ vectors.T

    def _card(self) -> Card:
        rows = {
            "parameters": ", ".join(self.names),
            "axial strain [%]": f"{100 * self.strain[0]:.3g} to {100 * self.strain[-1]:.3g}",
            "packings": str(self.packings),
        }
        told = {f"direction {place}": one.told(self.names) for place, one in enumerate(self.directions, 1)}
        return Card("Sensitivity", rows | told, brief=tuple(rows))

    def __str__(self) -> str:
        return self.table()

    def table(self, room: int = 120) -> str:
        """As text, tables within so many characters: in several pieces where they are wider."""
        how = "tangents" if self.differences is not None else f"differences, mean of {self.packings} packings"
        width = max(map(len, self.names)) + 2
        shown = range(len(self.strain) - 1, -1, -2)[::-1] if len(self.strain) > 6 else range(len(self.strain))
        fit = max((room - width) // 18, 1)
        lines = []
        for place, (title, size) in enumerate((("dR/dlog p", 1.0), ("d(volumetric strain)/dlog p [%]", 100.0))):
            lines.append(f"{title}, {how}, at axial strain [%]")
            for some in (shown[k : k + fit] for k in range(0, len(shown), fit)):
                lines.append(" " * width + "".join(f"{100 * self.strain[s]:>18.3g}" for s in some))
                for p, name in enumerate(self.names):
                    cells = []
                    for s in some:
                        value, error = size * self.slopes[p, place, s], size * self.errors[p, place, s]
                        cells.append(f"{value:.3g}" if np.isnan(error) else f"{value:.2g} +- {error:.1g}")
                    lines.append(f"{name:{width}}" + "".join(f"{cell:>18}" for cell in cells))
        if (apart := self.disagreement) is not None:
            told = ", ".join(f"{name} {a:.1e} and {b:.1e}" for name, (a, b) in zip(self.names, apart, strict=True))
            lines.append(f"disagreement of the tangents with differences (of R and volume): {told}")
        lines.append(
            f"directions, best known first, by data at these strains with uncertainties {self.sigma[0]:g} of R and "
            f"{100 * self.sigma[1]:g} % of volumetric strain:"
        )
        lines += [f"  {one.told(self.names)}" for one in self.directions]
        return "\n".join([*lines, *(f"note: {text}" for text in self.notes)])

    def save(self, path) -> Path:
        """Write the table as CSV, one line a parameter and strain; returns the path."""
        heads = [
            "parameter", "axial_strain [-]", "stress_ratio [-]", "volumetric_strain [-]", "dR/dlogp [-]", "error [-]",
            "difference [-]", "depsv/dlogp [-]", "error [-]", "difference [-]",
        ]  # fmt: skip
        lines = ["# compression positive; error: standard error of the mean over packings", ",".join(heads)]
        for p, name in enumerate(self.names):
            for s, strain in enumerate(self.strain):
                cells = [strain, *self.curve[:, s]]
                for place in range(2):
                    other = np.nan if self.differences is None else self.differences[p, place, s]
                    cells += [self.slopes[p, place, s], self.errors[p, place, s], other]
                lines.append(",".join([name, *("" if np.isnan(cell) else f"{cell:.9g}" for cell in cells)]))
        write_whole(Path(path), lambda target: target.write_text("\n".join(lines) + "\n"))
        return Path(path)

    def draw(self, path) -> Path:
        """Write a picture of both slopes against strain, with two standard errors or the differences as dots."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        figure = Figure(figsize=(11, 4.6), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(1, 2)
        strain = 100 * self.strain
        for place, (name, size) in enumerate((("dR/dlog p [-]", 1.0), ("d(volumetric strain)/dlog p [%]", 100.0))):
            for p, label in enumerate(self.names):
                colour = COLOURS[p % len(COLOURS)]
                line, error = size * self.slopes[p, place], 2 * size * self.errors[p, place]
                axes[place].plot(strain, line, color=colour, label=label)
                if np.isfinite(error).all():
                    axes[place].fill_between(strain, line - error, line + error, color=colour, alpha=0.2, lw=0)
                if self.differences is not None:
                    axes[place].plot(strain, size * self.differences[p, place], ".", color=colour)
            axes[place].axhline(0, color="0.7", lw=0.8, zorder=0)
            axes[place].set(xlabel="axial strain [%]", ylabel=name, xscale="log")
        axes[1].legend(frameon=False, fontsize=9)
        how = "dots: differences" if self.differences is not None else (
            f"{self.packings} packings, band: two standard errors"
        )  # fmt: skip
        figure.suptitle(f"sensitivity of the curve, compression positive; {how}", fontsize="medium")
        write_whole(Path(path), lambda target: figure.savefig(target, dpi=150, format="png"))
        return Path(path)


def sensitivity(
    tests,
    names: Sequence[str] | str | None = None,
    *,
    strains: Sequence[float] | None = None,
    sigma: tuple[float, float] = (0.02, 1e-4),
    report: Callable[[str], Any] = lambda line: None,
) -> Sensitivity:
    """The sensitivity of a lattice's test, or of the tests of several packings of one random specimen.

    tests: a TriaxialTest, or several that differ by their packings only. names: parameters or symbols; None takes all
    that are one positive number. strains: where, by default ten up to the end of the run. sigma: uncertainties of a
    measured R and volumetric strain, by which directions are judged [-]. report: called with a line a packing.

    Raises ValueError for names and strains that make no sense, RunFailed where no run is sound.
    """
    tests = list(tests) if isinstance(tests, list | tuple) else [tests]
    named, left_out = _parameters(tests[0].params, names)
    end = 0.97 * float(tests[0].axial_strain)
    lattice = tests[0].specimen.zone_rule == "given"
    at = _strains(strains, end if lattice else end / (1 + WINDOW / 2))
    if lattice:
        curve, slopes, differences, notes = _by_tangents(tests[0], list(named), at)
        steps, errors = np.full(len(named), SMALL), np.full(slopes.shape, np.nan)
        packings = 1
    else:
        steps = np.array([_step(about, value) for about, value in named.values()])
        held, failed = [], []
        for number, test in enumerate(tests, 1):
            found, wrong = _by_differences(test, list(named), steps, at)
            failed += wrong
            held.append(found)
            report(f"packing {number} of {len(tests)}: {2 * len(named) + 1} runs, {len(wrong)} failed")
        curve, slopes, errors = _mean(held, steps, failed)
        differences, packings = None, len(tests)
        notes = [f"{len(failed)} of {len(tests) * (2 * len(named) + 1)} runs failed and are left out, the first: "
                 f"{failed[0]}."] if failed else []  # fmt: skip
    result = Sensitivity(
        tuple(named), at, curve, slopes, errors, differences, steps, packings, sigma, (*left_out, *notes)
    )
    apart = result.disagreement
    more = [] if apart is None else [
        f"the tangent of {name} disagrees with its difference by {100 * gap:.3g} %: believe the difference, or a "
        "shorter strain." for name, gap in zip(named, apart.max(axis=1), strict=True) if gap > AGREE
    ]  # fmt: skip
    return replace(result, notes=(*result.notes, *more))


def further_tests(found: Mapping[str, Sensitivity]) -> list[str]:
    """Which test narrows the parameters most beside the first, in lines: standard errors of log p from the first alone
    and with each other, that with the most information first.

    Linear, at the parameters of the cases; before any data each parameter is known to a factor e. Raises ValueError
    where the cases have other parameters.
    """
    (first, start), *others = found.items()
    for name, one in others:
        if one.names != start.names:
            raise ValueError(f"'{name}' has the parameters {', '.join(one.names)}, '{first}' {', '.join(start.names)}: "
                             "name those that both have.")  # fmt: skip
    before = start.information + np.eye(len(start.names)) / UNKNOWN**2

    def told(information) -> str:
        errors = np.sqrt(np.diag(np.linalg.inv(information)))
        return ", ".join(f"{name} {100 * error:.2g} %" for name, error in zip(start.names, errors, strict=True))

    both = {name: before + one.information for name, one in others}
    gain = {name: 0.5 * (np.linalg.slogdet(one)[1] - np.linalg.slogdet(before)[1]) for name, one in both.items()}
    lines = [f"what data would tell, one standard error (before any, 100 %): {first} alone: {told(before)}"]
    return lines + [
        f"  with {name}: {told(both[name])} (gains {gain[name]:.2g} nats)"
        for name in sorted(gain, key=lambda name: -gain[name])
    ]


def _parameters(params, names) -> tuple[dict[str, tuple[Quantity, float]], list[str]]:
    """Declaration and value of the parameters, and sentences on those that have no logarithm."""
    known = present(params)
    usable = {
        name: (about, float(value)) for name, (about, value) in known.items()
        if np.ndim(value) == 0 and np.isfinite(value) and value > 0
    }  # fmt: skip
    if names is None:
        left = [name for name in known if name not in usable]
        return usable, [f"{', '.join(left)}: not one positive number, left out."] if left else []
    symbols = aliases(known)
    given = [name.strip() for name in (names.split(",") if isinstance(names, str) else names)]
    wanted = [symbols.get(name, name) for name in given]
    for name in wanted:
        if name not in usable:
            raise ValueError(
                f"parameter '{name}': must be one positive number of this test, in order to have a logarithm: "
                f"{', '.join(usable)}."
            )
        if wanted.count(name) > 1:
            raise ValueError(f"parameter '{name}' is named twice; name each once.")
    return {name: usable[name] for name in wanted}, []


def _strains(strains, end: float) -> np.ndarray:
    if strains is None:
        return np.geomspace(end / 50, end, POINTS)
    found = np.asarray(strains, float)
    if found.ndim != 1 or not found.size or not ((found > 0) & (found <= end * (1 + 1e-9))).all():
        raise ValueError(f"strains = {strains!r}: must be positive and at most {end:.4g}, a little before the end.")
    return found


def _step(about: Quantity, value: float) -> float:
    return float(np.clip(FRICTION / value, SMALL, 3 * LARGE)) if about.coordinate == "logit" else LARGE


def _series(curve, strains: np.ndarray, window: float):
    """(2, S) R and volumetric strain at these strains, or means over a window about each, a share of it."""
    places = strains[:, None] * (1 + window * np.linspace(-0.5, 0.5, 21 if window else 1) * bool(window))
    return jnp.stack([_at(curve, places, name).mean(axis=1) for name in ("stress_ratio", "volumetric_strain")])


def _by_tangents(test, names: list[str], strains):
    """(2, S) values, (P, 2, S) tangents and differences, by `simulate`."""

    def values(logs):
        moved = {name: getattr(test.params, name) * jnp.exp(z) for name, z in zip(names, logs, strict=True)}
        curve = test.simulate(replace(test.params, **moved))
        return _series(curve, strains, 0.0), jnp.asarray(curve.status)

    run = jax.jit(values)
    push = jax.jit(lambda z, along: jax.jvp(values, (z,), (along,), has_aux=True))

    def sound(result, status):
        if wrong := described(int(status)):
            raise RunFailed(f"the run went wrong: {wrong}")
        return np.asarray(result)

    def one(p):
        along = np.eye(len(names))[p]
        value, tangent, status = push(jnp.zeros(len(names)), along)
        up, down = (sound(*run(jnp.asarray(sign * SMALL * along))) for sign in (1, -1))
        return sound(value, status), np.asarray(tangent), (up - down) / (2 * SMALL)

    first = one(0)  # compiles
    found = [first, *parallel(one, range(1, len(names)))]
    for result in found:
        if isinstance(result, Exception):
            raise result
    return first[0], np.array([one[1] for one in found]), np.array([one[2] for one in found]), []


def _by_differences(test, names: list[str], steps: np.ndarray, strains) -> tuple[np.ndarray, list[str]]:
    """(2P + 1, 2, S) of the test itself and of each parameter up and down, by `run`, NaN where one failed; why."""
    moves: list[Mapping[str, float]] = [{}]
    for name, step in zip(names, steps, strict=True):
        moves += [{name: float(getattr(test.params, name)) * np.exp(sign * step)} for sign in (1, -1)]

    def one(move):
        curve = test.run(replace(test.params, **move)).curve
        return np.asarray(_series(SimpleNamespace(**vars(curve)), strains, WINDOW))

    found = [*parallel(one, moves[:1]), *parallel(one, moves[1:])]  # the first compiles
    values, failed = np.full((len(moves), 2, len(strains)), np.nan), []
    for place, (move, result) in enumerate(zip(moves, found, strict=True)):
        if isinstance(result, RuntimeError | ValueError):
            failed.append(f"{', '.join(f'{n} = {v:.4g}' for n, v in move.items()) or 'as given'}: {result}")
        elif isinstance(result, Exception):
            raise result
        else:
            values[place] = result
    return values, failed


def _mean(held: list[np.ndarray], steps: np.ndarray, failed: list[str]):
    """(2, S) curve, (P, 2, S) slopes and their standard errors over the packings.

    Raises RunFailed where a slope has no packing with both its runs.
    """
    values = np.stack(held)  # (K, 2P + 1, 2, S)
    slopes = (values[:, 1::2] - values[:, 2::2]) / (2 * steps)[None, :, None, None]
    count = np.isfinite(slopes).sum(axis=0)
    if (count == 0).any() or np.isnan(values[:, 0]).all():
        raise RunFailed(f"no packing has all runs that a sensitivity is made of: {failed[0]}.")
    mean = np.nansum(slopes, axis=0) / count
    # Of one packing nothing is known of the scatter.
    spread = np.nansum((slopes - mean) ** 2, axis=0) / np.where(count > 1, count - 1, np.nan)
    return np.nanmean(values[:, 0], axis=0), mean, np.sqrt(spread / count)
