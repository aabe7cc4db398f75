"""The three kinds of structures, their dimensions drawn within what engineers build. A random generator flows in, a Body out."""
import numpy as np

from world import Body, Element

STEEL = 2.1e11, 7850.0
CONCRETE = 3.2e10, 2500.0


def lattice(random, slender):
    """A steel tower of twelve bays with four tapering legs, pinned bracing (X or K), and platforms. Slender: a heavy head."""
    height_m = random.uniform(60, 120)
    ratio = random.uniform(1.03, 1.3)
    base_m = height_m / random.uniform(9, 13) / (1.25 if slender else 1.0)
    top_m = base_m * random.uniform(0.45, 0.85)
    bracing = random.choice(["X", "K"])
    leg_base_m2 = height_m / 80 * random.uniform(0.025, 0.05)
    leg_top_m2 = leg_base_m2 * random.uniform(0.3, 0.5)
    brace_share = random.uniform(0.12, 0.25)
    bays = 12
    levels_m = [height_m * i / bays for i in range(bays + 1)]
    body = Body("lattice", f"lattice tower, {bracing} bracing, {height_m:.0f} m", STEEL[0], levels_m)
    corners, middles = [], []
    for level, z in enumerate(levels_m):
        half_x = 0.5 * (base_m + (top_m - base_m) * z / height_m)
        half_y = half_x / ratio
        plan = [(-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)]
        corners.append([body.node(*xy, z, level, 1.0) for xy in plan])
        if bracing == "K" and level:
            ends = zip(plan, plan[1:] + plan[:1])
            middles.append([body.node((a[0] + b[0]) / 2, (a[1] + b[1]) / 2, z) for a, b in ends])
        else:
            middles.append(None)

    def truss(a, b, family, bay, area_m2):
        body.elements.append(Element("truss", (a, b), family, bay, area_m2))

    def girder(a, b, area_m2):
        body.elements.append(Element("girder", (a, b), "horizontal", None, area_m2, area_m2 * 0.07**2))

    for bay in range(bays):
        leg_m2 = leg_base_m2 + (leg_top_m2 - leg_base_m2) * (bay + 0.5) / bays
        brace_m2 = brace_share * leg_m2
        for side in range(4):
            other = (side + 1) % 4
            # Faces 0 and 2 run along X, faces 1 and 3 along Y.
            family = "brace_x" if side % 2 == 0 else "brace_y"
            low, high = corners[bay], corners[bay + 1]
            body.elements.append(Element("column", (low[side], high[side]), "leg", bay, leg_m2, leg_m2 * 0.11**2))
            if bracing == "X":
                truss(low[side], high[other], family, bay, brace_m2)
                truss(low[other], high[side], family, bay, brace_m2)
                girder(high[side], high[other], brace_m2)
            else:
                middle = middles[bay + 1][side]
                truss(low[side], middle, family, bay, brace_m2)
                truss(low[other], middle, family, bay, brace_m2)
                girder(high[side], middle, brace_m2)
                girder(middle, high[other], brace_m2)
                truss(middle, middles[bay + 1][other], "plan", None, brace_m2)
        if bracing == "X":
            truss(corners[bay + 1][0], corners[bay + 1][2], "plan", None, brace_m2)
            truss(corners[bay + 1][1], corners[bay + 1][3], "plan", None, brace_m2)
    body.mass_of_members(STEEL[1], share_more=0.25)
    own_kg = body.total_mass_kg()
    head_kg = own_kg * (random.uniform(1.5, 4.0) if slender else random.uniform(0.03, 0.15))
    platforms = {bays: head_kg}
    for level in random.choice(np.arange(3, bays), size=random.integers(2, 4), replace=False):
        platforms[int(level)] = own_kg * random.uniform(0.02, 0.06)
    for level, mass_kg in platforms.items():
        for tag in corners[level]:
            body.add_mass(tag, mass_kg / 4)
        # A deck keeps its level's corners in place.
        for side in range(4):
            for other in range(side):
                truss(corners[level][side], corners[level][other], "deck", None, 8 * brace_share * leg_base_m2)
    return body


