#!/usr/bin/env python3
"""Writes the matrices of the templates `frame` and `bridge`: `python3 host/templates/space_models.py` (needs NumPy).

Euler-Bernoulli beams in space with six degrees of freedom a node, masses at the nodes. Every group is a matrix of its own, and their sum is K. Both
structures are made up: dimensions and stiffnesses are those of ordinary buildings and bridges, of none in particular.
"""

from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
# Names of degrees of freedom as dofs.csv has them, in the order of the rows of a node.
DOFS = ["ux", "uy", "uz", "rx", "ry", "rz"]
E_CONCRETE, E_STEEL, POISSON = 32e9, 210e9, 0.2


class Model:
    """Nodes, and matrices by name over the rows of free nodes."""

    def __init__(self):
        self.nodes, self.rows, self.parts, self.mass = {}, {}, {}, {}
        self.lines, self.surfaces = [], []

    def node(self, name, place, fixed=False):
        self.nodes[name] = (np.array(place, float), fixed)
        if not fixed:
            self.rows[name] = 6 * len(self.rows)

    def add(self, part, names, matrix):
        """Adds an element's matrix over the six degrees of freedom of each of its nodes; those of fixed nodes are left out."""
        entries = self.parts.setdefault(part, {})
        at = [None if name not in self.rows else self.rows[name] + dof for name in names for dof in range(6)]
        for i, row in enumerate(at):
            for j, column in enumerate(at):
                if row is not None and column is not None and row >= column and matrix[i, j] != 0:
                    entries[row, column] = entries.get((row, column), 0.0) + matrix[i, j]

    def beam(self, part, a, b, e, area, i_strong, i_weak, j, up=(0, 0, 1), drawn=True):
        """A beam; it bends about the axis across `up` with `i_strong`."""
        along = self.nodes[b][0] - self.nodes[a][0]
        length = np.linalg.norm(along)
        x = along / length
        y = np.cross(up, x)
        y /= np.linalg.norm(y)
        turn = np.vstack([x, y, np.cross(x, y)])
        g = e / (2 * (1 + POISSON))
        k = np.zeros((12, 12))
        for (first, second), stiffness in {(0, 6): e * area / length, (3, 9): g * j / length}.items():
            k[np.ix_([first, second], [first, second])] += stiffness * np.array([[1, -1], [-1, 1]])
        # Deflection along z turns about -y, that along y about z.
        for inertia, dofs, sign in [(i_strong, [2, 4, 8, 10], -1), (i_weak, [1, 5, 7, 11], 1)]:
            l, s = length, sign
            bending = np.array([
                [12, 6 * l * s, -12, 6 * l * s],
                [6 * l * s, 4 * l * l, -6 * l * s, 2 * l * l],
                [-12, -6 * l * s, 12, -6 * l * s],
                [6 * l * s, 2 * l * l, -6 * l * s, 4 * l * l],
            ])
            k[np.ix_(dofs, dofs)] += e * inertia / l**3 * bending
        whole = np.kron(np.eye(4), turn)
        self.add(part, [a, b], whole.T @ k @ whole)
        if drawn:
            self.lines.append((a, b))

    def bearing(self, part, upper, lower, along_x, along_y, upwards):
        """Springs at the lower node (None is the ground below), which the upper one reaches by a rigid arm."""
        arm = np.zeros(3) if lower is None else self.nodes[lower][0] - self.nodes[upper][0]
        rx, ry, rz = arm
        reach = np.hstack([np.eye(3), np.array([[0, rz, -ry], [-rz, 0, rx], [ry, -rx, 0]])])
        move = reach if lower is None else np.hstack([-reach, np.eye(3), np.zeros((3, 3))])
        names = [upper] if lower is None else [upper, lower]
        self.add(part, names, move.T @ np.diag([along_x, along_y, upwards]) @ move)
        if lower is not None:
            self.lines.append((upper, lower))

    def load(self, name, mass):
        self.mass[name] = self.mass.get(name, 0.0) + mass

    def write(self, folder):
        size = 6 * len(self.rows)

        def matrix(file, entries):
            entries = {at: value for at, value in sorted(entries.items(), key=lambda item: item[0][::-1]) if abs(value) > 1e-3}
            text = f"%%MatrixMarket matrix coordinate real symmetric\n{size} {size} {len(entries)}\n"
            text += "".join(f"{row + 1} {column + 1} {value:.7g}\n" for (row, column), value in entries.items())
            (folder / file).write_text(text)

        for part, entries in self.parts.items():
            matrix(f"{part}.mtx", entries)
        translations = {(self.rows[name] + dof,) * 2: mass for name, mass in self.mass.items() for dof in range(3)}
        matrix("mass.mtx", translations)
        rows = ["row,node,dof,x_m,y_m,z_m"]
        for name, (place, fixed) in self.nodes.items():
            for dof, word in enumerate(DOFS):
                row = "" if fixed else self.rows[name] + dof + 1
                rows.append(f"{row},{name},{word}," + ",".join(f"{metres:g}" for metres in place))
        (folder / "dofs.csv").write_text("\n".join(rows) + "\n")
        (folder / "lines.csv").write_text("from,to\n" + "".join(f"{a},{b}\n" for a, b in self.lines))
        (folder / "surfaces.csv").write_text("a,b,c,d\n" + "".join(",".join(corners) + "\n" for corners in self.surfaces))


