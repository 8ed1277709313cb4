"""The command check."""

from pathlib import Path


def check(what: Path) -> None:
    """TODO"""
