// Singular values over frequency: where modes were found and what was fitted there, which lines are forced, what was rejected and why.

import { button, can, fitTo, identify, pick, picks, typed } from "@/actions.js"
import { make } from "@/canvas.js"
import { clean, densityIn, extent, items, modeMarks, nearest, plot, setupChoice, setupOf, steps, unpack } from "@/curves.js"
import { fixed, hertz, inWords, known, percent, plural, power } from "@/numbers.js"

const LOOKS = [{ width: 1.8 }, { width: 1.2, alpha: 0.72 }, { width: 1, alpha: 0.52 }, { width: 0.8, alpha: 0.42 }].map(look => ({ colour: "measured", ...look }))
// A click finds a peak so near, in CSS pixels.
const SNAP = 8
// A peak is of a mode that is so near, as a share of its frequency and in lines.
const SAME = 0.01, SAME_LINES = 2
const setupsOf = data => items(data.spectra?.setups).filter(setup => items(setup.singular).length)
const of = (data, name) => items(data.modes?.[name]).filter(one => known(one.frequency_hz))
const rounded = hz => Number(hz.toFixed(4))

/** A mode's fit as these lines see it: those of a narrow mode are finer. */
function onTheseLines({ frequency_hz, fitted, on_lines }, hz) {
    const xs = on_lines ? hz.subarray(on_lines.first_line) : frequency_hz
    return Array.from(unpack(on_lines?.values ?? fitted), (value, i) => [xs[i], value])
}

