"""The study that an engineer would hand over: the beam table of the sound body, and hours of wind as accelerometers record them.

Bodies and modes flow in; beam.csv, study.toml and recording.npy flow out. The table comes from unit loads on the sound body. The
recording is made in the frequency domain, line by line of its own Fourier series, so that it has no transient and no error of a
time step.
"""
import dataclasses

import numpy as np
import openseespy.opensees as ops

import world

HEADER = ("z_bottom_m,z_top_m,bending_1_n_m2,bending_2_n_m2,axis_deg,shear_1_n,shear_2_n,torsion_n_m2,mass_top_kg,"
          "inertia_x_kg_m2,inertia_y_kg_m2,inertia_z_kg_m2")
COLUMNS = HEADER.split(",")
FX, FY, MX, MY, MZ = 0, 1, 3, 4, 5
# Bending makes a lattice shear by more than this share of a bay's height: the engineer says so. Below that nobody looks.
NOTED = 0.2
# Frequency error in percent, among the lowest eight modes, above which the engineer calibrates the table.
TOLERATED_PERCENT = 3.0
STUDY = """[structure]
name = "{name}"

[[setup]]
name = "wind"
files = ["recording.npy"]
sampling_rate_hz = {rate_hz}
unit = "m/s2"

{sensors}{analysis}[model]
beam = "beam.csv"
background_stiffness = 0.03
background_mass = 0.01
{effect}"""
COUPLED_SHEAR = """
[[model.effect]]
kind = "coupled-shear"
distance = {:.3f}
"""
WALL_FRAME = """
[[model.effect]]
kind = "wall-frame"
share_x = {:.4f}
share_y = {:.4f}
"""
SENSOR = """[[setup.sensor]]
channel = "{channel}"
node = {node}
elevation_m = {elevation_m:.6f}
azimuth_deg = {azimuth_deg}
offset_m = [{x_m:.4f}, {y_m:.4f}]

"""


@dataclasses.dataclass
class Table:
    """A beam table, and what its engineer says beside it."""

    rows: list
    # Bending makes the structure shear: by so much per curvature.
    coupled_shear_m: float = 0.0
    # Frames beside a wall: the share of a moment at the top that they have taken from it at the base, along X and Y.
    frame_shares: tuple = (0.0, 0.0)

    def effects(self):
        """The same in study.toml."""
        shear = COUPLED_SHEAR.format(self.coupled_shear_m) if self.coupled_shear_m else ""
        return shear + (WALL_FRAME.format(*self.frame_shares) if any(self.frame_shares) else "")

    def apart(self, axis):
        """Bending stiffness of the wall alone along axis 1 or 2, segment by segment, and shear stiffness of the frames."""
        share, bending = self.frame_shares[axis - 1], np.array([row[f"bending_{axis}_n_m2"] for row in self.rows])
        length = np.array([row["z_top_m"] - row["z_bottom_m"] for row in self.rows])
        # Under a unit moment at the top.
        turn = np.concatenate([[0.0], np.cumsum(length / bending)])
        sway = np.concatenate([[0.0], np.cumsum(0.5 * length * (turn[1:] + turn[:-1]))])
        frames_n = share / sway[-1]
        return bending * (1 - frames_n * (sway[-1] - 0.5 * (sway[1:] + sway[:-1]))), frames_n


def twist_axis_m(body, answers):
    """Where forces bend without twisting: the mean over the levels, weighted by how far a torque turns them."""
    turns = answers[1:, 5, MZ]
    # A force at the present axis twists by rz; moved by y (x) it would not.
    y = answers[1:, 5, FX] / turns
    x = -answers[1:, 5, FY] / turns
    return body.axis_m + np.array([np.average(x, weights=turns), np.average(y, weights=turns)])


