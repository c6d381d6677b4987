"""Results in xarray: select, plot, refit and export the datasets of a run.

Question: how are the datasets of a run used, and how does another program read its law?

    python workflows/guides/03_results_in_xarray.py

reads the folder ``results`` of the first command in the README, and writes ``gap.csv``,
``law.csv`` and ``rough_joint.inp``.
"""

from multiscale.io import open_run
from multiscale.laws import Exponential
from multiscale.upscaling import (
    Family,
    Parameter,
    compare_laws,
    fit_law,
    law_from_dataset,
    write_law_table,
    write_pressure_overclosure,
)

# open_run gives a run as a DataTree, with a node for the dataset of every stage of the run. Values
# are in SI units, and each variable has the attributes units and long_name. Steps that did not
# converge stay in the file, as NaN with converged = 0.
#
#   dataset               dimensions                            content
#   micro_response        realisation, step, component          traction, mean gap, contact fraction
#                                                               and effort of the cells
#   shear_response        realisation, step, component          the same of cells that are pressed,
#                                                               sheared and released
#   control_response      realisation, step, component          flat control cells
#   coarser_response      realisation, step, component          the first cells on half of their
#                                                               points, and coarser_shear_response
#   interface_law         term, sample, step                    law, bootstrap samples, fit errors
#   macro_result          step, and link, node, point or cycle  stiffness, gap, tensions, zones,
#                                                               energies, error budget
#   sliding_response      load, step, component                 friction, gap and contact of a cell
#                                                               that slides
#   vibration             mode, step, node                      frequency, damping and shapes
#   rve                   direction, realisation                damage and stiffness of a volume
#   fatigue_life          record, element                       damage and life of a body
#   fields                step, y, x                            heights, gap and pressure of a cell
#   sweep                 point, step or cycle                  answers and parameters of each point
#   granulate             step, frame, grain, contact           motion and forces of grains
#   work_precision        run                                   errors and times of methods
#   stability             case                                  outcomes of extreme cases
#
# multiscale.schema has every variable with its dimensions, unit and meaning, for instance
# MICRO_RESPONSE.variables["mean_gap"]; open_dataset refuses a file that does not follow its schema.
tree = open_run("results")
response, law, joint = (
    tree[name].to_dataset() for name in ("micro_response", "interface_law", "macro_result")
)
print(response)

# Select. Steps count from 0, and the pressures are a coordinate along them.
gap = response["mean_gap"].swap_dims(step="nominal_pressure")  # m
light = gap.sel(nominal_pressure=slice(2e6, 20e6))  # Pa
print(light.mean("realisation").values, light.std("realisation").values)
stiffness = joint["joint_stiffness"].swap_dims(step="preload")  # Pa/m
print(float(stiffness.sel(preload=20e6)))
light.to_dataframe().to_csv("gap.csv")

# Plot. Every figure of the report is a function of multiscale.plotting that takes a dataset and
# axes; xarray has figures, too.
gap.plot.line(x="nominal_pressure", xscale="log", add_legend=False)

# Evaluate the law between the pressures of the cells: the fit, and one of its bootstrap samples.
print(law_from_dataset(law).gap_at(15e6), law_from_dataset(law, 0).gap_at(15e6))  # m

# Fit another family to the same cells, and compare it with others.
mine = Family(
    "exponential, 0.3 um",
    ("gap",),
    {"pressure_scale": Parameter("Pa")},
    make=lambda pressure_scale: Exponential(pressure_scale, 0.3e-6),
    start=lambda seen: {"pressure_scale": float(seen.pressure.max())},
)
print(fit_law(response, family=mine)["pressure_scale"].values)
print(compare_laws(response, ["convex_decreasing", "power", mine]).to_dataframe())

# Export. The second file is input of CalculiX and Abaqus, in mm and MPa.
write_law_table(law, "law.csv")
write_pressure_overclosure(law, "rough_joint.inp")