export default {
    id: "singular-values",
    title: "Singular values",
    follows: ["setup", "mode"],
    uses: ["picks"],
    says(data) {
        const [modes, forced, rejected] = ["modes", "harmonics", "rejected"].map(name => of(data, name)), setup = setupOf(setupsOf(data))
        return `The singular values of the cross-spectral matrix${setupsOf(data).length > 1 ? ` of ${inWords(setup.setup)}` : ""}${setup.averages ? ` from ${plural(setup.averages, "average")}` : ""} show `
            + (modes.length ? `${plural(modes.length, "mode")} between ${fixed(modes[0].frequency_hz, 3)} and ${fixed(modes.at(-1).frequency_hz, 3)} Hz` : "no mode")
            + (forced.length ? `, ${plural(forced.length, "forced line")} (F)` : "")
            + (rejected.length ? `, and ${plural(rejected.length, "peak")} that ${rejected.length === 1 ? "is no mode" : "are no modes"} (×).` : ".")
    },
    has: data => setupsOf(data).length > 0,
    draw(host, data, view) {
        const setups = setupsOf(data), setup = setupOf(setups)
        const singular = items(setup.singular).slice(0, 4).map(unpack)
        const hz = steps(setup.first_hz, setup.spacing_hz, singular[0].length)
        const others = setups.filter(other => other !== setup).map(other => {
            const first = clean(unpack(items(other.singular)[0]), true)
            return [steps(other.first_hz, other.spacing_hz, first.length), first]
        })
        const [forced, rejected] = ["harmonics", "rejected"].map(name => of(data, name))
        host.append(setupChoice(setups))

        const action = make("p.pick", { role: "status", hidden: true })
        const offer = (words, label, ...what) => {
            if (!can()) return
            action.hidden = false
            action.replaceChildren(words + " ", label ? make("button", { onclick: () => pick(...what) }, label) : "")
        }
        const { added_hz: added, dropped, bands, standing } = picks()
        // Of the modes that come: those that were dropped before, and those that are new.
        const were = items(standing?.dropped_hz), [back, fresh] = [true, false].map(is => added.filter(hz => were.includes(hz) === is))
        const [gone, absent] = [were, items(standing?.absent_hz)].map(list => list.filter(hz => !added.includes(hz)))
        // What a mode is called in study.toml: where it was asked for, it may lie beside.
        const asked = mark => mark.is.asked_hz ?? rounded(mark.x)
        const level = value => singular[0][nearest(hz, value)]
        const offerBack = hz => offer(`Dropped at ${hertz(hz)} in study.toml.`, "Take it back", hz, true)
        const isDropped = ({ is }) => dropped.includes(is.number)
        const modes = modeMarks(data), mode = modes.find(mark => mark.chosen)
        // The band that the chosen mode is to be fitted to, where a reader has chosen it.
        const own = bands.find(each => each.mode === mode?.is.number), band = mode && (own ?? mode.is).band_hz
        const fitting = make("p.pick")
        const inHz = ends => ends.map(hz => fixed(hz, 4)).join(" to ") + " Hz", name = `mode ${mode?.text}`
        function offerBand(from, to) {
            if (!mode || !can()) return
            const canFit = modes.filter(({ x }) => from < x && x < to).map(({ x }) => x).join() === String(mode.x)
            fitting.replaceChildren(...band ? [`The fit of ${name} takes the lines from ${inHz(band)}. `, make("button", { onclick: () => fitTo(mode.is, null) }, "Choose lines automatically"), " "] : [],
                !canFit ? `To choose the lines of its fit, zoom until ${name} is the only mode in sight.` : make("button", { onclick: () => fitTo(mode.is, [rounded(from), rounded(to)]) }, `Fit ${name} to what is in sight, ${inHz([from, to])}`))
        }
        const marks = [
            ...modes.map(mark => isDropped(mark) ? { ...mark, colour: "rejected", dash: [2, 4], isStruck: true, title: mark.title + "; dropped, until modes are identified again" } : mark),
            ...[[fresh, "Added", "Take it back"], [back, "No longer dropped", "Drop it again"]].flatMap(([list, what, undo]) => list.map(hz => ({
                x: hz, text: "+", dash: [5, 4], alpha: 1, title: `${what.toLowerCase()} at ${hertz(hz)}, not identified yet`, press: () => offer(`${what} at ${hertz(hz)}.`, undo, hz, false),
            }))),
            ...forced.map(line => ({
                x: line.frequency_hz, text: "F", colour: "forced-text", dash: [5, 4], alpha: 1, half: line.wanders_hz,
                title: `forced line at ${hertz(line.frequency_hz)}, kurtosis ${fixed(line.kurtosis, 2)}`
                    + (line.wanders_hz ? `, wanders by ${hertz(line.wanders_hz)}` : "") + (line.on_share < 1 ? `, there for ${percent(line.on_share, 0)} of the time` : ""),
            })),
            // Those of study.toml that the modes were identified with.
            ...gone.map(hz => ({ x: hz, text: "−", colour: "rejected", dash: [2, 4], title: `dropped at ${hertz(hz)} in study.toml`, press: () => offerBack(hz) })),
            ...absent.map(hz => ({
                x: hz, text: "?", colour: "rejected", dash: [2, 4], title: `asked for at ${hertz(hz)} in study.toml, where no mode was found`,
                press: () => offer(`No mode was found at ${hertz(hz)}, where study.toml asks for one.`, "Take it back", hz, false),
            })),
            ...rejected.map(({ frequency_hz, in_words, because, can_be_added: canBeAdded }) => ({
                x: frequency_hz, y: level(frequency_hz), text: "×", colour: "rejected", line: false, title: `${hertz(frequency_hz)} is no mode: ${in_words ?? because}`,
                press: () => canBeAdded === false ? offer(`Rejected at ${hertz(frequency_hz)}: ${in_words}. It cannot be added.`) : offer(`Rejected at ${hertz(frequency_hz)}.`, "Add it as a mode", rounded(frequency_hz), true),
            })),
        ]
        // The lower values reach far down in places; three decades below the first are enough.
        const fits = items(data.spectra.fitted).filter(one => one.setup === setup.setup && one.frequency_hz).map(fit => onTheseLines(fit, hz))
        const [low, high] = extent(singular[0], true) ?? [1e-12, 1], least = Math.max(low * 1e-3, extent(singular.at(-1), true)?.[0] ?? 0)
        const chart = plot(host, {
            zoom: "hz", height: 340, noted: true, marks,
            x: { label: "frequency in Hz", range: [hz[0], hz.at(-1)] },
            y: { label: `density in ${densityIn(setup)}`, log: true, fit: (from, to) => [Math.max(from ?? least, least) * 0.7, (to ?? high) * 4] },
            data: [hz, ...singular.map(values => clean(values, true))],
            lines: LOOKS.slice(0, singular.length),
            behind(pen) {
                if (band) {
                    pen.style("rejected", { alpha: 0.18 })
                    pen.box(band[0], least * 1e-3, band[1], high * 1e3)
                }
                pen.style("rejected", { width: 0.8, alpha: 0.55 })
                for (const [xs, ys] of others) pen.trace(xs, ys)
            },
            front(pen) {
                pen.style("ink", { width: 1.2, dash: [3, 2] })
                for (const fit of fits) pen.line(fit)
            },
            moved: (from, to) => offerBand(from, to),
            at: (_, index) => hertz(hz[index]),
            legend: [
                ...singular.map((values, rank) => ({ ...LOOKS[rank], label: ["first", "second", "third", "fourth"][rank], value: index => power(values[index], 1) })),
                others.length > 0 && { label: others.length > 1 ? `first of the other ${others.length} setups` : "first of the other setup", colour: "rejected", alpha: 0.6 },
                fits.length > 0 && { label: "fit of each mode", kind: "dash" },
                modes.length > 0 && { label: "mode", kind: "up" },
                added.length > 0 && { label: "+ added: comes when modes are identified again", kind: "dash" },
                dropped.length > 0 && { label: "dropped: goes then", colour: "rejected", kind: "dots" },
                gone.length > 0 && { label: "− dropped in study.toml", colour: "rejected", kind: "dots" },
                absent.length > 0 && { label: "? asked for, no mode found", colour: "rejected", kind: "dots" },
                forced.length > 0 && { label: "F forced line", colour: "forced", kind: "dash" },
                rejected.length > 0 && { label: "rejected", colour: "rejected", kind: "cross" },
                band && { label: "band of the mode's fit", colour: "rejected", alpha: 0.3, kind: "band" },
            ],
            press: can() ? (where, _, u) => {
                const reach = u.posToVal(SNAP, "x") - u.posToVal(0, "x"), near = modes.find(({ x }) => Math.abs(x - where) < reach)
                // The line of a mode is that mode; beside it, zoom in.
                if (near) return near.chosen ? offerMode() : view.set({ mode: near.is.number })
                const before = gone.find(hz => Math.abs(hz - where) < reach)
                if (before) return offerBack(before)
                // A mode below a stronger one's bell has its peak in a lower curve.
                if (!setup.peaks_hz) return offer("Where peaks stand out is known once modes are identified again.")
                const peak = setup.peaks_hz.reduce((best, at) => Math.abs(at - where) >= Math.abs(best - where) ? best : at, NaN), at = hertz(peak)
                const isSame = (x, peak) => Math.abs(x - peak) <= Math.max(SAME * peak, SAME_LINES * setup.spacing_hz), own = modes.find(({ x }) => isSame(x, peak)), lost = gone.find(hz => isSame(hz, peak)), none = `No peak stands out at ${hertz(where)}`
                if (!known(peak)) offer(`${none}, nor anywhere else.`)
                else if (lost) offerBack(lost)
                else if (own) offer(`${none}; the nearest is mode ${own.text}, at ${hertz(own.x)}.`)
                else offer(Math.abs(peak - where) < reach ? `Peak at ${at}.` : `${none}; the nearest peak is at ${at}.`, `Add a mode at ${at}`, rounded(peak), true)
            } : null,
        })
        const offerMode = () => {
            const isBack = isDropped(mode)
            offer(`Mode ${mode.text} at ${hertz(mode.x)}${isBack ? " is dropped" : ""}.`, isBack ? "Take it back" : "Drop this mode", asked(mode), isBack, mode.is.number)
        }
        if (mode) offerMode()
        queueMicrotask(() => offerBand(chart.u.scales.x.min, chart.u.scales.x.max))
        const count = [fresh.length && `${fresh.length} added`, back.length && `${back.length} no longer dropped`, dropped.length && `${dropped.length} dropped`, bands.length && plural(bands.length, "band")].filter(Boolean).join(", ")
        host.append(action, fitting, standing ? make("p.quiet", standing.in_words) : "", count && make("p.pick", `Picked: ${count}, in study.toml, not identified yet. `, button("Identify modes", identify(data)), typed(identify(data))))
        return chart.free
    },
}
