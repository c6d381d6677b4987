"""Bodies in contact that several tests solve."""

from dataclasses import dataclass, replace

import numpy as np
from skfem import MeshHex, MeshQuad

from multiscale.laws.bulk import Elastic
from multiscale.laws.bulk.bulk_law import contact_modulus
from multiscale.macro import (
    Body,
    Contact,
    FiniteAssembly,
    RigidObstacle,
    RigidPlane,
    solve_contact,
)
from tests.closed_forms import hertz, mindlin
from tests.closed_forms.rings import NestedRings

STEEL = (210e9, 0.3)
FORCE, RADIUS, FRICTION = 100.0, 10e-3, 0.3  # N, m: two steel spheres of the validation plan
MODULUS = contact_modulus(STEEL, STEEL)
CONTACT_RADIUS = hertz.sphere_radius(FORCE, RADIUS, MODULUS)
APPROACH = hertz.sphere_approach(FORCE, RADIUS, MODULUS)
PEAK = 1.5 * FORCE / (np.pi * CONTACT_RADIUS**2)
LIMIT = FRICTION * FORCE
TANGENTIAL_MODULUS = mindlin.tangential_modulus(STEEL, STEEL)


@dataclass(frozen=True)
class RigidBall(RigidObstacle):
    """A ball of a centre and a radius, m; in two dimensions a disc."""

    centre: tuple[float, ...]
    radius: float
    motion: tuple[float, ...] = ()

    def distance(self, x):
        arm = x - np.asarray(self.centre)
        length = np.linalg.norm(arm, axis=1, keepdims=True)
        return length[:, 0] - self.radius, arm / length


def graded(first, uniform, length, ratio):
    """Coordinates from 0 to a length: equal steps first, then growing by a ratio."""
    steps = [first] * int(np.ceil(uniform / first - 1e-9))
    while sum(steps) < length:
        steps.append(steps[-1] * ratio)
    x = np.concatenate([[0.0], np.cumsum(steps)])
    return x / x[-1] * length


def near(value):
    return lambda x: np.isclose(x, value, atol=1e-12)


def block(kind, elements, low, high):
    """A box of any kind of element, its sides named."""
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, elements, strict=True)]
    d = len(low)
    names = {"bottom": (d - 1, low), "top": (d - 1, high), "left": (0, low), "right": (0, high)}
    if d == 3:
        names |= {"front": (1, low), "back": (1, high)}
    sides = {
        name: (lambda x, i=i, value=corner[i]: near(value)(x[i]))
        for name, (i, corner) in names.items()
    }
    return kind.init_tensor(*axes).with_boundaries(sides)


def moved(mesh, position):
    """The same mesh elsewhere; boundaries stay."""
    return replace(mesh, doflocs=np.ascontiguousarray(position))


def distorted(kind, seed=0):
    """A unit block with nodes moved at random."""
    d = kind().dim()
    mesh = block(kind, (3,) * d, (0.0,) * d, (1.0,) * d)
    noise = np.random.default_rng(seed).uniform(-0.07, 0.07, size=mesh.p.shape)
    return moved(mesh, mesh.p + noise)


