"""What is hidden in a structure, as physics of the three-dimensional body: members cut, tanks, springs, weight, channels.

A sound Body flows in; a Truth and a changed Body flow out. Sizes are drawn so that some frequency moves by 1.5 to 10 percent.
"""
import copy
import dataclasses
import math

import numpy as np

import structures
import study
import world
from world import RX, RY, RZ, STIFF, X, Y, Z

EFFECTS = ["stiffness-loss", "added-mass", "base-rotation", "base-translation", "p-delta", "stiffness-scale",
           "mass-eccentricity", "connection-flexibility", "base-torsion", "lateral-support"]
# Effects that only one kind of structure can have.
OWN_EFFECTS = {"lattice": ["coupled-shear", "one-leg-springs"], "frame": ["wall-frame"]}
# Those that are in the body from the start, and that the engineer forgets to state.
FORGOTTEN = ["coupled-shear", "wall-frame"]
CHANNELS = ["sensor-gain", "sensor-polarity", "sensor-swap"]
OUTSIDERS = {
    "lattice": ["one-direction-loss"],
    "frame": ["one-direction-loss"],
    "tube": ["one-direction-loss"],
}
SHIFT = 0.015, 0.10
MODES = 26
COMPARED = 10


@dataclasses.dataclass
class Truth:
    """What a case hides. Values are intervals, as physics may have one value along X and another along Y."""

    category: str  # sound, effect, channel, outsider
    kind: str
    detail: str = ""
    place_m: float | None = None
    channels: tuple = ()
    values: dict = dataclasses.field(default_factory=dict)
    shift_percent: float = 0.0


def shift(sound, changed):
    """Largest relative change among the lowest frequencies, modes paired by shape."""
    moved = lambda modes: modes.sections[:, [0, 1, 5]].reshape(-1, len(modes.frequencies_hz))
    before, after = moved(sound), moved(changed)
    likeness = (before.T @ after) ** 2 / np.outer((before**2).sum(axis=0), (after**2).sum(axis=0))
    largest = 0.0
    for mode in sound.lowest(COMPARED):
        near = np.abs(changed.frequencies_hz / sound.frequencies_hz[mode] - 1) < 0.35
        best = int(np.argmax(np.where(near, likeness[mode], -1.0)))
        if near[best] and likeness[mode, best] > 0.5:
            largest = max(largest, abs(changed.frequencies_hz[best] / sound.frequencies_hz[mode] - 1))
    return largest


def sized(body, sound, change, guess, limit, random):
    """Finds a size whose shift is near one that is drawn; the size, the changed body, its modes and the shift."""
    wanted = math.exp(random.uniform(math.log(SHIFT[0]), math.log(SHIFT[1])))
    size = guess
    for _ in range(6):
        changed = copy.deepcopy(body)
        change(changed, size)
        modes = world.modes(changed, MODES)
        reached = shift(sound, modes)
        if abs(math.log(max(reached, 1e-9) / wanted)) < 0.15 or (size >= limit and reached < wanted):
            break
        size = min(size * float(np.clip(wanted / max(reached, 1e-6), 0.05, 20.0)), limit)
    if not 0.01 <= reached <= 0.11:
        raise ValueError(f"the size {size:.3g} moves frequencies by {100 * reached:.2f} %")
    return size, changed, modes, reached


def scale(body, bays, families, factor):
    """Multiplies the stiffness of the members in some bays; families None are all."""
    for element in body.elements:
        if element.bay in bays and (families is None or element.family in families):
            element.factor *= factor


def levers(body, level):
    """Sums of y² and x² of a level's springy nodes about their middle: what upright springs resist turning about X and Y by."""
    plan = np.array([body.nodes[tag][:2] for tag in body.level_nodes[level]])
    plan = plan - plan.mean(axis=0)
    return (plan[:, 1] ** 2).sum(), (plan[:, 0] ** 2).sum()