def frame():
    """Five storeys of 3.5 m, two bays of 6 m by one of 5 m: columns 45 x 45 cm, beams 30 x 50 cm, slabs that hold floors in form."""
    model = Model()
    plan = {"A": (0, 0), "B": (6, 0), "C": (12, 0), "D": (0, 5), "E": (6, 5), "F": (12, 5)}
    beams = ["AB", "BC", "DE", "EF", "AD", "BE", "CF"]
    for level in range(6):
        for letter, (x, y) in plan.items():
            model.node(f"{letter}{level}", (x, y, 3.5 * level), fixed=level == 0)
    side, width, height = 0.45, 0.30, 0.50
    for level in range(1, 6):
        part = f"storey{level}"
        for letter in plan:
            inertia = side**4 / 12
            model.beam(part, f"{letter}{level - 1}", f"{letter}{level}", E_CONCRETE, side**2, inertia, inertia, 0.14 * side**4, up=(1, 0, 0))
            # A slab with finishes and a part of the live load, 900 kg/m²; columns in the middle carry twice as much.
            model.load(f"{letter}{level}", 900 * 7.5 * (2 if letter in "BE" else 1) + 2500 * side**2 * 3.5)
        for a, b in beams:
            strong, weak = width * height**3 / 12, height * width**3 / 12
            model.beam(part, f"{a}{level}", f"{b}{level}", E_CONCRETE, width * height, strong, weak, 0.2 * width**3 * height)
        for corners in ["ABED", "BCFE"]:
            for a, b in (corners[0] + corners[2], corners[1] + corners[3]):
                # 15 cm of slab, as wide as a third of the bay.
                model.beam("floors", f"{a}{level}", f"{b}{level}", E_CONCRETE, 0.15 * 2.0, 1e-9, 1e-9, 1e-9, drawn=False)
            model.surfaces.append([f"{letter}{level}" for letter in corners])
    model.write(HERE / "frame")


def bridge():
    """Three spans of 24, 30 and 18 m: two girders with cross beams and a slab, on bearings at two abutments and two piers."""
    model = Model()
    supports, step, height = [0, 4, 9, 12], 6.0, 9.0
    last = supports[-1]
    for section in range(last + 1):
        for letter, y in [("L", 3.0), ("R", -3.0)]:
            model.node(f"{letter}{section}", (step * section, y, height))
            model.load(f"{letter}{section}", 4200 * step * (0.5 if section in (0, last) else 1.0))
    for section in range(last):
        span = sum(section >= support for support in supports)
        for letter in "LR":
            model.beam(f"span{span}", f"{letter}{section}", f"{letter}{section + 1}", E_STEEL, 0.09, 0.028, 0.004, 0.002)
        for a, b in [("L", "R"), ("R", "L")]:
            # The slab holds the girders together in plan.
            model.beam("deck", f"{a}{section}", f"{b}{section + 1}", E_CONCRETE, 0.25 * 1.5, 1e-9, 1e-9, 1e-9, drawn=False)
        model.surfaces.append([f"L{section}", f"L{section + 1}", f"R{section + 1}", f"R{section}"])
    for section in range(last + 1):
        model.beam("deck", f"L{section}", f"R{section}", E_CONCRETE, 1.2, 0.02, 0.3, 0.01)
    for number, section in enumerate(supports[1:-1], 1):
        x, top = step * section, height - 0.4
        for side, y in [("l", 3.0), ("m", 0.0), ("r", -3.0)]:
            model.node(f"P{number}{side}", (x, y, top))
            model.load(f"P{number}{side}", 15e3)
        model.node(f"P{number}foot", (x, 0.0, 0.0), fixed=True)
        # 1.2 m along the bridge, 2.4 m across it.
        model.beam("piers", f"P{number}foot", f"P{number}m", E_CONCRETE, 2.88, 2.4 * 1.2**3 / 12, 1.2 * 2.4**3 / 12, 0.9, up=(1, 0, 0))
        for side in "lr":
            model.beam("piers", f"P{number}m", f"P{number}{side}", E_CONCRETE, 1.8, 0.3, 0.2, 0.3)
    for name, section, along_x in [("west", 0, 4e6), ("pier1", 4, 1e9), ("pier2", 9, 4e6), ("east", 12, 4e6)]:
        for girder, side in [("L", "l"), ("R", "r")]:
            lower = f"P{name[-1]}{side}" if name.startswith("pier") else None
            model.bearing(f"bearing-{name}", f"{girder}{section}", lower, along_x, 2e8, 6e8)
    model.write(HERE / "bridge")


if __name__ == "__main__":
    for folder, make in [("frame", frame), ("bridge", bridge)]:
        (HERE / folder).mkdir(exist_ok=True)
        make()
