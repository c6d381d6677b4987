"""Cells beyond linear elasticity: large strain, plasticity, viscosity, friction."""
