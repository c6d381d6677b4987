"""Trusses, tensegrity and nets: links that go slack, at rest and in motion.

Question: how many cables of a tensegrity grid go slack under load, and how does the grid swing when
the load is taken away?

    python workflows/guides/07_trusses.py
"""

import numpy as np

from multiscale.macro import simulate, solve_static, tensegrity_grid

# A structure has nodes and links. Each link is a bar, a cable that goes slack, a strut or a beam.
# Structures come from builders such as this one, from tables or from line meshes
# (microcases/manual/structures.md).
grid = tensegrity_grid(8)  # 64 self-stressed modules

# At rest: one step for each factor of the load.
rest = solve_static(grid, [0.0, 1.0, 4.0])
print((rest["slack"] > 0.0).sum("link").values)  # slack cables at each factor
print(rest["tension"].max("link").values)  # N

# In motion: the grid starts at rest under the load, which is then taken away.
loaded = rest["displacement"].sel(step=1).values  # m
start = (loaded, np.zeros_like(loaded))
motion = simulate(grid, np.linspace(0.0, 0.1, 41), 2.0, load_factor=lambda t: 0.0, start=start)
print(motion["kinetic_energy"].values[-1])  # J, with 2 kg at each node