def table(body, answers):
    """Rows of a beam table: bending from moments at the top, shear from forces at the top, torsion from a torque."""
    levels = body.levels_m
    rows = []
    for bay in range(len(levels) - 1):
        length = levels[bay + 1] - levels[bay]
        below, above = answers[bay], answers[bay + 1]
        row = {"z_bottom_m": levels[bay], "z_top_m": levels[bay + 1], "axis_deg": 0.0}
        for axis, (force, moment, turn, sign) in enumerate([(FX, MY, 4, 1.0), (FY, MX, 3, -1.0)], 1):
            bending = length / (above[turn, moment] - below[turn, moment])
            # A unit force at the top and the moment there that leaves the segment's middle without one: what sways is shear,
            # but for the bending of a member held at both ends.
            arm = levels[-1] - 0.5 * (levels[bay] + levels[bay + 1])
            upper, lower = (
                (answer[:, force] - sign * arm * answer[:, moment])[[axis - 1, turn]] for answer in (above, below)
            )
            lean = 0.5 * sign * (upper[1] + lower[1])
            sheared = upper[0] - lower[0] - lean * length - length**3 / (12 * bending)
            row[f"bending_{axis}_n_m2"] = bending
            row[f"shear_{axis}_n"] = length / sheared
        row["torsion_n_m2"] = length / (above[5, MZ] - below[5, MZ])
        rows.append(row)
    for row, mass in zip(rows, lumped(body)[1:]):
        row |= dict(zip(COLUMNS[-4:], mass))
    worst = min(value for row in rows for key, value in row.items() if key[:4] in ("bend", "shea", "tors"))
    if worst <= 0:
        raise RuntimeError("a section of the beam has no stiffness")
    return rows


def coupled_shear_m(body, answers):
    """Shear of the segments under unit moments at the top, over their change of rotation: mean over the segments, along X and Y."""
    lengths = np.diff(body.levels_m)
    result = []
    for axis, (moment, turn, sign) in enumerate([(MY, 4, 1.0), (MX, 3, -1.0)]):
        sway, rotation = answers[:, axis, moment], sign * answers[:, turn, moment]
        sheared = np.diff(sway) - 0.5 * lengths * (rotation[1:] + rotation[:-1])
        result.append(-float(np.mean(sheared / np.diff(rotation))))
    return result


def beside_coupled_shear(rows, distance_m):
    """The same table for a beam that also shears where it bends: what sways under a force is then in part bending."""
    for row in rows:
        for axis in (1, 2):
            row[f"shear_{axis}_n"] = 1 / (1 / row[f"shear_{axis}_n"] - distance_m**2 / row[f"bending_{axis}_n_m2"])
    return rows


def patterns(rows, axis, unit):
    """Forces on the floors, spread as in the three lowest modes: floors x 3. `unit` is the sway of one floor by a force on another."""
    root = np.sqrt([row["mass_top_kg"] for row in rows])
    _, vectors = np.linalg.eigh(root[:, None] * unit * root)
    return root[:, None] * vectors[:, ::-1][:, :3]


def sways(body, axis, forces):
    """What such forces along axis 0 or 1 do to the body: floors x 3."""
    loads = np.zeros((forces.shape[1], len(body.levels_m), 6))
    loads[:, 1:, axis] = forces.T
    return world.answers(body, loads)[1:, axis]


def share_of_frames(body, rows, axis):
    """The share of frames (see Table) with which forces on the floors sway the table as the body; by golden section."""
    levels = np.array(body.levels_m)
    bending, shear = (np.array([row[f"{name}_{axis + 1}_{unit}"] for row in rows]) for name, unit in (("bending", "n_m2"), ("shear", "n")))
    forces = patterns(rows, axis, influence(levels, bending, shear).sum(axis=2))
    wanted = sways(body, axis, forces)
    length = np.diff(levels)

    def misfit(share):
        wall, frames_n = Table(rows, frame_shares=(share, share)).apart(axis + 1)
        flexibility = influence(levels, wall, shear).sum(axis=2)
        # Springs between successive floors, the lowest to the ground, beside what the wall is.
        between = np.eye(len(rows)) - np.eye(len(rows), k=-1)
        stiffness = np.linalg.inv(flexibility) + between.T @ np.diag(frames_n / length) @ between
        return (((np.linalg.solve(stiffness, forces) - wanted) / np.abs(wanted).max(axis=0)) ** 2).sum()

    low, high = 0.0, 0.6
    for _ in range(40):
        a, b = high - 0.618 * (high - low), low + 0.618 * (high - low)
        low, high = (low, b) if misfit(a) < misfit(b) else (a, high)
    return 0.5 * (low + high)


