"""Laws of interfaces, bulk materials and links, used at every scale."""

from multiscale.laws.asperities import (
    Asperities,
    AsperityLaw,
    class_densities,
    gaussian_asperities,
)
from multiscale.laws.friction_laws import (
    BellFriction,
    Coulomb,
    DecayingFriction,
    FrictionLaw,
    RigidContact,
    SteadySliding,
    wlf_shift,
)
from multiscale.laws.hysteretic import HystereticLaw
from multiscale.laws.interface_law import GapLaw, InterfaceLaw, NormalLaw, Response, Sliding
from multiscale.laws.normal import ConvexDecreasing, Exponential, ModifiedLaw, PowerLaw, Tabulated
from multiscale.laws.pressure_functions import (
    AreaLaw,
    ErrorFunctionArea,
    PowerStiffness,
    StiffnessLaw,
)
from multiscale.laws.sliders import Sliders
from multiscale.laws.softening import Softening

__all__ = [
    "AreaLaw",
    "Asperities",
    "AsperityLaw",
    "BellFriction",
    "ConvexDecreasing",
    "Coulomb",
    "DecayingFriction",
    "ErrorFunctionArea",
    "Exponential",
    "FrictionLaw",
    "GapLaw",
    "HystereticLaw",
    "InterfaceLaw",
    "ModifiedLaw",
    "NormalLaw",
    "PowerLaw",
    "PowerStiffness",
    "Response",
    "RigidContact",
    "Sliders",
    "Sliding",
    "Softening",
    "SteadySliding",
    "StiffnessLaw",
    "Tabulated",
    "class_densities",
    "gaussian_asperities",
    "wlf_shift",
]

__dir__ = __all__.copy
