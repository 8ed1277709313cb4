"""Gradings of random specimens; see `axijax.specimen.grading`."""

from axijax.specimen.grading import Grading, linear, sieve_curve, two_sizes, uniform

__all__ = ["Grading", "linear", "sieve_curve", "two_sizes", "uniform"]
