"""Case files; see `axijax.app.case`."""

from axijax.app.case import Case, default_case, load_case, make_case
from axijax.app.case_writing import to_toml

__all__ = ["Case", "default_case", "load_case", "make_case", "to_toml"]
