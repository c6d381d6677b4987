"""Large structures that carry interface laws.

Solvers of each kind of structure:

=====================================  ==========================================================
structure                              solvers
=====================================  ==========================================================
``LinkSystem``: bars, cables, beams    :func:`solve_static`, :func:`simulate`
``FiniteAssembly``: bodies of any bulk :func:`solve_contact`: Newton on displacement and reaction
law, Coulomb contact, large            together, or only on the reactions if the bodies are linear
displacement and sliding
links or elastic bodies, cut           :func:`solve_latin`, :class:`NewtonSchur`: any interface law
(:func:`cut_links`, ``cut_assembly``)  between the bodies, many substructures, several processes
``Assembly``: elastic bodies, any      :func:`solve_assembly`: assembled Newton, LATIN, Newton-Schur
interface law, rigid plates, bolts
``RoughJoint``: two elastic blocks     :func:`press_joint`: uniform pressure, closed form;
                                       :func:`pressed_blocks` makes an ``Assembly`` of it
matrices of elastic bodies and a jump  :func:`solve_interface`: any law, all unknowns together
grains                                 :func:`granulate.simulate_grains`
=====================================  ==========================================================
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
