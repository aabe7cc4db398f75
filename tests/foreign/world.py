"""A three-dimensional structure as plain data, and what OpenSees says of it: static answers and modes.

A Body flows in, numbers flow out. Nothing here knows beams of a table, Belfry or its effects.
"""
import dataclasses

import numpy as np
import openseespy.opensees as ops

G_M_S2 = 9.81
# Stiff beside every member, soft enough for double precision: N/m and N m/rad.
STIFF = 1e13
# Degrees of freedom as OpenSees numbers them.
X, Y, Z, RX, RY, RZ = 1, 2, 3, 4, 5, 6


@dataclasses.dataclass
class Element:
    """A member or a shell facet. `bay` is the segment between two levels that it stands in, None where it lies in a level."""

    kind: str  # truss, column (upright beam), girder (lying beam), shell
    nodes: tuple
    family: str
    bay: int | None
    area_m2: float = 0.0
    inertia_m4: float = 0.0
    thickness_m: float = 0.0
    factor: float = 1.0


@dataclasses.dataclass
class Body:
    """A structure. Levels are heights at which the engineer's table has its nodes; level 0 is the base."""

    kind: str  # lattice, frame, tube
    name: str
    modulus_n_m2: float
    levels_m: list
    nodes: dict = dataclasses.field(default_factory=dict)
    level_nodes: list = dataclasses.field(default_factory=list)
    # Share of each node in its level's motion; what carries upright forces counts.
    weights: dict = dataclasses.field(default_factory=dict)
    masses_kg: dict = dataclasses.field(default_factory=dict)
    elements: list = dataclasses.field(default_factory=list)
    diaphragms: bool = False
    axis_m: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(2))
    # Base: dof -> spring of a rigid mat (N/m or N m/rad); None is clamped.
    mat: dict | None = None
    # Upright springs under base nodes in N/m.
    feet_n_m: dict = dataclasses.field(default_factory=dict)
    # Springs to ground: (node, dof, N/m).
    stays: list = dataclasses.field(default_factory=list)
    # Joints: (lower node, upper node, upright N/m).
    joints: list = dataclasses.field(default_factory=list)
    # Masses on a platform's middle, carried by spokes: (level, x_m, y_m, kg).
    tanks: list = dataclasses.field(default_factory=list)
    weight_acts: bool = False

    def node(self, x_m, y_m, z_m, level=None, weight=0.0):
        """Adds a node; with a level it moves with that level's section."""
        tag = len(self.nodes) + 1
        self.nodes[tag] = np.array([x_m, y_m, z_m], dtype=float)
        if level is not None:
            while len(self.level_nodes) <= level:
                self.level_nodes.append([])
            self.level_nodes[level].append(tag)
            self.weights[tag] = weight
        return tag

    def add_mass(self, tag, mass_kg):
        self.masses_kg[tag] = self.masses_kg.get(tag, 0.0) + mass_kg

    def mass_of_members(self, density_kg_m3, share_more=0.0):
        """Spreads every element's own mass over its nodes, with a share more for what is not modelled."""
        for element in self.elements:
            points = [self.nodes[tag] for tag in element.nodes]
            if element.kind == "shell":
                a, b, c, d = points
                volume_m3 = element.thickness_m * 0.5 * np.linalg.norm(np.cross(c - a, d - b))
            else:
                volume_m3 = element.area_m2 * np.linalg.norm(points[1] - points[0])
            for tag in element.nodes:
                self.add_mass(tag, density_kg_m3 * (1 + share_more) * volume_m3 / len(element.nodes))

    def total_mass_kg(self):
        return sum(self.masses_kg.values()) + sum(tank[3] for tank in self.tanks)

    def height_m(self):
        return self.levels_m[-1] - self.levels_m[0]

    def section(self, level):
        """Maps the motions of a level's nodes (3 each) to its rigid motion x, y, z, rx, ry, rz about the axis: 6 x 3n."""
        tags = self.level_nodes[level]
        rows = rigid_rows(np.array([self.nodes[tag] for tag in tags]), [*self.axis_m, self.levels_m[level]])
        weights = np.repeat([self.weights[tag] for tag in tags], 3)
        return np.linalg.solve(rows.T @ (weights[:, None] * rows), rows.T * weights)


def rigid_rows(points_m, origin_m):
    """Motions of points (3 each) from a rigid motion x, y, z, rx, ry, rz about an origin."""
    rows = np.zeros((3 * len(points_m), 6))
    for i, (x, y, z) in enumerate(np.asarray(points_m) - origin_m):
        rows[3 * i : 3 * i + 3] = [[1, 0, 0, 0, z, -y], [0, 1, 0, -z, 0, x], [0, 0, 1, y, -x, 0]]
    return rows


@dataclasses.dataclass
class Modes:
    """Modes of a body: frequencies, shapes at all nodes scaled to a modal mass of 1, and as rigid motion of the levels."""

    frequencies_hz: np.ndarray
    shapes: dict  # node -> 3 x modes
    sections: np.ndarray  # levels x 6 x modes
    seen: np.ndarray  # share of a mode's kinetic energy in rigid sideways motion and twist of the levels

    def lowest(self, count):
        """The lowest modes that the levels show."""
        return np.flatnonzero(self.seen > 0.5)[:count]


