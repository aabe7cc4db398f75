// What the model may lack: candidates with their probabilities and values, and what the chosen one would do beside what is missing.

import { button, can, candidateName, isAmong, isIn } from "@/actions.js"
import { canvas, colour, make, mix, printing, size } from "@/canvas.js"
import { chosenMode, items, legend } from "@/curves.js"
import { matrix } from "@/matrix.js"
import { clamp, fixed, hertz, known, metres, percent, plural, probability, pvalue, signed, significant, within } from "@/numbers.js"
import { bars } from "@/pictures/frequency-errors.js"
import { bar, table } from "@/tables.js"

const all = data => items(data.diagnosis?.candidates)
const printsOf = data => items(data.fingerprints?.candidates)
/** The candidate whose fingerprint is shown: what the reader chose, otherwise the best. */
function chosenOf(data, view) {
    const wanted = view.get("candidate") ?? data.diagnosis?.best?.[0], prints = printsOf(data)
    return { wanted, print: prints.find(one => one.effect === wanted) ?? (view.get("candidate") ? null : prints[0]) }
}
// Each set is what the data cannot tell apart.
const setsOf = ambiguous => items(ambiguous).map(names => [names].flat())
const sumOf = rows => probability(rows.reduce((sum, one) => sum + (one.probability ?? 0), 0))
const sized = ({ value, std, unit }) => `${std > 0 ? within(value, std) : significant(value, 3)}${unit && unit !== "-" ? " " + unit : ""}`

export const candidates = {
    id: "candidates", title: "What the model may lack", long: true, follows: ["candidate"], from: "diagnosis",
    has: data => all(data).length > 0,
    draw(host, data, view) {
        const { ambiguous, probabilities, joint, partial, next_measurement: next, elsewise, reason, warnings, verdict, goodness_of_fit, present, present_beside_best } = data.diagnosis, { print } = chosenOf(data, view)
        // The test that goes with its probability.
        const test = verdict === "adequate" ? goodness_of_fit : present_beside_best ?? present
        const rest = [["nothing: the model is adequate", probabilities?.adequate, test], ["something else", probabilities?.something_else]].filter(([, p]) => known(p)).map(([effect, probability, test]) => ({ ...test, effect, probability, isRest: true }))
        const sorted = [...all(data), ...rest].sort((a, b) => (b.probability ?? -1) - (a.probability ?? -1))
        const groups = setsOf(ambiguous).map(names => sorted.filter(one => isAmong(one, names))).filter(rows => rows.length > 1), others = sorted.filter(one => !groups.flat().includes(one))
        const of = cell => one => one.isRest ? "" : cell(one), isImpossible = one => one.admissible === false
        host.append(table("Candidates", [
            ["Effect", "", candidateName, "text"],
            ["Probability", "", one => isImpossible(one) ? "impossible" : bar(one.probability, 1, one.isRest ? "rejected" : "effects", probability(one.probability)), "text"],
            ["Value", "", of(one => one.parameters?.map(each => (one.parameters.length > 1 ? each.name + " " : "") + sized(each)).join("; ")), "wrap"],
            ["ln Bayes factor", "over the model as it is", of(one => signed(one.log_bayes_factor, 1))],
            ["Chi-squared", "left", one => fixed(one.chi_squared, 0)],
            ["p", "of fit", one => pvalue(one.p_value)],
            ["Misfit left", "% of squares, outliers less", of(one => fixed(100 * (one.errors_left?.misfit ?? NaN), 0))],
            sorted.some(one => one.where_std_m != null || one.near?.length) && ["Place", "± m, or as well at", of(one => [one.where_std_m != null && "± " + significant(one.where_std_m, 2), ...items(one.near).slice(0, 3).map(near => near.where)].filter(Boolean).join(", ")), "wrap"],
            can() && ["Into the model", "", of(one => isImpossible(one) ? "" : isIn(data, candidateName(one)) ? "is in it" : button("Add", ["add", candidateName(one)], { "aria-label": `Add ${candidateName(one)} to the model` }))],
        ], [...groups.map(rows => ({ title: `The data cannot tell these apart: together ${sumOf(rows)}`, rows })), { title: groups.length > 0 && "Others", rows: others }],
        { key: one => one.isRest ? null : candidateName(one), chosen: sorted.map(candidateName).find(name => name === view.get("candidate")) ?? print?.effect, choose: candidate => view.set({ candidate }) }))
        host.append(make("p.quiet", data.says?.["candidates-columns"] ?? ""))
        const fitted = items(joint?.values)
        for (const text of [
            fitted.length > 1 && "Fitted together: " + fitted.map(each => `${each.effect} ${sized(each)}`).join("; ") + ".",
            items(partial?.effects).length > 0 && "Together these explain most: " + partial.effects.map(candidateName).join(", ") + ".",
            next && `What would tell more: ${next}`,
            ...items(elsewise).map(one => `With ${one.tolerance_times} times the stated tolerance the verdict would be ${[one.verdict, ...items(one.best)].join(" ")}.`),
            reason, ...items(warnings)]) if (typeof text === "string") host.append(make("p", text))
    },
}

