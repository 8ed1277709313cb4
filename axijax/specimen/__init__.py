"""Specimens: lattices, gradings, and what a packing looks like inside."""