def build(body):
    """Puts a body into OpenSees."""
    ops.wipe()
    ops.model("basic", "-ndm", 3, "-ndf", 6)
    for tag, point in body.nodes.items():
        ops.node(tag, *map(float, point))
    extra = max(body.nodes) + 1
    has_shells = any(element.kind == "shell" for element in body.elements)
    poisson = 0.2 if has_shells else 0.3
    for tag, mass in body.masses_kg.items():
        ops.mass(tag, mass, mass, mass, 0.0, 0.0, 0.0)
    bend = "PDelta" if body.weight_acts else "Linear"
    ops.geomTransf(bend, 1, 1.0, 0.0, 0.0)
    # Rings and strips hold shells that widen under weight; the shells' own share of that balance is not in their stiffness, so neither is theirs.
    ops.geomTransf("Linear" if has_shells else bend, 2, 0.0, 0.0, 1.0)
    materials, sections = {}, {}
    for number, element in enumerate(body.elements, 1):
        e = body.modulus_n_m2 * element.factor
        if element.kind == "truss":
            if e not in materials:
                materials[e] = len(materials) + 1
                ops.uniaxialMaterial("Elastic", materials[e], e)
            ops.element("corotTruss" if body.weight_acts else "Truss", number, *element.nodes, element.area_m2, materials[e])
        elif element.kind == "shell":
            key = (e, element.thickness_m)
            if key not in sections:
                sections[key] = len(sections) + 1
                ops.section("ElasticMembranePlateSection", sections[key], e, poisson, element.thickness_m, 0.0)
            ops.element("ShellDKGQ", number, *element.nodes, sections[key])
        else:
            inertia = element.inertia_m4
            ops.element("elasticBeamColumn", number, *element.nodes, element.area_m2, e, e / (2 * (1 + poisson)),
                        1.7 * inertia, inertia, inertia, 1 if element.kind == "column" else 2)
    number, material = len(body.elements) + 1, len(materials) + 1
    if body.weight_acts:
        for (lower, upper), force_n in weight_on_edges(body).items():
            length_m = body.nodes[upper][2] - body.nodes[lower][2]
            ops.uniaxialMaterial("Elastic", material, -force_n / length_m)
            ops.element("zeroLength", number, lower, upper, "-mat", material, material, "-dir", X, Y)
            number += 1
            material += 1

    def spring(lower, upper, stiffness):
        """Springs between two nodes at one point: {dof: N/m}."""
        nonlocal number, material
        tags = []
        for value in stiffness.values():
            ops.uniaxialMaterial("Elastic", material, float(value))
            tags.append(material)
            material += 1
        ops.element("zeroLength", number, lower, upper, "-mat", *tags, "-dir", *stiffness)
        number += 1

    def grounded(tag, stiffness):
        nonlocal extra
        ops.node(extra, *map(float, ops.nodeCoord(tag)))
        ops.fix(extra, 1, 1, 1, 1, 1, 1)
        spring(extra, tag, stiffness)
        extra += 1

    base = body.level_nodes[0]
    if body.mat is not None:
        center = extra
        extra += 1
        ops.node(center, *map(float, body.axis_m), float(body.levels_m[0]))
        for tag in base:
            ops.rigidLink("beam", center, tag)
        grounded(center, body.mat)
        ops.fix(center, *(int(dof not in body.mat) for dof in (X, Y, Z, RX, RY, RZ)))
    else:
        for tag in base:
            if tag in body.feet_n_m:
                ops.fix(tag, 1, 1, 0, 1, 1, 1)
                grounded(tag, {Z: body.feet_n_m[tag]})
            else:
                ops.fix(tag, 1, 1, 1, 1, 1, 1)
    for tag, dof, stiffness in body.stays:
        grounded(tag, {dof: stiffness})
    for lower, upper, stiffness in body.joints:
        spring(lower, upper, {X: STIFF, Y: STIFF, Z: stiffness, RX: STIFF, RY: STIFF, RZ: STIFF})
    ties = {}
    for level, x, y, mass in body.tanks:
        ops.node(extra, float(x), float(y), float(body.levels_m[level]))
        ops.mass(extra, mass, mass, 0.0, 0.0, 0.0, 0.0)
        ops.fix(extra, 0, 0, 1, 1, 1, 0 if body.diaphragms else 1)
        if body.diaphragms:
            ties.setdefault(level, []).append(extra)
        else:
            ops.uniaxialMaterial("Elastic", material, 1e11)
            for tag in body.level_nodes[level]:
                ops.element("Truss", number, extra, tag, 0.02, material)
                number += 1
            material += 1
        extra += 1
    if body.diaphragms:
        for level in range(1, len(body.level_nodes)):
            ops.node(extra, *map(float, body.axis_m), float(body.levels_m[level]))
            ops.fix(extra, 0, 0, 1, 1, 1, 0)
            ops.rigidDiaphragm(3, extra, *body.level_nodes[level], *ties.get(level, []))
            extra += 1