def calibrate(body, rows):
    """Corrects bending and shear so that forces on the floors, spread as in the lowest modes, deflect the beam as the body.

    Where walls and frames carry loads together, or legs taper, one pair of stiffnesses does not serve all loads. The
    correction is by least squares, smooth over the height, and small where it gains little.
    """
    levels = np.array(body.levels_m)
    length = np.diff(levels)
    for axis in (0, 1):
        bending, shear = f"bending_{axis + 1}_n_m2", f"shear_{axis + 1}_n"
        unit = influence(levels, [row[bending] for row in rows], [row[shear] for row in rows])
        forces = patterns(rows, axis, unit.sum(axis=2))
        wanted = sways(body, axis, forces)
        scale = np.abs(wanted).max(axis=0)
        matrix = np.einsum("ijk,jp->ipk", unit, forces) / scale[None, :, None]
        count = matrix.shape[2]
        segments = len(length)
        near = 0.02 * np.eye(count)
        smooth = np.zeros((count, count))
        for k in range(count):
            if (k + 1) % segments:
                smooth[k, [k, k + 1]] = -0.3, 0.3
        stacked = np.vstack([matrix.reshape(-1, count), near, smooth])
        target = np.concatenate([(wanted / scale).ravel(), 0.02 * np.ones(count), np.zeros(count)])
        factors = np.clip(np.linalg.lstsq(stacked, target, rcond=None)[0], 0.2, 5.0)
        for k, row in enumerate(rows):
            row[bending] /= factors[k]
            row[shear] /= factors[segments + k]
    return rows


def influence(levels, bending, shear):
    """Deflection at level i under a unit force at level j, segment by segment: by bending, then by shear."""
    segments = len(levels) - 1
    result = np.zeros((segments, segments, 2 * segments))
    for k in range(segments):
        low, length = levels[k], levels[k + 1] - levels[k]
        arm = np.clip(levels[1:] - low, 0.0, None)
        a, b = np.meshgrid(arm, arm)
        above = (a > 0) & (b > 0)
        bent = (a * b * length - (a + b) * length**2 / 2 + length**3 / 3) / bending[k]
        result[:, :, k] = np.where(above, bent, 0.0)
        result[:, :, segments + k] = np.where(above, length / shear[k], 0.0)
    return result


def lumped(body):
    """Mass, and inertia about X, Y and Z, of every level; a mass between two levels is shared by both."""
    result = np.zeros((len(body.levels_m), 4))
    for tag, mass in body.masses_kg.items():
        x, y = body.nodes[tag][:2] - body.axis_m
        place = np.interp(body.nodes[tag][2], body.levels_m, np.arange(len(body.levels_m)))
        low = min(int(place), len(body.levels_m) - 2)
        turning = body.weights.get(tag, 1.0) > 0
        inertia = mass * np.array([1.0, turning * y * y, turning * x * x, x * x + y * y])
        result[low] += (1 - (place - low)) * inertia
        result[low + 1] += (place - low) * inertia
    return result


def write_table(rows, path):
    text = lambda column, value: f"{value:.6f}" if column.startswith("z_") else f"{value:.8g}"
    lines = [HEADER] + [",".join(text(column, row[column]) for column in COLUMNS) for row in rows]
    path.write_text("\n".join(lines) + "\n")


