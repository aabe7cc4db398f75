// The structure in three dimensions on a canvas of our own. A scene is a list of lines and dots, each point with its motion;
// a camera turns it, a phase moves it. Measured motion is drawn at the sensors, with the section's outline moved and turned
// as they say; the model is its axis and the same outlines.

import { colour, font, mix, ramp } from "@/canvas.js"
import { stepFor } from "@/curves.js"
import { decimals, fixed, known, significant } from "@/numbers.js"

// Least drawn radius of a section over the height: 7 m on 600 m would not be seen.
const SECTION = 0.045
// Largest drawn translation of sensors over the height, at amplitude 1.
const TRAVEL = 0.12
// A mast above all sensors may swing this much further.
const MAST = 1.25
// Largest drawn travel by rotation over the drawn radius.
const TURN = 0.6
// More sections hide each other.
const OUTLINES = 12
// Width of the misfit's column, pixels.
const STRIP = 118
// Least distance of its labels.
const ROW = 17

/** Cameras [azimuth, elevation] in radians. */
export const cameras = { x: [0, 0], y: [1.571, 0], above: [0, 1.571] }

const finite = v => Array.isArray(v) && v.every(known)
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
const largest = list => list.reduce((m, v) => Math.max(m, v || 0), 0)

/** The model's mode that a measured mode is paired with. */
function partner(d, part, mode) {
    const pairs = (d.comparison?.[part.name] ?? d.comparison?.given)?.pairs
    const number = pairs ? pairs.find(p => p.measured === mode)?.model : mode
    return part.modes?.find(m => m.number === number) ?? null
}

/** Motion [ux, uy, uz, rz] over height, linear between the model's nodes. */
function overHeight(nodes, motion) {
    const rows = nodes.map((n, i) => [n, motion[i]]).filter(([n, m]) => finite(n) && m).sort((a, b) => a[0][2] - b[0][2])
    return z => {
        const i = rows.findIndex(([n]) => n[2] >= z)
        if (i < 1) return (rows.at(i) ?? [0, [0, 0, 0, 0]])[1]
        const [[a, from], [b, to]] = [rows[i - 1], rows[i]], t = (z - a[2]) / (b[2] - a[2] || 1)
        return from.map((v, k) => v + t * (to[k] - v))
    }
}

/** The outline through points in plan, and through the axis where there are fewer than three. */
function ring(points) {
    const distinct = list => [...new Map(list.map(p => [String(p), p])).values()], own = distinct(points), all = own.length < 3 ? distinct([...own, [0, 0]]) : own
    const [x, y] = [0, 1].map(k => all.reduce((sum, p) => sum + p[k], 0) / all.length)
    return all.sort((a, b) => Math.atan2(a[1] - y, a[0] - x) - Math.atan2(b[1] - y, b[0] - x))
}

const determinant = ([a, b, c]) => a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0])

/**
 * The section's motion [ux, uy, rz] at a level by least squares from what its sensors say, `start` (the model, or rest)
 * where they say nothing. `arm` weighs rotation like translation. `turns`: whether the sensors fix all three.
 */
function section(readings, start, arm) {
    const rows = readings.map(r => [r.direction[0], r.direction[1], (r.direction[1] * r.offset[0] - r.direction[0] * r.offset[1]) / arm])
    const p = [start[0], start[1], start[2] * arm], axes = [0, 1, 2]
    const normal = axes.map(i => axes.map(j => rows.reduce((s, a) => s + a[i] * a[j], 0)))
    const size = (normal[0][0] + normal[1][1] + normal[2][2]) / 3
    const turns = determinant(normal) > 1e-4 * size ** 3
    axes.forEach(i => normal[i][i] += 1e-6 * size)
    const right = axes.map(i => rows.reduce((s, a, k) => s + a[i] * (readings[k].value - dot(a, p)), 0)), whole = determinant(normal)
    const change = axes.map(k => determinant(normal.map((row, i) => row.map((v, j) => j === k ? right[i] : v))) / whole)
    return { motion: [p[0] + change[0], p[1] + change[1], (p[2] + change[2]) / arm], turns }
}

