"""Reverse mode: one target, many parameters. A friction for each ball gives a map of which balls carry the peak.

A test keeps only its state at each record and runs each block of steps again on the way back, so the memory is tens of
megabytes.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from axijax.core.files import write_whole
from axijax.core.status import described


@dataclass(frozen=True)
class FrictionMap:
    """Sensitivity of one number to the friction of each of N balls.

    value: the number. sensitivity: (N,) d value / d friction of the ball [unit of value]; a contact takes the mean of
    its two balls. total: their sum, the derivative to one common friction. positions: (3, N) [L]; radius: (N,) [L].
    """

    value: float
    sensitivity: np.ndarray
    positions: np.ndarray
    radius: np.ndarray

    @property
    def total(self) -> float:
        return float(self.sensitivity.sum())

    def draw(self, path, title: str = "which balls carry the peak") -> Path:
        """Write a picture: the balls in the (rho, z) plane of the sector, coloured by sensitivity; returns the path."""
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib.figure import Figure

        path = Path(path)
        rho = np.hypot(*self.positions[:2])
        order = np.argsort(np.abs(self.sensitivity))
        figure = Figure(figsize=(4.4, 7), layout="constrained")
        axes = figure.subplots()
        size = np.abs(self.sensitivity).max() or 1.0
        dots = axes.scatter(
            rho[order],
            self.positions[2][order],
            c=self.sensitivity[order],
            s=60,
            cmap="RdBu_r",
            vmin=-size,
            vmax=size,
            edgecolor="0.6",
            linewidth=0.3,
        )
        figure.colorbar(dots, label="d value / d friction of the ball [-]")
        axes.set(
            xlabel="distance from the axis [L]",
            ylabel="height [L]",
            title=f"{title} (sum {self.total:.3f})",
            aspect="equal",
        )
        write_whole(path, lambda target: figure.savefig(target, dpi=150))
        return path


def friction_map(test, functional, friction=None) -> FrictionMap:
    """Derivative of a functional to the friction of every ball of a test's sector, by reverse mode.

    test: a TriaxialTest; functional: curve -> number; friction: a number or (N,), by default the test's own.
    Costs about four to six runs and one state for each record, whatever N.

    Raises ValueError for a friction of the wrong shape or sign, RunFailed for a run that is not sound.
    """
    from calibrate.model import RunFailed

    count = len(test.cut)
    given = np.asarray(test.params.friction if friction is None else friction, float)
    if given.shape not in ((), (count,)) or not (np.isfinite(given).all() and (given >= 0).all()):
        raise ValueError(
            f"friction of shape {given.shape}: must be one number or ({count},), one a ball, zero or positive."
        )

    def number(per_ball):
        curve = test.simulate(replace(test.params, friction=per_ball))
        return jnp.reshape(functional(curve), ()), curve.status

    per_ball = jnp.broadcast_to(jnp.asarray(given), (count,))
    step = jax.jit(jax.value_and_grad(number, has_aux=True))
    (value, status), slope = step(per_ball)
    if wrong := described(int(status)):
        raise RunFailed(f"the run behind the map went wrong: {wrong}.")
    if not np.isfinite(np.asarray(slope)).all():
        raise RunFailed(
            "a sensitivity behind the map is not finite: the tangents of so long a run ran away; stop at a smaller "
            "axial_strain."
        )
    return FrictionMap(float(value), np.asarray(slope), np.asarray(test.cut.positions), np.asarray(test.cut.radius))