def rotation_2d(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def fitted_ellipse(distance, pressure):
    """Peak and radius of p = p0 sqrt(1 - r^2/a^2), from the inner part of the contact."""
    inside = pressure > 0.3 * pressure.max()
    slope, peak = np.polyfit(distance[inside] ** 2, pressure[inside] ** 2, 1)
    return np.sqrt(peak), np.sqrt(-peak / slope)


def moment_radius(distance, traction, area):
    """Radius c of q ~ sqrt(c^2 - r^2) from its second moment, 2 c^2 / 5, not of one point."""
    return np.sqrt(2.5 * np.sum(area * traction * distance**2) / np.sum(area * traction))


def cylinder_on_block(size, *, swapped=False, **contact):
    """NAFEMS benchmark 1: half of an aluminium block under half of a steel cylinder."""
    radius, load, length = 50e-3, 17.5e6, 100e-3
    across = graded(size / radius * np.sqrt(2.0), 0.23, 1.0, 1.3)
    down = 1.0 - graded(size / radius, 0.17, 1.0, 1.3)[::-1]
    unit = MeshQuad.init_tensor(across, down).with_boundaries(
        {
            "contact": lambda x: near(1.0)(x[1]),
            "top": lambda x: near(0.0)(x[1]),
            "axis": lambda x: near(0.0)(x[0]),
        }
    )
    s, t = unit.p  # a square onto a quarter of a disc
    place = [radius * s * np.sqrt(1.0 - t**2 / 2.0), -radius * t * np.sqrt(1.0 - s**2 / 2.0)]
    x = graded(1.3 * size, 8e-3, length, 1.3)
    y = -radius - graded(size, 6e-3, 2.0 * length, 1.3)[::-1]
    below = MeshQuad.init_tensor(x, y).with_boundaries(
        {
            "contact": lambda x: near(-radius)(x[1]),
            "base": lambda x: near(-radius - 2.0 * length)(x[1]),
            "axis": lambda x: near(0.0)(x[0]),
        }
    )
    cylinder = Body(
        moved(unit, place),
        Elastic(210e9, 0.3),
        supports={"axis": (0.0, None)},
        tractions={"top": (0.0, -load / radius)},
    )
    base = Body(below, Elastic(70e9, 0.3), supports={"axis": (0.0, None), "base": (0.0, 0.0)})
    sides = (("cylinder", "contact"), ("block", "contact"))
    sides = sides[::-1] if swapped else sides
    problem = FiniteAssembly(
        {"cylinder": cylinder, "block": base}, {"joint": Contact(*sides, **contact)}
    )
    return solve_contact(problem)[-1].unwrap()


def far_field(component, side, modulus, force, motion):
    """Half-space under a normal and a tangential force at the origin, plus a rigid motion.

    Boussinesq's and Cerruti's solutions; side -1 is the body below, +1 the one above. ``force``
    and ``motion`` are functions of time that return the normal and the tangential part.
    """
    E, nu = modulus
    shear = E / (2.0 * (1.0 + nu))

    def displacement(x, time):
        z, r2 = np.abs(x[2]), x[0] ** 2 + x[1] ** 2
        rho = np.sqrt(r2 + z**2)
        normal, tangent = (value / (4.0 * np.pi * shear) for value in force(time))
        tangent = -side * tangent
        if component == 2:
            u = side * normal * (z**2 / rho**3 + 2.0 * (1.0 - nu) / rho)
            v = side * tangent * x[0] * (z / rho**3 + (1.0 - 2.0 * nu) / (rho * (rho + z)))
            return u + v - (motion(time)[0] if side > 0 else 0.0)
        u = normal * x[component] * (z / rho**3 - (1.0 - 2.0 * nu) / (rho * (rho + z)))
        direct = 1.0 / rho + (1.0 - 2.0 * nu) / (rho + z) if component == 0 else 0.0
        cross = 1.0 / rho**3 - (1.0 - 2.0 * nu) / (rho * (rho + z) ** 2)
        v = tangent * (direct + x[0] * x[component] * cross)
        return u + v + (motion(time)[1] if side > 0 and component == 0 else 0.0)

    return displacement


def ball_on_half_space(points):
    """A rigid ball on one quarter of a half-space with the contact modulus of two of steel.

    ``points`` elements on the radius of the contact; returns force, peak, radius and the step.
    """
    a, length = CONTACT_RADIUS, 12.0 * CONTACT_RADIUS
    material = (MODULUS * (1.0 - 0.3**2), 0.3)
    x = graded(a / points, 1.4 * a, length, 1.5)
    z = -graded(0.7 * a / points, a, length, 1.5)[::-1]
    core = 1.4 * a
    mesh = MeshHex.init_tensor(x, x, z).with_boundaries(
        {
            "contact": lambda x: near(0.0)(x[2]) & (x[0] < core) & (x[1] < core),
            "x": lambda x: near(0.0)(x[0]),
            "y": lambda x: near(0.0)(x[1]),
            "far": lambda x: np.any(np.isclose(np.abs(x), length), axis=0),
        }
    )
    far = [
        far_field(i, -1, material, lambda t: (t * FORCE, 0.0), lambda t: (0.0, 0.0))
        for i in range(3)
    ]
    supports = {"far": far, "x": (0.0, None, None), "y": (None, 0.0, None)}
    ball = RigidBall((0.0, 0.0, RADIUS), RADIUS, motion=(0.0, 0.0, -APPROACH))
    problem = FiniteAssembly(
        {"base": Body(mesh, Elastic(*material), supports)},
        {"ball": Contact(("base", "contact"), ball)},
    )
    step = solve_contact(problem)[-1].unwrap()
    surface = step.contact["ball"]
    peak, radius = fitted_ellipse(np.hypot(*surface.position[:2]), surface.pressure)
    return 4.0 * surface.force[2], peak, radius, step


def half_disc(cells, rings):
    """Quadrilaterals on half a disc: a square core, then rings of given radii."""
    m = cells
    x, y = np.meshgrid(np.linspace(-1, 1, 2 * m + 1), np.linspace(0, 1, m + 1), indexing="ij")
    size = np.maximum(np.abs(x), y)  # concentric map of the square onto the disc
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = np.where(
            np.abs(x) >= y,
            np.where(x >= 0, np.pi / 4 * y / np.abs(x), np.pi - np.pi / 4 * y / np.abs(x)),
            np.pi / 2 - np.pi / 4 * x / np.where(y > 0, y, 1.0),
        )
    angle = np.where(size > 0, angle, 0.0)
    points = [rings[0] * np.stack([size * np.cos(angle), size * np.sin(angle)], -1).reshape(-1, 2)]
    number = np.arange(x.size).reshape(x.shape)
    quads = [[number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]]]
    quads = [np.stack([q.ravel() for q in quads[0]])]
    last = np.concatenate([number[-1, :], number[-2::-1, -1], number[0, -2::-1]])
    theta = np.linspace(0.0, np.pi, 4 * m + 1)
    for radius in rings[1:]:
        new = sum(map(len, points)) + np.arange(4 * m + 1)
        points.append(radius * np.stack([np.cos(theta), np.sin(theta)], -1))
        quads.append(np.stack([last[:-1], new[:-1], new[1:], last[1:]]))
        last = new
    return np.concatenate(points), np.concatenate(quads, axis=1)


