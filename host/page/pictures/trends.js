// Every mode over hours and months: frequency and damping, beside temperature and level.

import { make, printing } from "@/canvas.js"
import { choice, chosenMode, clean, extent, freeing, items, legend, motionIn, plot, scaled, setupChoice, setupOf } from "@/curves.js"
import { fixed, hertz, known, significant, within } from "@/numbers.js"
import { timeAxis } from "@/pictures/record.js"

const of = (data, name) => items(data.modes?.trends?.[name])
/** The setups with their intervals, the one with most of them first. */
function setupsOf(data) {
    const setups = new Map()
    for (const interval of of(data, "intervals")) setups.set(interval.setup, [...setups.get(interval.setup) ?? [], interval])
    return [...setups].map(([setup, intervals]) => ({ setup, intervals })).sort((a, b) => b.intervals.length - a.intervals.length)
}

// Apart by more than so many intervals, two are not joined: what lies between was not measured.
const GAP = 1.5
/** The intervals with an empty one in each gap, which breaks every curve. */
const withGaps = intervals => intervals.flatMap((one, i) => {
    const next = intervals[i + 1], long = one.end_s - one.start_s
    return next && next.start_s - one.start_s > GAP * long ? [one, { start_s: one.end_s, end_s: next.start_s }] : [one]
})

export default {
    id: "trends",
    title: "Modes over time",
    long: true,
    follows: ["setup", "trend", "mode"],
    has: data => of(data, "intervals").some(interval => items(interval.modes).length),
    draw(host, data, view) {
        const setups = setupsOf(data), { setup, intervals: measured } = setupOf(setups), intervals = withGaps(measured), isDamping = view.get("trend") === "damping"
        const middle = intervals.map(interval => (interval.start_s + interval.end_s) / 2), range = extent(intervals.flatMap(interval => [interval.start_s, interval.end_s])) ?? [0, 1]
        const axis = timeAxis(items(data.record?.setups).find(one => one.setup === setup)?.start, range[1])
        host.append(setupChoice(setups), choice("of each mode", "trend", [["frequency"], ["damping"]], isDamping ? "damping" : "frequency"),
            legend([{ label: "each interval, bar: ± 2 standard deviations", colour: "measured", kind: "dot" }, { label: "mean", kind: "dash" }]))
        const levels = intervals.map(interval => Math.sqrt(items(interval.modes).reduce((sum, mode) => sum + (mode.response_rms || 0) ** 2, 0)) || NaN), [least, most] = extent(levels, true) ?? [1, 1]
        const { factor, unit } = scaled(motionIn(items(data.spectra?.setups).find(one => one.setup === setup)), most)
        const numbers = new Set(intervals.flatMap(interval => items(interval.modes).map(mode => mode.number)))
        const panels = [
            { name: "temperature in °C", values: intervals.map(interval => interval.temperature_degc), colour: "series-3" },
            { name: `response, RMS of all modes in ${unit}`, values: levels.map(level => level * factor), colour: "rejected", log: most > 4 * least },
            ...[...numbers].sort((a, b) => a - b).map(number => {
                const seen = intervals.map(interval => items(interval.modes).find(mode => mode.number === number)), trend = of(data, "modes").find(mode => mode.number === number)
                const [value, deviation, factor] = isDamping ? ["damping_ratio", "damping_ratio_std", 100] : ["frequency_hz", "frequency_std_hz", 1], pick = name => seen.map(mode => mode ? factor * mode[name] : NaN)
                const values = pick(value), std = pick(deviation)
                // The mean by inverse variance; without any, all count alike.
                const isSure = values.some((value, i) => known(value) && std[i] > 0), weightOf = i => isSure ? std[i] > 0 ? std[i] ** -2 : 0 : 1
                const weights = values.map((value, i) => known(value) ? weightOf(i) : 0), sum = weights.reduce((a, b) => a + b, 0), mean = weights.reduce((total, weight, i) => total + (weight && weight * values[i]), 0) / sum
                // Frequencies in percent off their mean: what a change of a mode is compared by.
                const off = list => list.map(value => 100 * value / mean), shown = isDamping ? { values, std, mean, name: `damping in %, mean ${fixed(mean, 2)}` } : { values: off(values.map(value => value - mean)), std: off(std), mean: 0, name: `frequency in % off its mean of ${hertz(mean)}` }
                return {
                    number, ...shown, colour: "measured", on: number === chosenMode(), name: `mode ${number}: ${shown.name}`,
                    more: isDamping || trend?.changes == null ? "" : trend.changes ? " — changes" : " — no change",
                }
            }),
        ].filter(panel => panel.values.some(known))
        const both = { zoom: this.id, sync: this.id, with: new Set() }, grid = make("div.trends")
        host.append(grid)
        return freeing(panels.map(({ number, name, more, values, std, mean, colour, on, log }, index) => {
            // On paper there are two columns.
            const isLast = index >= panels.length - (printing() ? 2 : 1)
            const cell = make("div", { class: on ? "cell chosen" : "cell" }, number
                ? make("button.caption", { "aria-pressed": String(on), onclick: () => view.set({ mode: on ? null : number }) }, name, make("span.quiet", more)) : make("p.caption", name))
            grid.append(cell)
            const bar = i => 2 * (std?.[i] || 0), [low, high] = extent(values.flatMap((value, i) => [value - bar(i), value + bar(i)]), log) ?? [0, 1], room = 0.08 * (high - low || Math.abs(high) || 1)
            return plot(cell, {
                ...both, name: `${name}, from ${significant(low, 4)} to ${significant(high, 4)}`, height: isLast ? 124 : 92, quiet: !isLast,
                x: { ...axis, range, bare: !isLast },
                y: { log, range: log ? [low / 1.2, high * 1.2] : [low - room, high + room], least: 6 },
                data: [Float64Array.from(middle), clean(values)],
                lines: [{ colour, width: 0.8, alpha: std ? 0.5 : 1 }],
                front(pen) {
                    const isCrowded = middle.length * 5 * pen.ratio > pen.right - pen.left
                    pen.style("ink", { width: 0.8, alpha: 0.6, dash: [4, 4] })
                    pen.level(mean)
                    values.forEach((value, i) => {
                        if (!known(value)) return
                        pen.style(colour, { width: 1, alpha: isCrowded ? 0.45 : 0.8 })
                        if (bar(i)) pen.whisker(middle[i], value - bar(i), value + bar(i), isCrowded ? 0 : 2)
                        pen.style(colour)
                        pen.dot(middle[i], value, isCrowded ? 1.4 : 2.6)
                    })
                },
                legend: [{ label: "", kind: "none", value: i => `${axis.clock(middle[i], 60)}: ${std ? within(values[i], std[i]) : significant(values[i], 3)}` }],
            })
        }))
    },
}
