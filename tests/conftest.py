"""Tests run with the fast kernels that the command line uses; they must be switched on before the first computation.

Compiled programs are kept for the session only, never in the user's folder; processes that tests start share them.
"""

import os
import shutil
import tempfile
from pathlib import Path

import jax
import pytest

import axijax

axijax.fast_cpu_kernels()


def pytest_configure(config):
    if hasattr(config, "workerinput"):  # pytest-xdist's workers inherit the folder
        return
    config.axijax_cache = tempfile.mkdtemp(prefix="axijax-cache-")
    os.environ["AXIJAX_CACHE"] = config.axijax_cache


def pytest_unconfigure(config):
    if hasattr(config, "axijax_cache"):
        shutil.rmtree(config.axijax_cache, ignore_errors=True)


@pytest.fixture(scope="module", autouse=True)
def width_of_a_pipe():
    """Workers have no terminal; a width that they inherit or that a library sets is not what a pipe has."""
    os.environ.pop("COLUMNS", None)


@pytest.fixture(scope="module", autouse=True)
def few_mappings():
    """A process may map some 65,000 pieces of memory (Linux), of which each compiled program takes several: a worker
    that has run a thousand tests would die of it while it compiles the next."""
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > 20_000:
        jax.clear_caches()
