// What all curves share: uPlot with axes that have units, the page's colours, zoom, marks whose labels do not overlap, a legend with the
// values at the cursor, sharp print. Pictures give data and painters, and free what they get back.

import { colour, font, make, printing } from "@/canvas.js"
import { clamp, decimals, fixed, hertz, known, percent, power } from "@/numbers.js"
import { view } from "@/view.js"

// uPlot takes the page's ratio of pixels when it loads. Two at least, so that curves print sharp from any screen.
globalThis.devicePixelRatio = Math.max(2, globalThis.devicePixelRatio || 1)
const { default: uPlot } = await import("@/vendor/uPlot.js")

const SIZE = 11
// Height of a row of labels above a plot, CSS pixels.
const MARK_ROW = 16
// A zoom goes into the address when it has rested so long.
const SETTLED_MS = 250
// How high plots are on paper.
const PRINTED = 0.8
const MOST_ZOOM = 1e7
// Room at the right of a plot for half of the last number, CSS pixels.
const RIGHT = 18

// ---- numbers

function decades(low, high, room) {
    const [from, to] = [Math.ceil(Math.log10(low) - 1e-9), Math.floor(Math.log10(high) + 1e-9)]
    const every = Math.max(1, Math.ceil((to - from + 1) / room)), fronts = room < 4 || to - from > 1 ? [1] : to - from < 1 ? [1, 2, 5] : [1, 3], found = []
    for (let n = from - 1; n <= to; n++) if (n % every === 0) for (const front of fronts) found.push(front * 10 ** n)
    return found.filter(value => value >= low * 0.999 && value <= high * 1.001)
}
/** A step of 1, 2 or 5 times a power of ten that fits into a span at most so often. */
export function stepFor(span, room) {
    const rough = span / room, decade = 10 ** Math.floor(Math.log10(rough))
    return rough > 0 && known(rough) ? decade * ([1, 2, 5].find(front => front * decade >= rough) ?? 10) : 1
}
function ticks(low, high, room) {
    const step = stepFor(high - low, room), found = []
    for (let n = Math.ceil(low / step - 1e-6); n * step <= high + 1e-6 * step && found.length < 200; n++) found.push(n * step)
    // One alone is no scale.
    return found.length < 2 && room < 12 ? ticks(low, high, room + 1) : found
}

/** The unit in which values up to `most` read well: 0.0003 m/s² are 0.3 mm/s². */
export function scaled(unit, most) {
    if (!/^m(\/s|$)/.test(unit ?? "") || !(most > 0 && most < 0.2)) return { factor: 1, unit: unit ?? "" }
    return most < 2e-4 ? { factor: 1e6, unit: "µ" + unit } : { factor: 1e3, unit: "m" + unit }
}

// ---- data

/** The unit of a setup's spectra. */
export const densityIn = setup => setup?.unit ?? "(m/s²)²/Hz"
/** The unit of the motion that they are of. */
export const motionIn = setup => densityIn(setup).slice(1, -5)

/** A Float64Array of packed numbers: value = from + step n, its power of ten where `log`, NaN for the largest n. */
export function unpack(packed) {
    if (!packed?.base64) return new Float64Array(0)
    const bytes = Uint8Array.from(atob(packed.base64), c => c.charCodeAt(0))
    const wide = packed.type === "u16"
    const count = wide ? bytes.length >> 1 : bytes.length
    const last = wide ? 65535 : 255
    const values = new Float64Array(count)
    for (let i = 0; i < count; i++) {
        const n = wide ? bytes[2 * i] | bytes[2 * i + 1] << 8 : bytes[i]
        const value = packed.from + packed.step * n
        values[i] = n === last ? NaN : packed.log ? 10 ** value : value
    }
    return values
}

/** What of an array is there; data may lack anything. */
export const items = array => Array.isArray(array) ? array.filter(one => one != null) : []
export const steps = (first, spacing, count) => Float64Array.from({ length: count }, (_, i) => first + spacing * i)

/** Values as uPlot takes them: gaps are null, and where the axis is logarithmic nothing at or below zero. */
export function clean(values, log = false) {
    const bad = value => !known(value) || log && value <= 0
    return values.some(bad) ? Array.from(values, value => bad(value) ? null : value) : values
}

