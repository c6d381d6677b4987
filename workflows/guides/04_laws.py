"""Laws and their errors: from cells to an interface law with its uncertainty.

Question: how accurate is a law that was fitted to ten cells?

    python workflows/guides/04_laws.py

writes ``rough_joint.inp``.
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
# a report of its admissibility. The default is a normal law of free form, convex and decreasing.
# Its accuracy depends on the spacing of its data: with 2, 3, 4 and 8 pressures per decade of known
# exponential, power, Greenwood-Williamson and Westergaard laws, the fitted pressure has errors of
# 4, .4, .25 and .08 % and the stiffness of 20, 5, 3 and 1 %, the largest at the highest pressures.
# Exponential, power and further families (guide 03) are alternatives.
response = press(64)
law = fit_law(response)
print(law.attrs["admissibility"])
print(compare_laws(response))  # cross-validated errors and Akaike weights
print(law_band(law, lambda sample: sample.gap_at(np.array([1e9]))))  # m, 95 %

# error_budget estimates each term of the error of a law separately (guide 02): cells on a grid
# coarser by a factor of 2 give the discretisation. Terms without data are listed as unknown, with
# the calculation that would estimate them.
budget = error_budget(response, law, resolutions={2.0: press(32)})
print(budget["error_total"].sel(quantity="mean_gap").values)  # relative, at each pressure
print(budget.attrs["unknown"])  # cell size, small slopes, scale separation

# Totals were compared with the means of 96 other realisations of the same cells, in ten scenes of
# flat cells that differ in Hurst's exponent, band, slope, pressures and family of the law, with 60
# realisations each in ensembles of 3 to 6 (tests/verification/test_coverage_of_budgets.py). The
# table has the share of steps within the 95 % interval, with its 95 % interval over the scenes:
#
#   realisations   mean gap       contact fraction   stiffness
#   3              .952 +- .022   .959 +- .014       .955 +- .011
#   4              .946 +- .018   .963 +- .017       .953 +- .019
#   5              .940 +- .029   .952 +- .026       .946 +- .021
#   6              .945 +- .021   .959 +- .024       .933 +- .037
#
# Bands come from the bootstrap, with the width of Student's interval for few realisations.
#
# Most of the bias of small cells comes from their rms height: at_rms_height scales their gaps to
# the rms height of the whole surface.
#
# Tangential law: two deformable bodies with friction are pressed, sheared until they slip, and
# released, along shear_path(cell, pressures). fit_branches(response, shear=sheared) adds to the
# normal law the ratio of tangential to normal stiffness and the friction coefficient of a bed of
# sliders, with samples; error_budget(..., tangential={}) contains the difference between cells and
# bed, and sliders_from_dataset(law) returns the law of slipping joints. Between equal bodies the
# ratio is 2 (1 - nu) / (2 - nu); without sheared cells assume_shear adds assumed values. A rigid
# counterface gives a wrong ratio, since its edges slip already under pressure. In cases the table
# [micro.shear] does all of this, and joints take friction and ratio from their law.
#
# Other laws: contact area, tangential stiffness, friction over pressure and speed, unloading.
# friction_observations reads the friction of dragged cells. Measured stiffness comes from a CSV
# file with units in its first line, such as
#
#   pressure (MPa), stiffness (MPa/um), specimen
#
# by fit_law(read_observations("stiffness.csv", "normal_stiffness"), family="power").
#
# Measured joints correct the law of cells: calibrate(law, [read_measured("loops.csv", "loop",
# error=0.03)]) estimates form, heights, friction and stiffness ratio from law and data, with an
# unknown compliance of the frame of the machine, and names parameters on which law and data
# disagree. The samples of its law are the posterior; predict_measured(law, table) evaluates other
# loads with their bands, as in workflows/measured_joint.py.
#
# propagate(name, law_sources(law), solve, value) computes the errors of any structure from the
# budget of its law; joints in scenes do so by default. The law can be exported, here for CalculiX
# and Abaqus in mm and MPa; friction_for="calculix" or "abaqus" adds friction and stick stiffness.
# multiscale export does the same with files.
write_pressure_overclosure(law, "rough_joint.inp")
