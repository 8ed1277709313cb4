"""Which balls are near which images of which others: one k-d tree over all images (host)."""

import numpy as np
from scipy.spatial import cKDTree

from axijax.core.sector import Sector


def directed_pairs(positions, radius, skin, sector: Sector, on_axis):
    """All (i, j, k) nearer than touching plus skin, sorted, each contact from both its sides."""
    balls = np.tile(np.arange(radius.size), sector.images)
    turns = np.repeat(np.arange(sector.images), radius.size)
    copies = sector.rotate(positions[:, balls], turns)
    distinct = (turns == 0) | ~on_axis[balls]  # all images of an on-axis ball are the ball itself
    balls, turns, copies = balls[distinct], turns[distinct], copies[:, distinct]
    tree = cKDTree(copies.T)
    near = cKDTree(positions.T).sparse_distance_matrix(tree, 2 * radius.max() + skin, output_type="ndarray")
    i, j, k = near["i"], balls[near["j"]], turns[near["j"]]
    kept = ((i != j) | (k != 0)) & (near["v"] < radius[i] + radius[j] + skin)
    i, j, k = i[kept], j[kept], k[kept]
    order = np.lexsort((k, j, i))
    return i[order], j[order], k[order]
