"""The triaxial test: what is asked, how it is prepared, the engine that steps its stages, their records."""
