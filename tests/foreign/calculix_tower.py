"""A tall box of solid elements in CalculiX, as a study of Belfry: K and M, one group a slice, and the modes of a truth in which one slice is
softer and all differ a little. Needs ccx, numpy and scipy.

    python3 tests/foreign/calculix_tower.py FOLDER [WIDTH HEIGHT SLICES]

WIDTH elements along each side and HEIGHT upwards; 4 90 30 makes some 20 000 degrees of freedom.
"""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import scipy.sparse as sparse

SIZE_M = (1.0, 1.3, 2.0)
MODULUS, DENSITY = 3e10, 2500
HIDDEN, SOFTER = 2, 0.7
SENSOR_STEPS = 8


def nodes_of(width, height):
    side = width + 1
    return lambda i, j, k: (k * side + j) * side + i + 1


def text(width, height, slices, factors, step):
    node = nodes_of(width, height)
    lines = ["*NODE,NSET=ALL"]
    for k in range(height + 1):
        for j in range(width + 1):
            for i in range(width + 1):
                place = ",".join(f"{at * size:g}" for at, size in zip((i, j, k), SIZE_M))
                lines.append(f"{node(i, j, k)},{place}")
    element = 0
    for part in range(slices):
        lines.append(f"*ELEMENT,TYPE=C3D8I,ELSET=S{part}")
        for k in range(part * height // slices, (part + 1) * height // slices):
            for j in range(width):
                for i in range(width):
                    element += 1
                    corners = [(i + x, j + y, k + z) for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
                    lines.append(f"{element}," + ",".join(str(node(*corner)) for corner in corners))
    lines.append("*NSET,NSET=BASE")
    lines += [f"{node(i, j, 0)}," for j in range(width + 1) for i in range(width + 1)]
    lines.append("*BOUNDARY\nBASE,1,3")
    for part, factor in enumerate(factors):
        lines.append(f"*MATERIAL,NAME=M{part}\n*ELASTIC\n{MODULUS * factor:.9e},0.2\n*DENSITY\n{DENSITY}")
        lines.append(f"*SOLID SECTION,ELSET=S{part},MATERIAL=M{part}")
    return "\n".join(lines + ["*STEP", step, "*END STEP", ""])


def run(folder, name, content):
    (folder / f"{name}.inp").write_text(content)
    subprocess.run(["ccx", name], cwd=folder, check=True, stdout=subprocess.DEVNULL)


def matrix(path):
    entries = np.loadtxt(path)
    rows, columns = entries[:, 0].astype(int) - 1, entries[:, 1].astype(int) - 1
    size = max(rows.max(), columns.max()) + 1
    upper = sparse.coo_matrix((entries[:, 2], (rows, columns)), shape=(size, size)).tocsr()
    return upper + sparse.triu(upper, 1).T


def main():
    folder = Path(sys.argv[1])
    width, height, slices = (int(word) for word in sys.argv[2:5]) if len(sys.argv) > 2 else (4, 90, 30)
    folder.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(7)
    export = "*FREQUENCY,SOLVER=MATRIXSTORAGE\n2"
    run(folder, "model", text(width, height, slices, [1.0] * slices, export))
    stiffness, mass = matrix(folder / "model.sti"), matrix(folder / "model.mas")
    sparse.save_npz(folder / "k.npz", stiffness.tocsr())
    sparse.save_npz(folder / "m.npz", mass.tocsr())
    groups = []
    for part in range(slices):
        factors = [2.0 if other == part else 1.0 for other in range(slices)]
        run(folder, "twice", text(width, height, slices, factors, export))
        change = matrix(folder / "twice.sti") - stiffness
        change.data[np.abs(change.data) < 1e-9 * np.abs(stiffness.data).max()] = 0.0
        change.eliminate_zeros()
        sparse.save_npz(folder / f"slice{part}.npz", change.tocsr())
        groups.append(f"slice{part}")
    factors = 1 + 0.02 * random.standard_normal(slices)
    factors[HIDDEN] *= SOFTER
    node = nodes_of(width, height)
    heights = [round(height * step / SENSOR_STEPS) for step in range(1, SENSOR_STEPS + 1)]
    places = [(node(i, j, k), axis) for k in heights for i, j in ((0, 0), (width, width)) for axis in (1, 2)]
    wanted = "\n".join(f"{place}," for place in sorted({place for place, _ in places}))
    began = time.time()
    truth = text(width, height, slices, factors, "*FREQUENCY\n10\n*NODE PRINT,NSET=SEEN\nU")
    run(folder, "truth", truth.replace("*BOUNDARY", f"*NSET,NSET=SEEN\n{wanted}\n*BOUNDARY", 1))
    print(f"{stiffness.shape[0]} degrees of freedom, {slices} groups; ccx took {time.time() - began:.1f} s for 10 modes")
    frequencies, shapes = read_modes(folder / "truth.dat")
    write_study(folder, places, frequencies, shapes, groups, random)


def read_modes(path):
    frequencies, shapes, current = [], [], None
    for line in path.read_text().splitlines():
        words = line.split()
        if len(words) == 5 and words[0].isdigit() and not shapes:
            frequencies.append(float(words[3]))
        if "displacements" in line:
            current = {}
            shapes.append(current)
        elif current is not None and len(words) == 4 and words[0].isdigit():
            current[int(words[0])] = [float(word) for word in words[1:]]
    return frequencies, shapes


def write_study(folder, places, frequencies, shapes, groups, random):
    names = [f"{place}{'xyz'[axis - 1]}" for place, axis in places]
    lines = ["mode,frequency_hz,frequency_std_hz," + ",".join(f"{name},{name}_std" for name in names)]
    for mode, (hz, shape) in enumerate(zip(frequencies, shapes), 1):
        values = np.array([shape[place][axis - 1] for place, axis in places])
        if np.abs(values).max() == 0.0:
            continue
        values = values / values[np.abs(values).argmax()] + 0.01 * random.standard_normal(len(values))
        hz *= 1 + 5e-4 * random.standard_normal()
        lines.append(f"{mode},{hz:.6f},{5e-4 * hz:.6f}," + ",".join(f"{value:.5f},0.01" for value in values))
    (folder / "modes.csv").write_text("\n".join(lines) + "\n")
    study = ['[structure]\nname = "Box of solid elements"\n\n[measured]\nmodes = "modes.csv"\n']
    study += [f'[[sensor]]\nchannel = "{name}"\n' for name in names]
    study.append('[model.matrices]\nstiffness = "k.npz"\nmass = "m.npz"\ndofs = "model.dof"\n')
    study += [f'[[model.group]]\nname = "{name}"\nstiffness = "{name}.npz"\nstd = 0.03\n' for name in groups]
    (folder / "study.toml").write_text("\n".join(study))


main()
