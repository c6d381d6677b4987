"""The answer of a run and its error.

Question: which part of the stated error comes from the scatter of the surfaces, and which errors
are not estimated?

    python workflows/guides/02_answer_and_error.py

reads the folder ``results`` of the first command in the README.
"""

from multiscale.io import open_run

joint = open_run("results")["macro_result"].to_dataset()

# The stiffness of the joint includes the blocks; times the nominal area it is force over
# displacement. Interface and blocks are its two parts in series, each with a separate error, so
# that compliant blocks hide no error of the interface. A run prints all three with --details, in
# MPa/um; datasets have Pa/m.
for part in ("joint_stiffness", "interface_stiffness", "solid_stiffness"):
    total = joint["error_total"].sel(quantity=part)  # relative, at each preload
    sampling = joint["error_half_width"].sel(quantity=part, error_term="sampling")
    print(part, total.values, "of it sampling", sampling.values)

# The 95 % band of the law in a figure contains only the scatter of the realisations. The total,
# printed as "error (%)", is the half-width of a 95 % interval with every known term: sampling, fit,
# size of the cells, discretisation, increments, surface, scale separation, few cells, and a
# discrepancy of the joint from the law of its cells. An attribute describes how each term was
# computed.
#
# Each answer has two intervals. The first contains the answer of the mean law. The second contains
# the next joint; it is wider because an interface has few cells, and by the discrepancy.
print(joint["joint_stiffness_mean_law"].values, joint["joint_stiffness_one_part"].values)  # Pa/m
for term in joint["error_term"].values:
    print(term, "-", joint.attrs["how_" + term.replace(" ", "_")])

# A term without a computation is listed as unknown, with the key that estimates it: coarser in
# [micro] for the discretisation of the cells, a target in [accuracy] for all terms, also the size
# of the cells.
print(joint.attrs["unknown"])

# Every total includes sampling, fit and surface. If one of these terms, or a term that the case
# requests, cannot be computed, the total is NaN in the dataset and "unknown" in print.
#
# A single realisation has no sampling error. Two or more have Student's interval: 12.7 standard
# errors for two, 4.3 for three. Three realisations give samples of the law, and with them bands of
# the joint; four give a 95 % band of the law.

# The print and the report have the cautions. They concern too few points per shortest wavelength,
# lost roughness of a map, load outside the pressures of the cells, a real pressure too high for
# metals, and too few realisations. A caution does not stop a run, but it must be explained before
# the answer is used.
print(joint.attrs["cautions"] or "no cautions")
