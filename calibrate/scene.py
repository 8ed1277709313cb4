"""A random specimen's test as a fit sees it: not one packing but as many as are asked for, at whatever parameters.

    def sand(seed, params):
        specimen, report = axijax.random_cylinder(500, axijax.Sector(2), seed=seed, params=params)
        return axijax.TriaxialTest(specimen, axijax.Sector(2), params=params, axial_strain=0.1, tolerance=1e-3,
                                   confining_friction=report.compaction_friction)

    scene = calibrate.RandomScene(sand, axijax.Params(friction=0.4))

**Similarity.** Stresses and stiffnesses enter a test by their ratios alone, so a run at one confining stress is a run
at any other with the stiffnesses in proportion. The point of a run holds the parameters in this form, and one library
of runs serves every confining pressure.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from axijax.core.fingerprint import fingerprint, versions
from axijax.core.quantity import parts_of, present

STRESS = "confining_stress"


@dataclass(frozen=True)
class RandomScene:
    """Tests on packings of their own.

    make: (seed of the packing, Params) to a test with `run()`; a function of a module, so that processes can call it.
    params: reference parameters, for whatever is not fitted.
    identity: further parts of what the scene is; by default those of `make`.
    least: least values of parameters by name, below which a test would be another one (friction below that with which
        the specimen was compacted).
    """

    make: Callable[[int, Any], Any]
    params: Any
    identity: Mapping[str, str] = field(default_factory=dict)
    least: Mapping[str, float] = field(default_factory=dict)

    @property
    def parts(self) -> dict[str, str]:
        """What the scene is, as parts by name; the values of its parameters do not count."""
        parts = {"axijax": versions()["axijax"], **(self.identity or fingerprint(self.make, "make"))}
        if any(getattr(self.params, "terms", ())):  # gravity and the like hold numbers of their own
            parts |= fingerprint(self.params.terms, "terms")
        kinds = ", ".join(type(part).__qualname__ for part in parts_of(self.params))
        return parts | {"kinds": kinds, "parameters": ", ".join(sorted(present(self.params)))}

    @property
    def stress(self) -> float:
        """Confining stress at which its runs are made."""
        return float(self.params.confining_stress)

    def values(self) -> dict[str, float]:
        """The reference parameters by name. Raises ValueError for a parameter given per ball."""
        found = {}
        for name, (_, value) in present(self.params).items():
            if getattr(value, "ndim", 0):
                raise ValueError(f"{name} is given per ball; a fit on random packings takes one number.")
            found[name] = float(value)
        return found

    def point(self, values: Mapping[str, float], stress: float) -> dict[str, float]:
        """Where a test with these parameters stands: forces over the confining stress, all else as it is."""
        return {
            name: value / stress if is_force(self, name) else value
            for name, value in (self.values() | dict(values)).items()
            if name != STRESS
        }

    def params_at(self, point: Mapping[str, float]) -> Any:
        """The parameters of a run at a point."""
        return replace(
            self.params, **{n: v * self.stress if is_force(self, n) else v for n, v in point.items()}
        )  # fmt: skip

    def run(self, point: Mapping[str, float], seed: int, reach: float) -> Any:
        """The curve of a packing at a point, with a record at or past this axial strain. Raises what packing and test
        raise."""
        test = self.make(seed, self.params_at(point))
        return replace(test, axial_strain=min(reach + 1.5 * _between_records(test), 0.499)).run().curve


def _between_records(test: Any) -> float:
    """Axial strain from one record to the next [-]; zero for a stand-in that has none of this."""
    if not hasattr(test, "prepared"):
        return 0.0
    seconds = test.record_every * float(test.prepared.time_step)
    return seconds * 2 * float(test.params.platen_speed) / float(test.cut.height)


def is_force(scene: RandomScene, name: str) -> bool:
    """Whether a parameter is in units of force, so that it goes with the confining stress."""
    return present(scene.params)[name][0].unit.startswith("F")
