"""Closed forms that the solvers are checked against: plain functions of arrays."""
