// Spectra over time: every row a part of the record, colours by density.

import { canvas, make, ramp, size } from "@/canvas.js"
import { densityIn, items, modeMarks, plot, setupChoice, setupOf, steps, unpack } from "@/curves.js"
import { clamp, duration, fixed, hertz, inWords, plural } from "@/numbers.js"

// Pixels of the image in either direction.
const MOST = 2048
// Shares of the densities at the ends of the colours.
const ENDS = [0.02, 0.995]

const setupsOf = data => items(data.record?.setups).filter(({ waterfall }) => waterfall?.rows > 0 && waterfall.columns > 0 && waterfall.values)

// A colour map that is perceptually uniform (viridis): [r, g, b] of a share from 0 to 1.
const VIRIDIS = [[68, 1, 84], [72, 36, 117], [65, 68, 135], [53, 95, 141], [42, 120, 142], [33, 145, 140], [34, 168, 132], [68, 191, 112], [122, 209, 81], [189, 223, 38], [253, 231, 37]]
function viridis(share) {
    const at = clamp(share, 0, 1) * 10, i = Math.min(Math.floor(at), 9)
    return VIRIDIS[i].map((from, k) => Math.round(from + (at - i) * (VIRIDIS[i + 1][k] - from)))
}

/** The bar of colours between two texts. */
function key(low, high) {
    const bar = canvas("Colours from low to high")
    ramp(size(bar, 240, 9), 0, 0, 240, share => `rgb(${viridis(share)})`)
    return make("p.colours", low, bar, high)
}

/** The image of all densities, and the powers of ten at the ends of its colours. */
function image(density, columns, rows) {
    const known = Float64Array.from(density).filter(value => value > 0).sort()
    const [from, to] = ENDS.map(share => Math.log10(known[Math.floor(share * known.length)] ?? 1)), span = Math.max(to - from, 0.3)
    const [across, up] = [Math.min(columns, MOST), Math.min(rows, MOST)]
    const element = make("canvas", { width: across, height: up }), pen = element.getContext("2d"), pixels = pen.createImageData(across, up)
    for (let j = 0; j < up; j++) for (let i = 0; i < across; i++) {
        // The greatest of all that falls on a pixel: a narrow peak is not lost.
        let most = 0
        for (let r = Math.floor(j * rows / up); r < Math.ceil((j + 1) * rows / up); r++)
            for (let c = Math.floor(i * columns / across); c < Math.ceil((i + 1) * columns / across); c++) if (density[r * columns + c] > most) most = density[r * columns + c]
        if (most > 0) pixels.data.set([...viridis((Math.log10(most) - from) / span), 255], 4 * ((up - 1 - j) * across + i))
    }
    pen.putImageData(pixels, 0, 0)
    return { element, from, to: from + span }
}

export default {
    id: "waterfall",
    title: "Spectra over time",
    follows: ["setup", "mode"],
    says(data) {
        const { setup, waterfall: { rows, row_s } } = setupOf(setupsOf(data))
        return `${plural(rows, "spectrum", "spectra")}, one for every ${duration(row_s)} of ${setupsOf(data).length > 1 ? inWords(setup) : "the record"}: a mode is a line that stands still; what comes and goes is a machine or a gust.`
    },
    has: data => setupsOf(data).length > 0,
    draw(host, data) {
        const setups = setupsOf(data), { setup, waterfall: { columns, rows, row_s, first_hz, spacing_hz, values } } = setupOf(setups)
        const density = unpack(values), { element, from, to } = image(density, columns, rows)
        const range = [first_hz - spacing_hz / 2, first_hz + (columns - 0.5) * spacing_hz], xs = steps(first_hz, spacing_hz, columns)
        const hours = rows * row_s / 3600, short = hours < 2, top = hours * (short ? 60 : 1), modes = modeMarks(data)
        host.append(setupChoice(setups))
        const chart = plot(host, {
            zoom: "hz", height: Math.min(420, 180 + 3 * rows), crosshair: true,
            x: { label: "frequency in Hz", range, grid: false },
            y: { label: short ? "time in min" : "time in h", range: [0, top], grid: false },
            data: [xs, Array(columns).fill(null)],
            behind(pen) {
                pen.ctx.imageSmoothingEnabled = false
                pen.ctx.drawImage(element, pen.x(range[0]), pen.top, pen.x(range[1]) - pen.x(range[0]), pen.bottom - pen.top)
            },
            // Modes at the edge only: a line across would hide what it marks.
            marks: modes.map(mark => ({ ...mark, line: mark.chosen })),
            front(pen) {
                for (const [name, width] of [["paper", 4], ["ink", 1.8]]) {
                    pen.style(name, { width })
                    for (const { x } of modes) pen.line([[x, top], [x, 0.97 * top]])
                }
            },
            at(_, index) {
                const row = Math.min(rows - 1, Math.max(0, Math.floor((1 - chart.u.cursor.top / chart.u.over.clientHeight) * rows))), value = density[row * columns + index]
                return `${hertz(xs[index])}, ${duration(row * row_s)}: ${value > 0 ? `${fixed(10 * Math.log10(value), 1)} dB` : "no data"}`
            },
            legend: [],
        })
        host.append(key(`${fixed(10 * from, 0)} dB`, `${fixed(10 * to, 0)} dB of 1 ${densityIn(items(data.spectra?.setups).find(one => one.setup === setup))}, all channels together`))
        return chart.free
    },
}