def beam_modes(table, count):
    """Frequencies and shapes of a table, by OpenSees' own Timoshenko element: above each node where bending makes it shear, with springs
    beside it where there are frames."""
    rows, distance_m = table.rows, table.coupled_shear_m
    (bending_1, frames_1), (bending_2, frames_2) = table.apart(1), table.apart(2)
    ops.wipe()
    ops.model("basic", "-ndm", 3, "-ndf", 6)
    # Local axes of an upright member: z along X, y along -Y.
    ops.geomTransf("Linear", 1, 1.0, 0.0, 0.0)
    ops.node(1, 0.0, 0.0, rows[0]["z_bottom_m"])
    ops.fix(1, 1, 1, 1, 1, 1, 1)
    above = len(rows) + 1
    if distance_m:
        ops.node(1 + above, 0.0, 0.0, rows[0]["z_bottom_m"] + distance_m)
        ops.fix(1 + above, 1, 1, 1, 1, 1, 1)
    for tag, row in enumerate(rows, 2):
        ops.node(tag, 0.0, 0.0, row["z_top_m"])
        if distance_m:
            ops.node(tag + above, 0.0, 0.0, row["z_top_m"] + distance_m)
            ops.rigidLink("beam", tag, tag + above)
        ops.fix(tag, 0, 0, 1, 0, 0, 0)
        mass = row["mass_top_kg"]
        ops.mass(tag, mass, mass, 0.0, *(row[column] for column in COLUMNS[-3:]))
        ends = (tag - 1 + above, tag + above) if distance_m else (tag - 1, tag)
        ops.element("ElasticTimoshenkoBeam", tag, *ends, 1.0, 1.0, 1.0, row["torsion_n_m2"],
                    bending_1[tag - 2], bending_2[tag - 2], row["shear_2_n"], row["shear_1_n"], 1)
        for axis, frames_n in ((1, frames_1), (2, frames_2)):
            if frames_n:
                number = axis * above + tag
                ops.uniaxialMaterial("Elastic", number, frames_n / (row["z_top_m"] - row["z_bottom_m"]))
                ops.element("zeroLength", number, tag - 1, tag, "-mat", number, "-dir", axis)
    world.prepare()
    values = ops.eigen(count)
    shapes = np.zeros((len(rows) + 1, 6, count))
    for tag in range(1, len(rows) + 2):
        for mode in range(count):
            shapes[tag - 1, :, mode] = ops.nodeEigenvector(tag, mode + 1)
    return np.sqrt(np.array(values)) / (2 * np.pi), shapes


def pairs(table, sound, count):
    """Frequency error in percent and MAC of a table's modes against the body's lowest ones, paired by shape."""
    found_hz, shapes = beam_modes(table, count + 6)
    rows = table.rows
    radius_m = np.sqrt(rows[0]["inertia_z_kg_m2"] / rows[0]["mass_top_kg"])
    scaled = np.array([1.0, 1.0, radius_m])[None, :, None]
    found = (shapes[:, [0, 1, 5]] * scaled).reshape(-1, count + 6)
    wanted = (sound.sections[:, [0, 1, 5]] * scaled).reshape(-1, sound.sections.shape[2])
    result, free = [], list(range(count + 6))
    for mode in sound.lowest(count):
        macs = [mac(wanted[:, mode], found[:, i]) for i in free]
        best = int(np.argmax(macs))
        result.append((100 * (found_hz[free.pop(best)] / sound.frequencies_hz[mode] - 1), macs[best]))
    return np.array(result)


def errors_percent(table, sound, count):
    return pairs(table, sound, count)[:, 0]


def likeness(table, sound, count):
    return pairs(table, sound, count)[:, 1]


def mac(a, b):
    return (a @ b) ** 2 / ((a @ a) * (b @ b))


