"""Bulk laws, which map a deformation gradient to a stress with its consistent tangent."""

from multiscale.laws.bulk.bulk_law import BulkLaw, BulkResponse, respond_bulk
from multiscale.laws.bulk.elastic import AnisotropicElastic, Elastic, GradedElastic
from multiscale.laws.bulk.rubber import J2, NeoHookean, Prony

__all__ = [
    "J2",
    "AnisotropicElastic",
    "BulkLaw",
    "BulkResponse",
    "Elastic",
    "GradedElastic",
    "NeoHookean",
    "Prony",
    "respond_bulk",
]