def turning(body, level, spring_n_m):
    """Flexibilities about X and Y of upright springs under all nodes of a level, as the values of an effect."""
    x, y = (1 / (spring_n_m * lever) for lever in levers(body, level))
    return {"flexibility": (min(x, y), max(x, y)), "flexibility_x": (x, x), "flexibility_y": (y, y)}


def turning_over(body, leg, spring_n_m):
    """The same of one upright spring under a leg: it shortens by its share of the moment, and the base turns about a diagonal."""
    x, y = np.array(body.nodes[leg][:2]) - np.mean([body.nodes[tag][:2] for tag in body.level_nodes[0]], axis=0)
    about_y_lever, about_x_lever = x / levers(body, 0)[1], y / levers(body, 0)[0]
    along_x, along_y = about_x_lever**2 / spring_n_m, about_y_lever**2 / spring_n_m
    diagonal = -2 * about_x_lever * about_y_lever / spring_n_m
    return {"flexibility_x": (0, along_x), "flexibility_y": (0, along_y), "flexibility_diagonal": (diagonal, diagonal)}


def stiffness_of(body, sound):
    """A stiffness in N/m to begin sizes with: that of the first mode."""
    return body.total_mass_kg() * (2 * math.pi * sound.frequencies_hz[0]) ** 2


def split(body, level, spring_n_m):
    """Puts upright springs between what stands below and what stands above a level."""
    doubles = {}
    above = [element for element in body.elements if element.bay == level]
    ends = {tag for element in above for tag in element.nodes} & set(body.level_nodes[level])
    for tag in sorted(ends):
        doubles[tag] = body.node(*body.nodes[tag])
        body.joints.append((tag, doubles[tag], spring_n_m))
        body.masses_kg[doubles[tag]] = 0.5 * body.masses_kg[tag]
        body.masses_kg[tag] *= 0.5
    for element in above:
        element.nodes = tuple(doubles.get(tag, tag) for tag in element.nodes)


def turned(body, changed, bay):
    """What a change does to the rotation of the top under a unit moment there, about X, Y and Z, over what the sound bay does to it."""
    before, after = (world.answers_at_top(one)[:, 3:, 3:] for one in (body, changed))
    return [(after - before)[-1, axis, axis] / (before[bay + 1] - before[bay])[axis, axis] for axis in range(3)]