def beam_table(body, sound):
    """The table that the engineer ends with, and its frequency errors in percent."""
    answers = world.answers_at_top(body)
    result = Table(table(body, answers))
    if body.kind == "lattice":
        coupled_m = float(np.mean(coupled_shear_m(body, answers)))
        if abs(coupled_m) > NOTED * np.diff(body.levels_m).mean():
            result = Table(beside_coupled_shear(result.rows, coupled_m), coupled_shear_m=coupled_m)
    elif body.kind == "frame":
        result.frame_shares = share_of_frames(body, result.rows, 0), share_of_frames(body, result.rows, 1)
    errors = errors_percent(result, sound, 8)
    if np.abs(errors).max() > TOLERATED_PERCENT:
        result = Table(calibrate(body, table(body, answers)))
        errors = errors_percent(result, sound, 8)
    return result, errors


@dataclasses.dataclass
class Sensor:
    """A channel: its number in the file, its box, its level, the body's node that it sits on, its direction (0 is X, 1 is Y)."""

    channel: str
    node: int
    level: int
    tag: int
    direction: int


def sensors(body, random):
    """Two directions on six to eight levels, and on some a second one off the axis, parallel to one of the two."""
    count = len(body.levels_m) - 1
    levels = np.unique(np.round(np.linspace(1, count, int(random.integers(6, 9)))).astype(int))
    more = set(random.choice(levels[1:], size=min(4, len(levels) - 1), replace=False).tolist()) | {int(levels[-1])}
    result = []

    def put(node, level, tag, direction):
        result.append(Sensor(str(len(result) + 1), node, int(level), tag, direction))

    for node, level in enumerate(levels, 1):
        tags = body.level_nodes[level]
        plan = np.array([body.nodes[tag][:2] for tag in tags]) - body.axis_m
        corner = int(np.argmax(plan @ [1.0, 1.01]))
        far = int(np.argmax(plan @ [1.0, -1.01]))
        put(node, level, tags[corner], 0)
        put(node, level, tags[corner], 1)
        if int(level) in more:
            put(node, level, tags[far], 0)
    return result


def shapes(body, modes, placed, rigid):
    """Channels x modes: the motion of the sensors' nodes, or of their sections as rigid bodies."""
    if not rigid:
        return np.array([modes.shapes[sensor.tag][sensor.direction] for sensor in placed])
    rows = []
    for sensor in placed:
        x_m, y_m = body.nodes[sensor.tag][:2] - body.axis_m
        section = modes.sections[sensor.level]
        rows.append(section[sensor.direction] + (x_m if sensor.direction else -y_m) * section[5])
    return np.array(rows)


