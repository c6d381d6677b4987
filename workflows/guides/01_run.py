"""A run from Python: one case, its stiffness, and the law that it leaves.

Question: what does the command ``multiscale run`` do, and how does Python reach each part of it?

    python workflows/guides/01_run.py

leaves the folder ``results_from_python``. All other guides that need a run read the folder
``results`` of the first command in the README.
"""

from multiscale.io import open_law
from multiscale.pipeline import load_case, run
from multiscale.upscaling import law_from_dataset

# A case is a file, or the name of a shipped case. quick() takes fewer and coarser cells, and the
# cautions state it. A case is frozen; model_copy makes a changed one. Flat cells are used
# here because they are the fastest: they take the roughness as the gap of an elastic layer, which
# is right for small slopes.
case = load_case("ground_steel").quick()
flat = case.cell.model_copy(update={"geometry": "flat"})
case = case.model_copy(update={"cell": flat})

# The results hold one dataset for each arrow of the chain. Every dataset is also a file in the
# folder. The same call again finds the finished cells and continues from them.
results = run(case, "results_from_python")
stiffness = results.macro_result["joint_stiffness"]  # Pa/m, at each preload
print(stiffness)

# The fitted law is an object with a traction, a gap and a stiffness at any pressure of its data.
law = law_from_dataset(open_law("results_from_python/interface_law.nc"))
gap = law.gap_at(10e6)  # m, at 10 MPa
print(gap, law.stiffness(gap))  # m and Pa/m