def extruded(points, quads, levels):
    """Hexahedra over a mesh of quadrilaterals."""
    n = len(points)
    place = np.concatenate([np.c_[points, np.full(n, z)] for z in levels]).T
    layers = [np.concatenate([quads + k * n, quads + (k + 1) * n]) for k in range(len(levels) - 1)]
    cells = np.concatenate(layers, axis=1)[[0, 4, 3, 1, 7, 5, 2, 6]]
    return MeshHex(np.ascontiguousarray(place), np.ascontiguousarray(cells))


def quarter(points, quads):
    """The part of half a disc with x > 0."""
    quads = quads[:, points[quads].mean(axis=0)[:, 0] > 0.0]
    used, number = np.unique(quads, return_inverse=True)
    points = np.where(np.abs(points) < 1e-12 * np.abs(points).max(), 0.0, points)
    return points[used], number.reshape(quads.shape)


def beyond(rings, length, ratio):
    """Rings with steps that grow by a ratio, from the last of some rings to a length."""
    outer, step = [rings[-1]], rings[-1] - rings[-2]
    while outer[-1] + 1.5 * ratio * step < length:
        step *= ratio
        outer.append(outer[-1] + step)
    return np.concatenate([rings, outer[1:], [length]])


def half_ball(cells, rings, layer, side):
    """Half of the elastic body below (-1) or above (+1) the contact, cut at y = 0.

    The upper body is curved for both, so that the normals of the lower body are vertical,
    as they are on the common surface of like balls once these are pressed together.
    """
    a, length = CONTACT_RADIUS, 8.0 * CONTACT_RADIUS
    radii = a * np.asarray(rings)
    points, quads = half_disc(cells, beyond(radii, length, 1.5))
    mesh = extruded(points, quads, -graded(layer * a, 3.0 * layer * a, length, 1.4)[::-1])
    mesh = mesh.with_boundaries(
        {
            "contact": lambda x: near(0.0)(x[2]) & (np.hypot(x[0], x[1]) < radii[-1]),
            "plane": lambda x: near(0.0)(x[1]),
            "far": lambda x: near(-length)(x[2]) | (np.hypot(x[0], x[1]) > 0.98 * length),
        }
    )
    place = mesh.p.copy()
    if side > 0:
        bulge = (place[0] ** 2 + place[1] ** 2) / (2.0 * RADIUS) * np.exp(place[2] / a)
        place[2] = bulge - place[2]
    return moved(mesh, place)


