"""Closed forms that the solvers are checked against: plain functions of arrays."""

from multiscale.reference import (
    full_contact,
    hertz,
    janssen,
    johnson,
    joint,
    layer,
    mindlin,
    persson,
    rings,
    westergaard,
)

__all__ = [
    "full_contact",
    "hertz",
    "janssen",
    "johnson",
    "joint",
    "layer",
    "mindlin",
    "persson",
    "rings",
    "westergaard",
]