export const fingerprint = {
    id: "fingerprint", title: "What is missing, and what a candidate would do", from: "diagnosis", follows: ["candidate", "mode"],
    has: data => printsOf(data).length > 0 && items(data.fingerprints.modes).length > 0,
    says(data, view) {
        const { wanted, print } = chosenOf(data, view)
        return print ? `${print.effect} explains ${percent(Math.max(print.explained, 0), 0)} of the squares of what is missing.`
            : `No fingerprint was computed for ${wanted}.`
    },
    draw(host, data, view) {
        const { print } = chosenOf(data, view), { measured } = data.fingerprints
        if (!print) return
        const modes = data.fingerprints.modes.map(mode => mode ?? {}), sensors = (data.fingerprints.sensors ?? []).map(one => one ?? {}), values = { measured: measured?.frequency, effects: print.fingerprint?.frequency }
        const chart = bars(host, {
            name: `Frequencies by mode: what is missing, and what ${print.effect} would do`, height: 165, unit: "", x: "measured mode", y: "frequency, in std",
            groups: modes.map((mode, i) => ({ mode: mode.measured, below: hertz(mode.measured_hz, 3), i })),
            kinds: [["measured", "what is missing"], ["effects", print.effect]],
            value: ({ i }, kind) => values[kind]?.[i], press: ({ mode }) => view.set({ mode }),
        })
        const shapes = [["what is missing", measured?.shape], [print.effect, print.fingerprint?.shape]]
        if (sensors.length && shapes.every(([, table]) => table?.length)) heatMaps(host, modes, sensors, shapes, view)
        return chart.free
    },
}

/** Where numbers end. One outlier must not pale the rest: it is the size that one in fifty exceeds. */
function endOf(values) {
    const sizes = values.filter(known).map(Math.abs).sort((a, b) => a - b)
    return Math.max(sizes[Math.floor(0.98 * (sizes.length - 1))] ?? 1, 1)
}
/** The colours of changes of shapes, for the misfit and for candidates alike. */
function huesOf(shape) {
    const reach = endOf(shape.flat()), [none, less, more, paper] = ["panel", "less", "more", "paper"].map(name => colour(name))
    return { reach, hue: value => known(value) ? mix(none, value < 0 ? less : more, Math.abs(value / reach)) : paper }
}

// A small fingerprint, CSS pixels: its width, the height of frequencies, the gap between the two tables of shapes, a sensor's row.
const SMALL = 208, FREQUENCIES = 52, BETWEEN = 8, SENSOR = 3

