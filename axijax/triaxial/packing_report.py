"""What a generated specimen has become."""

from dataclasses import dataclass

import numpy as np

from axijax.core.shown import Card, shown
from axijax.specimen.grading import Fraction
from axijax.triaxial.density import Bounds


@shown
@dataclass(frozen=True)
class PackingReport:
    """What a generated specimen has become; `print(report)` says it in words.

    balls: in the full cylinder. grading: what was asked for. radii: (N,) of the sector's balls, rising [L].
    sieves: (S, 3) radius [L], per cent passing by mass wanted and reached.
    fractions: what each fraction of the grading was to have, and got; empty where it has none.
    warnings: sentences.
    membrane_radius: Rm, through the middle of the membrane zone; height: between the platens [L].
    void_ratio: volume not in balls over volume in balls, in the cylinder of radius Rm between the platens (volume
        pi Rm^2 H; of a ball that it cuts, the part inside) [-].
    core_void_ratio: the same within Rm/2 and the middle 60 % of the height [-].
    counted_void_ratio: that below the skin, which every record of a test holds (see `axijax.mechanics.volume`) and a
        void ratio asked for means; in a specimen too small to have an inside the one in pi Rm^2 H [-].
    bounds: void ratios of the grading's densest and loosest packing, counted likewise; None where they were not needed.
    core_stress_ratio, core_contacts, core_stress_error: of that core, see `uniformity.CoreStress`.
    void_ratio_trend, size_trend, size_trend_error: (2,) along radius and height, see `uniformity.Trends`; NaN where too
        few balls lie deep enough [-].
    coordination_number, mechanical_coordination_number, rattler_fraction, anisotropy: see `fabric.Contacts` [-].
    compaction_friction: with which it was compacted [-].
    unbalanced_force, stress_error: how well it is balanced, as at the end of a confinement [-].
    steps: of the compaction. seed: of the random numbers.
    """

    balls: int
    order: int
    grading: str
    radii: np.ndarray
    sieves: np.ndarray
    fractions: list[Fraction]
    warnings: list[str]
    membrane_radius: float
    height: float
    void_ratio: float
    core_void_ratio: float
    counted_void_ratio: float
    bounds: Bounds | None
    core_stress_ratio: float
    core_contacts: int
    core_stress_error: float
    void_ratio_trend: tuple[float, float]
    size_trend: tuple[float, float]
    size_trend_error: tuple[float, float]
    coordination_number: float
    mechanical_coordination_number: float
    rattler_fraction: float
    anisotropy: float
    compaction_friction: float
    unbalanced_force: float
    stress_error: float
    steps: int
    seed: int

    @property
    def deviation(self) -> float | None:
        """By how much of the whole mass the worst fraction misses what was asked for; None without fractions [-]."""
        return max((abs(each.got - each.wanted) for each in self.fractions), default=None)

    @property
    def relative_density(self) -> float | None:
        """(e_max - e)/(e_max - e_min) of the counted void ratio; None without bounds [-]."""
        return self.bounds and self.bounds.relative_density(self.counted_void_ratio)

    def _card(self) -> Card:
        rows = {
            "balls": str(self.balls),
            "seed": str(self.seed),
            "void ratio [-]": f"{self.counted_void_ratio:.4f}",
            "compaction friction [-]": f"{self.compaction_friction:.4g}",
            "in the sector": f"{self.radii.size}, order {self.order}",
            "Rm, height [L]": f"{self.membrane_radius:.4g}, {self.height:.4g}",
            "coordination number [-]": f"{self.coordination_number:.3f}",
            "rattlers [%]": f"{100 * self.rattler_fraction:.1f}",
            "stress ratio of the core [-]": self._core_stress("{:.3f} +- {:.3f}"),
            "warnings": "; ".join(self.warnings) or "none",
        }
        return Card("PackingReport", rows, brief=("balls", "seed", "void ratio [-]", "compaction friction [-]"))

    def _core_stress(self, text: str) -> str:
        if not self.core_contacts:
            return "not known: no contact of the inner core bears anything"
        return text.format(self.core_stress_ratio, self.core_stress_error)

    def _uniformity(self) -> str:
        if np.isnan([*self.void_ratio_trend, *self.size_trend, *self.size_trend_error]).any():
            return "not known: too few balls lie deep enough below membrane and platens to compare halves of them"
        (radial, axial), sizes = self.void_ratio_trend, zip(self.size_trend, self.size_trend_error, strict=True)
        size = ", ".join(f"{100 * trend:+.1f} +- {100 * error:.1f} %" for trend, error in sizes)
        return f"void ratio {radial:+.3f} outer less inner half, {axial:+.3f} middle less ends; size {size}"

    def _density(self) -> list[str]:
        if self.bounds is None:
            return []
        densest, loosest = self.bounds
        return [
            f"  relative density {self.relative_density:.3f} between e {densest:.4f} and {loosest:.4f} of the grading"
        ]

    def __str__(self) -> str:
        core = f"{self.core_void_ratio:.4f}" if np.isfinite(self.core_void_ratio) else "none"
        sieves = "  ".join(f"{radius:.4g}: {wanted:.0f}/{got:.1f}" for radius, wanted, got in self.sieves)
        return "\n".join(
            [
                f"random specimen, seed {self.seed}: {self.balls} balls, {self.radii.size} in a sector of order "
                f"{self.order}",
                f"  grading          {self.grading}; radius: % passing by mass, wanted/reached  {sieves}",
                f"  size             Rm {self.membrane_radius:.4g}, H {self.height:.4g}, H/D "
                f"{self.height / 2 / self.membrane_radius:.3f}",
                f"  void ratio       {self.void_ratio:.4f} in pi Rm^2 H, {core} in the inner core, "
                f"{self.counted_void_ratio:.4f} below the skin",
                *self._density(),
                "  core             "
                + self._core_stress("stress ratio {:.3f}, vertical over horizontal; 1 +- {:.3f} expected")
                + f" of {self.core_contacts} contacts" * bool(self.core_contacts),
                f"  uniformity       {self._uniformity()}",
                f"  coordination     {self.coordination_number:.3f}, mechanical "
                f"{self.mechanical_coordination_number:.3f}, rattlers {100 * self.rattler_fraction:.1f} %",
                f"  fabric           vertical minus horizontal {self.anisotropy:+.4f}",
                f"  compaction       friction {self.compaction_friction:.4g}, {self.steps} steps, unbalanced force "
                f"{self.unbalanced_force:.1e}, stress error {self.stress_error:.1e}",
                *(f"  warning          {text}" for text in self.warnings),
            ]
        )