// Of each data, by mode.
const scenes = new WeakMap()

/** Everything to draw of a mode; null where nothing is known of the structure's geometry. */
export function scene(d, mode) {
    if (!scenes.has(d)) scenes.set(d, new Map())
    const modes = scenes.get(d)
    if (!modes.has(mode)) modes.set(mode, compose(d, mode))
    return modes.get(mode)
}

function compose(d, mode) {
    const sensors = (d.study?.sensors ?? []).filter(s => known(s.elevation_m)).map(s => ({ ...s, offset: finite(s.offset_m) ? s.offset_m : [0, 0] }))
    const parts = (d.model?.parts ?? []).filter(p => p?.nodes?.length && p.modes)
    const nodes = parts.flatMap(p => p.nodes.filter(finite))
    const heights = [...sensors.map(s => s.elevation_m), ...nodes.map(n => n[2])].sort((a, b) => a - b)
    if (!heights.length) return null
    // Without a model, the axis starts at the ground, unless all sensors are far above it.
    if (!nodes.length && heights[0] > 0 && heights[0] < heights.at(-1) / 3) heights.unshift(0)
    const low = heights[0], high = heights.at(-1), height = high - low || 1
    const radius = largest([...sensors.map(s => Math.hypot(...s.offset)), ...nodes.map(n => Math.hypot(n[0], n[1]))])
    const isWide = radius > 1e-6, arm = isWide ? radius : SECTION * height
    const plan = isWide ? Math.max(1, SECTION * height / radius) : 1

    const values = new Map((d.modes?.modes?.find(m => m.number === mode)?.shape ?? []).map(c => [c.channel, c.re]))
    const frame = parts.find(p => p.is_spatial)
    if (frame) return spatial(d, mode, { frame, parts, sensors, values, low, high })
    // Levels of sensors, with what the mode's shape says there and the outline of the section.
    const levels = new Map()
    for (const s of sensors) {
        const key = s.elevation_m.toFixed(2), value = values.get(s.channel)
        if (!levels.has(key)) levels.set(key, { z: s.elevation_m, all: [], readings: [] })
        levels.get(key).all.push(s.offset)
        if (known(value) && finite(s.direction)) levels.get(key).readings.push({ offset: s.offset, direction: s.direction, value })
    }
    const rows = [...levels.values()].sort((a, b) => a.z - b.z)
    const square = [[arm, 0], [0, arm], [-arm, 0], [0, -arm]]
    for (const row of rows) row.outline = isWide ? ring(row.all) : square

    const motions = parts.map(part => {
        const motion = partner(d, part, mode)?.motion
        return motion && { part, motion, kind: part.name === "effects" ? "effects" : "given", at: overHeight(part.nodes, motion) }
    }).filter(Boolean)
    const best = motions.find(m => m.kind === "effects") ?? motions[0]
    for (const row of rows) {
        const flat = row.readings.filter(r => Math.hypot(r.direction[0], r.direction[1]) > 0.3), m = best?.at(row.z) ?? [0, 0, 0, 0]
        if (flat.length) Object.assign(row, section(flat, [m[0], m[1], m[3]], arm))
    }
    const told = rows.filter(r => r.motion)

    // One amplitude for all of them.
    const model = motions.flatMap(m => m.motion.filter(Boolean)), travel = list => largest(list.map(m => Math.hypot(m[0], m[1])))
    const turn = arm * largest([...told.map(r => Math.abs(r.motion[2])), ...model.map(m => Math.abs(m[3]))])
    const A = [[TRAVEL * height, travel(told.map(r => r.motion))], [MAST * TRAVEL * height, travel(model)], [TURN * arm * plan, turn]]
        .reduce((least, [most, is]) => is > 0 ? Math.min(least, most / is) : least, 1e30)

    const items = []
    const place = ([x, y], z) => [x * plan, y * plan, z]
    const moved = ([x, y], [ux, uy, rz], uz = 0) => [A * (ux - rz * y), A * (uy + rz * x), A * uz]
    const line = (kind, points, moves, more) => points.length > 1 && items.push({ kind, points, moves: moves ?? points.map(() => [0, 0, 0]), ...more })
    const outline = (kind, row, to, dashed) => line(kind, row.outline.map(o => place(o, row.z)), to && row.outline.map(to), { closed: true, thin: true, dashed })
    const axis = (kind, part, motion) => {
        for (const ends of part.lines ?? []) if (ends.every(i => finite(part.nodes[i]) && (!motion || motion[i])))
            line(kind, ends.map(i => place(part.nodes[i], part.nodes[i][2])), motion && ends.map(i => motion[i].slice(0, 3).map(v => A * (v ?? 0))))
    }
    if (parts[0]) axis("rest", parts[0])
    else line("rest", [low, ...rows.map(r => r.z)].map(z => [0, 0, z]))
    const drawn = rows.filter((_, i) => (rows.length - 1 - i) % Math.ceil(rows.length / OUTLINES) === 0)
    for (const row of drawn) outline("rest", row)
    for (const { part, motion, kind, at } of motions) {
        axis(kind, part, motion)
        for (const row of drawn) { const m = at(row.z); outline(kind, row, o => moved(o, [m[0], m[1], m[3]], m[2])) }
    }
    line("measured", told.map(r => [0, 0, r.z]), told.map(r => moved([0, 0], r.motion)), { dashed: true })
    const marks = []
    for (const row of rows) {
        // A dot moves with its section, but along each direction that is measured there exactly as measured; that part is its arrow.
        const motion = row.motion ?? [0, 0, 0], dots = new Map()
        for (const { offset, direction, value } of row.readings) {
            const key = String(offset), d = dots.get(key) ?? { offset, end: moved(offset, motion), measured: [0, 0, 0] }, left = A * value - dot(d.end, direction)
            dots.set(key, d)
            direction.forEach((v, k) => { d.end[k] += left * v; d.measured[k] += A * value * v })
        }
        // The outline goes through the dots; where it is left out, a spoke joins each to the axis, so that none hangs in the air.
        const isDrawn = drawn.includes(row) && row.motion
        if (isDrawn) outline("measured", row, o => dots.get(String(o))?.end ?? moved(o, motion), !row.turns)
        for (const { offset, end, measured } of dots.values()) {
            if (!isDrawn) line("measured", [[0, 0], offset].map(o => place(o, row.z)), [moved([0, 0], motion), end], { thin: true, dashed: true })
            marks.push({ kind: "measured", dot: true, points: [place(offset, row.z)], moves: [end], from: end.map((v, k) => v - measured[k]) })
        }
    }
    items.push(...marks)

    const sum = f => told.reduce((s, { motion: m }) => s + f(m), 0)
    const torsion = sum(m => (m[2] * arm) ** 2), bending = sum(m => m[0] ** 2 + m[1] ** 2)
    const towards = (Math.atan2(2 * sum(m => m[0] * m[1]), sum(m => m[0] ** 2 - m[1] ** 2)) / 2 + Math.PI) % Math.PI
    // Where all sensors look one way, nothing is known of the other.
    const flat = sensors.flatMap(s => finite(s.direction) && Math.hypot(s.direction[0], s.direction[1]) > 0.3 ? [s.direction] : []), single = flat.every(d => Math.abs(d[0] * flat[0][1] - d[1] * flat[0][0]) < 0.1)
    return { items, low, high, plan, towards, isWide, kinds: ["measured", "given", "effects"].filter(k => items.some(i => i.kind === k)), undetermined: told.some(r => !r.turns),
        character: !told.length ? "" : torsion > bending ? "torsion" : `bending towards ${fixed(towards * 180 / Math.PI, 0)}°${single ? ", the only direction that was measured" : ""}${torsion > 0.1 * bending ? " with torsion" : ""}` }
}

