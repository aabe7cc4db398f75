"""A plane frame of six storeys and two bays in OpenSees: the model's modes, runs with one group changed, and modes "measured" where the lower
columns have lost a quarter and all else differs a little. Needs openseespy; the tables beside it are what it writes.

    python3 frame.py
"""

import math
import random

import openseespy.opensees as ops

STOREYS, BAYS, MODES = 6, 2, 12
GROUPS = {"columns-low": 1.0, "columns-high": 1.0, "beams": 1.0, "foundation": 1.0}


def build(factor):
    ops.wipe()
    ops.model("basic", "-ndm", 2, "-ndf", 3)
    node = lambda i, k: 100 * k + i
    for k in range(STOREYS + 1):
        for i in range(BAYS + 1):
            ops.node(node(i, k), 6.0 * i, 3.5 * k, "-mass", *((30e3, 30e3, 0.0) if k else (0.0, 0.0, 0.0)))
    ops.uniaxialMaterial("Elastic", 1, 4e8 * factor["foundation"])
    for i in range(BAYS + 1):
        ops.node(9000 + i, 6.0 * i, 0.0)
        ops.fix(9000 + i, 1, 1, 1)
        ops.equalDOF(9000 + i, node(i, 0), 1, 2)
        ops.element("zeroLength", 9000 + i, 9000 + i, node(i, 0), "-mat", 1, "-dir", 6)
    ops.geomTransf("Linear", 1)
    tag = 1
    for k in range(STOREYS):
        group = "columns-low" if k < 3 else "columns-high"
        for i in range(BAYS + 1):
            ops.element("elasticBeamColumn", tag, node(i, k), node(i, k + 1), 0.16, 3e10 * factor[group], 2.1e-3, 1)
            tag += 1
    for k in range(1, STOREYS + 1):
        for i in range(BAYS):
            ops.element("elasticBeamColumn", tag, node(i, k), node(i + 1, k), 0.15, 3e10 * factor["beams"], 3.1e-3, 1)
            tag += 1
    return [(node(i, k), d) for k in range(1, STOREYS + 1) for i in (0, BAYS) for d in (1, 2) if d == 1 or k in (3, 6)]


def write(name, factor):
    places = build({**GROUPS, **factor})
    lambdas = ops.eigen("-fullGenLapack", MODES)
    with open(name, "w") as file:
        file.write("frequency_hz," + ",".join(f"{node}{'xyz'[d - 1]}" for node, d in places) + "\n")
        for mode, value in enumerate(lambdas, 1):
            shape = [ops.nodeEigenvector(node, mode, d) for node, d in places]
            file.write(f"{math.sqrt(value) / (2 * math.pi):.9g}," + ",".join(f"{x:.7e}" for x in shape) + "\n")


write("base.csv", {})
for group in GROUPS:
    write(f"{group}.csv", {group: 1.1})
    write(f"{group}-0.8.csv", {group: 0.8})


def measured(name, factor, seed):
    """Modes as a measurement would have them: 0.05 % of a frequency, 1 % of a shape."""
    random.seed(seed)
    build({**GROUPS, **factor})
    lambdas = ops.eigen("-fullGenLapack", MODES)
    places = [100 * k for k in range(1, STOREYS + 1)]
    with open(name, "w") as file:
        file.write("mode,frequency_hz,frequency_std_hz," + ",".join(f"{p}x,{p}x_std" for p in places) + "\n")
        for mode in range(1, 7):
            hz = math.sqrt(lambdas[mode - 1]) / (2 * math.pi)
            shape = [ops.nodeEigenvector(p, mode, 1) for p in places]
            largest = max(shape, key=abs)
            values = [x / largest + random.gauss(0, 0.01) for x in shape]
            file.write(f"{mode},{hz * random.gauss(1, 5e-4):.5f},{hz * 5e-4:.5f}," + ",".join(f"{x:.4f},0.01" for x in values) + "\n")


measured("modes.csv", {"columns-low": 0.75, "columns-high": 0.98, "beams": 1.03, "foundation": 1.05}, 20261129)
