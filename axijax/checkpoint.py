"""A shear in progress on disk; see `axijax.triaxial.checkpoint`."""

from axijax.triaxial.checkpoint import load_progress, save_progress

__all__ = ["load_progress", "save_progress"]
