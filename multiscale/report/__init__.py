"""What a run has found, as tables and as a page."""

from multiscale.report.page import write_report
from multiscale.report.roughness import list_cutoffs, tabulate_roughness
from multiscale.report.sliding import describe_sliding
from multiscale.report.sweep import list_sweep_cautions
from multiscale.report.tables import (
    list_cycles,
    list_facts,
    tabulate,
    tabulate_braking,
    tabulate_grains,
    tabulate_links,
    tabulate_scene,
    tabulate_sweep,
)

__all__ = [
    "describe_sliding",
    "list_cutoffs",
    "list_cycles",
    "list_facts",
    "list_sweep_cautions",
    "tabulate",
    "tabulate_braking",
    "tabulate_grains",
    "tabulate_links",
    "tabulate_roughness",
    "tabulate_scene",
    "tabulate_sweep",
    "write_report",
]
