// What was measured of every mode, and what was fitted to it: the chosen mode large, the others small.

import { make } from "@/canvas.js"
import { chosenMode, clean, densityIn, extent, freeing, items, plot, steps, unpack } from "@/curves.js"
import { clamp, hertz, inWords, known, named, percent, plural, power } from "@/numbers.js"

// Standard deviations that hold 95 % of all lines.
const BAND = 1.96

/** The fits mode by mode; of several setups the chosen one, or one that does not fit. */
function panelsOf(data, view) {
    const modes = new Map()
    for (const one of items(data.spectra?.fitted)) modes.set(one.mode, [...modes.get(one.mode) ?? [], one])
    return [...modes].sort(([a], [b]) => a - b).map(([number, fits]) => {
        const one = fits.find(fit => fit.setup === view.get("setup")) ?? fits.find(fit => fit.is_misfit) ?? fits[0]
        const measured = unpack(one.measured), fitted = unpack(one.fitted), mode = items(data.modes?.modes).find(mode => mode.number === number)
        return {
            number, one, measured, fitted, mode, unit: densityIn(items(data.spectra.setups).find(setup => setup.setup === one.setup)), misfit: fits.some(fit => fit.is_misfit),
            hz: Array.isArray(one.frequency_hz) ? Float64Array.from(one.frequency_hz) : steps(one.first_hz, one.spacing_hz, fitted.length),
            name: `mode ${number}${mode ? `: ${hertz(mode.frequency_hz)}` : ""}`, setup: fits.length > 1 ? `, ${inWords(one.setup)}` : "",
        }
    }).filter(panel => panel.hz.length > 1)
}

function draw(host, { hz, measured, fitted, one, mode, name, misfit, unit }, more) {
    const edge = sign => clean(fitted.map(value => value * Math.max(1 + sign * BAND * one.scatter, 0.02)), true), banded = known(one.scatter)
    const [low, high] = extent([...fitted, ...measured], true) ?? [1e-12, 1]
    return plot(host, {
        name: name + (misfit ? ", something else lies here" : ""), ...more,
        x: { range: [hz[0], hz.at(-1)], bare: !more.small },
        y: { label: more.small ? null : `density in ${unit}`, log: true, range: [low * 0.5, high * 1.8], least: 5 },
        data: [hz, clean(measured, true), clean(fitted, true), ...(banded ? [edge(1), edge(-1)] : [])],
        lines: [{ colour: "measured", dots: more.small ? 3.5 : 5 }, { width: 1.6 }, { hidden: true }, { hidden: true }],
        bands: banded ? [{ between: [3, 4], colour: "rejected" }] : [],
        marks: mode ? [{ x: mode.frequency_hz }] : [],
        at: (_, index) => hertz(hz[index]),
        legend: [
            { label: "measured", colour: "measured", kind: "dot", value: index => power(measured[index], 1) },
            { label: "fitted", value: index => power(fitted[index], 1) },
            banded && { label: "95 % of the lines, if the fit lacks nothing", colour: "rejected", alpha: 0.4, kind: "band" },
        ],
    })
}

function residuals(host, { hz, measured, fitted, one }, more) {
    const left = clean(measured.map((value, i) => (value / fitted[i] - 1) / one.scatter))
    const reach = Math.min(1.1 * Math.max(2.7, ...extent(left.map(Math.abs)) ?? []), 9)
    return plot(host, {
        name: "What the fit leaves, line by line, in standard deviations", height: 110, ...more,
        x: { label: "frequency in Hz", range: [hz[0], hz.at(-1)] },
        y: { label: "left, in std", range: [-reach, reach], least: 5, splits: () => reach > 5 ? [-5, 0, 5] : [-2, 0, 2] },
        data: [hz, left],
        behind(pen) {
            pen.style("rejected", { alpha: 0.22 })
            pen.box(hz[0], -BAND, hz.at(-1), BAND)
            pen.style("ink", { width: 1 })
            pen.level(0)
        },
        front(pen) {
            left.forEach((value, i) => {
                if (value == null) return
                const off = Math.abs(value) > BAND
                pen.style(off ? "bad" : "measured")
                pen.dot(hz[i], clamp(value, -reach, reach), off ? 3.5 : 2.5, off)
            })
        },
    })
}

export default {
    id: "fits",
    title: "Fitted and measured spectra",
    long: true,
    follows: ["mode", "setup"],
    says(data, view) {
        const panels = panelsOf(data, view), misfits = panels.filter(panel => panel.misfit).map(panel => panel.number)
        return `Each mode's spectrum behind its modal filter, and the fit: of ${plural(panels.length, "mode")} ` + (misfits.length
            ? `something else lies at ${named("mode", misfits)}: the fit leaves more there than chance does.` : "none leaves more than chance does.")
    },
    has: data => items(data.spectra?.fitted).length > 0,
    draw(host, data, view) {
        const panels = panelsOf(data, view), chosen = panels.find(panel => panel.number === chosenMode()), made = []
        if (chosen) {
            const large = make("div.large", make("h4", `${chosen.name}${chosen.mode ? `, damping ${percent(chosen.mode.damping_ratio)}` : ""}${chosen.setup}${chosen.one.is_misfit ? " — something else lies here" : ""}`))
            host.append(large)
            const both = { zoom: "fits", sync: "fits", with: new Set() }
            made.push(draw(large, chosen, { height: 260, quiet: chosen.one.scatter > 0, ...both }))
            if (chosen.one.scatter > 0) made.push(residuals(large, chosen, both))
        }
        const grid = make("div.multiples")
        host.append(grid, make("p.axes", `Density in ${panels[0]?.unit} over frequency in Hz. Dots: measured. Line: fitted. Grey: where 95 % of the dots lie if the fit lacks nothing.`))
        for (const panel of panels) {
            const on = panel === chosen
            const cell = make("div", { class: `cell${panel.misfit ? " misfit" : ""}${on ? " chosen" : ""}` },
                make("button.caption", { "aria-pressed": String(on), onclick: () => view.set({ mode: on ? null : panel.number, "zoom.fits": null }) },
                    panel.name, panel.misfit && make("strong", " misfit")))
            grid.append(cell)
            made.push(draw(cell, panel, { small: true, still: true, height: 130 }))
        }
        return freeing(made)
    },
}
