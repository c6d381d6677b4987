"""Laws of interfaces, bulk materials and links, used at every scale."""

from multiscale.laws.area import AreaLaw, ErrorFunctionArea
from multiscale.laws.asperities import Asperities, class_densities, gaussian_asperities
from multiscale.laws.asperity_law import AsperityLaw
from multiscale.laws.convex_decreasing import ConvexDecreasing
from multiscale.laws.damaged import Damaged
from multiscale.laws.exponential import Exponential
from multiscale.laws.interface_law import InterfaceLaw, NormalLaw, Response, Sliding
from multiscale.laws.power import PowerLaw
from multiscale.laws.rigid import RigidContact
from multiscale.laws.sliders import Sliders
from multiscale.laws.sliding_friction import BellFriction, Coulomb, DecayingFriction, FrictionLaw
from multiscale.laws.softening import Softening
from multiscale.laws.steady_sliding import SteadySliding
from multiscale.laws.stiffness import PowerStiffness, StiffnessLaw
from multiscale.laws.stretched import StretchedLaw
from multiscale.laws.tabulated import Tabulated
from multiscale.laws.temperature_shift import wlf_shift
from multiscale.laws.unloading import HystereticLaw, ShakenDownLaw

__all__ = [
    "AreaLaw",
    "Asperities",
    "AsperityLaw",
    "BellFriction",
    "ConvexDecreasing",
    "Coulomb",
    "Damaged",
    "DecayingFriction",
    "ErrorFunctionArea",
    "Exponential",
    "FrictionLaw",
    "HystereticLaw",
    "InterfaceLaw",
    "NormalLaw",
    "PowerLaw",
    "PowerStiffness",
    "Response",
    "RigidContact",
    "ShakenDownLaw",
    "Sliders",
    "Sliding",
    "Softening",
    "SteadySliding",
    "StiffnessLaw",
    "StretchedLaw",
    "Tabulated",
    "class_densities",
    "gaussian_asperities",
    "wlf_shift",
]

__dir__ = __all__.copy
