"""Bulk laws: deformation gradient in, stress and consistent tangent out."""

from multiscale.laws.bulk.anisotropic import AnisotropicElastic
from multiscale.laws.bulk.bulk_law import BulkLaw, BulkResponse, respond_bulk
from multiscale.laws.bulk.elastic import Elastic, GradedElastic
from multiscale.laws.bulk.j2 import J2
from multiscale.laws.bulk.neo_hookean import NeoHookean
from multiscale.laws.bulk.prony import Prony

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
