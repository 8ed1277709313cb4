"""What random specimens are supported, asked before anything long runs; and whether the balls meet their grading."""

import warnings

import numpy as np

from axijax.mechanics.params import Params
from axijax.specimen.grading import WELL_MET, Fraction, Grading

WIDEST = 6.0  # largest over smallest radius, up to which every trial settled
SOFTEST = 0.04  # of `pressed_in`, likewise


def check_feasible(grading: Grading, radii: np.ndarray, params: Params, balls: int) -> list[str]:
    """Sentences on what was asked for and is not met, of which it warns as well.

    radii: of the balls of one sector [L]. balls: in the full cylinder.

    Raises ValueError for a fraction that gets no ball, with the number of balls that would do, and for a size ratio or
    a softness that is not supported, with the one that is.
    """
    order = balls // radii.size
    told = _grading_missed(grading, grading.fractions(radii), radii.size, order)
    ratio = radii.max() / radii.min()
    if ratio > WIDEST * (1 + 1e-9):
        raise ValueError(
            f"grading '{grading.name}': its size ratio is {ratio:.3g} (radii {radii.min():.4g} to {radii.max():.4g}), "
            f"and random specimens are supported up to {WIDEST:g}: leave out the finest or the coarsest balls."
            + "".join(f" Besides, {text}." for text in told)
        )
    pressed = pressed_in(radii, params)
    if pressed > SOFTEST * (1 + 1e-9):
        softness = float(params.confining_stress) * radii.mean() / float(params.normal_stiffness)
        raise ValueError(
            f"softness s3 r/kn = {softness:.3g}: random specimens of size ratio {ratio:.3g} are supported up to "
            f"{softness * SOFTEST / pressed:.2g}, as softer balls are pressed deep into one another: raise "
            "normal_stiffness or lower confining_stress."
        )
    for text in told:
        warnings.warn(text + ".", stacklevel=3)
    return told


def pressed_in(radii: np.ndarray, params: Params) -> float:
    """s3 R^2/(r kn), R the largest and r the smallest radius: how deep the load on R presses r in, in its radii [-].

    Zero for a material without a normal stiffness, with which no packing is made.
    """
    stiffness = getattr(params.material, "normal_stiffness", np.inf)
    return float(params.confining_stress) * radii.max() ** 2 / radii.min() / float(stiffness)


def _grading_missed(grading: Grading, fractions: list[Fraction], in_sector: int, order: int) -> list[str]:
    """Sentences on the fractions that miss the mass asked for; ValueError where one gets no ball."""
    empty = [each for each in fractions if each.wanted > 0 and each.balls == 0]
    # Of two fractions that miss by as much, the finer.
    worst = max(fractions, key=lambda each: round(abs(each.got - each.wanted), 9), default=None)
    if not empty and (worst is None or abs(worst.got - worst.wanted) <= WELL_MET):
        return []
    enough = grading.enough(in_sector)
    if empty:
        nominal = grading.radii[-1] / grading.radii[0]
        remedy = "no feasible number of balls would do" if enough is None else f"take {order * enough} balls"
        shown = " or ".join(_diameters(each) for each in empty)
        raise ValueError(
            f"grading '{grading.name}': of {in_sector} balls in a sector none is {shown}, though "
            f"{100 * sum(each.wanted for each in empty):.3g} % of the mass is asked for there: {remedy}"
            + (f"; its size ratio of {nominal:.3g} is above {WIDEST:g} as well, the most that is supported."
               if nominal > WIDEST else ", or leave that fraction out.")
        )  # fmt: skip
    assert worst is not None
    remedy = "no feasible number of balls comes" if enough is None else f"{order * enough} balls come"
    return [
        f"grading '{grading.name}' is not met: of {in_sector} balls in a sector those {_diameters(worst)} have "
        f"{100 * worst.got:.3g} % of the mass, where {100 * worst.wanted:.3g} % is asked for; {remedy} within "
        f"{100 * WELL_MET:g} %"
    ]


def _diameters(fraction: Fraction) -> str:
    return f"of diameter {2 * fraction.smallest:.4g} to {2 * fraction.largest:.4g}"
