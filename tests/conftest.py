"""Tests run with the fast kernels that the command line uses; they must be switched on before the first computation."""

import axijax

axijax.fast_cpu_kernels()