/** Least and greatest of finite values; null where there are none. */
export function extent(values, log = false) {
    let low = Infinity, high = -Infinity
    for (const value of values) if (known(value) && (!log || value > 0)) { low = Math.min(low, value); high = Math.max(high, value) }
    return low <= high ? [low, high] : null
}

export function nearest(sorted, value) {
    let low = 0, high = sorted.length - 1
    while (high - low > 1) {
        const middle = (low + high) >> 1
        if (sorted[middle] < value) low = middle; else high = middle
    }
    return Math.abs(sorted[low] - value) <= Math.abs(sorted[high] - value) ? low : high
}

// ---- what painters draw with: places in the axes' units, sizes in CSS pixels

function penOf(u) {
    const ratio = uPlot.pxRatio, { ctx, bbox: { left, top, width, height } } = u
    const map = (name, from, size) => {
        const { min, max, distr } = u.scales[name], f = distr === 3 ? Math.log : v => v
        const low = f(min), scale = size / (f(max) - low || 1)
        return v => from + scale * (f(v) - low)
    }
    const x = map("x", left, width), y = map("y", top + height, -height)
    const { min, max } = u.scales.x
    const inSight = xs => [Math.max(nearest(xs, min) - 1, 0), Math.min(nearest(xs, max) + 1, xs.length - 1)]
    const path = points => {
        ctx.beginPath()
        let open = false
        for (const [a, b] of points) {
            const there = known(a) && known(b)
            if (there) open ? ctx.lineTo(x(a), y(b)) : ctx.moveTo(x(a), y(b))
            open = there
        }
    }
    /** Bars from least to greatest in every column of pixels: much faster than strokes. False where points are further apart. */
    function columns(xs, upper, lower, thickness) {
        // A column is a pixel of the screen; on paper, which does not move, one of the canvas.
        const [from, to] = inSight(xs), step = printing() ? 1 : Math.floor(ratio)
        if (to - from < width / step) return false
        let column = -1, low = Infinity, high = -Infinity, before = [NaN, NaN]
        const flush = () => {
            if (low > high) { before = [NaN, NaN]; return }
            // Neighbours touch, so that a steep curve stays whole.
            const y0 = y(high < before[0] ? before[0] : high), y1 = y(low > before[1] ? before[1] : low)
            ctx.fillRect(left + column * step, y0 - thickness / 2, step, Math.max(y1 - y0 + thickness, 1))
            before = [low, high]
        }
        for (let i = from; i <= to; i++) {
            const at = Math.floor((x(xs[i]) - left) / step)
            if (at !== column) {
                if (column >= 0) flush()
                column = at; low = Infinity; high = -Infinity
            }
            if (known(upper[i]) && upper[i] > high) high = upper[i]
            if (known(lower[i]) && lower[i] < low) low = lower[i]
        }
        flush()
        return true
    }
    return {
        ctx, x, y, ratio, left, top, right: left + width, bottom: top + height,
        style(name, { width = 1.5, alpha = 1, dash = [] } = {}) {
            ctx.strokeStyle = ctx.fillStyle = colour(name, alpha)
            ctx.lineWidth = width * ratio
            ctx.lineJoin = "bevel"
            ctx.setLineDash(dash.map(length => length * ratio))
        },
        line(points) { path(points); ctx.stroke() },
        /** A line across. */
        level(b) { this.line([[min, b], [max, b]]) },
        area(points) { path(points); ctx.fill() },
        box(x0, y0, x1, y1) { ctx.fillRect(x(x0), y(y0), x(x1) - x(x0), y(y1) - y(y0)) },
        dot(a, b, radius, hollow) {
            ctx.beginPath()
            ctx.arc(x(a), y(b), radius * ratio, 0, 7)
            hollow ? ctx.stroke() : ctx.fill()
        },
        /** The bar of an error. */
        whisker(a, low, high, half = 3) {
            const px = x(a), s = half * ratio
            ctx.beginPath()
            for (const [x0, y0, x1, y1] of [[px, y(low), px, y(high)], [px - s, y(low), px + s, y(low)], [px - s, y(high), px + s, y(high)]]) { ctx.moveTo(x0, y0); ctx.lineTo(x1, y1) }
            ctx.stroke()
        },
        text(words, a, b, align, dx, dy) {
            ctx.font = font(SIZE * ratio)
            ctx.textAlign = align
            ctx.textBaseline = "middle"
            const at = [words, x(a) + dx * ratio, y(b) + dy * ratio]
            ctx.strokeStyle = colour("paper"); ctx.lineWidth = 3 * ratio; ctx.setLineDash([]); ctx.strokeText(...at)
            ctx.fillStyle = colour("ink"); ctx.fillText(...at)
        },
        /** A curve, and what lies between two. */
        trace(xs, ys, width = 1) {
            if (columns(xs, ys, ys, width * ratio)) return
            const [from, to] = inSight(xs)
            path(Array.from({ length: to - from + 1 }, (_, i) => [xs[from + i], ys[from + i]]))
            ctx.stroke()
        },
        between(xs, upper, lower) {
            if (columns(xs, upper, lower, 0)) return
            const [from, to] = inSight(xs)
            let run = []
            for (let i = from; i <= to + 1; i++) {
                if (i <= to && known(upper[i]) && known(lower[i])) run.push(i)
                else {
                    // One area of all that hang together.
                    this.area([...run.map(i => [xs[i], upper[i]]), ...run.reverse().map(i => [xs[i], lower[i]])])
                    run = []
                }
            }
        },
    }
}

