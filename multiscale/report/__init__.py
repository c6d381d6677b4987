"""What a run has found, as tables and as a page."""

from multiscale.report.page import write_report
from multiscale.report.roughness_section import list_cutoffs, tabulate_roughness
from multiscale.report.rows import (
    list_cycles,
    list_facts,
    tabulate,
    tabulate_braking,
    tabulate_grains,
    tabulate_links,
    tabulate_scene,
    tabulate_sweep,
)
from multiscale.report.sliding_section import describe_sliding
from multiscale.report.sweep_page import list_sweep_cautions

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
