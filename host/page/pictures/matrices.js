// Two matrices. Do the model's shapes agree with the measured ones: the modal assurance criterion of all pairs of modes, for the model as
// given, after the direct update, and with effects. And what did the direct update change: Psi, which couples the model's modes; its
// diagonal moves frequencies, the rest turns shapes.

import { colour, make, mix, printing } from "@/canvas.js"
import { matrix } from "@/matrix.js"
import { KINDS, clamp, fixed, kindsOf, known, mac as written, percent, significant } from "@/numbers.js"

const sane = d => Object.keys(KINDS).flatMap(what => (d.mac ?? []).filter(m => m.what === what && m.values?.length && m.measured?.length && m.model?.length))
const best = m => m.values.map(row => row.reduce((a, b) => Math.max(a, b ?? 0), 0))
// Cut, never rounded up: only the same shape is 1, and .99 stands for all from 0.99 on.
const short = (v, brief) => v >= 0.05 ? (brief ? fixed(Math.floor(100 * v + 1e-9) / 100, 2) : written(v)).replace("0.", ".") : ""

// What each MAC matrix was drawn of, and its canvas; and the note that their cells write to.
const drawn = new Map(), note = make("p.quiet.no-print")

export const macs = {
    id: "mac", title: "Agreement of shapes (MAC)", follows: ["mode"], uses: ["mac"],
    has: d => sane(d).length > 0,
    says(d) {
        const parts = sane(d).map(m => {
            const all = best(m), low = Math.min(...all)
            return `${kindsOf(d)[m.what]} at least ${written(low)} (mode ${m.measured[all.indexOf(low)]})`
        })
        return `Each measured mode against each of the model's; 1 is the same shape. Of the best pairs: ${parts.join(", ")}.` + (sane(d).some(m => m.what === "updated") ? " The direct update turns shapes within their span, so a good MAC after it is no evidence." : "")
    },
    draw(host, d, view) {
        const grid = make("div.matrices")
        note.textContent = "\u00a0"
        host.append(grid, note)
        const list = sane(d).map(m => {
            const cell = make("div", make("h4", { tint: m.what + "-text" }, kindsOf(d)[m.what]))
            grid.append(cell)
            return [m, cell]
        })
        for (const [m, cell] of list) {
            const none = colour("low"), full = colour(m.what)
            // A slider moves one of them; the others stay as they are drawn.
            const key = JSON.stringify([m, view.get("mode"), cell.clientWidth, none, full, colour("ink"), printing(), devicePixelRatio]), before = drawn.get(m.what)
            if (before?.key === key) {
                cell.append(before.sheet)
                continue
            }
            matrix(cell, m.values, { rows: m.measured, columns: m.model, axes: ["measured mode", "model's mode"], most: 40, key: ["MAC", 0, 1, "0", "1"], text: short,
                sentence: `${KINDS[m.what]}: best MAC of modes ${m.measured.join(", ")} is ${best(m).map(written).join(", ")}`,
                hue: v => mix(none, full, (v || 0) ** 2), strong: r => m.measured[r] === view.get("mode"),
                point(r, c, click) {
                    note.textContent = `${KINDS[m.what]}: measured mode ${m.measured[r]}, model's mode ${m.model[c]}, MAC ${written(m.values[r][c])}`
                    if (click) view.set({ mode: m.measured[r] })
                } })
            drawn.set(m.what, { key, sheet: cell.lastChild })
        }
    },
}

const largest = psi => psi.flat().reduce((m, v) => Math.max(m, Math.abs(v) || 0), 0)
const labels = d => d.update.psi.map((_, i) => d.update.pairs?.[i]?.measured ?? i + 1)

export const psi = {
    id: "psi", title: "Psi of the direct update", follows: ["mode"], from: "update",
    has: d => Array.isArray(d.update?.psi) && d.update.psi.length > 0 && d.update.psi.every(Array.isArray),
    says(d) {
        const { psi, psi_size: share, mean_abs_frequency_error_percent: error } = d.update, names = labels(d), most = largest(psi)
        const r = Math.max(0, psi.findIndex(row => row.some(v => Math.abs(v) === most))), c = Math.max(0, psi[r].findIndex(v => Math.abs(v) === most))
        return (r === c ? `The strongest change is that of mode ${names[r]} itself` : `The strongest coupling is between modes ${names[r]} and ${names[c]}`) + ` (${significant(psi[r][c])} 1/s²).`
            + (share != null ? ` Psi is ${percent(share, 1)} of the eigenvalues in size.` : "")
            + (error ? ` The mean frequency error goes from ${fixed(error.before, 2)} to ${fixed(error.after, 2)} % by construction, which proves nothing about the model.` : "")
    },
    draw(host, d, view) {
        const { psi } = d.update, names = labels(d), most = largest(psi) || 1, digits = clamp(2 - Math.floor(Math.log10(most)), 0, 6)
        const zero = colour("low"), more = colour("given"), less = colour("measured"), note = make("p.quiet.no-print", "\u00a0")
        matrix(host, psi, { rows: names, columns: names, axes: ["mode", "mode"], most: printing() ? 20 : 46, key: ["Psi, 1/s²", -most, most, significant(-most), "+" + significant(most)], sentence: this.says(d),
            // Square root: couplings of a tenth are to be seen beside the largest.
            hue: v => mix(zero, v > 0 ? more : less, Math.sqrt(Math.abs(v) / most || 0)), text: v => known(v) ? fixed(v, digits) : "",
            strong: (r, c) => [names[r], names[c]].includes(view.get("mode")),
            point: (r, c) => note.textContent = `Modes ${names[r]} and ${names[c]}: ${significant(psi[r][c], 4)} 1/s²` })
        host.append(note)
    },
}
