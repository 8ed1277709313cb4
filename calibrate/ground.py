"""The ground on which a fit stands: the library's runs that it can use, as points of its own axes."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calibrate.axes import Axis, of_point, physical
from calibrate.library import Library, StoredRun
from calibrate.scene import RandomScene, is_force

BEYOND = 1.6  # runs of other fits so far outside the box (whose half width is one) still help at its edges
SAME = 1e-6  # relative; parameters that are held are the same within


class Ground:
    """Runs of one scene along P axes.

    stresses: confining stresses of the tests that stand on it, by which the axes of stiffnesses are stretched: at a
        higher stress the same balls are softer.
    """

    def __init__(self, scene: RandomScene, axes: Sequence[Axis], stresses: Sequence[float], library: Library):
        self.scene, self.library = scene, library
        factors = [scene.stress / stress for stress in stresses]
        self.axes = tuple(
            axis.stretched(min(factors), max(factors)) if self._goes_with_stress(axis.name) else axis for axis in axes
        )
        self.runs: list[StoredRun] = []
        self.failed: list[StoredRun] = []

    def _goes_with_stress(self, name: str) -> bool:
        return name in self.scene.values() and is_force(self.scene, name)

    @property
    def dims(self) -> int:
        return len(self.axes)

    def read(self, reach: float) -> None:
        """Take from the library what goes as far and has what is held at the values held here."""
        self.runs, self.failed = [], []
        for run in self.library.runs():
            if not self._fits(run):
                continue
            if run.curve is None:
                self.failed.append(run)
            elif run.curve["axial_strain"][-1] >= reach:
                self.runs.append(run)

    def _fits(self, run: StoredRun) -> bool:
        try:
            values = of_point(self.scene, self.axes, run.point)
            expected = self.point(self._shares(values))
        except (KeyError, ValueError):
            return False
        if set(expected) != set(run.point) or not np.isfinite(values).all():
            return False
        held = all(
            np.isclose(run.point[n], expected[n], rtol=SAME, atol=0) or run.point[n] == expected[n] for n in expected
        )
        return held and bool((np.abs(2 * self._shares(values) - 1) <= BEYOND).all())

    def _shares(self, values: Sequence[float] | np.ndarray) -> np.ndarray:
        return np.array([float(axis.to_unit(value)) for axis, value in zip(self.axes, values, strict=True)])

    def point(self, shares: np.ndarray) -> dict[str, float]:
        """The point of a run at (P,) shares of the axes."""
        values = [float(axis.from_unit(share)) for axis, share in zip(self.axes, shares, strict=True)]
        return self.scene.point(physical(self.scene, self.axes, values), self.scene.stress)

    def x(self, values: np.ndarray, stress: float) -> np.ndarray:
        """(n, P) coordinates between -1 and 1 of (n, P) values of the parameters in a test at this stress."""
        columns = []
        for k, axis in enumerate(self.axes):
            factor = self.scene.stress / stress if self._goes_with_stress(axis.name) else 1.0
            columns.append(2 * axis.to_unit(values[:, k] * factor) - 1)
        return np.stack(columns, axis=1)

    def run_x(self) -> np.ndarray:
        """(N, P) coordinates of the runs."""
        values = np.array([of_point(self.scene, self.axes, run.point) for run in self.runs])
        return self.x(values.reshape(-1, self.dims), self.scene.stress)

    def void_ratios(self) -> np.ndarray:
        """(N,) void ratios of the runs at the beginning of the shear."""
        return np.array([run.void_ratio for run in self.runs])

    def used_seeds(self) -> int:
        """One more than the largest seed in the library, failed runs included; 0 where it is empty."""
        return max((run.seed for run in self.library.runs()), default=-1) + 1


def own_scene(scene: RandomScene, axes: Sequence[Axis], stress: float) -> RandomScene:
    """The scene for a test at this stress: stiffnesses that are held stay what they are in a test, so beside another
    stress they are others in a run."""
    moved = set(physical(scene, axes, [axis.low for axis in axes]))
    values: Mapping[str, float] = scene.values()
    held = [n for n in values if n not in moved and n != "confining_stress" and is_force(scene, n)]
    if not held or stress == scene.stress:
        return scene
    changed = {name: values[name] * scene.stress / stress for name in held}
    return replace(scene, params=replace(scene.params, **changed))