/** Every candidate with its fingerprint beside what is missing; those of little probability folded away. */
export const fingerprints = {
    id: "fingerprints", title: "Every candidate beside what is missing", from: "diagnosis", follows: ["candidate"], long: true,
    has: data => fingerprint.has(data) && printsOf(data).length > 1,
    says: data => `${plural(printsOf(data).length, "candidate")}, the most probable first. The more alike the two sides, the more it explains.${printing() ? "" : " Choose one to see it large."}`,
    draw(host, data, view) {
        const prints = printsOf(data), { print: chosen } = chosenOf(data, view), { measured } = data.fingerprints
        const end = Math.max(1, ...measured.frequency.map(Math.abs)), { hue } = huesOf(measured.shape ?? [])
        const cell = one => {
            const { effect, explained } = one, about = `${probability(one.probability)}, ${explained > 0 ? `explains ${percent(explained, 0)}` : "explains nothing"}`, sheet = canvas(`${effect}: ${about}`)
            const modes = measured.frequency.length, step = SMALL / modes, rows = Math.max(0, ...(measured.shape ?? []).map(row => row.length))
            const pen = size(sheet, SMALL, FREQUENCIES + BETWEEN + rows * SENSOR), up = value => FREQUENCIES / 2 * (1 - clamp(value / end, -1, 1))
            pen.fillStyle = colour("line")
            pen.fillRect(0, up(0), SMALL, 1)
            measured.frequency.forEach((value, m) => {
                pen.fillStyle = colour("measured", 0.45)
                pen.fillRect((m + 0.15) * step, Math.min(up(0), up(value)), 0.7 * step, Math.abs(up(value) - up(0)))
                pen.fillStyle = colour("effects")
                pen.fillRect((m + 0.15) * step, up(one.fingerprint.frequency[m]) - 1.2, 0.7 * step, 2.4)
            })
            const wide = (SMALL - BETWEEN) / 2, across = wide / modes
            ;[measured, one.fingerprint].forEach(({ shape }, side) => shape?.forEach((row, m) => row.forEach((value, s) => {
                pen.fillStyle = hue(value)
                pen.fillRect(side * (wide + BETWEEN) + m * across, FREQUENCIES + BETWEEN + (rows - 1 - s) * SENSOR, across, SENSOR)
            })))
            return make("button", { "aria-pressed": String(one === chosen), onclick: () => view.set({ candidate: effect }) }, make("b", effect), make("span", about), sheet)
        }
        const grid = list => make("div.shapes.prints", ...list.map(cell)), isShown = (one, i) => i < 4 || one.probability >= 0.01 || printing(), rest = prints.filter((one, i) => !isShown(one, i))
        host.append(legend([
            { label: "frequencies by mode: what is missing", colour: "measured", alpha: 0.45, kind: "bar" }, { label: "what the candidate would do", colour: "effects" },
            { label: "below, shapes by mode and sensor: what is missing, and beside it the candidate;", kind: "none" }, { label: "more motion", colour: "more", kind: "bar" }, { label: "less", colour: "less", kind: "bar" },
        ]), grid(prints.filter(isShown)), rest.length ? make("details", make("summary", `${rest.length} more, each below 1 %`), grid(rest)) : "")
    },
}

/** The shapes' misfit by sensor and mode: measured, and what the candidate would do, side by side in the same colours. */
function heatMaps(host, modes, sensors, shapes, view) {
    const { reach, hue } = huesOf(shapes[0][1])
    // From the top down; one label for all sensors of a height.
    const down = sensors.map((_, i) => sensors.length - 1 - i), heights = down.map(s => sensors[s].elevation_m)
    const rows = down.map((s, r) => {
        const from = heights.indexOf(heights[r]), to = heights.lastIndexOf(heights[r])
        return !known(heights[r]) ? String(sensors[s].channel) : r === (from + to) >> 1 ? metres(heights[r]) : ""
    })
    const cells = shapes.map(([title]) => make("div.cell", make("p.caption", `Shapes: ${title}`))), output = make("output.note")
    host.append(make("div.pair", ...cells), output)
    shapes.forEach(([title, shape], which) => matrix(cells[which], down.map(s => modes.map((_, m) => shape[m]?.[s] ?? null)), {
        rows, columns: modes.map(mode => mode.measured ?? ""), axes: ["sensors", "measured mode"], left: 62, most: 80, down: clamp((printing() ? 360 : 520) / sensors.length, 3, 12),
        sentence: `Shapes by sensor and mode, ${title}: ${modes.length} modes, ${sensors.length} sensors`,
        hue,
        key: ["std", -reach, reach, `${signed(-reach, 1)} less`, `${signed(reach, 1)} more`], strong: (r, c) => modes[c]?.measured === chosenMode(),
        point(r, c, click) {
            const { channel, elevation_m } = sensors[down[r]], { measured: mode } = modes[c]
            output.textContent = `mode ${mode}, channel ${channel}${known(elevation_m) ? ` at ${fixed(elevation_m, 1)} m` : ""}: ${shapes.map(([name, values]) => `${name} ${signed(values[c]?.[down[r]], 2)}`).join(", ")}`
            if (click) view.set({ mode })
        },
    }))
}
