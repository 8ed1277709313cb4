"""The result of a small run, as fixtures for the tests that read it; made once a session.

Nothing is asserted here: PYTEST_DONT_REWRITE.
"""

import pytest

from axijax.app.case import Case
from axijax.app.results import open_result
from axijax.app.runs import run_case
from axijax.app.snapshot import snapshot

CASE = {
    "specimen": {"layers": 5, "half_width": 5},
    "test": {"axial_strain": 0.002, "tolerance": 1e-6, "record_every": 20},
    "parameters": {"platen_speed": 0.003},
}


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """The result folder of a small quarter: balls on the axis, across the planes, sliding contacts."""
    path = tmp_path_factory.mktemp("run") / "small"
    run_case(Case.model_validate(CASE), path, "small", snapshots=2)
    return path


@pytest.fixture(scope="session")
def result(folder):
    return open_result(folder)


@pytest.fixture(scope="session")
def moment(result):
    """The last state, images filled in."""
    return snapshot(result.test, result.progress, full=True, confined=result.test.cut.positions)