def frame(random, slender):
    """A concrete building of fourteen storeys: columns, beams, rigid floors, and a core of shell walls to one side."""
    storeys = 14
    storey_m = random.uniform(3.2, 4.0)
    span_x, span_y = random.uniform(5.5, 7.5), random.uniform(5.0, 7.0)
    if slender:
        span_x, span_y = 0.9 * span_x, 0.9 * span_y
    column_base_m = random.uniform(0.5, 0.65)
    strip_m = random.uniform(1.0, 1.6), random.uniform(0.2, 0.25)
    wall_m = random.uniform(0.2, 0.35)
    floor_kg_m2 = random.uniform(1000, 1400) if slender else random.uniform(700, 1000)
    levels_m = [storey_m * i for i in range(storeys + 1)]
    body = Body("frame", f"concrete frame, {storeys} storeys, {levels_m[-1]:.0f} m", CONCRETE[0], levels_m, diaphragms=True)
    lines_x = span_x * (np.arange(5) - 2)
    lines_y = span_y * (np.arange(4) - 1.5)
    # The core stands in one cell, half a span beside the middle.
    core = [(1, 1), (2, 1), (2, 2), (1, 2)]
    tags, between, halfway = [], [], []
    for level, z in enumerate(levels_m):
        share = 1 - 0.45 * level / storeys
        side_m = column_base_m * share**0.5
        grid = {}
        for i, x in enumerate(lines_x):
            for j, y in enumerate(lines_y):
                in_core = (i, j) in core
                weight = wall_m * (span_x + span_y) / 4 if in_core else 0.0
                grid[i, j] = body.node(x, y, z, level, weight)
        tags.append(grid)
        between.append([])
        for side in range(4):
            a, b = (body.nodes[grid[core[s % 4]]] for s in (side, side + 1))
            length = span_x if side % 2 == 0 else span_y
            between[-1].append(body.node(*(0.5 * (a + b))[:2], z, level, wall_m * length / 2))
        if level < storeys:
            ring = [body.nodes[tag] for tag in core_ring(grid, between[-1], core)]
            halfway.append([body.node(*point[:2], z + 0.5 * storey_m) for point in ring])
    for storey in range(storeys):
        share = 1 - 0.45 * (storey + 0.5) / storeys
        side_m = column_base_m * share**0.5
        for place, tag in tags[storey].items():
            if place not in core:
                ends = tag, tags[storey + 1][place]
                body.elements.append(Element("column", ends, "column", storey, side_m**2, side_m**4 / 12))
        low = core_ring(tags[storey], between[storey], core)
        high = core_ring(tags[storey + 1], between[storey + 1], core)
        for lower, upper in ((low, halfway[storey]), (halfway[storey], high)):
            for k in range(8):
                facet = lower[k], lower[(k + 1) % 8], upper[(k + 1) % 8], upper[k]
                family = "wall_x" if k // 2 % 2 == 0 else "wall_y"
                body.elements.append(Element("shell", facet, family, storey, thickness_m=wall_m))
        grid = tags[storey + 1]
        for (i, j), tag in grid.items():
            for neighbour in ((i + 1, j), (i, j + 1)):
                if neighbour in grid and not ((i, j) in core and neighbour in core):
                    ends = tag, grid[neighbour]
                    # A strip of slab, cracked.
                    inertia = 0.25 * strip_m[0] * strip_m[1] ** 3 / 12
                    body.elements.append(Element("girder", ends, "strip", None, strip_m[0] * strip_m[1], inertia))
    body.mass_of_members(CONCRETE[1])
    for level in range(1, storeys + 1):
        for (i, j), tag in tags[level].items():
            edge = (0.5 if i in (0, 4) else 1.0) * (0.5 if j in (0, 3) else 1.0)
            body.add_mass(tag, floor_kg_m2 * span_x * span_y * edge * (0.8 if level == storeys else 1.0))
    return body


def core_ring(grid, between, core):
    """The eight nodes of the core at a level, in order around it."""
    return [tag for side in range(4) for tag in (grid[core[side]], between[side])]


