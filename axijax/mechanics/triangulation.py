"""Triangles between the balls of the unfolded membrane, and what is read off their neighbours (host, SciPy)."""

from functools import lru_cache

import numpy as np
from scipy.spatial import Delaunay


def surface_triangles(places, owned):
    """Delaunay triangles (3, T) with an owned corner, counter-clockwise."""
    corners = _triangles(np.asarray(places, float).tobytes()).T.copy()
    a, b, c = places[:, corners[0]], places[:, corners[1]], places[:, corners[2]]
    clockwise = _cross(b - a, c - a) < 0
    corners[1:, clockwise] = corners[:0:-1, clockwise]
    return corners[:, owned[corners].any(axis=0)]


@lru_cache(maxsize=4)  # a zone found again, its holes and its membrane ask for the same ones, one after the other
def _triangles(places: bytes) -> np.ndarray:
    """Delaunay triangles (T, 3) of places (2, C) in float64, not to be written to."""
    return Delaunay(np.frombuffer(places).reshape(2, -1).T).simplices


def neighbours_median(values, corners):
    """Median over each ball's neighbours on the surface, of values (Z,) one a ball; its own value where it has none.

    corners: (3, T), the zone's balls at the triangles' corners.
    """
    ball, near = np.concatenate([corners[[0, 1, 2, 1, 2, 0]], corners[[1, 2, 0, 0, 1, 2]]], axis=1).reshape(2, -1)
    ball, near = np.divmod(np.unique((ball * values.size + near)[ball != near]), values.size)
    if not ball.size:
        return values.copy()
    ordered = values[near[np.lexsort((values[near], ball))]]
    sizes = np.bincount(ball, minlength=values.size)
    first = np.cumsum(sizes) - sizes
    middle = np.clip([first + (sizes - 1) // 2, first + sizes // 2], 0, ordered.size - 1)
    return np.where(sizes > 0, ordered[middle].mean(axis=0), values)


def _cross(u, v):
    return u[0] * v[1] - u[1] * v[0]
