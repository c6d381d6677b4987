"""Large structures that carry interface laws.

Solvers of each kind of structure:

- ``LinkSystem``, bars, cables and beams: :func:`solve_static`, :func:`simulate`
- ``FiniteAssembly``, bodies of any bulk law, Coulomb contact, large displacement and sliding:
  :func:`solve_contact`, Newton on displacement and reaction together, or only on the reactions if
  the bodies are linear
- links or elastic bodies that are cut (:func:`cut_links`, ``cut_assembly``): :func:`solve_latin`,
  :class:`NewtonSchur`, with any interface law between the bodies, over processes
- ``Assembly``, elastic bodies, any interface law, rigid plates, bolts: :func:`solve_assembly`
- ``RoughJoint``, two elastic blocks: :func:`press_joint` under uniform pressure, in closed form
- matrices of elastic bodies and a jump: :func:`solve_interface`, any law, all unknowns together
- grains: :func:`granulate.simulate_grains`
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
