// Tables of numbers as coloured cells on a canvas: MAC, Psi, shapes by sensor and mode. Numbers stand in the cells where there is room.

import { LEAST_PRINTED, canvas, colour, font, inkOn, printing, ramp, size } from "@/canvas.js"
import { clamp } from "@/numbers.js"

// Room for column labels and the key, pixels.
const BELOW = 72
// Smaller numbers cannot be read.
const LEAST_TEXT = 8
// Least distance of labels.
const APART = 12.5

/**
 * Draws `values[row][column]` into `host`, cells at most `most` pixels wide and `down` high, by themselves square. `hue(value)` is a
 * cell's colour, `text(value, brief)` its number; `axes` are the titles of rows and columns, `left` the room for row labels, `key` [title, least,
 * largest, their labels]. `strong(row, column)`: bold numbers, and bold labels where only one of the two is given. `point(row, column,
 * click)` hears what is under the pointer.
 */
export function matrix(host, values, { rows, columns, axes, sentence, hue, text, key, most, down, left = 46, strong, point }) {
    const sheet = canvas(sentence)
    host.append(sheet)
    const width = Math.max(160, host.clientWidth), side = Math.min((width - left - 6) / columns.length, most), high = down ?? side, tall = 4 + high * rows.length, wide = side * columns.length
    const pen = size(sheet, width, tall + BELOW - 4)
    const write = (words, x, y, pixels, align = "center", weight) => {
        pen.font = font(pixels, weight)
        pen.textAlign = align
        pen.fillText(words, x, y)
    }
    const least = printing() ? LEAST_PRINTED : LEAST_TEXT, weight = (r, c) => strong(r, c) ? "700" : ""
    pen.textBaseline = "middle"
    pen.font = font(10)
    let texts, pixels = 0
    // Fewer digits where all do not fit.
    for (const brief of text ? [false, true] : []) if (pixels < least) {
        texts = values.map(line => line.map(value => text(value, brief)))
        pixels = Math.min(11, 10 * (side - 4) / pen.measureText(texts.flat().reduce((a, b) => b.length > a.length ? b : a, "0")).width)
    }
    values.forEach((line, r) => line.forEach((value, c) => {
        const x = left + c * side, y = 4 + r * high, fill = hue(value)
        pen.fillStyle = fill
        pen.fillRect(x, y, Math.max(side - 0.6, 0.4), Math.max(high - 0.6, 0.4))
        pen.fillStyle = inkOn(fill)
        if (pixels >= least) write(texts[r][c], x + side / 2, y + side / 2, pixels, "center", weight(r, c))
    }))
    const labels = clamp(side * 0.5 + 1, Math.max(least, 8), 12)
    pen.fillStyle = colour("ink")
    const along = (list, at, put) => {
        let last = -Infinity
        list.forEach((label, i) => {
            if (label === "" || at(i) - last < APART) return
            last = at(i)
            put(label, last, i)
        })
    }
    along(rows, r => 4 + (r + 0.5) * high, (label, y, r) => write(label, left - 5, y, down ? 11 : labels, "right", weight(r)))
    along(columns, c => left + (c + 0.5) * side, (label, x, c) => write(label, x, tall + 10, labels, "center", weight(undefined, c)))
    const [title, from, to, ...ends] = key, long = clamp(wide / 2, 150, 240), y = tall + 42
    ramp(pen, left, y, long, share => hue(from + (to - from) * share))
    pen.fillStyle = colour("quiet")
    write(axes[1], left + wide / 2, tall + 25, 11)
    write(ends[0], left, y + 18, 11, "left")
    write(title, left + long / 2, y + 18, 11)
    write(ends[1], left + long, y + 18, 11, "right")
    pen.translate(8, tall / 2)
    pen.rotate(-Math.PI / 2)
    write(axes[0], 0, 0, 11)

    for (const kind of ["pointermove", "click"]) sheet.addEventListener(kind, event => {
        const box = sheet.getBoundingClientRect(), zoom = width / box.width
        const r = Math.floor(((event.clientY - box.top) * zoom - 4) / high), c = Math.floor(((event.clientX - box.left) * zoom - left) / side)
        if (values[r]?.[c] !== undefined) point(r, c, kind === "click")
    })
}