function painted(u, painters) {
    const { ctx, bbox } = u, pen = penOf(u)
    ctx.save()
    ctx.beginPath()
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height)
    ctx.clip()
    for (const paint of painters) if (paint) { ctx.save(); paint(pen, u); ctx.restore() }
    ctx.restore()
}

/** A legend of { label, colour, kind, alpha, value(index), check: properties of a box to tick }; its `show(index, x)` writes the values at a place. */
export function legend(entries, at) {
    const place = at && make("output.at"), values = []
    const list = make("ul.key", ...entries.filter(Boolean).map(({ label, colour = "ink", kind = "line", alpha = 1, value, check }) => {
        const output = value && make("output.value"), swatch = make("i", { tint: colour, class: "swatch " + kind }, kind === "cross" ? "×" : "")
        swatch.style.opacity = alpha
        if (value) values.push([output, value])
        return make("li", make(check ? "label" : "span", check && make("input", { type: "checkbox", ...check }), kind !== "none" && swatch, label), output)
    }), place && make("li", place))
    list.show = (index, x) => {
        if (place) place.textContent = index == null ? "" : at(x, index)
        for (const [output, value] of values) output.textContent = index == null ? "" : value(index)
    }
    return list
}

// ---- the plot

const span = ([low, high]) => high > low ? [low, high] : [low - (Math.abs(low) || 1) / 2, low + (Math.abs(low) || 1) / 2]

/** Some room around what is in sight. */
function around(low, high, log) {
    if (low == null || high == null) return log ? [1e-9, 1] : [0, 1]
    const room = 10 ** (0.04 * Math.max(Math.log10(high / low), 1)), [a, b] = span([low, high])
    return log ? [low / room, high * room] : [a - 0.05 * (b - a), b + 0.05 * (b - a)]
}

/** Of numbers below an axis, those that neither touch the one before nor reach beyond the edge. */
function apart(texts, places, edge) {
    let end = -Infinity
    return texts.map((text, i) => {
        const half = 3.1 * text.length
        if (!text || places[i] - half < end + 6 || places[i] + half > edge) return ""
        end = places[i] + half
        return text
    })
}