/** A structure with lines of its own: they move as the model says, and a dot at each sensor's place along what is measured there. */
function spatial(d, mode, { frame, parts, sensors, values, low, high }) {
    const motions = parts.map(part => ({ part, motion: partner(d, part, mode)?.motion, kind: part.name === "effects" ? "effects" : "given" })).filter(m => m.motion)
    const best = motions.find(m => m.kind === "effects") ?? motions[0], far = (n, p) => Math.hypot(...n.map((v, k) => v - p[k]))
    const dots = new Map()
    for (const s of sensors) {
        const value = values.get(s.channel), place = [...s.offset, s.elevation_m], key = String(place)
        if (!known(value) || !finite(s.direction)) continue
        const near = best ? best.part.nodes.reduce((m, n, i) => far(n, place) < far(best.part.nodes[m], place) ? i : m, 0) : 0
        const dot = dots.get(key) ?? { place, end: best?.motion[near]?.slice(0, 3) ?? [0, 0, 0], measured: [0, 0, 0] }
        dots.set(key, dot)
        const left = value - s.direction.reduce((sum, v, k) => sum + v * dot.end[k], 0)
        s.direction.forEach((v, k) => { dot.end[k] += left * v; dot.measured[k] += value * v })
    }
    const told = [...dots.values()], side = k => { const all = frame.nodes.map(n => n[k]); return Math.max(...all) - Math.min(...all) }
    const size = Math.max(side(0), side(1), side(2)) || 1, travel = list => largest(list.map(m => Math.hypot(m[0], m[1], m[2])))
    const most = Math.max(travel(told.map(t => t.end)), travel(motions.flatMap(m => m.motion))), A = most > 0 ? TRAVEL * size / most : 0, scaled = m => m.slice(0, 3).map(v => A * v)
    const items = []
    const draw = (kind, part, motion) => {
        const put = (ids, more) => items.push({ kind, points: ids.map(i => part.nodes[i]), moves: ids.map(i => motion ? scaled(motion[i]) : [0, 0, 0]), ...more })
        for (const ids of part.surfaces ?? []) put(ids, { closed: true, thin: true })
        for (const ids of part.lines ?? []) put(ids)
    }
    draw("rest", frame)
    for (const { part, motion, kind } of motions) draw(kind, part, motion)
    for (const { place, end, measured } of told) items.push({ kind: "measured", dot: true, points: [place], moves: [scaled(end)], from: scaled(end.map((v, k) => v - measured[k])) })
    const share = k => told.reduce((sum, t) => sum + t.measured[k] ** 2, 0), [x, y, z] = [0, 1, 2].map(share)
    const xy = told.reduce((sum, t) => sum + t.measured[0] * t.measured[1], 0), angle = (Math.atan2(2 * xy, x - y) / 2 + Math.PI) % Math.PI
    const isWide = Math.hypot(side(0), side(1)) > side(2), isVertical = z > x + y
    // Levels whose sensors tell sway and turn: how they turn about the middle of the plan.
    const middle = [0, 1].map(k => frame.nodes.reduce((sum, n) => sum + n[k], 0) / frame.nodes.length), arm = Math.hypot(side(0), side(1)) / 2 || 1, levels = new Map()
    for (const s of sensors) {
        const value = values.get(s.channel), key = s.elevation_m.toFixed(1)
        if (known(value) && finite(s.direction) && Math.hypot(s.direction[0], s.direction[1]) > 0.3) levels.set(key, [...levels.get(key) ?? [], { offset: s.offset.map((v, k) => v - middle[k]), direction: s.direction, value }])
    }
    const turning = [...levels.values()].map(r => section(r, [0, 0, 0], arm)).filter(l => l.turns).map(l => l.motion)
    const turned = turning.reduce((sum, m) => sum + (m[2] * arm) ** 2, 0), swayed = turning.reduce((sum, m) => sum + m[0] ** 2 + m[1] ** 2, 0)
    return { items, low, high, plan: 1, towards: isWide ? (side(0) >= side(1) ? 0 : Math.PI / 2) : angle, isWide: true, isLong: isWide, kinds: ["measured", "given", "effects"].filter(k => items.some(i => i.kind === k)), undetermined: false,
        character: !told.length ? "" : turned > swayed ? "torsion" : isVertical ? "mostly vertical" : `mostly towards ${fixed(angle * 180 / Math.PI, 0)}°` }
}

