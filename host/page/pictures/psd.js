// Power spectral density of channels, several to compare.

import { make } from "@/canvas.js"
import { clean, densityIn, extent, items, modeMarks, nearest, plot, steps, unpack } from "@/curves.js"
import { fixed, hertz, named, plural, power } from "@/numbers.js"

// Colours of curves that mean nothing but "another channel".
const SERIES = ["measured", "series-2", "series-3", "series-4", "series-5", "series-6"], DASHES = [[], [6, 3], [2, 2]]
const lookOf = i => ({ colour: SERIES[i % 6], dash: DASHES[Math.floor(i / 6) % 3], width: 1.3 })
const setupsOf = data => items(data.spectra?.setups).filter(setup => setup.psd?.length)

/** All channels of spectra or records, named with their setup where there are several. */
export const channelsOf = setups => setups.flatMap(setup => (setup.channels ?? []).map((channel, index) => ({
    name: setups.length > 1 && !String(channel).includes("/") ? `${setup.setup}/${channel}` : String(channel), channel, setup, index,
})))

/** Channels from the top down, those of a height together: [height in words, channels]. */
export function byHeight(channels, data) {
    const heights = new Map(items(data.study?.sensors).map(sensor => [sensor.channel, sensor.elevation_m])), groups = new Map()
    for (const one of channels) {
        const height = heights.get(one.name) ?? heights.get(one.channel) ?? null
        groups.set(height, [...groups.get(height) ?? [], one])
    }
    return [...groups].sort(([a], [b]) => (b ?? -Infinity) - (a ?? -Infinity)).map(([height, list]) => [height == null ? "height unknown" : `${fixed(height, 1)} m`, list])
}

function chosenOf(data, view) {
    const channels = channelsOf(setupsOf(data)), wanted = view.get("channels")
    // In the order in which they were ticked: a curve keeps its colour when others come.
    const found = items(wanted).map(name => channels.find(one => one.name === String(name))).filter(Boolean)
    // By itself two at the highest level that look in different directions.
    const [first, ...others] = byHeight(channels, data)[0]?.[1] ?? [], of = one => items(data.study?.sensors).find(sensor => sensor.channel === one.name)?.direction ?? []
    const second = others.find(one => Math.abs(of(one).reduce((sum, v, k) => sum + v * of(first)[k], 0)) < 0.9) ?? others[0]
    return [found.length ? found : [first, second].filter(Boolean), channels]
}

export default {
    id: "psd",
    title: "Spectral density by channel",
    follows: ["channels", "mode"],
    says(data, view) {
        const [chosen, channels] = chosenOf(data, view)
        return `The power spectral density of ${named("channel", chosen.map(one => one.name))}, of ${plural(channels.length, "channel")}.`
    },
    has: data => channelsOf(setupsOf(data)).length > 0,
    draw(host, data, view) {
        const [chosen, channels] = chosenOf(data, view), names = chosen.map(one => one.name)
        const toggle = ({ name }) => view.set({ channels: names.includes(name) ? names.filter(one => one !== name) : [...names, name] })
        const picker = make("details.picker", { open: view.get("pick-channels") === true, ontoggle: () => view.set({ "pick-channels": picker.open || null }) },
            make("summary", `Channels: ${chosen.length} of ${channels.length}`),
            ...byHeight(channels, data).map(([height, list]) => make("fieldset", make("legend", height),
                ...list.map(one => make("label.choice", make("input", { type: "checkbox", checked: chosen.includes(one), onchange: () => toggle(one) }), " ", one.name)))))
        host.append(make("div.controls", picker))
        const tables = chosen.map(({ setup, index }) => {
            const values = clean(unpack(setup.psd[index]), true)
            return [steps(setup.first_hz, setup.spacing_hz, values.length), values]
        })
        const [hz, ...curves] = join(tables)
        return plot(host, {
            zoom: "hz", height: 320, marks: modeMarks(data),
            x: { label: "frequency in Hz", range: extent(hz) ?? [0, 1] },
            y: { label: `density in ${densityIn(chosen[0].setup)}`, log: true },
            data: [hz, ...curves],
            lines: chosen.map((_, i) => lookOf(i)),
            at: (_, index) => hertz(hz[index]),
            legend: chosen.map((one, i) => ({ ...lookOf(i), label: one.name, kind: i < 6 ? "line" : "dash", value: index => power(curves[i][index], 1) })),
        }).free
    },
}

/** All in one grid; where grids differ, each curve's nearest value. */
function join(tables) {
    const all = Float64Array.from(new Set(tables.flatMap(([xs]) => [...xs]))).sort()
    return [all, ...tables.map(([xs, values]) => xs.length === all.length ? values : Array.from(all, x => x < xs[0] || x > xs.at(-1) ? null : values[nearest(xs, x)]))]
}