function axisOf(axis, name, small) {
    const vertical = name === "y", own = font(SIZE), faint = { stroke: () => colour("line") }
    const length = u => (vertical ? u.bbox.height : u.bbox.width) / uPlot.pxRatio || (vertical ? u.height : u.width) * 0.9
    const room = u => Math.max(2, Math.floor(length(u) / (vertical ? 24 : axis.room ?? 55)))
    return {
        side: vertical ? 3 : 2, stroke: () => colour("quiet"), font: own, labelFont: own,
        label: axis.bare ? null : axis.label, labelSize: axis.label && !axis.bare ? 16 : 0, labelGap: vertical ? 2 : 0, gap: 4,
        grid: { ...faint, show: axis.grid ?? true, width: 0.5 }, ticks: { ...faint, show: !small && !axis.bare, width: 1, size: 4 }, border: { ...faint, show: true, width: 1 },
        splits: (u, _, low, high) => (axis.splits ?? (axis.log ? decades : ticks))(low, high, room(u), length(u)),
        filter: (_, splits) => splits,
        values(u, splits) {
            const { min, max } = u.scales[name], all = length(u)
            const written = () => {
                if (axis.bare) return splits.map(() => "")
                if (axis.values) return axis.values(splits, all)
                if (axis.log) return splits.map(value => power(value))
                const step = splits[1] - splits[0] || stepFor(max - min, room(u))
                return splits.map(value => fixed(value, decimals(step)))
            }
            return vertical ? written() : apart(written(), splits.map(value => all * (value - min) / (max - min)), all + RIGHT)
        },
        // As wide as its longest number; `least` letters, so that panels below each other agree.
        size: vertical ? (_, values) => Math.ceil(6.3 * (values ?? []).reduce((most, text) => Math.max(most, text.length), axis.least ?? 3)) + 10 : axis.bare ? 0 : 22,
    }
}

/**
 * Draws a plot into `host`:
 * `x`, `y`: { label, range, log, splits(low, high, room), values(splits) }, without `y.range` it follows what is in sight;
 * `data`: [xs, ys, ..]; `lines`: { colour, width, alpha, dash, dots, hidden } a ys; `bands`: [{ between: [i, j], colour, alpha }];
 * `behind(pen)`, `front(pen)`: painters; `marks`: [{ x, y, text, title, colour, line, dash, half, press, chosen }], see modeMarks;
 * `legend`: entries; `at(x, index)`: the cursor's place in words; `name`: what it shows, by itself the sentence of its figure;
 * `zoom`: its name in the view; `opening`: in sight where the view has none; `with`: a Set of plots that zoom alike; `moved(low, high)`;
 * `press(x, y)`: a click, or Enter; `noted`: marks are explained below; `quiet`: no button; `still`: no zoom; `small`: one of many.
 */
