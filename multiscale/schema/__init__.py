"""The datasets that pass between the layers: names, dimensions and units, written once."""

from multiscale.schema.base import COMPONENTS, Schema, Variable, with_cautions
from multiscale.schema.cell import FIELDS, MICRO_RESPONSE, SLIDING_RESPONSE
from multiscale.schema.damage import DAMAGE_SECTIONS, FATIGUE, RVE_STIFFNESS, WOEHLER
from multiscale.schema.end_to_end import END_TO_END
from multiscale.schema.granulate import GRANULATE
from multiscale.schema.law import ERROR_BUDGET, INTERFACE_LAW, LAW_COMPARISON
from multiscale.schema.stability import STABILITY
from multiscale.schema.stored_cells import STORED_CELLS
from multiscale.schema.structure import HOMOGENISED, MACRO_RESULT
from multiscale.schema.sweep import SWEEP
from multiscale.schema.work_precision import WORK_PRECISION

__all__ = [
    "COMPONENTS",
    "DAMAGE_SECTIONS",
    "END_TO_END",
    "ERROR_BUDGET",
    "FATIGUE",
    "FIELDS",
    "GRANULATE",
    "HOMOGENISED",
    "INTERFACE_LAW",
    "LAW_COMPARISON",
    "MACRO_RESULT",
    "MICRO_RESPONSE",
    "RVE_STIFFNESS",
    "SCHEMAS",
    "SLIDING_RESPONSE",
    "STABILITY",
    "STORED_CELLS",
    "SWEEP",
    "WOEHLER",
    "WORK_PRECISION",
    "Schema",
    "Variable",
    "with_cautions",
]

SCHEMAS = {
    schema.name: schema
    for schema in (
        MICRO_RESPONSE,
        INTERFACE_LAW,
        MACRO_RESULT,
        FIELDS,
        WORK_PRECISION,
        DAMAGE_SECTIONS,
        RVE_STIFFNESS,
        FATIGUE,
        WOEHLER,
        ERROR_BUDGET,
        LAW_COMPARISON,
        HOMOGENISED,
        GRANULATE,
        END_TO_END,
        STORED_CELLS,
        SWEEP,
        SLIDING_RESPONSE,
        STABILITY,
    )
}
