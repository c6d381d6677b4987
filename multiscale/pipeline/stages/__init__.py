"""The stages of all cases; a new stage needs a file and a line here."""

from collections.abc import Container

from multiscale.pipeline.stage import Stage
from multiscale.pipeline.stages import ensembles
from multiscale.pipeline.stages.accuracy import accuracy_stage
from multiscale.pipeline.stages.body_fatigue import BODY_FATIGUE
from multiscale.pipeline.stages.braking import BRAKING
from multiscale.pipeline.stages.cells import CELLS
from multiscale.pipeline.stages.cracking_body import CRACKING_BODY
from multiscale.pipeline.stages.cut_structures import CONDENSED_PARTS, LINKS
from multiscale.pipeline.stages.ensembles import SLIDING
from multiscale.pipeline.stages.fitted_law import FITTED_LAW
from multiscale.pipeline.stages.grains import GRAINS
from multiscale.pipeline.stages.joint import JOINT
from multiscale.pipeline.stages.loaded_bodies import LOADED_BODIES
from multiscale.pipeline.stages.plates_of_links import EQUIVALENT_PLATE
from multiscale.pipeline.stages.ring_seal import RING_SEAL
from multiscale.pipeline.stages.rubber_friction import FRICTION_LAW, ROADS
from multiscale.pipeline.stages.third_body import (
    THIRD_BODY_CELLS,
    THIRD_BODY_LAW,
    WIDER_CELLS,
)
from multiscale.pipeline.stages.vibrating_bodies import VIBRATING_BODIES
from multiscale.pipeline.stages.volumes import GROWING_CRACKS, REPRESENTATIVE_VOLUME

__all__ = ["STAGES", "stages_of"]

COMPUTED: tuple[Stage, ...] = (
    REPRESENTATIVE_VOLUME,
    GROWING_CRACKS,
    SLIDING,
    CELLS,
    ensembles.SHEARED_CELLS,
    ensembles.COARSER_CELLS,
    ensembles.COARSER_SHEAR,
    ensembles.CONTROL_CELLS,
    FITTED_LAW,
    THIRD_BODY_CELLS,
    WIDER_CELLS,
    THIRD_BODY_LAW,
    RING_SEAL,
    JOINT,
    ROADS,
    FRICTION_LAW,
    BRAKING,
    LINKS,
    EQUIVALENT_PLATE,
    LOADED_BODIES,
    BODY_FATIGUE,
    CRACKING_BODY,
    VIBRATING_BODIES,
    GRAINS,
    CONDENSED_PARTS,
)
"""Stages that compute from the tables of a case, in the order in which they are run."""

ACCURACY_STAGE = accuracy_stage(COMPUTED)
STAGES: tuple[Stage, ...] = (*COMPUTED, ACCURACY_STAGE)
"""All stages; the plan of a target for the error is run and shown before the others."""


def stages_of(tables: Container[str]) -> tuple[Stage, ...]:
    """Return the stages of the tables of a case file, in their order."""
    return tuple(stage for stage in STAGES if stage.asked_for(tables))