def weight_on_edges(body):
    """Weight in N on each upright edge (lower node, upper node) of shells, from the masses that stand above it on its line.

    OpenSees' shells know weight only by von Karman's terms, the slopes out of their plane: a tube then leans half as much as its weight
    makes it, and more in one direction than in the other. Edges that lean like links have both.
    """
    edges = {edge for element in body.elements if element.kind == "shell"
             for edge in ((element.nodes[0], element.nodes[3]), (element.nodes[1], element.nodes[2]))}
    result, carried_n = {}, {}
    for lower, upper in sorted(edges, key=lambda edge: -body.nodes[edge[1]][2]):
        result[lower, upper] = carried_n.get(upper, 0.0) + G_M_S2 * body.masses_kg.get(upper, 0.0)
        carried_n[lower] = result[lower, upper]
    return result


def prepare(algorithm="Linear"):
    """Says how OpenSees is to solve; the modes need it as well."""
    ops.constraints("Transformation")
    # The nodes stand in order of height, which suits a profile; SuperLU corrupts memory here where weight acts (3.7.1.2).
    ops.numberer("Plain")
    ops.system("ProfileSPD")
    ops.test("RelativeNormDispIncr", 1e-6, 20, 0)
    ops.algorithm(algorithm)
    ops.integrator("LoadControl", 1.0)
    ops.analysis("Static", "-noWarnings")


def solve():
    """Solves for the loads that act."""
    if ops.analyze(1):
        raise RuntimeError("OpenSees finds no static answer")


def answers(body, loads):
    """Rigid motions of all levels under loads on the levels' sections (each levels x 6): levels x 6 x loads."""
    build(body)
    prepare()
    sections = [body.section(level) for level in range(len(body.level_nodes))]
    result = np.zeros((len(body.level_nodes), 6, len(loads)))
    for number, load in enumerate(loads):
        ops.reset()
        ops.timeSeries("Constant", number + 1)
        ops.pattern("Plain", number + 1, number + 1)
        for level in np.flatnonzero(np.any(load, axis=1)):
            forces = (load[level] @ sections[level]).reshape(-1, 3)
            for tag, force in zip(body.level_nodes[level], forces):
                ops.load(tag, *map(float, force), 0.0, 0.0, 0.0)
        solve()
        for level, tags in enumerate(body.level_nodes):
            result[level, :, number] = sections[level] @ np.concatenate([ops.nodeDisp(tag)[:3] for tag in tags])
        ops.remove("loadPattern", number + 1)
        ops.remove("timeSeries", number + 1)
    return result


def answers_at_top(body):
    """The six unit loads at the top."""
    loads = np.zeros((6, len(body.level_nodes), 6))
    loads[np.arange(6), -1, np.arange(6)] = 1.0
    return answers(body, loads)


def modes(body, count):
    """The lowest modes; where weight acts, about the state that it leads to."""
    build(body)
    prepare("Newton" if body.weight_acts else "Linear")
    if body.weight_acts:
        ops.timeSeries("Constant", 1)
        ops.pattern("Plain", 1, 1)
        for tag, mass in body.masses_kg.items():
            ops.load(tag, 0.0, 0.0, -G_M_S2 * mass, 0.0, 0.0, 0.0)
        solve()
    values = np.array(ops.eigen(count))
    if len(values) < count or not np.all(values > 0):
        raise RuntimeError("OpenSees finds no modes")
    shapes = {
        tag: np.array([ops.nodeEigenvector(tag, mode + 1)[:3] for mode in range(count)]).T for tag in body.nodes
    }
    energy = sum(mass * (shapes[tag] ** 2).sum(axis=0) for tag, mass in body.masses_kg.items())
    sections = np.array([
        body.section(level) @ np.concatenate([shapes[tag] for tag in tags])
        for level, tags in enumerate(body.level_nodes)
    ])
    seen = np.zeros(count)
    for level, tags in enumerate(body.level_nodes):
        mass = sum(body.masses_kg.get(tag, 0.0) for tag in tags)
        radius2 = sum(body.masses_kg.get(tag, 0.0) * ((body.nodes[tag][:2] - body.axis_m) ** 2).sum() for tag in tags)
        seen += mass * (sections[level, :2] ** 2).sum(axis=0) + radius2 * sections[level, 5] ** 2
        if level:
            for _, _, _, tank_kg in (tank for tank in body.tanks if tank[0] == level):
                energy += tank_kg * (sections[level, :2] ** 2).sum(axis=0)
    on_levels = {tag for tags in body.level_nodes for tag in tags}
    share = sum(m for tag, m in body.masses_kg.items() if tag in on_levels) / sum(body.masses_kg.values())
    scale = 1 / np.sqrt(energy)
    return Modes(
        frequencies_hz=np.sqrt(values) / (2 * np.pi),
        shapes={tag: shape * scale for tag, shape in shapes.items()},
        sections=sections * scale,
        seen=seen / (energy * share),
    )
