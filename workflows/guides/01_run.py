"""A run from Python: a case, its stiffness, and its interface law.

Question: what does the command ``multiscale run`` do, and how is each part of it used from Python?

    python workflows/guides/01_run.py

writes the folder ``results_from_python``. All other guides that need a run read the folder
``results`` of the first command in the README.
"""

from multiscale.io import open_law
from multiscale.pipeline import load_case, run
from multiscale.upscaling import law_from_dataset

# A case comes from a file or by the name of a shipped case. quick() takes fewer and coarser cells,
# which the cautions report. A case is frozen; model_copy makes a changed copy. Flat cells are used
# here because they are the fastest: their roughness is the gap of an elastic layer, which is
# accurate for small slopes.
case = load_case("ground_steel").quick()
flat = case.cell.model_copy(update={"geometry": "flat"})
case = case.model_copy(update={"cell": flat})

# The results have a dataset of each stage of the chain, which is also a file in the folder. The
# same call reads finished cells from the folder and computes only the others.
results = run(case, "results_from_python")
stiffness = results.macro_result["joint_stiffness"]  # Pa/m, at each preload
print(stiffness)

# The fitted law is an object with a traction, a gap and a stiffness at any pressure of its data.
law = law_from_dataset(open_law("results_from_python/interface_law.nc"))
gap = law.gap_at(10e6)  # m, at 10 MPa
print(gap, law.stiffness(gap))  # m and Pa/m
