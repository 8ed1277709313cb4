"""Many tests on all cores, devices and hosts; see `axijax.app.batch`."""

from axijax.app.batch import (
    BatchResult,
    Member,
    Outcome,
    open_batch,
    parameter_grid,
    run_batch,
    simulate_many,
)

__all__ = ["BatchResult", "Member", "Outcome", "open_batch", "parameter_grid", "run_batch", "simulate_many"]
