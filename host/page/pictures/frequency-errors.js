// Frequencies mode by mode: the model's against the measured ones, and those of now against an earlier measurement.

import { make } from "@/canvas.js"
import { chosenMode, extent, items, plot } from "@/curves.js"
import { fixed, hertz, kindsOf, known, plural, pvalue, signed } from "@/numbers.js"

/** The errors of each mode: of the model as given, with its effects, and after the update. An update that has no MAC is of another model, or of other modes. */
function errorsOf({ modes, comparison, update, mac }) {
    const rows = new Map(), std = new Map(items(modes?.modes).map(mode => [mode.number, 100 * mode.frequency_std_hz / mode.frequency_hz]))
    for (const [kind, pairs] of [["given", comparison?.given?.pairs], ["effects", comparison?.effects?.pairs], ["updated", items(mac).some(one => one.what === "updated") ? update?.pairs : []]]) for (const pair of items(pairs)) {
        const { measured, measured_hz } = pair, { frequency_error_percent, frequency_z } = kind === "updated" ? pair.after ?? {} : pair
        // z is the error over the deviation; it gives the deviation where modes.json does not.
        if (!rows.has(measured)) rows.set(measured, { mode: measured, hz: measured_hz, std: std.get(measured) ?? Math.abs(frequency_error_percent / frequency_z) })
        rows.get(measured)[kind] = frequency_error_percent
    }
    return [...rows.values()].sort((a, b) => a.mode - b.mode)
}

export const frequencyErrors = {
    id: "frequency-errors",
    title: "Errors of the model's frequencies",
    follows: ["mode"],
    uses: ["comparison"],
    says(data) {
        const list = errorsOf(data), worst = list.filter(one => known(one.given)).sort((a, b) => Math.abs(b.given) - Math.abs(a.given))[0]
        const means = Object.entries(kindsOf(data)).map(([kind, label]) => {
            const values = list.map(one => one[kind]).filter(known)
            return values.length && `${fixed(values.reduce((sum, value) => sum + Math.abs(value), 0) / values.length, 2)} % ${kind === "updated" ? "" : "for the "}${label}`
        }).filter(Boolean)
        return `Over ${plural(list.length, "mode")} the mean error is ${means.join(", ") || "unknown"}${worst ? `; as given the model is worst at mode ${worst.mode}, ${signed(worst.given, 2)} %.` : "."}`
    },
    has: data => errorsOf(data).length > 0,
    draw(host, data, view) {
        const list = errorsOf(data)
        return bars(host, {
            height: 280, x: "measured mode", y: "error of the model in %", more: "± 2 standard deviations of the measurement",
            groups: list.map(one => ({ mode: one.mode, below: hertz(one.hz, 3), one })),
            kinds: Object.entries(kindsOf(data)).filter(([kind]) => list.some(one => known(one[kind]))),
            value: ({ one }, kind) => one[kind], error: ({ one }) => one.std,
            press: ({ mode }) => view.set({ mode }),
        }).free
    },
}

const changesOf = data => items(data.change?.modes).filter(mode => known(mode.change_percent))

export const change = {
    id: "change",
    title: "Change since an earlier measurement",
    follows: ["mode"],
    says(data) {
        const { test, common_percent, common_percent_std, diagnosis, before } = data.change, p = pvalue(test?.p_value)
        return `Frequencies now against ${before ?? "before"}` + (test ? `: ${test.p_value < 0.01 ? "something has changed" : "no change beyond the measurements' scatter"} (p ${p[0] === "<" ? p : "= " + p})` : "")
            + (known(common_percent) ? `; all frequencies together by ${signed(common_percent, 2)} ± ${fixed(common_percent_std, 2)} %.` : ".")
            + (diagnosis?.verdict === "effect" && items(diagnosis.best).length ? ` Most probably ${diagnosis.best.join(", ")} has ${diagnosis.direction ?? "come"}.` : "")
    },
    has: data => changesOf(data).length > 0,
    draw(host, data, view) {
        const { diagnosis, only_before, only_now } = data.change
        const predicted = new Map(items(diagnosis?.predicted).filter(one => known(one.predicted_percent)).map(one => [one.now, one.predicted_percent]))
        const chart = bars(host, {
            height: 260, x: "mode now", y: "change of frequency in %", more: "± 2 standard deviations of both measurements",
            groups: changesOf(data).map(one => ({ mode: one.now, below: `${fixed(one.before_hz, 4)} to ${hertz(one.now_hz)}`, one })),
            kinds: [["measured", "measured"], ...(predicted.size ? [["effects", `with ${items(diagnosis.best).join(", ") || "the named effect"}`]] : [])],
            value: ({ one }, kind) => kind === "measured" ? one.change_percent : predicted.get(one.now),
            error: ({ one }, kind) => kind === "measured" ? one.change_percent_std : 0,
            press: ({ mode }) => view.set({ mode }),
        })
        const alone = [["only before", only_before], ["only now", only_now]].filter(([, list]) => items(list).length)
        host.append(make("p.quiet", alone.map(([what, list]) => `Found ${what}: ${items(list).map(mode => hertz(mode.frequency_hz)).join(", ")}. `).join("")))
        return chart.free
    },
}

/** Bars in groups, with whiskers of two deviations; each kind has the colour of its name. */
export function bars(host, { name, height, groups, kinds, value, error = () => 0, x, y, more, press, unit = " %" }) {
    const count = groups.length, width = Math.min(0.8 / kinds.length, 0.3), range = [0.4, count + 0.6]
    const all = groups.flatMap((group, i) => kinds.map(([kind], k) => ({ kind, at: i + 1 + (k - (kinds.length - 1) / 2) * width, v: value(group, kind), e: 2 * (error(group, kind) || 0) })).filter(({ v }) => known(v)))
    const [low, high] = extent([0, ...all.flatMap(({ v, e }) => [v - e, v + e])]) ?? [-1, 1], room = 0.08 * (high - low || 1)
    return plot(host, {
        name, height, still: true, cursor: true,
        x: {
            label: x, range, grid: false,
            splits: (from, to, _, length) => groups.map((_, i) => i + 1).filter((_, i) => i % Math.max(1, Math.ceil(26 * count / length)) === 0),
            values: splits => splits.map(i => String(groups[i - 1]?.mode ?? "")),
        },
        y: { label: y, range: [low - room, high + room] },
        data: [groups.map((_, i) => i + 1), groups.map(() => null)],
        behind(pen) {
            pen.style("ink", { alpha: 0.08 })
            groups.forEach(({ mode }, i) => { if (mode === chosenMode()) pen.box(i + 0.5, low - room, i + 1.5, high + room) })
        },
        front(pen) {
            pen.style("ink", { width: 1 })
            pen.level(0)
            for (const { kind, at, v, e } of all) {
                const [a, b] = [at - 0.44 * width, at + 0.44 * width]
                pen.style(kind, { width: 2 })
                pen.box(a, 0, b, v)
                // A bar too short to see still has its place.
                pen.line([[a, v], [b, v]])
                pen.style("ink", { width: 1 })
                if (e > 0) pen.whisker(at, v - e, v + e, Math.min(3, 75 / count))
            }
        },
        press: press && (where => { const group = groups[Math.round(where) - 1]; if (group) press(group) }),
        at: (_, index) => groups[index] ? `mode ${groups[index].mode}, ${groups[index].below}` : "",
        legend: [
            ...kinds.map(([kind, label]) => ({ label, colour: kind, kind: "bar", value: index => groups[index] && known(value(groups[index], kind)) ? signed(value(groups[index], kind), 2) + unit : "" })),
            more && { label: more, kind: "whisker" },
        ],
    })
}