export function plot(host, options) {
    const { x, y, data = [x.range, [null, null]], lines = [], marks = [], small, still } = options
    const caption = host.closest("figure")?.querySelector("figcaption"), named = options.name ?? caption?.querySelector("p:last-child")?.textContent ?? ""
    const whole = span(x.range), zoomName = options.zoom && "zoom." + options.zoom
    function inside([a, b]) {
        const [low, high] = whole, least = (high - low) / MOST_ZOOM
        if (b - a < least) { a = (a + b - least) / 2; b = a + least }
        if (b - a >= high - low) return whole
        if (a < low) { b += low - a; a = low }
        return b > high ? [a - (b - high), high] : [a, b]
    }
    const opening = options.opening ? inside(options.opening) : whole
    const asked = () => {
        const wanted = zoomName && view.get(zoomName)
        return Array.isArray(wanted) && wanted.length === 2 && wanted.every(known) && wanted[1] > wanted[0] ? inside(wanted) : opening
    }

    const box = make("div.plot", { ...(!still && { tabIndex: 0, role: "group", "aria-label": `${caption?.firstChild.textContent}: plus and minus zoom, arrows move, 0 shows the whole${options.press ? ", Shift and arrows move the cursor, Enter picks" : ""}` }) })
    const again = make("button.whole", { hidden: true, onclick: () => to(whole) }, "whole")
    const key = options.legend && legend(options.legend, options.at)
    const hint = options.noted && make("output.note")
    if (key && !small) host.append(key)
    box.append(again)
    host.append(box, hint || "")

    const rows = marks.some(mark => mark.text) ? 2 : 0, height = Math.round((options.height ?? 300) * (printing() ? PRINTED : 1))
    const width = () => Math.max(120, Math.floor(box.clientWidth))
    let settled = 0, applying = true
    const isWhole = () => u.scales.x.min <= whole[0] && u.scales.x.max >= whole[1]
    function tellPlace(u) {
        const { left } = u.cursor
        key?.show(left >= 0 ? u.posToIdx(left) : null, u.posToVal(left, "x"))
    }

    const u = new uPlot({
        width: width(), height,
        padding: [rows * MARK_ROW + (rows ? 4 : 8), RIGHT, x.bare ? 6 : null, null],
        legend: { show: false },
        cursor: {
            show: options.cursor ?? !small, y: options.crosshair ?? false,
            points: { size: 6, show: !still && lines.some(line => !line.hidden) },
            drag: { x: !still, y: false, setScale: !still, dist: 4 },
            bind: { dblclick: () => () => { if (!still) to(whole); return null } },
            ...(options.sync && { sync: { key: options.sync, scales: ["x", null] } }),
        },
        scales: {
            x: { time: false, auto: false, range: (_, low, high) => [low ?? whole[0], high ?? whole[1]] },
            y: { distr: y.log ? 3 : 1, auto: !y.range, range: (_, low, high) => y.range ?? (y.fit ?? around)(low, high, y.log) },
        },
        axes: [axisOf(x, "x", small), axisOf(y, "y", small)],
        series: [{}, ...data.slice(1).map((_, i) => {
            const { hidden = !lines[i], dots, colour: name = "ink" } = lines[i] ?? {}, stroke = () => hidden ? "#0000" : colour(name)
            // Curves are drawn by drawLines.
            return { stroke, width: 0, paths: () => null, points: { show: Boolean(dots), size: dots, width: 0, fill: stroke, stroke } }
        })],
        hooks: {
            drawAxes: [u => painted(u, [options.behind, drawMarks, drawBands])],
            draw: [u => { painted(u, [drawLines, options.front]); placeMarks() }],
            setCursor: [tellPlace],
            setScale: [(u, name) => {
                const { min, max } = u.scales.x
                if (name !== "x" || min == null) return
                again.hidden = still || options.quiet || isWhole()
                // What is under the pointer is another place now.
                tellPlace(u)
                if (applying) return
                const [low, high] = inside([min, max])
                if (low !== min || high !== max) return void queueMicrotask(() => to([low, high]))
                options.moved?.(low, high)
                for (const other of options.with ?? []) if (other !== made) other.quietly([low, high])
                if (!zoomName) return
                clearTimeout(settled)
                settled = setTimeout(() => view.set({ [zoomName]: isWhole() && opening === whole ? null : [low, high].map(v => Number(v.toPrecision(7))) }), SETTLED_MS)
            }],
        },
    }, null, box)
    const drawing = u.root.querySelector("canvas")
    drawing.setAttribute("role", "img")
    drawing.setAttribute("aria-label", named)

    function drawBands(pen) {
        for (const { between: [upper, lower], colour, alpha = 0.25 } of options.bands ?? []) {
            pen.style(colour, { alpha })
            pen.between(u.data[0], u.data[upper], u.data[lower])
        }
    }
    function drawLines(pen) {
        lines.forEach((line, i) => {
            if (line.hidden || line.dots) return
            pen.style(line.colour ?? "ink", line)
            pen.trace(u.data[0], u.data[i + 1], line.width ?? 1.5)
        })
    }

    // ---- marks: a line in the plot with a label above it, or a label at a place of its own

    function drawMarks(pen) {
        const [low, high] = [u.scales.y.min, u.scales.y.max]
        for (const { x, half, line, colour = "ink", chosen, alpha = 0.4, dash } of marks) {
            if (half > 0) { pen.style(colour, { alpha: 0.18 }); pen.box(x - half, low, x + half, high) }
            if (line === false) continue
            pen.style(colour, { width: chosen ? 1.6 : 0.8, alpha: chosen ? 0.9 : alpha, dash })
            pen.line([[x, low], [x, high]])
        }
    }
    const say = mark => { if (hint) hint.textContent = mark.title ?? "" }
    const labels = marks.map(mark => {
        if (!mark.text) return null
        const label = make("button", {
            tint: mark.colour ?? "ink", class: `mark${mark.chosen ? " chosen" : ""}${mark.y === undefined ? "" : " free"}`, "aria-label": mark.title, title: hint ? null : mark.title,
            onclick: event => { event.stopPropagation(); say(mark); mark.press?.() },
            onpointerenter: () => say(mark), onfocus: () => say(mark), onmousedown: event => event.stopPropagation(), ondblclick: event => event.stopPropagation(),
        }, mark.text)
        if (mark.isStruck) label.style.textDecoration = "line-through"
        return label
    })
    const buttons = labels.filter(Boolean)
    // One stop for the Tab key; arrows go from mark to mark.
    u.over.append(make("div.marks", { onkeydown: event => {
        const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key], seen = buttons.filter(button => !button.hidden)
        if (!by) return
        event.preventDefault()
        event.stopPropagation()
        seen[(seen.indexOf(document.activeElement) + by + seen.length) % seen.length]?.focus()
    } }, ...buttons))

    function placeMarks() {
        const { min, max } = u.scales.x, taken = Array.from({ length: rows }, () => [])
        const order = marks.map((_, i) => i).filter(i => labels[i]).sort((a, b) => Boolean(marks[b].chosen) - Boolean(marks[a].chosen) || marks[a].x - marks[b].x)
        for (const i of order) {
            const { x, y, text } = marks[i], at = u.valToPos(x, "x"), half = 3.6 * text.length + 3
            const row = taken.findIndex(spots => !spots.some(([from, to]) => at - half < to && at + half > from))
            labels[i].hidden = !(x >= min && x <= max) || y === undefined && row < 0
            if (labels[i].hidden) continue
            if (y === undefined) taken[row].push([at - half, at + half])
            labels[i].style.transform = y === undefined ? `translate(${at}px, ${-(row + 1) * MARK_ROW}px) translateX(-50%)` : `translate(${at}px, ${u.valToPos(y, "y")}px) translate(-50%, -50%)`
        }
        const seen = buttons.filter(button => !button.hidden), stop = seen.find(button => button.classList.contains("chosen")) ?? seen[0]
        for (const button of buttons) button.tabIndex = button === stop ? 0 : -1
    }

    // ---- zoom

    const sight = () => [u.scales.x.min, u.scales.x.max]
    function to(range) {
        const [min, max] = inside(range)
        u.setScale("x", { min, max })
    }
    function by(factor, centre = 0.5) {
        const [a, b] = sight(), middle = a + centre * (b - a)
        to([middle - (middle - a) * factor, middle + (b - middle) * factor])
    }
    function move(share) {
        const [a, b] = sight()
        to([a + share * (b - a), b + share * (b - a)])
    }
    const pressed = (left, top) => options.press?.(u.posToVal(left, "x"), u.posToVal(top, "y"), u)
    const { over } = u
    let down = [0, 0]
    over.addEventListener("pointerdown", event => { down = [event.clientX, event.clientY] })
    over.addEventListener("click", event => {
        box.focus({ preventScroll: true })
        const { left, top } = over.getBoundingClientRect()
        if (Math.hypot(event.clientX - down[0], event.clientY - down[1]) < 4) pressed(event.clientX - left, event.clientY - top)
    })
    if (!still) {
        // The wheel zooms a plot that has the focus, or with Ctrl; otherwise a page full of plots could not be scrolled.
        over.addEventListener("wheel", event => {
            if (!event.ctrlKey && !event.metaKey && !box.contains(document.activeElement) || event.deltaY > 0 && isWhole()) return
            event.preventDefault()
            const { left, width } = over.getBoundingClientRect()
            if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) move(event.deltaX / width)
            else by(Math.exp(clamp(event.deltaY * 0.002, -0.5, 0.5)), (event.clientX - left) / width)
        }, { passive: false })
        box.addEventListener("keydown", event => {
            if (event.altKey || event.ctrlKey || event.metaKey || event.target !== box) return
            const cursor = by => u.setCursor({ left: clamp((u.cursor.left < 0 ? over.clientWidth / 2 : u.cursor.left) + by, 0, over.clientWidth), top: over.clientHeight / 2 })
            const sideways = sign => event.shiftKey || isWhole() ? cursor(4 * sign) : move(0.15 * sign)
            const act = {
                "+": () => by(0.7), "=": () => by(0.7), "-": () => by(1 / 0.7), 0: () => to(whole), Escape: () => to(whole),
                ArrowLeft: () => sideways(-1), ArrowRight: () => sideways(1), Enter: () => u.cursor.left >= 0 ? pressed(u.cursor.left, u.cursor.top) : cursor(0),
            }[event.key]
            if (!act) return
            event.preventDefault()
            act()
        })
        // Two fingers zoom, one moves sideways; up and down still scrolls the page.
        const fingers = new Map()
        over.style.touchAction = "pan-y"
        over.addEventListener("pointerdown", event => { if (event.pointerType === "touch") fingers.set(event.pointerId, event.clientX) })
        over.addEventListener("pointermove", event => {
            if (!fingers.has(event.pointerId)) return
            const { left, width } = over.getBoundingClientRect(), before = [...fingers.values()]
            fingers.set(event.pointerId, event.clientX)
            const after = [...fingers.values()], [d0, d1] = [before, after].map(([a, b]) => Math.max(Math.abs(a - b), 8))
            if (after.length === 1) move((before[0] - after[0]) / width)
            else by(d0 / d1, ((after[0] + after[1]) / 2 - left) / width)
        })
        for (const name of ["pointerup", "pointercancel", "pointerleave"]) over.addEventListener(name, event => fingers.delete(event.pointerId))
    }

    // ---- life

    const made = {
        u,
        to,
        /** Without telling anyone. */
        quietly([min, max]) {
            if (u.scales.x.min === min && u.scales.x.max === max) return
            applying = true
            u.setScale("x", { min, max })
            queueMicrotask(() => {
                applying = false
                options.moved?.(min, max)
            })
        },
        set(next) {
            u.setData(next, false)
            u.redraw(true, true)
            // The place under the pointer has another index now.
            tellPlace(u)
        },
        free() {
            clearTimeout(settled)
            options.with?.delete(made)
            watch.disconnect()
            unfollow()
            u.destroy()
        },
    }
    options.with?.add(made)
    u.batch(() => {
        u.setData(data, true)
        const [min, max] = asked()
        u.setScale("x", { min, max })
    })
    queueMicrotask(() => { applying = false })
    const watch = new ResizeObserver(() => { if (box.clientWidth && width() !== u.width) u.setSize({ width: width(), height }) })
    watch.observe(box)
    // A link, or the Back button, changes the zoom from outside.
    const unfollow = view.follow(names => { if (names.includes(zoomName)) made.quietly(asked()) })
    return made
}