def two_steel_balls(path, *mesh):
    """Press two bodies together at time 1, then follow (time, tangential force, displacement)."""
    times, forces, motions = (
        np.array([0.0, *start, *(point[k] for point in path)])
        for k, start in enumerate([(1.0,), (0.0,), (0.0,)])
    )

    def force(time):
        return FORCE * min(time, 1.0), np.interp(time, times, forces)

    def motion(time):
        return APPROACH * min(time, 1.0), np.interp(time, times, motions)

    bodies = {}
    for name, side in (("below", -1), ("above", 1)):
        far = [far_field(i, side, STEEL, force, motion) for i in range(3)]
        supports = {"far": far, "plane": (None, 0.0, None)}
        bodies[name] = Body(half_ball(*mesh, side), Elastic(*STEEL), supports)
    contact = Contact(("below", "contact"), ("above", "contact"), FRICTION)
    steps = solve_contact(FiniteAssembly(bodies, {"joint": contact}), times[1:], condensed=True)
    return [step.unwrap() for step in steps]


def ball_on_rough_half_space(friction, rings, growth):
    """A rigid ball pressed with friction on a quarter of a half-space, in steps of the radius.

    The ball is so flat that the normals are vertical. The contact grows from a fifth of its
    radius by a factor in each step; returns distances over the last radius and the contact.
    """
    a, length, nu, start = 1e-3, 8e-3, 0.3, 0.2
    radius, material = 1e4 * a, (1e9, nu)
    radii = a * np.asarray(rings)
    mesh = extruded(
        *quarter(*half_disc(2, beyond(radii, length, 1.4))),
        -graded(0.02 * a, 0.06 * a, length, 1.4)[::-1],
    ).with_boundaries(
        {
            "contact": lambda x: near(0.0)(x[2]) & (np.hypot(x[0], x[1]) < radii[-1]),
            "x": lambda x: near(0.0)(x[0]),
            "y": lambda x: near(0.0)(x[1]),
            "far": lambda x: near(-length)(x[2]) | (np.hypot(x[0], x[1]) > 0.98 * length),
        }
    )
    n = int(np.ceil(np.log(1.0 / start) / np.log(growth)))

    def reached(time):
        return a * start ** (1.0 - time) if time > 0.0 else 0.0

    def force(time):
        return 4.0 * contact_modulus(material) * reached(time) ** 3 / (3.0 * radius), 0.0

    far = [far_field(i, -1, material, force, lambda t: (0.0, 0.0)) for i in range(3)]
    supports = {"far": far, "x": (0.0, None, None), "y": (None, 0.0, None)}
    sinks = (0.0, 0.0, lambda x, t: -(reached(t) ** 2) / radius)
    ball = RigidBall((0.0, 0.0, radius), radius, motion=sinks)
    problem = FiniteAssembly(
        {"base": Body(mesh, Elastic(*material), supports)},
        {"ball": Contact(("base", "contact"), ball, friction)},
    )
    times = np.r_[1e-9, np.arange(1, n + 1) / n]
    surface = solve_contact(problem, times, condensed=True)[-1].unwrap().contact["ball"]
    return np.hypot(*surface.position[:2]) / a, surface


