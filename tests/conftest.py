"""Tests run with the fast kernels that the command line uses; they must be switched on before the first computation.

Compiled programs are kept for the session only, never in the user's folder; all workers and the processes that tests
start share them.
"""

import os
import shutil
import tempfile

import axijax  # isort: skip  (before jax: it quietens XLA)
import pytest
from hasty import hasty

from axijax.core.platform import make_room_for_programs

axijax.fast_cpu_kernels()

# Modules that take half a minute and more begin first, the longest at the head, or else one worker is left with them
# while the others have nothing to do.
LONGEST = (
    "test_readme", "test_guide", "test_calibrate_gradients", "test_limits", "test_time_step", "test_reverse_mode",
    "test_calibrate_random", "test_volume", "test_stages", "test_energy", "test_table1", "test_gradients",
    "test_thornton", "test_nothing_lost", "test_executors", "test_batch", "test_tight_list",
    "test_calibrate_functionals", "test_calibrate_study", "test_update",
)  # fmt: skip


def pytest_configure(config):
    if not hasattr(config, "workerinput"):  # pytest-xdist's workers inherit the folder
        config.axijax_cache = tempfile.mkdtemp(prefix="axijax-cache-")
        os.environ["AXIJAX_CACHE"] = config.axijax_cache
    axijax.use_compilation_cache()


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: LONGEST.index(item.path.stem) if item.path.stem in LONGEST else len(LONGEST))


def pytest_unconfigure(config):
    if hasattr(config, "axijax_cache"):
        shutil.rmtree(config.axijax_cache, ignore_errors=True)


@pytest.fixture(scope="module", autouse=True)
def width_of_a_pipe():
    """Workers have no terminal; a width that they inherit or that a library sets is not what a pipe has."""
    os.environ.pop("COLUMNS", None)


# Modules whose programs run long, that validate the kernels as users have them, or hold two programs to the same bits.
THOROUGH = ("test_platform", "test_table1", "test_terms", "test_membrane_surface")


@pytest.fixture(scope="session", autouse=True)
def haste():
    """What is made once a session is made so too."""
    with hasty():
        yield


@pytest.fixture(scope="module", autouse=True)
def haste_of_a_module(request, haste):
    with hasty(request.path.stem not in THOROUGH):
        yield


@pytest.fixture(scope="module", autouse=True)
def few_mappings():
    """A worker that has run a thousand tests would die of its programs while it compiles the next."""
    yield
    make_room_for_programs()