// ---- what pictures share

/** A labelled choice of [value, text], or of [group, [[value, text], ..]]; it sets `name` in the view. */
export function choice(label, name, choices, value) {
    const option = ([each, text]) => Array.isArray(text) ? make("optgroup", { label: each }, ...text.map(option)) : make("option", { value: each, selected: each === value }, text ?? each)
    const select = make("select", { onchange: () => view.set({ [name]: select.value }) }, ...choices.map(option))
    return make("div.controls", make("label.choice", label, " ", select))
}
export const setupOf = setups => setups.find(one => one.setup === view.get("setup")) ?? setups[0]
/** The choice of a setup where there are several. */
export const setupChoice = setups => setups.length > 1 ? choice("setup", "setup", setups.map(one => [one.setup]), setupOf(setups).setup) : ""

export const freeing = plots => () => plots.forEach(plot => plot.free())
export const chosenMode = () => Number(view.get("mode"))

/** The modes of the study as marks, the chosen one strong. */
export const modeMarks = data => items(data.modes?.modes).filter(mode => known(mode.frequency_hz)).map(mode => ({
    x: mode.frequency_hz, text: String(mode.number), chosen: mode.number === chosenMode(), is: mode,
    title: `mode ${mode.number}: ${hertz(mode.frequency_hz)}, damping ${percent(mode.damping_ratio)}`,
    press: () => view.set({ mode: mode.number }),
}))
