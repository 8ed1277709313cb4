"""Reverse mode: one target, many parameters. A friction for each ball gives a map of which balls carry the peak.

Reverse mode stores what the way back needs. Kept for every step of a test that is gigabytes, so the records' scan is
checkpointed: only the state at each record is kept, and each block of steps is run again on the way back.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import jaxpr_as_fun
from jax.extend.core.primitives import jit_p, scan_p


def checkpoint_scans(function):
    """The same pure function with the body of every outermost scan checkpointed, so that reverse mode keeps one carry
    an iteration and nothing inside. The value and all derivatives stay what they are."""

    def wrapped(*arguments):
        closed, shape = jax.make_jaxpr(function, return_shape=True)(*arguments)
        results = _evaluate(closed.jaxpr, closed.consts, jax.tree.leaves(arguments))
        return jax.tree.unflatten(jax.tree.structure(shape), results)

    return wrapped


def _evaluate(jaxpr, constants, arguments):
    values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*constants, *arguments], strict=True))

    def read(atom):
        return atom.val if hasattr(atom, "val") else values[atom]

    for equation in jaxpr.eqns:
        inputs = [read(atom) for atom in equation.invars]
        if equation.primitive is jit_p:
            inner = equation.params["jaxpr"]
            outputs = _evaluate(inner.jaxpr, inner.consts, inputs)
        elif equation.primitive is scan_p:
            outputs = _checkpointed_scan(equation.params, inputs)
        else:
            bound = equation.primitive.get_bind_params(equation.params)
            functions, parameters = bound if isinstance(bound, tuple) else ((), bound)  # a pair before jax 0.10
            outputs = equation.primitive.bind(*functions, *inputs, **parameters)
            outputs = outputs if equation.primitive.multiple_results else [outputs]
        values.update(zip(equation.outvars, outputs, strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def _checkpointed_scan(parameters, inputs):
    body = jax.checkpoint(jaxpr_as_fun(parameters["jaxpr"]))
    constants, carried = parameters["num_consts"], parameters["num_carry"]
    fixed, carry, rows = inputs[:constants], inputs[constants : constants + carried], inputs[constants + carried :]

    def step(carry, row):
        outputs = body(*fixed, *carry, *row)
        return outputs[:carried], outputs[carried:]

    carry, rows = jax.lax.scan(
        step, list(carry), list(rows), length=parameters["length"], reverse=parameters["reverse"]
    )
    return [*carry, *rows]


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
        figure.savefig(path, dpi=150)
        return path


def friction_map(test, functional, friction=None) -> FrictionMap:
    """Derivative of a functional to the friction of every ball of a test's sector, by checkpointed reverse mode.

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
    step = jax.jit(jax.value_and_grad(checkpoint_scans(number), has_aux=True))
    (value, status), slope = step(per_ball)
    if int(status) or not np.isfinite(np.asarray(slope)).all():
        raise RunFailed(f"the run behind the map ended with status {int(status)}, or a sensitivity that is not finite.")
    return FrictionMap(float(value), np.asarray(slope), np.asarray(test.cut.positions), np.asarray(test.cut.radius))
