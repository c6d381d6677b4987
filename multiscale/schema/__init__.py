"""The datasets that pass between the layers: names, dimensions and units, written once."""

from multiscale.schema.cell_schema import (
    COARSER_RESPONSE,
    COARSER_SHEAR_RESPONSE,
    CONTROL_RESPONSE,
    FIELDS,
    HOLDING,
    LOADING,
    MICRO_RESPONSE,
    SHEAR_RESPONSE,
    SLIDING_RESPONSE,
    SURFACE_STATISTICS,
    UNLOADING,
    branch_of,
)
from multiscale.schema.damage_schema import (
    CRACK_BAND,
    CRACK_GROWTH,
    DAMAGE_SECTIONS,
    FATIGUE,
    FATIGUE_LIFE,
    RVE,
    RVE_STIFFNESS,
    RVE_VOLUMES,
    WOEHLER,
)
from multiscale.schema.dataset_schema import COMPONENTS, Schema, Variable, with_cautions
from multiscale.schema.law_schema import ERROR_BUDGET, INTERFACE_LAW, LAW_COMPARISON
from multiscale.schema.structure_schema import (
    GRANULATE,
    HOMOGENISED,
    MACRO_RESULT,
    SEAL,
    VIBRATION,
)
from multiscale.schema.study_schema import END_TO_END, STABILITY, STORED_CELLS, WORK_PRECISION
from multiscale.schema.sweep_schema import SWEEP

__all__ = [
    "COARSER_RESPONSE",
    "COARSER_SHEAR_RESPONSE",
    "COMPONENTS",
    "CONTROL_RESPONSE",
    "CRACK_BAND",
    "CRACK_GROWTH",
    "DAMAGE_SECTIONS",
    "END_TO_END",
    "ERROR_BUDGET",
    "FATIGUE",
    "FATIGUE_LIFE",
    "FIELDS",
    "GRANULATE",
    "HOLDING",
    "HOMOGENISED",
    "INTERFACE_LAW",
    "LAW_COMPARISON",
    "LOADING",
    "MACRO_RESULT",
    "MICRO_RESPONSE",
    "RVE",
    "RVE_STIFFNESS",
    "RVE_VOLUMES",
    "SCHEMAS",
    "SEAL",
    "SHEAR_RESPONSE",
    "SLIDING_RESPONSE",
    "STABILITY",
    "STORED_CELLS",
    "SURFACE_STATISTICS",
    "SWEEP",
    "UNLOADING",
    "VIBRATION",
    "WOEHLER",
    "WORK_PRECISION",
    "Schema",
    "Variable",
    "branch_of",
    "with_cautions",
]

__dir__ = __all__.copy

SCHEMAS = {
    schema.name: schema
    for schema in (
        MICRO_RESPONSE,
        INTERFACE_LAW,
        MACRO_RESULT,
        FIELDS,
        WORK_PRECISION,
        CRACK_BAND,
        CRACK_GROWTH,
        DAMAGE_SECTIONS,
        RVE,
        RVE_STIFFNESS,
        RVE_VOLUMES,
        FATIGUE,
        FATIGUE_LIFE,
        WOEHLER,
        ERROR_BUDGET,
        LAW_COMPARISON,
        HOMOGENISED,
        SEAL,
        VIBRATION,
        GRANULATE,
        END_TO_END,
        STORED_CELLS,
        SWEEP,
        SHEAR_RESPONSE,
        COARSER_RESPONSE,
        COARSER_SHEAR_RESPONSE,
        CONTROL_RESPONSE,
        SLIDING_RESPONSE,
        STABILITY,
        SURFACE_STATISTICS,
    )
}
