"""The datasets that pass between the layers: names, dimensions and units, written once."""

from multiscale.schema.dataset_schema import COMPONENTS as COMPONENTS
from multiscale.schema.dataset_schema import HOLDING as HOLDING
from multiscale.schema.dataset_schema import LOADING as LOADING
from multiscale.schema.dataset_schema import UNLOADING as UNLOADING
from multiscale.schema.dataset_schema import Dataset as Dataset
from multiscale.schema.dataset_schema import PlainDataset as PlainDataset
from multiscale.schema.dataset_schema import Schema as Schema
from multiscale.schema.dataset_schema import Variable as Variable
from multiscale.schema.dataset_schema import branch_of as branch_of
from multiscale.schema.dataset_schema import read_schemas
from multiscale.schema.dataset_schema import with_cautions as with_cautions
from multiscale.schema.shown import SHOWN as SHOWN
from multiscale.schema.shown import Show as Show
from multiscale.schema.shown import schema_table
from multiscale.schema.shown import unit_in as unit_in

SCHEMAS = read_schemas(schema_table("datasets"))  # kinds of datasets by their names

SURFACE_STATISTICS = SCHEMAS["surface_statistics"]
MICRO_RESPONSE = SCHEMAS["micro_response"]
SHEAR_RESPONSE = SCHEMAS["shear_response"]
COARSER_RESPONSE = SCHEMAS["coarser_response"]
COARSER_SHEAR_RESPONSE = SCHEMAS["coarser_shear_response"]
CONTROL_RESPONSE = SCHEMAS["control_response"]
SLIDING_RESPONSE = SCHEMAS["sliding_response"]
FIELDS = SCHEMAS["fields"]
INTERFACE_LAW = SCHEMAS["interface_law"]
ERROR_BUDGET = SCHEMAS["error_budget"]
LAW_COMPARISON = SCHEMAS["law_comparison"]
MACRO_RESULT = SCHEMAS["macro_result"]
VIBRATION = SCHEMAS["vibration"]
SEAL = SCHEMAS["seal"]
HOMOGENISED = SCHEMAS["homogenised"]
GRANULATE = SCHEMAS["granulate"]
DAMAGE_SECTIONS = SCHEMAS["damage_sections"]
RVE_VOLUMES = SCHEMAS["rve_volumes"]
RVE = SCHEMAS["rve"]
VOLUME_GROWTH = SCHEMAS["volume_growth"]
CRACK_GROWTH = SCHEMAS["crack_growth"]
CRACK_BAND = SCHEMAS["crack_band"]
CRACKED_BODY = SCHEMAS["cracked_body"]
FATIGUE = SCHEMAS["fatigue"]
FATIGUE_LIFE = SCHEMAS["fatigue_life"]
WOEHLER = SCHEMAS["woehler"]
SWEEP = SCHEMAS["sweep"]
ACCURACY = SCHEMAS["accuracy"]
WORK_PRECISION = SCHEMAS["work_precision"]
STABILITY = SCHEMAS["stability"]
