// Channels that were left out: what was measured there, and what the model makes of the others.

import { choice, clean, extent, freeing, items, plot, scaled, steps, unpack } from "@/curves.js"
import { KINDS, fixed, known, significant } from "@/numbers.js"
import { quantity } from "@/pictures/record.js"

// Dashes in turn, so that curves that lie on each other all show.
const CURVES = [
    { colour: "given", key: "model", label: KINDS.given, width: 1.4 },
    { colour: "effects", key: "with_effects", label: KINDS.effects, width: 1.4, dash: [7, 4], kind: "dash" },
    { colour: "updated", key: "updated", label: KINDS.updated, width: 1.4, dash: [2, 4], kind: "dash" },
    { key: "measured_shapes", label: "by the measured shapes: about what noise leaves", width: 0.9, dash: [1, 3], kind: "dots" },
]
// What is shown at first: an hour of a curve is a grey band.
const STRETCH_S = 30

const curvesOf = data => items(data.curves?.channels).filter(one => unpack(one.measured).length)
function chosenOf(data, view) {
    const curves = curvesOf(data), one = curves.find(one => one.channel === String(view.get("left-out"))) ?? curves[0]
    const errors = items(data.covalidation?.channels).find(each => each.channel === one.channel)?.error_percent ?? {}
    return { curves, one, error: key => known(errors[key]) ? `${fixed(errors[key], 2)} %` : "" }
}

export default {
    id: "covalidation",
    title: "Motion of left-out sensors",
    from: "covalidation",
    follows: ["left-out", "misses"],
    says(data, view) {
        const { one, error } = chosenOf(data, view), said = CURVES.filter(({ key }) => error(key)).map(({ key, label }) => `${error(key)} ${/^model/.test(label) ? "for the " : ""}${label}`)
        return `Channel ${one.channel} was left out and predicted from the others${said.length ? `; the error E_d is ${said.join(", ")}.` : "."}`
    },
    has: data => curvesOf(data).length > 0,
    draw(host, data, view) {
        const { curves, one, error } = chosenOf(data, view), { start_s = 0, spacing_s = 1, unit: of = "m/s²" } = data.curves
        const raw = unpack(one.measured), { factor, unit } = scaled(of, Math.max(...(extent(raw) ?? [0, 1]).map(Math.abs)))
        const measured = raw.map(value => value * factor), time = steps(start_s, spacing_s, raw.length)
        const kinds = CURVES.map(curve => ({ ...curve, values: unpack(one[curve.key]).map(value => value * factor) })).filter(({ values }) => values.length === raw.length)
        // Which of them are drawn.
        const wanted = view.get("misses"), chosen = Array.isArray(wanted) ? wanted : ["model", kinds.some(({ key }) => key === "with_effects") ? "with_effects" : "updated"]
        const toggle = key => view.set({ misses: chosen.includes(key) ? chosen.filter(one => one !== key) : [...chosen, key] })
        const missed = kinds.filter(({ key }) => chosen.includes(key)), off = missed.map(({ values }) => clean(values.map((value, i) => value - measured[i])))
        // Half a minute from the middle, unless the address says otherwise.
        const range = [time[0], time.at(-1)], middle = (range[0] + range[1]) / 2, opening = range[1] - range[0] > 2 * STRETCH_S ? [middle - STRETCH_S / 2, middle + STRETCH_S / 2] : null
        const both = { zoom: this.id, sync: this.id, with: new Set(), opening }
        if (curves.length > 1) host.append(choice("left-out channel", "left-out", curves.map(each => [each.channel]), one.channel))
        const upper = plot(host, {
            ...both, height: 260, quiet: true,
            x: { range, bare: true },
            y: { label: quantity(of, unit), least: 6 },
            data: [time, clean(measured), ...kinds.map(({ values }) => clean(values))],
            lines: [{ colour: "measured", width: 5, alpha: 0.35 }, ...kinds.map(kind => ({ ...kind, hidden: !chosen.includes(kind.key) }))],
            at: (_, i) => `${fixed(time[i], 2)} s`,
            legend: [
                { label: "measured", colour: "measured", alpha: 0.5, kind: "thick", value: i => fixed(measured[i], 3) },
                ...kinds.map(({ colour, key, label, kind, values }) => ({ label: label + (error(key) && `, E_d = ${error(key)}`), colour, kind,
                    check: { checked: chosen.includes(key), onchange: () => toggle(key), title: "Show it" }, value: i => fixed(values[i], 3) })),
            ],
        })
        const lower = plot(host, {
            ...both, height: 130, name: `What each prediction misses, at most ${significant(Math.max(0, ...off.flatMap(values => extent(values) ?? []).map(Math.abs)), 2)} ${unit}`,
            x: { label: "time in s", range },
            y: { label: `off, in ${unit}`, least: 6 },
            data: [time, ...off],
            lines: missed,
            behind(pen) { pen.style("ink", { width: 0.8 }); pen.level(0) },
        })
        return freeing([upper, lower])
    },
}
