"""The answer and its error: what a run states, and how far it can be trusted.

Question: which part of the stated error comes from the scatter of the surfaces, and what has not
been estimated at all?

    python workflows/guides/02_answer_and_error.py

reads the folder ``results`` of the first command in the README.
"""

from multiscale.io import open_run

joint = open_run("results")["macro_result"].to_dataset()

# The stiffness of the joint is force over displacement of both blocks, and includes the blocks.
# The stiffness times the nominal area is the force per displacement. Interface and bodies are its
# two parts in series, each with a separate error, so that stiff bodies hide no interface. A run
# prints all three with --details, in MPa/um; datasets have Pa/m.
for part in ("joint_stiffness", "interface_stiffness", "solid_stiffness"):
    total = joint["error_total"].sel(quantity=part)  # relative, at each preload
    sampling = joint["error_half_width"].sel(quantity=part, error_term="sampling")
    print(part, total.values, "of it sampling", sampling.values)

# The 95 % band of the law in a figure contains only the scatter of the realisations. The total,
# printed as "error (%)", is the half-width of a 95 % interval that counts every known term:
# sampling, fit, size of the cells, discretisation, increments, surface, scale separation, few
# cells, and a discrepancy of the joint from the law of its cells. An attribute states how each term
# was found.
#
# Two intervals stand next to each answer, printed with as many digits as its error leaves. The
# answer of the mean law lies in the first. The next joint lies in the second, which is wider by the
# few cells that its interface holds, and by the discrepancy.
print(joint["joint_stiffness_mean_law"].values, joint["joint_stiffness_one_part"].values)  # Pa/m
for term in joint["error_term"].values:
    print(term, "-", joint.attrs["how_" + term.replace(" ", "_")])

# A term for which nothing was computed is listed as not known, with the key that makes it known:
# coarser in [micro] for the discretisation of the cells, a target in [accuracy] for all terms, also
# the size of the cells.
print(joint.attrs["unknown"])

# Sampling, fit and surface belong to every total: where one of them, or another term that the case
# asks for, cannot be computed, the total is NaN in the dataset and "unknown" in print.
#
# One realisation gives no sampling error. From two realisations on every quantity has Student's
# interval: 12.7 standard errors for two, 4.3 for three. Three realisations give samples of the law,
# and with them bands of the joint; four give a 95 % band of the law.

# Cautions are printed and stand in the report. They concern too few points to the shortest
# wavelength, lost roughness of a map, load outside the pressures of the cells, a real pressure that
# no metal bears, and too few realisations. A caution does not stop a run; an answer that matters
# needs an explanation of each.
print(joint.attrs["cautions"] or "no cautions")
