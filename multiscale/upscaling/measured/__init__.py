"""Measured joints: their answers by a law with gradients, and their tables."""