def inclined_slider(friction, *, deformable, finite_sliding=False):
    """NAFEMS CGS-4: pressed by 2 mm on a slope of 0.1 until time 1, then pushed uphill."""
    mesh = block(MeshQuad, (8, 4), (0.0, 0.0), (2.0, 1.0))
    slider = moved(mesh, [mesh.p[0], mesh.p[1] + 0.1 * mesh.p[0]])
    drive = (lambda x, t: 0.02 * max(0.0, t - 1.0), lambda x, t: -2e-3 * min(t, 1.0))
    bodies = {"slider": Body(slider, Elastic(1e9, 0.3), supports={"top": drive})}
    side2 = RigidPlane((0.0, 0.0), (-0.1, 1.0))
    if deformable:
        ramp = block(MeshQuad, (13, 3), (-1.0, -1.0), (3.0, 0.0))
        ramp = moved(ramp, [ramp.p[0], ramp.p[1] + 0.1 * ramp.p[0] * (ramp.p[1] + 1.0)])
        bodies["ramp"] = Body(ramp, Elastic(1e9, 0.3), supports={"bottom": (0.0, 0.0)})
        side2 = ("ramp", "top")
    contact = Contact(("slider", "bottom"), side2, friction, finite_sliding)
    steps = solve_contact(FiniteAssembly(bodies, {"slope": contact}), (1.0, 1.5, 2.0))
    force = -steps[-1].unwrap().contact["slope"].force
    return -force[0] / force[1]


def quarter_ring(kind, radial, around, inner, outer):
    """A quarter of a ring."""
    unit = kind.init_tensor(
        np.linspace(inner, outer, radial + 1), np.linspace(0.0, np.pi / 2.0, around + 1)
    ).with_boundaries(
        {
            "inside": lambda x: near(inner)(x[0]),
            "outside": lambda x: near(outer)(x[0]),
            "x": lambda x: near(0.0)(x[1]),
            "y": lambda x: near(np.pi / 2.0)(x[1]),
        }
    )
    r, angle = unit.p
    return moved(unit, [r * np.cos(angle), r * np.sin(angle)])


RINGS = NestedRings((0.6, 0.8, 1.0), 1e9, 0.2, 1e7, 1e6)


def nested_rings(n, kind=MeshQuad):
    """Errors of pressure and displacement (relative, root of mean square) of two rings."""
    a, b, c = RINGS.radii
    meshes = {
        "inner": quarter_ring(kind, n, 4 * n, a, b),
        "outer": quarter_ring(kind, n, round(5.6 * n), b, c),
    }

    def push(component):
        def traction(x, time):
            pressure = RINGS.mean + RINGS.wave * np.cos(2.0 * np.arctan2(x[1], x[0]))
            return -time * pressure * x[component] / np.hypot(*x)

        return traction

    fixed = {"x": (None, 0.0), "y": (0.0, None)}
    bodies = {name: Body(mesh, Elastic(1e9, 0.2), fixed) for name, mesh in meshes.items()}
    bodies["outer"] = replace(bodies["outer"], tractions={"outside": (push(0), push(1))})
    contact = Contact(("outer", "inside"), ("inner", "outside"), fitted=True)
    step = solve_contact(FiniteAssembly(bodies, {"joint": contact}))[-1].unwrap()

    surface = step.contact["joint"]
    exact = RINGS.contact_pressure(np.arctan2(surface.position[1], surface.position[0]))
    wrong = np.sum(surface.area * (surface.pressure - exact) ** 2)
    error = np.sqrt(wrong / np.sum(surface.area * exact**2))
    motion = {name: RINGS.displacement(m.p, name == "outer") for name, m in meshes.items()}
    far = max(
        np.linalg.norm(step.displacement[name] - u) / np.linalg.norm(u)
        for name, u in motion.items()
    )
    return error, far
