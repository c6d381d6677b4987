"""Laws and their errors: from cells to an interface law whose uncertainty is stated.

Question: how accurate is a law that was fitted to ten cells?

    python workflows/guides/04_laws.py

leaves ``rough_joint.inp``.
"""

import numpy as np

from multiscale.micro import Cell, Path, run_ensemble, self_affine
from multiscale.upscaling import (
    compare_laws,
    error_budget,
    fit_law,
    law_band,
    write_pressure_overclosure,
)


def press(points):
    """Press ten flat cells of 4 x 4 longest wavelengths, the same surfaces on every grid."""
    spectrum = {"hurst_exponent": 0.8, "long_cutoff": 20e-6, "short_cutoff": 1e-5, "rms_slope": 0.1}
    size = (80e-6, 80e-6)  # m
    surfaces = [self_affine((points, points), size, seed, **spectrum) for seed in range(10)]
    cells = [Cell(surface, 80e-6, 8, 210e9, 0.3, geometry="flat") for surface in surfaces]
    return run_ensemble(cells, Path(pressure=tuple(np.geomspace(0.3e9, 4e9, 8))))  # Pa


# A law is fitted to cells, to measured stiffness or to other observations, with bootstrap bands and
# a report of its admissibility. The normal law of free form is the default. It is as accurate as
# its data are dense: with 2, 3, 4 and 8 pressures a decade, exponential, power,
# Greenwood-Williamson and Westergaard laws come back within 4, .4, .25 and .08 % of pressure and
# 20, 5, 3 and 1 % of stiffness, with the largest errors at the highest pressures. Exponential,
# power and further families (guide 03) are alternatives.
response = press(64)
law = fit_law(response)
print(law.attrs["admissibility"])
print(compare_laws(response))  # cross-validated errors and Akaike weights
print(law_band(law, lambda sample: sample.gap_at(np.array([1e9]))))  # m, 95 %

# error_budget estimates the error of a law, term by term (guide 02), each from separate evidence:
# cells on a coarser grid, here by a factor of 2, give the discretisation. The budget assumes
# nothing: it lists the terms without evidence as unknown, with the calculation that would give
# them.
budget = error_budget(response, law, resolutions={2.0: press(32)})
print(budget["error_total"].sel(quantity="mean_gap").values)  # relative, at each pressure
print(budget.attrs["unknown"])  # cell size, small slopes, scale separation

# Totals were compared with the means of 96 other realisations of the same cells, in ten scenes of
# flat cells that differ in Hurst's exponent, band, slope, pressures and family of the law, with 60
# realisations each in ensembles of 3 to 6 (tests/verification/test_coverage_of_budgets.py). Share
# of the steps within the stated 95 %, with its 95 % interval over the scenes:
#
#   realisations   mean gap       contact fraction   stiffness
#   3              .952 +- .022   .959 +- .014       .955 +- .011
#   4              .946 +- .018   .963 +- .017       .953 +- .019
#   5              .940 +- .029   .952 +- .026       .946 +- .021
#   6              .945 +- .021   .959 +- .024       .933 +- .037
#
# Bands come from the bootstrap, with the width of Student's interval for few realisations.
#
# Most of the bias of small cells is in their rms height: at_rms_height takes their gaps to the
# height of the surface at large.
#
# Tangential law: two deformable bodies with friction are pressed, sheared until they slip, and
# released, along shear_path(cell, pressures). fit_branches(response, shear=sheared) adds to the
# normal law the ratio of tangential to normal stiffness and the friction coefficient of a bed of
# sliders, with samples; error_budget(..., tangential={}) has the distance of the cells from the
# bed, and sliders_from_dataset(law) makes the law by which joints slip. Between alike bodies the
# ratio is 2 (1 - nu) / (2 - nu); where nothing was sheared, assume_shear states the assumed values.
# A rigid counterface gives a wrong ratio, since pressing alone makes its edges slip. In cases the
# table [micro.shear] does all of this, and joints take friction and ratio from their law.
#
# Other laws: contact area, tangential stiffness, friction over pressure and speed, unloading. Cells
# with friction that are dragged give friction, through friction_observations. Measured stiffness
# comes from a CSV file whose first line names the units, such as
#
#   pressure (MPa), stiffness (MPa/um), specimen
#
# by fit_law(read_observations("stiffness.csv", "normal_stiffness"), family="power").
#
# Measured joints correct the law of cells: calibrate(law, [read_measured("loops.csv", "loop",
# error=0.03)]) moves form, heights, friction and stiffness ratio as far as the data ask for, with
# the frame of the machine as an unknown, and names a parameter that disagrees. Its law has the
# posterior as samples; predict_measured(law, table) gives other loads with their bands, as in
# workflows/measured_joint.py.
#
# propagate(name, law_sources(law), solve, value) carries the budget of a law through any solver of
# structures; joints in scenes carry the budget by themselves if their law has one. The law can be
# exported, here for CalculiX and Abaqus in mm and MPa; friction_for="calculix" or "abaqus" adds
# friction and stick stiffness of a law that has them. multiscale export does the same with files.
write_pressure_overclosure(law, "rough_joint.inp")
