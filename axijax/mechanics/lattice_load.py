"""A lateral load under which a finite FCC prism is stressed like the infinite lattice.

Voronoi cells load the balls of a prism's large and small layers about alike, while the lattice at failure wants the
whole load on the small layer's outline; that is why the paper's specimens stay below Thornton's formula. Loading each
outer ball by what its missing neighbours would push removes that difference, and tests the formula cleanly.
"""

import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree

from axijax.core.sector import Sector
from axijax.mechanics.membrane import Load
from axijax.specimen.specimen import Specimen, cut_to_sector


def lattice_load(specimen: Specimen, sector: Sector) -> Load:
    """Constant load of an FCC prism (vertical cube axis) as the infinite lattice at failure would load it.

    For every missing inclined neighbour of the layer above or below, the horizontal part of 2 N0 n, with
    N0 = sqrt(2) s3 r^2; nothing for missing neighbours within the layer, which have lost contact by then (Thornton
    1979). The platens carry s3 on the area 4 r^2 of each ball of the smaller layers.

    specimen: the full prism from `packing.fcc_octagon` or `fcc_cylinder`. Returns the load of the sector's balls.
    """
    radius = float(specimen.radius[0])
    tree = cKDTree(specimen.positions.T)
    height = specimen.positions[2]
    push = np.zeros((2, len(specimen)))
    for x in (-1.0, 1.0):
        for y in (-1.0, 1.0):
            for z in (-np.sqrt(2), np.sqrt(2)):
                site = specimen.positions + radius * np.array([[x], [y], [z]])
                missing = tree.query(site.T)[0] > 1e-6 * radius
                beyond = (site[2] < height.min() - 1e-6 * radius) | (site[2] > height.max() + 1e-6 * radius)
                normal = 0.5 * np.array([[x], [y]])  # towards the missing ball, which would push the other way
                push += np.where(missing & ~beyond, 2 * np.sqrt(2) * radius**2 * normal, 0.0)
    kept = tree.query(cut_to_sector(specimen, sector).positions.T)[1]
    _, per_layer = np.unique(np.round(height / radius, 6), return_counts=True)
    section = per_layer.min() * 4 * radius**2 / sector.order
    return Load(jnp.asarray(push[:, kept]), jnp.asarray(section))
