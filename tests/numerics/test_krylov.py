"""Krylov methods on matrices without a solution."""