const shifted = (p, m, by) => [p[0] + by * m[0], p[1] + by * m[1], p[2] + by * m[2]]

/** From m to pixels, so that the scene fills [left, top, width, height] in every phase. A camera is [azimuth, elevation]. */
export function lens(s, [a, e], [left, top, width, height], amplitude, shown = () => true, most = Infinity) {
    const right = [Math.cos(a), Math.sin(a), 0], up = [-Math.sin(a) * Math.sin(e), Math.cos(a) * Math.sin(e), Math.cos(e)]
    let x0 = Infinity, x1 = -Infinity, y0 = Infinity, y1 = -Infinity
    for (const { kind, points, moves } of s.items) if (shown(kind)) points.forEach((p, i) => {
        for (const phase of [-1, 1]) {
            const q = shifted(p, moves[i], phase * amplitude), x = dot(q, right), y = dot(q, up)
            x0 = Math.min(x0, x); x1 = Math.max(x1, x); y0 = Math.min(y0, y); y1 = Math.max(y1, y)
        }
    })
    const scale = Math.min(width / (x1 - x0 || 1), height / (y1 - y0 || 1), most)
    const cx = left + width / 2 - scale * (x0 + x1) / 2, cy = top + height / 2 + scale * (y0 + y1) / 2
    return { to: p => [cx + scale * dot(p, right), cy - scale * dot(p, up)], scale, right, up, left }
}