def tube(random, slender):
    """A concrete chimney or tube of shells, oval, with walls that thin out and a mass on top."""
    height_m = random.uniform(80, 160)
    diameter_m = height_m / (random.uniform(20, 26) if slender else random.uniform(12, 17))
    ratio = random.uniform(1.04, 1.25)
    narrowing = random.uniform(0.65, 0.95)
    wall_base_m = random.uniform(0.30, 0.45)
    wall_top_m = wall_base_m * random.uniform(0.5, 0.8)
    segments, around = 16, 16
    levels_m = [height_m * i / segments for i in range(segments + 1)]
    body = Body("tube", f"shell tube, {height_m:.0f} m, {diameter_m:.1f} m wide", CONCRETE[0], levels_m)
    rings = []
    for half in range(2 * segments + 1):
        share = half / (2 * segments)
        radius_m = 0.5 * diameter_m * (1 + (narrowing - 1) * share)
        level = half // 2 if half % 2 == 0 else None
        angles = 2 * np.pi * np.arange(around) / around
        rings.append([
            body.node(radius_m * np.cos(a), radius_m / ratio * np.sin(a), share * height_m, level, 1.0) for a in angles
        ])
    for half in range(2 * segments):
        wall_m = wall_base_m + (wall_top_m - wall_base_m) * (half + 0.5) / (2 * segments)
        for k in range(around):
            after = (k + 1) % around
            facet = rings[half][k], rings[half][after], rings[half + 1][after], rings[half + 1][k]
            # Sectors about the X axis carry bending along X.
            direction = abs(np.cos(2 * np.pi * (k + 0.5) / around)) > np.sqrt(0.5)
            family = "shell_x" if direction else "shell_y"
            body.elements.append(Element("shell", facet, family, half // 2, thickness_m=wall_m))
    # Platforms: rings that keep the levels' sections in shape.
    ring_m2 = 0.6 * 0.8
    for ring in rings[2::2]:
        for k in range(around):
            ends = ring[k], ring[(k + 1) % around]
            body.elements.append(Element("girder", ends, "ring", None, ring_m2, 0.6 * 0.8**3 / 12))
    lining = random.uniform(0.6, 1.2) if slender else random.uniform(0.0, 0.3)
    body.mass_of_members(CONCRETE[1], share_more=lining)
    top_kg = body.total_mass_kg() * (random.uniform(0.08, 0.2) if slender else random.uniform(0.01, 0.05))
    for tag in rings[-1]:
        body.add_mass(tag, top_kg / around)
    return body


def place_axis(body, axis_m):
    """Moves the beam's axis to where the frame does not twist, and the floors' loads with it, as its designer would."""
    body.axis_m = axis_m
    for level in range(1, len(body.level_nodes)):
        shift_mass(body, level, *(axis_m - centre_of_mass_m(body, level)))


KINDS = {"lattice": lattice, "frame": frame, "tube": tube}


def shift_mass(body, level, x_m, y_m):
    """Moves a level's centre of mass by a distance: what is on one side grows, what is on the other shrinks."""
    tags = [tag for tag in body.level_nodes[level] if body.masses_kg.get(tag, 0.0) > 0]
    masses = np.array([body.masses_kg[tag] for tag in tags])
    plan = np.array([body.nodes[tag][:2] for tag in tags])
    plan = plan - masses @ plan / masses.sum()
    spread = (masses[:, None, None] * plan[:, :, None] * plan[:, None, :]).sum(axis=0) / masses.sum()
    factors = 1 + plan @ np.linalg.solve(spread, [x_m, y_m])
    if factors.min() < 0.05:
        raise ValueError("a level's mass cannot be moved that far")
    for tag, mass, factor in zip(tags, masses, factors):
        body.masses_kg[tag] = mass * factor


def centre_of_mass_m(body, level):
    tags = body.level_nodes[level]
    masses = np.array([body.masses_kg.get(tag, 0.0) for tag in tags])
    return masses @ np.array([body.nodes[tag][:2] for tag in tags]) / masses.sum()
