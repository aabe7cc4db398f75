"""A concrete frame of some 2300 degrees of freedom in OpenSees, as a study of Belfry: K and M, one group a storey and one for the core's walls, and the
modes of a truth in which one group is softer and all differ a little. It makes its own virtual environment in target/foreign-models.

    python3 tests/foreign/opensees_frame.py FOLDER

K and M come out of OpenSees by the integrator GimmeMCK, so any model that OpenSees can build is exported in the same way.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import environment

environment.enter(
    Path(__file__).resolve().parents[2] / "target/foreign-models", ["openseespy==3.7.1.2", "numpy==2.4.6", "scipy==1.17.1"]
)

import numpy as np
import openseespy.opensees as ops
import scipy.sparse as sparse

BAYS, STOREYS, BAY_M, STOREY_M = (7, 3), 12, 6.0, 3.4
MODULUS, POISSON = 32e9, 0.2
COLUMN_M, BEAM_M = (0.5, 0.5), (0.3, 0.55)
FLOOR_KG_M2 = 850.0
HIDDEN, SOFTER = "storey5", 0.75
DOFS = ["ux", "uy", "uz", "rx", "ry", "rz"]
MODES = 12


def node(i, j, level):
    return 1 + (level * (BAYS[1] + 1) + j) * (BAYS[0] + 1) + i


def build(factors):
    """The frame with the moduli of its groups times these factors."""
    ops.wipe()
    ops.model("basic", "-ndm", 3, "-ndf", 6)
    columns = [(i, j) for j in range(BAYS[1] + 1) for i in range(BAYS[0] + 1)]
    for level in range(STOREYS + 1):
        for i, j in columns:
            ops.node(node(i, j, level), BAY_M * i, BAY_M * j, STOREY_M * level)
            if level == 0:
                ops.fix(node(i, j, level), 1, 1, 1, 1, 1, 1)
    for number, axis in enumerate([(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)], 1):
        ops.geomTransf("Linear", number, *axis)
    shear = MODULUS / (2 * (1 + POISSON))
    tag = 0

    def beam(a, b, size, modulus, transf):
        nonlocal tag
        tag += 1
        width, height = size
        j = 0.2 * min(size) ** 3 * max(size)
        about = (height * width**3 / 12, width * height**3 / 12)
        ops.element("elasticBeamColumn", tag, a, b, width * height, modulus, shear * modulus / MODULUS, j, *about, transf)

    for level in range(1, STOREYS + 1):
        modulus = MODULUS * factors.get(f"storey{level}", 1.0)
        for i, j in columns:
            beam(node(i, j, level - 1), node(i, j, level), COLUMN_M, modulus, 1)
            area = BAY_M**2 * (0.5 if i in (0, BAYS[0]) else 1.0) * (0.5 if j in (0, BAYS[1]) else 1.0)
            mass = FLOOR_KG_M2 * area
            ops.mass(node(i, j, level), mass, mass, mass, 0.0, 0.0, 0.0)
            if i < BAYS[0]:
                beam(node(i, j, level), node(i + 1, j, level), BEAM_M, modulus, 2)
            if j < BAYS[1]:
                beam(node(i, j, level), node(i, j + 1, level), BEAM_M, modulus, 2)
        ops.uniaxialMaterial("Elastic", level, MODULUS)
        for j in range(BAYS[1]):
            for i in range(BAYS[0]):
                # Slabs hold floors in form.
                for a, b in [((i, j), (i + 1, j + 1)), ((i + 1, j), (i, j + 1))]:
                    tag += 1
                    ops.element("Truss", tag, node(*a, level), node(*b, level), 0.15 * BAY_M / 3, level)
    ops.uniaxialMaterial("Elastic", STOREYS + 1, MODULUS * factors.get("core", 1.0))
    # A core: one bay of the frame is braced along both directions over the whole height, as walls would do.
    middle = BAYS[0] // 2
    for level in range(STOREYS):
        for a, b in [((middle, 1), (middle + 1, 1)), ((middle, 2), (middle + 1, 2)), ((middle, 1), (middle, 2))]:
            for lower, upper in [(a, b), (b, a)]:
                tag += 1
                ops.element("Truss", tag, node(*lower, level), node(*upper, level + 1), 0.05, STOREYS + 1)


def matrix(mass, stiffness):
    """K or M as OpenSees assembles it: one step of an integrator that multiplies M, C and K with these factors. M alone has no solution, which OpenSees
    says; nothing is made of it."""
    ops.wipeAnalysis()
    ops.constraints("Plain")
    ops.numberer("RCM")
    ops.system("FullGeneral")
    ops.test("NormUnbalance", 1.0, 1)
    ops.algorithm("Linear")
    ops.integrator("GimmeMCK", mass, 0.0, stiffness)
    ops.analysis("Transient")
    ops.analyze(1, 0.0)
    size = ops.systemSize()
    full = np.array(ops.printA("-ret"), dtype=float).reshape(size, size)
    return sparse.csr_matrix(0.5 * (full + full.T))


def main():
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(11)
    groups = [f"storey{level}" for level in range(1, STOREYS + 1)] + ["core"]
    build({})
    stiffness = matrix(0.0, 1.0)
    mass = matrix(1.0, 0.0)
    places = {tag: ops.nodeCoord(tag) for tag in ops.getNodeTags()}
    rows = {tag: ops.nodeDOFs(tag) for tag in places}
    mass.data[np.abs(mass.data) < 1e-9] = 0.0
    mass.eliminate_zeros()
    sparse.save_npz(folder / "k.npz", stiffness)
    sparse.save_npz(folder / "m.npz", mass)
    for group in groups:
        build({group: 2.0})
        change = matrix(0.0, 1.0) - stiffness
        change.data[np.abs(change.data) < 1e-9 * np.abs(stiffness.data).max()] = 0.0
        change.eliminate_zeros()
        sparse.save_npz(folder / f"{group}.npz", change.tocsr())
    lines = ["row,node,dof,x_m,y_m,z_m"]
    for tag, place in places.items():
        for dof, word in enumerate(DOFS):
            row = rows[tag][dof]
            lines.append(f"{row + 1 if row >= 0 else ''},{tag},{word}," + ",".join(f"{metres:g}" for metres in place))
    (folder / "dofs.csv").write_text("\n".join(lines) + "\n")
    pairs = []
    for level in range(STOREYS + 1):
        for j in range(BAYS[1] + 1):
            for i in range(BAYS[0] + 1):
                pairs += [(node(i, j, level - 1), node(i, j, level))] if level else []
                pairs += [(node(i, j, level), node(i + 1, j, level))] if level and i < BAYS[0] else []
                pairs += [(node(i, j, level), node(i, j + 1, level))] if level and j < BAYS[1] else []
    (folder / "lines.csv").write_text("from,to\n" + "".join(f"{a},{b}\n" for a, b in pairs))

    truth = {group: 1 + 0.02 * random.standard_normal() for group in groups}
    truth[HIDDEN] *= SOFTER
    build(truth)
    values = ops.eigen("-genBandArpack", MODES)
    corners = [(0, 0), (BAYS[0], BAYS[1])]
    channels = [(node(i, j, level), dof) for level in range(1, STOREYS + 1) for i, j in corners for dof in (1, 2)]
    names = [f"{tag}{'xyz'[dof - 1]}" for tag, dof in channels]
    table = ["mode,frequency_hz,frequency_std_hz," + ",".join(f"{name},{name}_std" for name in names)]
    for mode, value in enumerate(values, 1):
        shape = np.array([ops.nodeEigenvector(tag, mode, dof) for tag, dof in channels])
        shape = shape / shape[np.abs(shape).argmax()] + 0.01 * random.standard_normal(len(shape))
        hz = np.sqrt(value) / (2 * np.pi) * (1 + 5e-4 * random.standard_normal())
        table.append(f"{mode},{hz:.6f},{5e-4 * hz:.6f}," + ",".join(f"{part:.5f},0.01" for part in shape))
    (folder / "modes.csv").write_text("\n".join(table) + "\n")
    study = ['[structure]\nname = "Concrete frame of OpenSees"\n\n[measured]\nmodes = "modes.csv"\n']
    study += [f'[[sensor]]\nchannel = "{name}"\n' for name in names]
    study.append('[model]\nlines = "lines.csv"\n')
    study.append('[model.matrices]\nstiffness = "k.npz"\nmass = "m.npz"\ndofs = "dofs.csv"\n')
    for level, group in enumerate(groups, 1):
        height = f"z_m = [{STOREY_M * (level - 1):g}, {STOREY_M * level:g}]\n" if group != "core" else f"z_m = [0.0, {STOREY_M * STOREYS:g}]\n"
        study.append(f'[[model.group]]\nname = "{group}"\nstiffness = "{group}.npz"\nstd = 0.03\n{height}')
    (folder / "study.toml").write_text("\n".join(study))
    print(f"{stiffness.shape[0]} degrees of freedom, {len(groups)} groups")
    print("truth: " + ", ".join(f"{group} {100 * (factor - 1):+.1f} %" for group, factor in truth.items()))


main()