function trace(pen, points, closed) {
    points.forEach(([x, y], i) => i ? pen.lineTo(x, y) : pen.moveTo(x, y))
    if (closed) pen.closePath()
}
function stroke(pen, points) {
    pen.beginPath()
    trace(pen, points)
    pen.stroke()
}
function disc(pen, x, y, radius) {
    pen.beginPath()
    pen.arc(x, y, radius, 0, 7)
    pen.fill()
}

/** Draws the scene at a phase from -1 to 1. */
export function paint(pen, s, view, { phase, amplitude = 1, shown = () => true, small }) {
    const at = (p, m) => view.to(shifted(p, m, phase * amplitude))
    pen.lineJoin = pen.lineCap = "round"
    // Lines of one style are one path: fewer strokes, more frames.
    let style = ""
    const end = () => { if (style) pen.stroke(); style = "" }
    for (const { kind, points, moves, ...how } of s.items) {
        if (!shown(kind)) continue
        if (how.dot) {
            end()
            pen.strokeStyle = pen.fillStyle = colour(kind)
            pen.lineWidth = 1
            pen.setLineDash([])
            const tip = at(points[0], moves[0])
            if (!small) arrow(pen, at(points[0], how.from), tip)
            disc(pen, ...tip, small ? 1.6 : 3.5)
            continue
        }
        const own = `${kind} ${how.thin} ${how.dashed}`
        if (own !== style) {
            end()
            style = own
            pen.strokeStyle = colour(kind === "rest" ? "line" : kind)
            pen.lineWidth = (kind === "rest" ? 1 : how.thin ? 1.2 : 2) * (small ? 0.7 : 1)
            pen.setLineDash(!how.dashed ? [] : small ? [2, 2] : [4, 3])
            pen.beginPath()
        }
        trace(pen, points.map((p, i) => at(p, moves[i])), how.closed)
    }
    end()
    pen.setLineDash([])
}

function arrow(pen, [x0, y0], [x1, y1]) {
    const length = Math.hypot(x1 - x0, y1 - y0)
    if (length < 10) return
    const ux = (x1 - x0) / length, uy = (y1 - y0) / length, bx = x1 - 4 * ux, by = y1 - 4 * uy
    stroke(pen, [[x0, y0], [bx, by]])
    pen.beginPath()
    trace(pen, [[bx, by], [bx - 6 * ux + 3 * uy, by - 6 * uy - 3 * ux], [bx - 6 * ux - 3 * uy, by - 6 * uy + 3 * ux]])
    pen.fill()
}

