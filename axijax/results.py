"""Results in folders; see `axijax.app.results`."""

from axijax.app.results import Result, open_result, open_results

__all__ = ["Result", "open_result", "open_results"]
