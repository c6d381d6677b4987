"""Tyres that slide: friction of rubber on a rough road by hysteresis.

Question: how does the friction of rubber on asphalt depend on its speed and temperature?

    python workflows/guides/12_sliding_tyres.py
"""

from multiscale.laws import wlf_shift
from multiscale.micro import RelaxingSolid, self_affine, solve_sliding

# The rubber is a Prony series, shifted by temperature after Williams, Landel and Ferry. The road is
# rigid, rough and self-affine. solve_sliding returns the friction of the viscoelastic half-space in
# steady sliding, for small slopes.
waves = {"hurst_exponent": 0.8, "long_cutoff": 8e-3, "short_cutoff": 2e-3, "rms_height": 0.17e-3}
road = self_affine((32, 32), (16e-3, 16e-3), 1, **waves)  # points, m, seed
rubber = RelaxingSolid(4e6, 0.49, moduli=(4e6, 36e6, 72e6), times=(0.1, 1e-3, 1e-5))  # Pa, s
friction = {}
for celsius in (10.0, 50.0):
    shift = wlf_shift(celsius + 273.15, 293.15, c1=8.86, c2=101.6)
    friction[celsius] = [
        solve_sliding(road, rubber, 400e3, speed, shift=shift).friction  # at 400 kPa
        for speed in (0.01, 0.1, 1.0, 10.0)  # m/s
    ]
    print(celsius, friction[celsius])

# Friction over speed is a bell, which moves to higher speeds with temperature: in this range the
# friction of the cold rubber falls with the speed, and the friction of the warm rubber rises.

# The case tyre_on_road computes more:
#
#   multiscale run tyre_on_road -o braking --quick
#
# It slides rubber at every pressure, speed and temperature of [sliding]; fits a bell of friction
# over pressure, speed and temperature with bands; and brakes a tread block under pressure and the
# local friction of the law. The run prints the braking force over speed and temperature and
# draws the bell, the force, the road, and pressure and friction of the footprint.
#
# This is the friction by hysteresis on the waves in [road], without adhesion and finer texture, and
# hence less than the friction of a tyre. The flanks of the bell are powers of the speed, and its
# peak depends on the pressure. The cells of the shipped case differ from the bell by 1.5 % of its
# peak, root mean square, and by 4 % at most. The error budget of the force contains this misfit,
# the scatter of the road and the elements of the block, and names the unknown terms.