/** Heights in m at the left, a bar of length in plan, and which way X, Y and Z point. */
export function scales(pen, s, view, height) {
    pen.fillStyle = pen.strokeStyle = colour("quiet")
    pen.lineWidth = 1
    pen.font = font(11)
    pen.textBaseline = "middle"
    if (view.up[2] > 0.5) {
        const step = stepFor(s.high - s.low, 4)
        pen.textAlign = "right"
        for (let z = Math.ceil(s.low / step) * step; z <= s.high + 1e-9; z += step) {
            const y = view.to([0, 0, z])[1]
            pen.fillText(fixed(z, decimals(step)), 40, y)
            stroke(pen, [[44, y], [50, y]])
        }
        pen.textAlign = "left"
        pen.fillText("height, m", 8, 10)
    }
    if (s.isWide) {
        const length = stepFor(30 / (view.scale * s.plan), 1), x = 64, y = height - 12, end = x + length * view.scale * s.plan
        pen.textAlign = "left"
        stroke(pen, [[x, y - 4], [x, y], [end, y], [end, y - 4]])
        pen.fillText(`${significant(length)} m${s.plan > 1.05 ? ` (plan × ${significant(s.plan, 2)})` : ""}`, end + 8, y - 2)
    }
    const ox = 26, oy = height - 20
    pen.font = font(11, "600")
    pen.textAlign = "center"
    const letters = []
    for (const [name, axis] of [["Z", [0, 0, 1]], ["X", [1, 0, 0]], ["Y", [0, 1, 0]]]) {
        const x = dot(axis, view.right), y = -dot(axis, view.up)
        if (Math.hypot(x, y) < 0.2) continue
        stroke(pen, [[ox, oy], [ox + 13 * x, oy + 13 * y]])
        const at = far => [ox + far * x, oy + far * y], isFree = ([a, b]) => letters.every(([c, d]) => Math.hypot(a - c, b - d) > 10)
        letters.push([20, 30].map(at).find(isFree) ?? at(40))
        pen.fillText(name, ...letters.at(-1))
    }
}

/** Misfit beside the structure from `x0` on, from quiet to strong. Labels stand at their heights and never overlap. */
export function misfits(pen, view, rows, title, x0, height) {
    if (!rows.length) return
    const most = largest(rows.map(r => r.misfit)) || 1, hue = share => mix(colour("low"), colour("high"), share), left = x0 + 18, top = 34, bottom = height - 54
    const level = view.up[2] > 0.5 && rows[0].z != null
    const list = [...rows].sort((a, b) => b.misfit - a.misfit).slice(0, Math.max(1, Math.floor((bottom - top) / ROW)))
    if (level) list.sort((a, b) => b.z - a.z)
    const ys = list.map((r, i) => level ? view.to([0, 0, r.z])[1] : top + i * ROW)
    for (let i = 0; i < ys.length; i++) ys[i] = Math.max(ys[i], i ? ys[i - 1] + ROW : top)
    for (let i = ys.length - 1; i >= 0; i--) ys[i] = Math.min(ys[i], i + 1 < ys.length ? ys[i + 1] - ROW : bottom)
    pen.font = font(11)
    pen.textBaseline = "middle"
    pen.textAlign = "left"
    pen.lineWidth = 1
    list.forEach((r, i) => {
        pen.fillStyle = hue(r.misfit / most)
        if (level) {
            const [x, y] = view.to([0, 0, r.z])
            pen.strokeStyle = colour("line")
            stroke(pen, [[x + 7, y], [left - 14, y], [left - 3, ys[i]]])
            disc(pen, x, y, 7)
        }
        pen.strokeStyle = colour("quiet")
        pen.fillRect(left, ys[i] - 6, 12, 12)
        pen.strokeRect(left, ys[i] - 6, 12, 12)
        pen.fillStyle = colour("ink")
        pen.fillText(`${fixed(r.misfit, 3)}  ${r.label}`, left + 18, ys[i])
    })
    pen.fillText(title, left, 12)
    ramp(pen, left, height - 26, 60, hue)
    pen.fillStyle = colour("quiet")
    pen.fillText("0", left, height - 9)
    pen.fillText(fixed(most, 3), left + 46, height - 9)
}
misfits.width = STRIP + 18
