"""Materials, forces as a sum of terms, membrane, time step and energy: one physical effect a file."""
