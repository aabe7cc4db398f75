// Poles of the subspace over its order: a mode stands at the same frequency at every order.

import { extent, items, modeMarks, plot, setupChoice, setupOf, steps, unpack } from "@/curves.js"
import { hertz, known, plural } from "@/numbers.js"

const polesOf = one => items(one.poles).filter(pole => known(pole.frequency_hz))
const diagramsOf = data => items([data.stabilisation].flat()).filter(one => polesOf(one).length)

export default {
    id: "stabilisation",
    title: "Stabilisation diagram",
    follows: ["setup", "mode"],
    says(data) {
        const one = setupOf(diagramsOf(data)), poles = polesOf(one), stable = items(one.stable)
        return `The band is fitted piece by piece, each piece with subspace models up to order ${extent(poles.map(pole => pole.order))?.[1] ?? 0}. Together they have ${plural(poles.length, "pole")}, with ${plural(stable.length, "line")} of stable ones, ${stable.filter(pole => pole.is_clear).length} of them clear.`
    },
    has: data => diagramsOf(data).length > 0,
    draw(host, data) {
        const diagrams = diagramsOf(data), one = setupOf(diagrams), poles = polesOf(one), top = (extent(poles.map(pole => pole.order))?.[1] ?? 1) + 1
        // A pole is stable where it belongs to a stable one of its order.
        const isStable = poles.map(pole => items(one.stable).some(({ orders, order, frequency_hz, frequency_std_hz }) => (orders ?? [order]).includes(pole.order)
            && Math.abs(pole.frequency_hz - frequency_hz) < Math.max(0.004 * frequency_hz, 3 * (frequency_std_hz ?? 0))))
        // The spectrum is a backdrop: logarithmic, from the foot of the picture to its top.
        const setups = items(data.spectra?.setups), setup = setups.find(each => each.setup === one.setup) ?? setups[0]
        const first = unpack(setup?.singular?.[0]), hz = steps(setup?.first_hz, setup?.spacing_hz, first.length)
        const logs = first.map(Math.log10), [low, high] = extent(logs) ?? [0, 1], backdrop = logs.map(value => (0.05 + 0.9 * (value - low) / (high - low || 1)) * top)
        const range = (hz.length > 1 && extent(hz)) || (extent(poles.map(pole => pole.frequency_hz)) ?? [0, 1])
        host.append(setupChoice(diagrams))
        return plot(host, {
            zoom: "hz", height: 320, marks: modeMarks(data),
            x: { label: "frequency in Hz", range },
            y: { label: "order of the piece's model", range: [0, top], values: splits => splits.map(value => Number.isInteger(value) ? String(value) : "") },
            behind(pen) {
                if (hz.length < 2) return
                pen.style("rejected", { width: 1, alpha: 0.6 })
                pen.trace(hz, backdrop)
            },
            front(pen) {
                for (const stable of [false, true]) {
                    stable ? pen.style("measured") : pen.style("rejected", { width: 1, alpha: 0.7 })
                    poles.forEach((pole, i) => { if (isStable[i] === stable) pen.dot(pole.frequency_hz, pole.order, stable ? 2.8 : 1.8, !stable) })
                }
            },
            at: where => hertz(where),
            legend: [
                { label: "stable pole", colour: "measured", kind: "dot" },
                { label: "other pole", colour: "rejected", kind: "ring" },
                hz.length > 1 && { label: "first singular value (logarithmic, without a scale)", colour: "rejected", alpha: 0.7 },
            ],
        }).free
    },
}
