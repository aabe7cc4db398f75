// Tables: how the error fell, modes, comparison, sensor nodes, method and settings. Each has the shape of a picture, so that it
// stands among them.

import { identify, typed } from "@/actions.js"
import { make } from "@/canvas.js"
import { KINDS, fixed, known, mac, pis, plural, pvalue, signed, within } from "@/numbers.js"
import history from "@/pictures/history.js"

/**
 * A table of `groups`, each with `rows` and perhaps a `title`. A column is [head, unit, cell(row), kind]; `kind` is "number"
 * (the default), "text" or "wrap". With `choose`, rows that have a key can be chosen by click and by their first cell, which is a button.
 */
export function table(label, columns, groups, { key, chosen, choose } = {}) {
    const all = columns.filter(Boolean)
    const line = row => {
        const name = key?.(row), is = String(name === chosen), isChoice = choose && name != null
        const cells = all.map(([, , cell, kind = "number"], i) => {
            const content = cell(row) ?? "–"
            return make("td", { class: kind }, i || !isChoice ? content : make("button.pick", { "aria-pressed": is }, content))
        })
        const tr = make("tr", isChoice && { class: is === "true" && "chosen", onclick: event => { if (!event.target.closest("button:not(.pick), a")) choose(name) } }, ...cells)
        if (isChoice) tr.dataset.key = name
        return tr
    }
    return make("div.scroll", { role: "region", "aria-label": label, tabIndex: 0 }, make("table", {},
        make("thead", make("tr", ...all.map(([head, unit, , kind = "number"]) => make("th", { scope: "col", class: kind }, head, unit && make("small", unit))))),
        ...groups.map(({ title, rows }) => make("tbody", title && make("tr.group", make("th", { scope: "rowgroup", colSpan: all.length }, title)), ...rows.filter(row => row != null).map(line)))))
}

/** A bar before its value: `value` of `most`, in a colour of style.css. */
export function bar(value, most, name, text = fixed(value, 2)) {
    const mark = make("span.bar", { "aria-hidden": "true" })
    mark.style.width = 110 * (value ?? 0) / most + "px"
    mark.style.background = `var(--${name})`
    return make("span", mark, text)
}

const fall = {
    id: "error-steps", title: "How the error fell",
    has: d => Boolean(d.history?.length),
    says: d => history.says(d),
    draw(host, { history: steps }) {
        const bars = name => {
            const most = Math.max(...steps.map(s => s?.[name] ?? 0)) || 1
            return s => bar(s[name], most, s.effects?.length ? "effects" : "given")
        }
        host.append(table("How the error fell", [
            ["Step", "", s => s.step],
            ["What was done", "", s => s.action, "text"],
            ["Frequency error", "mean, %", bars("mean_abs_frequency_error_percent"), "text"],
            ["Error of left-out sensors", "%", bars("held_out_error_percent"), "text"],
            ["MAC", "mean", s => mac(s.mean_mac)],
            ["Chi-squared", "on degrees of freedom", s => `${fixed(s.chi_squared, 0)} / ${s.degrees_of_freedom ?? "–"}`],
            ["p", "of fit", s => pvalue(s.p_value)],
        ], [{ rows: steps }]))
    },
}

const modes = {
    id: "modes-table", title: "Modes", follows: ["mode"], long: true,
    has: d => Boolean(d.modes?.modes?.length),
    says({ modes: { modes } }) {
        const second = modes.filter(m => m.second_opinion), no = second.filter(m => m.second_opinion.agrees === false).map(m => m.number)
        return `${plural(modes.length, "mode")}, each with one standard deviation. ` + (!second.length ? "No second method was asked."
            : `A second method, which shares no step with the first, has ${second.length} of them` + (no.length ? `; it disagrees on mode ${no.join(", ")}.` : " and agrees on all."))
    },
    draw(host, { modes: { modes } }, view) {
        const any = (name, ...column) => modes.some(m => m[name] != null) && column
        const second = (name, std, scale) => m => m.second_opinion && within(m.second_opinion[name], m.second_opinion[std], scale)
        host.append(table("Modes", [
            ["Mode", "", m => m.number, "text"],
            ["Frequency", "Hz", m => within(m.frequency_hz, m.frequency_std_hz)],
            ["Damping", "% of critical", m => within(m.damping_ratio, m.damping_ratio_std, 100)],
            ["Collinearity", "of phases", m => mac(m.phase_collinearity)],
            any("misfit", "Misfit", "1 is chance", m => fixed(m.misfit, 2)),
            any("lines_in_bandwidth", "Lines", "in its bandwidth", m => fixed(m.lines_in_bandwidth, 1)),
            any("second_opinion", "Second method", "Hz", second("frequency_hz", "frequency_std_hz")),
            any("second_opinion", "", "% of critical", second("damping_ratio", "damping_ratio_std", 100)),
            any("second_opinion", "", "verdict", m => !m.second_opinion ? "not found" : m.second_opinion.agrees === false ? make("span", { tint: "bad" }, "disagrees") : "agrees", "text"),
            any("pair_with", "Pair", "with mode", m => m.pair_with ?? ""),
        ], [{ rows: modes }], { key: m => m.number, chosen: view.get("mode", modes[0].number), choose: mode => view.set({ mode }) }))
    },
}

const kinds = c => Object.entries(KINDS).filter(([name]) => c?.[name]?.pairs)

