// The error, falling step by step: as effects come into the model, and of what was left out of the fit.

import { extent, items, plot } from "@/curves.js"
import { fixed, known, power } from "@/numbers.js"

const LINES = [["mean_abs_frequency_error_percent", "frequencies", []], ["held_out_mode_error_percent", "left-out modes", [7, 4]], ["held_out_error_percent", "left-out sensors", [2, 3]]]
const written = value => `${fixed(value, value < 0.1 ? 3 : value < 10 ? 2 : 1)} %`

export default {
    id: "history",
    title: "The error, step by step",
    from: "history",
    has: data => items(data.history).some(step => LINES.some(([key]) => step[key] > 0)),
    draw(host, data) {
        const steps = items(data.history), count = steps.length
        const lines = LINES.map(([key, label, dash], kind) => ({ label, dash, kind, values: steps.map(step => step[key]) })).filter(line => line.values.some(value => value > 0))
        const [low, high] = extent(lines.flatMap(line => line.values), true) ?? [0.1, 1], log = high / low > 6
        return plot(host, {
            height: 300, still: true, cursor: false,
            x: {
                range: [-0.3, count - 0.3], grid: false, splits: () => steps.map((_, i) => i),
                // Names may be long: as much of each as there is room for.
                values(splits, length) {
                    const letters = Math.max(3, Math.floor(length / count / 6.2) - 1), names = steps.map(({ action, step }) => action === "start" ? "as first given" : String(action ?? `step ${step}`))
                    return splits.map(i => names[i].length > letters ? names[i].slice(0, letters - 1) + "…" : names[i])
                },
            },
            y: {
                label: log ? "error in % (logarithmic)" : "error in %", log, range: log ? [low / 1.6, high * 1.6] : [0, high * 1.15],
                ...(log && { values: splits => splits.map(value => value < 0.001 ? power(value) : String(Number(value.toPrecision(3)))) }),
            },
            front(pen) {
                for (const { values, dash, kind } of lines) {
                    pen.style("ink", { width: 1.6, dash })
                    pen.line(values.map((value, i) => [i, value > 0 ? value : NaN]))
                    pen.style("ink", { width: 1.6 })
                    values.forEach((value, i) => { if (value > 0) pen.dot(i, value, 3.5 + 2 * kind, kind > 0) })
                }
                // The value beside each point, where no other is in the way.
                for (let i = 0; i < count; i++) {
                    let last = Infinity
                    for (const { value, next } of lines.map(({ values }) => ({ value: values[i], next: values[i + 1] })).filter(({ value }) => value > 0).sort((a, b) => a.value - b.value)) {
                        if (last - pen.y(value) < 13 * pen.ratio) continue
                        last = pen.y(value)
                        // Below a line that rises.
                        pen.text(written(value), i, value, "left", 8, next > value ? 11 : -9)
                    }
                }
            },
            legend: lines.map(({ label, kind }) => ({ label, kind: ["line", "dash", "dots"][kind] })),
        }).free
    },
}