def hide_effect(kind, body, sound, table, random):
    """Puts an effect of the catalogue into a body, whose table says what unit loads find: the truth, the changed body and its modes."""
    height_m, levels = body.height_m(), body.levels_m
    count = len(levels) - 1
    stiff = stiffness_of(body, sound)
    truth = Truth("effect", kind)
    if kind == "stiffness-loss":
        bay = int(random.integers(0, count * 3 // 4))
        families = None
        truth.place_m = 0.5 * (levels[bay] + levels[bay + 1])
        truth.detail = f"all members of bay {bay + 1}"
        if body.kind == "lattice" and random.random() < 0.5:
            families = ("brace_x", "brace_y")
            truth.detail = f"bracing of bay {bay + 1}"
        result = sized(body, sound, lambda b, size: scale(b, {bay}, families, 1 - size), 0.4, 0.85, random)
        if families is None:
            # What is lost of a bay's members, or of the bay as unit loads find it: its neighbours hold a short one.
            found = [more / (1 + more) for more in turned(body, result[1], bay)] + [result[0]]
            truth.values = {"relative": (min(found), max(found))}
    elif kind == "added-mass":
        level = int(random.integers(count // 3, count + 1))
        truth.place_m = levels[level]
        ring = random.random() < 0.3
        tags = [tag for tag in body.level_nodes[level] if body.masses_kg.get(tag, 0.0) > 0]
        x, y = body.axis_m + (random.uniform(-0.5, 0.5, 2) if body.diaphragms else 0.0)
        truth.detail = "a ring of machines on all nodes of the level" if ring else "a tank on the level's middle"

        def load(b, size):
            if ring:
                for tag in tags:
                    b.add_mass(tag, size / len(tags))
            else:
                b.tanks.append((level, x, y, size))

        result = sized(body, sound, load, 0.05 * body.total_mass_kg(), 0.5 * body.total_mass_kg(), random)
        truth.values = {"mass": (result[0], result[0])}
    elif kind == "one-leg-springs":
        truth.kind, truth.detail = "base-rotation", "springs under one leg"
        leg = int(random.choice(body.level_nodes[0]))
        foot = 40 * stiff * (height_m / 2) ** 2 / levers(body, 0)[0]
        result = sized(body, sound, lambda b, size: b.feet_n_m.update({leg: foot / size}), 1.0, 1e4, random)
        truth.values = turning_over(body, leg, foot / result[0])
    elif kind == "base-rotation":
        if body.kind == "lattice":
            truth.detail = "springs under the legs"
            foot = 40 * stiff * (height_m / 2) ** 2 / levers(body, 0)[0]

            def soften(b, size):
                b.feet_n_m = dict.fromkeys(b.level_nodes[0], foot / size)

            result = sized(body, sound, soften, 1.0, 1e4, random)
            truth.values = turning(body, 0, foot / result[0])
        else:
            truth.detail = "a rigid mat that rocks"
            about_x, about_y = 40 * stiff * (height_m / 2) ** 2 * random.uniform(0.85, 1.15, 2)

            def soften(b, size):
                b.mat = {X: STIFF, Y: STIFF, Z: STIFF, RX: about_x / size, RY: about_y / size, RZ: 1e4 * STIFF}

            result = sized(body, sound, soften, 1.0, 1e4, random)
            x, y = result[0] / about_x, result[0] / about_y
            truth.values = {"flexibility": (min(x, y), max(x, y)), "flexibility_x": (x, x), "flexibility_y": (y, y)}
    elif kind == "base-translation":
        along_x, along_y = 100 * stiff * random.uniform(0.85, 1.15, 2)
        truth.detail = "a rigid mat that slides and does not turn"

        def soften(b, size):
            b.mat = {X: along_x / size, Y: along_y / size, Z: STIFF, RX: 1e4 * STIFF, RY: 1e4 * STIFF, RZ: 1e4 * STIFF}

        result = sized(body, sound, soften, 1.0, 1e4, random)
        x, y = result[0] / along_x, result[0] / along_y
        truth.values = {"flexibility": (min(x, y), max(x, y)), "flexibility_x": (x, x), "flexibility_y": (y, y)}
    elif kind == "base-torsion":
        turn = 10 * stiff * height_m**2
        truth.detail = "a mat that only twists"

        def soften(b, size):
            b.mat = {X: STIFF, Y: STIFF, Z: STIFF, RX: 1e4 * STIFF, RY: 1e4 * STIFF, RZ: turn / size}

        result = sized(body, sound, soften, 1.0, 1e5, random)
        truth.values = {"flexibility": (result[0] / turn, result[0] / turn)}
    elif kind == "p-delta":
        changed = copy.deepcopy(body)
        changed.weight_acts = True
        modes = world.modes(changed, MODES)
        reached = shift(sound, modes)
        if not 0.01 <= reached <= 0.11:
            raise ValueError(f"weight moves frequencies by {100 * reached:.2f} %")
        result = 1.0, changed, modes, reached
        truth.values = {"factor": (1.0, 1.0)}
    elif kind == "lateral-support":
        level = int(count * random.uniform(0.4, 0.7))
        truth.place_m = levels[level]
        dof = int(random.choice([X, Y]))
        tags = body.level_nodes[level]
        truth.detail = f"guys along {'XY'[dof - 1]}"

        def hold(b, size):
            b.stays.extend((tag, dof, size * stiff / len(tags)) for tag in tags)

        result = sized(body, sound, hold, 0.1, 10.0, random)
        along = [result[0] * stiff * (dof == axis) for axis in (X, Y)]
        truth.values = {f"stiffness_{name}": (value, value) for name, value in zip("xy", along)}
    elif kind == "stiffness-scale":
        sign = random.choice([-1, 1])
        result = sized(body, sound, lambda b, size: rescale(b, sign * size), 0.1, 0.3, random)
        truth.values = {"relative": (sign * result[0], sign * result[0])}
    elif kind == "mass-eccentricity":
        angle = random.uniform(0, 2 * math.pi)
        way = np.array([math.cos(angle), math.sin(angle)])

        def push(b, size):
            for level in range(1, count + 1):
                structures.shift_mass(b, level, *(size * way))

        points = np.array([body.nodes[tag][:2] for tag in body.level_nodes[count]])
        width_m = np.ptp(points, axis=0).min()
        result = sized(body, sound, push, 0.1 * width_m, 0.22 * width_m, random)
        truth.values = {name: (result[0] * part, result[0] * part) for name, part in zip("xy", way)}
    else:
        level = int(random.integers(1, count * 3 // 4))
        truth.place_m = levels[level]
        first = 40 * stiff * (height_m / 2) ** 2 / levers(body, level)[0]
        result = sized(body, sound, lambda b, size: split(b, level, first / size), 1.0, 1e4, random)
        # In units of what the bay above bends by; motion along Y turns about X.
        length_m = levels[level + 1] - levels[level]
        (about_x, about_y, _), (along_x, along_y) = turned(body, result[1], level), (table.apart(axis)[0][level] for axis in (1, 2))
        x, y = about_x * length_m / along_y, about_y * length_m / along_x
        truth.values = {"flexibility": (min(x, y), max(x, y)), "flexibility_x": (x, x), "flexibility_y": (y, y)}
        truth.detail = f"upright springs between {len(result[1].joints)} ends of members"
    truth.shift_percent = 100 * result[3]
    return truth, result[1], result[2]


def forget(kind, body, sound, whole):
    """The truth, the table and its errors where the engineer forgets what is in the whole table; the body stays as it is."""
    name, (along_x, along_y), has_any = {
        "coupled-shear": lambda: ("distance", study.coupled_shear_m(body, world.answers_at_top(body)), whole.coupled_shear_m > 0),
        "wall-frame": lambda: ("share", whole.frame_shares, any(whole.frame_shares)),
    }[kind]()
    if not has_any:
        raise ValueError("there is next to nothing to forget")
    table = study.Table(study.table(body, world.answers_at_top(body)))
    errors = study.errors_percent(table, sound, 8)
    truth = Truth("effect", kind, body.name, shift_percent=float(np.abs(errors).max()))
    ends = min(along_x, along_y), max(along_x, along_y)
    truth.values = {name: ends, f"{name}_x": (along_x, along_x), f"{name}_y": (along_y, along_y)}
    return truth, table, errors


def hide_outsider(kind, body, sound, random):
    """Puts in what no effect of the catalogue describes."""
    count = len(body.levels_m) - 1
    truth = Truth("outsider", kind)
    axis = str(random.choice(["x", "y"]))
    lower = bool(random.random() < 0.5)
    bays = set(range(count // 2)) if lower else set(range(count // 2, count))
    families = {"lattice": (f"brace_{axis}",), "frame": (f"wall_{axis}",), "tube": (f"shell_{axis}",)}
    named = families[body.kind]
    truth.detail = f"{named[0]} over the {'lower' if lower else 'upper'} half"
    _, changed, modes, reached = sized(body, sound, lambda b, size: scale(b, bays, named, 1 - size), 0.3, 0.8, random)
    truth.shift_percent = 100 * reached
    return truth, changed, modes


def hide_channel(kind, channels, random):
    """A channel with a wrong gain, a reversed one, or two that were exchanged. Channels: (name, direction, node's height)."""
    truth = Truth("channel", kind)
    first = int(random.integers(len(channels)))
    if kind == "sensor-swap":
        second = int(random.choice([i for i in range(len(channels)) if i != first]))
        truth.channels = channels[first], channels[second]
    else:
        truth.channels = (channels[first],)
    if kind == "sensor-gain":
        factor = random.choice([random.uniform(0.5, 0.8), random.uniform(1.25, 2.0)])
        truth.values = {"factor": (factor, factor)}
    return truth


def rescale(body, relative):
    body.modulus_n_m2 *= 1 + relative
