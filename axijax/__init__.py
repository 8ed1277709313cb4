"""axijax: differentiable discrete element triaxial tests on an axisymmetric sector, in JAX.

Importing this package switches JAX to 64-bit numbers, which a discrete element test needs by default.
"""

import jax

jax.config.update("jax_enable_x64", True)
