// The time history of a channel: from the whole record down to a second. A report has least and greatest values; a server gives the samples.

import { can, samples } from "@/actions.js"
import { printing } from "@/canvas.js"
import { choice, clean, extent, items, plot, scaled, steps, unpack } from "@/curves.js"
import { clamp, duration, fixed, known, significant } from "@/numbers.js"
import { byHeight, channelsOf } from "@/pictures/psd.js"

// A zoom that has rested so long asks for samples.
const ASK_MS = 300
const STEPS_S = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400, 172800, 604800]
const two = n => String(n).padStart(2, "0")

/** What an axis of this unit shows. */
export const quantity = (of, unit) => `${{ "m/s²": "acceleration", g: "acceleration", "m/s": "velocity", m: "displacement", rad: "rotation", 1: "strain" }[of] ?? "signal"} in ${unit}`

/** An axis of time: by the clock (UTC) where the start is known, otherwise since the start. */
export function timeAxis(start, span_s) {
    const zero = Date.parse(start ?? ""), isKnown = known(zero), offset = isKnown ? zero / 1000 % 86400 : 0
    const date = seconds => new Date(zero + seconds * 1000).toISOString().slice(0, 10), days = isKnown && offset + span_s >= 86400
    function clock(seconds, step) {
        const digits = step < 0.01 ? 3 : step < 0.1 ? 2 : step < 1 ? 1 : 0, at = Math.round((seconds + offset) * 10 ** digits) / 10 ** digits
        const hours = Math.floor(at / 3600), rest = (at % 60).toFixed(digits).padStart(digits ? 3 + digits : 2, "0")
        if (days && (step >= 86400 || hours % 24 === 0 && at % 3600 === 0)) return date(seconds).slice(5)
        return `${isKnown ? two(hours % 24) : hours}:${two(Math.floor(at / 60) % 60)}${step < 60 ? ":" + rest : ""}`
    }
    return {
        label: isKnown ? `time (UTC), from ${date(0)}` : "time since the start in h:min or h:min:s", room: 75, clock,
        splits(low, high, room) {
            const step = STEPS_S.find(step => (high - low) / step <= room) ?? 604800, first = Math.ceil((low + offset) / step - 1e-9) * step - offset
            return Array.from({ length: Math.max(0, Math.floor((high - first) / step + 1e-9) + 1) }, (_, i) => first + i * step)
        },
        values: splits => splits.map(value => clock(value, splits.length > 1 ? splits[1] - splits[0] : 1)),
    }
}

const allOf = data => channelsOf(items(data.record?.setups).filter(setup => setup.min?.length))
/** The chosen channel, and all of them. */
function chosenOf(data, view) {
    const channels = allOf(data), groups = byHeight(channels, data)
    const one = channels.find(one => one.name === String(view.get("channel"))) ?? groups[0]?.[1][0]
    const [low, high] = ["min", "max"].map(name => unpack(one?.setup[name]?.[one.index]))
    const most = Math.max(...[low, high].flatMap(values => extent(values) ?? []).map(Math.abs), 0)
    const of = one?.setup.units?.[one.index] ?? one?.setup.unit
    return { ...one, groups, low, high, most, of, ...scaled(of, most) }
}

export default {
    id: "record",
    title: "Time history",
    follows: ["channel"],
    says(data, view) {
        const { name, setup, most, factor, unit } = chosenOf(data, view)
        return `Channel ${name} over ${duration(setup.duration_s)}: least and greatest value of every ${significant(setup.bin_s, 2)} s, at most ${significant(most * factor, 3)} ${unit}.${printing() ? "" : can() ? " In a zoom, those of finer pieces, down to the samples." : " A closer look shows no more here; belfry serve has the samples."}`
    },
    has: data => allOf(data).length > 0,
    draw(host, data, view) {
        const { name, channel, setup, groups, low, high, of, factor, unit } = chosenOf(data, view)
        const end = setup.duration_s ?? low.length * setup.bin_s, axis = timeAxis(setup.start, end)
        host.append(choice("channel", "channel", groups.map(([height, list]) => [height, list.map(one => [one.name])]), name))
        const table = (xs, ...values) => [xs, ...values.map(list => clean(Float64Array.from(list, value => value == null ? NaN : value * factor)))]
        const coarse = table(steps(setup.bin_s / 2, setup.bin_s, low.length), low, high)
        let shown = coarse, timer = 0, asked = 0, gone = false
        const show = next => { if (!gone && next !== shown) chart.set(shown = next) }
        async function refine(from_s, to_s) {
            const mine = ++asked
            if (to_s - from_s >= end * 0.999) return show(coarse)
            try {
                const { time_s, min, max } = await samples({ setup: setup.setup, channel, from_s, to_s, bins: clamp(chart.u.width, 200, 2000) })
                if (mine === asked && time_s.length) show(table(Float64Array.from(time_s), min, max))
            } catch { /* the coarse curve stays */ }
        }
        const later = (from, to) => {
            clearTimeout(timer)
            timer = setTimeout(refine, ASK_MS, from, to)
            // Out of what the finer samples cover, the coarse curve stands in until new ones are there.
            if (from < shown[0][0] - setup.bin_s || to > shown[0].at(-1) + setup.bin_s) queueMicrotask(() => show(coarse))
        }
        const chart = plot(host, {
            zoom: this.id, height: 240,
            x: { ...axis, range: [0, end] },
            y: { label: quantity(of, unit), least: 5 },
            data: coarse,
            lines: [{ colour: "measured", width: 1 }, { colour: "measured", width: 1 }],
            bands: [{ between: [2, 1], colour: "measured", alpha: 0.35 }],
            moved: can() ? later : null,
            at: (x, i) => axis.clock(shown[0][i] ?? x, (chart.u.scales.x.max - chart.u.scales.x.min) / 200),
            legend: [{ label: `channel ${name}, least and greatest`, colour: "measured", kind: "band", alpha: 0.6,
                value: i => shown[1][i] == null ? "no data" : `${fixed(shown[1][i], 3)} to ${fixed(shown[2][i], 3)} ${unit}` }],
        })
        const wanted = view.get("zoom.record")
        if (can() && Array.isArray(wanted)) later(...wanted)
        return () => { gone = true; clearTimeout(timer); chart.free() }
    },
}