const comparison = {
    id: "comparison-table", title: "Errors of the model, mode by mode", follows: ["mode"], uses: ["comparison"], long: true,
    has: d => kinds(d.comparison).length > 0,
    says({ comparison: { given, effects } }) {
        const last = effects ?? given, p = last.p_value
        return `The mean MAC is ${[given, effects].filter(Boolean).map(c => mac(c.mean_mac)).join(", with effects ")}.`
            + (known(p) ? ` Chi-squared is ${fixed(last.chi_squared, 0)} on ${last.degrees_of_freedom} degrees of freedom, p ${pis(p)}: ${p < 0.01 ? "the model misses by more than" : "what it misses lies within"} the measurement's deviations and its own tolerance.` : "")
    },
    draw(host, { comparison: c }, view) {
        const list = kinds(c), last = c[list.at(-1)[0]]
        const numbers = [...new Set(list.flatMap(([name]) => c[name].pairs.map(p => p.measured)))].sort((a, b) => a - b)
        const of = (name, n) => c[name].pairs.find(p => p.measured === n)
        host.append(table("Errors of the model", [
            ["Mode", "", n => n, "text"],
            ["Measured", "Hz", n => fixed(list.map(([name]) => of(name, n)?.measured_hz).find(Boolean), 4)],
            ...list.flatMap(([name, title]) => [
                [title.replace(/^m/, "M"), "Hz", n => make("span", { tint: name + "-text" }, fixed(of(name, n)?.model_hz, 4))],
                ["", "error %", n => signed(of(name, n)?.frequency_error_percent, 2)],
                ["", "in deviations", n => signed(of(name, n)?.frequency_z, 1)],
                ["", "MAC", n => mac(of(name, n)?.mac)]]),
        ], [{ rows: numbers }], { key: n => n, chosen: view.get("mode", numbers[0]), choose: mode => view.set({ mode }) }))
        for (const [side, say] of [["measured", "Measured and without a partner in the model"], ["model", "In the model and not measured"]]) {
            const alone = (last.unpaired ?? []).filter(u => u?.side === side)
            if (alone.length) host.append(make("p", `${say}: mode ${alone.map(u => u.number).join(", ")}.`))
        }
        host.append(...(last.warnings ?? []).map(text => make("p.quiet", text)))
    },
}

const nodes = {
    id: "nodes-table", title: "Nodes", long: true,
    has: d => Boolean(d.nodes?.length),
    says({ nodes }) {
        const ill = nodes.filter(n => n?.lost_windows > 0 || n?.bad_windows > 0).map(n => n.node)
        return `${plural(nodes.length, "node")}. ${ill.length ? `Lost or damaged windows at node ${ill.join(", ")}.` : "No window was lost or damaged."}`
    },
    draw(host, { nodes }) {
        host.append(table("Nodes", [
            ["Node", "", n => n.node], ["Setup", "", n => n.setup, "text"], ["Channels", "", n => n.channels?.join(", "), "wrap"],
            ["Windows", "", n => n.windows], ["Lost", "", n => n.lost_windows],
            ["Lost", "%", n => fixed(100 * n.lost_windows / (n.windows + n.lost_windows || 1), 1)], ["Damaged", "", n => n.bad_windows],
            ["Last window", "", n => n.last_window?.replace("T", " ").replace(/\.\d+/, "").replace("Z", " UTC"), "text"],
        ], [{ rows: nodes }]))
    },
}

const method = {
    id: "settings", title: "How it was done, and how to do it again", long: true,
    has: d => Boolean(d.study),
    says: d => `Belfry ${d.belfry?.version ?? "of unknown version"}. The settings below and the recordings are all that is needed to repeat it.`,
    draw(host, { study, modes, model, update }) {
        const sensors = study.sensors ?? [], vector = (v, digits) => v?.map(x => fixed(x, digits)).join(", ")
        const folded = (title, open, ...content) => make("details", { open }, make("summary", title), ...content)
        const words = [
            modes && "Modes are fitted to averaged spectra; a second method fits subspaces of correlations. Standard deviations come from the scatter of the averages.",
            ...(modes?.segments?.reasons ?? []),
            model && "The model is compared mode by mode, paired by shape and frequency. Chi-squared weighs differences by the measurement's deviations and by the model's stated tolerance. Candidates are weighed by their evidence.",
            update && "The direct update is that of Lei, Wang, Shen (2012): K* = K + M Φ Ψ Φᵀ M.",
        ]
        host.append(...words.filter(Boolean).map(text => make("p", text)), ...[
            ...study.setups?.length ? [identify({ modes })] : [],
            ...model ? ["compare", "update", "covalidate", "diagnose", "profile", "history"].map(name => [name]) : [],
            ...(model?.effects ?? []).map(effect => ["add", effect.split("=")[0]]),
        ].map(command => make("div", typed(command))))
        if (study.setups?.length) host.append(table("Setups", [
            ["Setup", "", s => s.name, "text"], ["Rate", "Hz", s => s.sampling_rate_hz], ["Unit", "", s => s.unit, "text"],
            ["Channels", "", s => s.channels?.length],
            ["Files", "", s => s.live ? "from nodes" : s.files?.join(", "), "wrap"]], [{ rows: study.setups }]))
        if (study.toml) host.append(folded("study.toml, all settings", true, make("pre", { tabIndex: 0 }, study.toml)))
        if (sensors.length) host.append(folded(plural(sensors.length, "channel"), false, table("Channels", [
            ["Channel", "", s => s.channel, "text"], ["Node", "", s => s.node],
            ["Height", "m", s => fixed(s.elevation_m, 2)], ["Off the axis", "x, y in m", s => vector(s.offset_m, 2)], ["Direction", "x, y, z", s => vector(s.direction, 3)]], [{ rows: sensors }])))
        const inputs = Object.entries(modes?.inputs ?? {})
        if (inputs.length) host.append(folded("Checksums of what the modes were identified from", false, table("Checksums", [["Input", "", i => i[0], "text"], ["Checksum", "", i => i[1], "text"]], [{ rows: inputs }])))
    },
}

export const tables = { fall, modes, comparison, nodes, method }