def wind(body, modes, frequencies_hz, random):
    """Spectral lines of the modal forces: gusts along X, Y and turning, colour -5/3, coherent over the height."""
    levels = np.array(body.levels_m)
    length = np.gradient(levels)
    width_m = np.array([np.ptp([body.nodes[tag][:2] for tag in tags], axis=0).max() for tags in body.level_nodes])
    height = (levels - levels[0]) / (levels[-1] - levels[0])
    sizes = width_m * length * np.maximum(height, 0.05) ** 0.2
    distance = np.abs(levels[:, None] - levels[None, :])
    decay = random.uniform(6.0, 10.0)
    speed_m_s = random.uniform(8.0, 16.0)
    corner_hz = speed_m_s / 100.0
    across, turning = random.uniform(0.6, 1.0), random.uniform(0.15, 0.3)
    parts = [(0, 1.0, sizes), (1, across, sizes), (5, turning, sizes * width_m)]
    count = len(modes.frequencies_hz)
    lines = np.empty((count, len(frequencies_hz)), dtype=np.complex64)
    edges = np.unique(np.searchsorted(frequencies_hz, np.geomspace(frequencies_hz[1], frequencies_hz[-1], 48)))
    edges = np.concatenate([[0], edges[1:-1], [len(frequencies_hz)]])
    generator = np.random.Generator(np.random.SFC64(random.integers(2**63)))
    for first, last in zip(edges[:-1], edges[1:]):
        middle_hz = frequencies_hz[(first + last) // 2]
        # Davenport's coherence; never quite whole, so that the factor below exists.
        coherence = np.exp(-decay * middle_hz * distance / speed_m_s) + 1e-6 * np.eye(len(levels))
        covariance = np.zeros((count, count))
        for dof, strength, size in parts:
            pushed = (modes.sections[:, dof] * size[:, None]).T
            covariance += strength**2 * pushed @ coherence @ pushed.T
        values, vectors = np.linalg.eigh(covariance)
        factor = (vectors * np.sqrt(np.maximum(values, 0.0))).astype(np.complex64)
        noise = generator.standard_normal((count, 2 * (last - first)), np.float32).view(np.complex64)
        lines[:, first:last] = factor @ noise
    return lines * ((1 + (frequencies_hz / corner_hz) ** 2) ** (-5 / 12)).astype(np.float32)


def transformable(rows):
    """The least number of at least so many rows that has no large prime factor."""
    tens = [2**a * 3**b * 5**c for a in range(1, 24) for b in range(5) for c in range(5)]
    return min(count for count in tens if count >= rows)


def record(body, modes, seen, hours, random):
    """Accelerations in m/s2 of channels that see the modes so, rows x channels; the sampling rate in Hz; the damping ratios."""
    lowest = modes.lowest(10)
    rate_hz = float(f"{8 * modes.frequencies_hz[lowest[-1]]:.3g}")
    rows = transformable(hours * 3600 * rate_hz)
    frequencies_hz = np.fft.rfftfreq(rows, 1 / rate_hz)
    damping = random.uniform(0.005, 0.015, len(modes.frequencies_hz))
    forces = wind(body, modes, frequencies_hz, random)
    for mode, (own_hz, ratio) in enumerate(zip(modes.frequencies_hz, damping)):
        share = (frequencies_hz / own_hz).astype(np.float32)
        forces[mode] *= share**2 / (1 - share**2 + np.complex64(2j * ratio) * share)
    lines = seen.astype(np.complex64) @ forces
    samples = np.array([np.fft.irfft(line, rows).astype(np.float32) for line in lines])
    rms = samples.std(axis=1)
    samples *= 0.02 / rms.max()
    noise = random.uniform(0.02, 0.05, len(seen)) * rms * (0.02 / rms.max())
    generator = np.random.Generator(np.random.SFC64(random.integers(2**63)))
    for row, strength in zip(samples, noise):
        row += generator.standard_normal(rows, np.float32) * np.float32(strength)
    return samples.T.copy(), rate_hz, damping


def spoil(samples, truth):
    """What a wrong channel does to the recording."""
    columns = [int(name) - 1 for name in truth.channels]
    if truth.kind == "sensor-gain":
        samples[:, columns[0]] *= truth.values["factor"][0]
    elif truth.kind == "sensor-polarity":
        samples[:, columns[0]] *= -1
    elif truth.kind == "sensor-swap":
        samples[:, columns] = samples[:, columns[::-1]]


def write_study(folder, body, placed, samples, rate_hz, band_hz, effects):
    """The study as an engineer would hand it over; beam.csv is written apart. Without a band Belfry chooses one."""
    entries = []
    for sensor in placed:
        x_m, y_m, z_m = body.nodes[sensor.tag] - [*body.axis_m, 0.0]
        entries.append(SENSOR.format(channel=sensor.channel, node=sensor.node, elevation_m=z_m,
                                     azimuth_deg=90 * sensor.direction, x_m=x_m, y_m=y_m))
    text = STUDY.format(name=body.name, rate_hz=rate_hz, sensors="".join(entries),
                        analysis=f"[analysis]\nband_hz = {band_hz}\n\n" if band_hz else "",
                        effect=effects)
    (folder / "study.toml").write_text(text)
    np.save(folder / "recording.npy", samples)
