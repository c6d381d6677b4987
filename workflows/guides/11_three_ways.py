"""Three ways to an answer: with a law, with cells at every point, or with all roughness resolved.

Question: how large is the error of a law of the roughness, and how much time does it save?

    python workflows/guides/11_three_ways.py
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))  # the folder of the script with the three ways
from three_ways import WAYS, RoughWave

# The chain condenses roughness into a law (sequential). The cells of the law can be pressed further
# where the load of the structure is outside their pressures (adaptive; way = "adaptive" in
# [interface] of a case). The same structure can be solved with a cell at every point (concurrent),
# or with all of its roughness (direct).
wave = RoughWave(1 / 8)  # longest wave of the roughness over the wave of the structure
gaps = []
for name, solve in WAYS.items():
    way = solve(wave, range(2), points_per_wave=4)  # two seeds
    print(name, way.mean_gap, way.seconds, way.solved, way.reused)  # m, s, cells
    gaps.append(way.mean_gap)

# CellLaw(cell, pressures) of multiscale.micro is the law of the concurrent way. The solvers of
# joints, scenes and substructures take it like any other law. It presses a flat, elastic,
# frictionless cell at the pressure of each new gap, each pressure once; law.account counts the
# cells pressed and reused.
#
# Comparing the sequential and the direct way on the same seeds splits the error: sampling, cell
# size, fit, both discretisations, and a remainder with the scale separation. For the rough wave,
# with cells of four longest waves (+- one standard error; tests/workflows/test_three_ways.py):
#
#   longest wave   gap over rms height   resolved   error           of it: cell size
#   1/4            1.165                 1.163      +0.2 +- 0.3 %   0
#   1/8            1.433                 1.448      -1.0 +- 0.4 %   -0.8 +- 0.2 %
#   1/16           1.739                 1.757      -1.0 +- 0.4 %   -1.2 +- 0.3 %
#   1/32           2.050                 2.072      -1.0 +- 0.5 %   -0.8 +- 0.5 %
#
# The remainder is within its standard error, 0.3 to 0.4 %, at every ratio, so the error of the
# scale separation is too small for this table.
#
# workflows/three_ways.py measures error against run time, and draws the figure. Its reference is
# each structure with a given surface, while a law averages over surfaces: with few waves along a
# structure this is the largest error, a tenth and more in a joint of profiles (TiltedJoint). Down
# to the ratio 1/32, resolving the wave by transforms is more accurate and faster than pressing
# eight cells. For the joint, resolved by finite elements, this is true down to 1/8; at 1/32 the law
# is faster and equally accurate. A law saves time where the roughness cannot be resolved, or where
# it is used for several structures.
