// Stiffness and mass over the height, and of groups, as fitted, against the model: bands of one standard deviation beside the tolerance.

import { make } from "@/canvas.js"
import { extent, freeing, items, legend, plot } from "@/curves.js"
import { known, metres, signed } from "@/numbers.js"

const named = quantity => quantity.replace("_1", ", 1st axis").replace("_2", ", 2nd axis")
// Segments that are together shorter than this share of the height, such as a foundation, do not set the scale for all others.
const SHORT = 0.05
const change = factor => 100 * (factor - 1)
const lastOf = data => data.profile?.with_effects ?? data.profile?.as_given
/** The quantities of a profile with what is known of their segments. */
const quantitiesOf = profile => items(profile?.quantities).map(({ quantity, segments }) => ({
    quantity, name: named(quantity),
    segments: items(segments).filter(one => one.given != null && [one.factor, one.z_bottom_m, one.z_top_m].every(known)),
})).filter(one => one.segments.length)

const groupsOf = profile => items(profile?.groups).filter(one => [one.factor, one.std, one.prior_std].every(known))
const inPercent = { room: 32, values: splits => splits.map(value => signed(value, splits[1] - splits[0] < 1 ? 1 : 0)) }

/** A row a group: the highest on top where heights are known, else as in study.toml. */
function drawGroups(grid, groups, kinds, stated) {
    const lowest = one => one.span_m?.[0] ?? -Infinity
    const rows = groups.toReversed().sort((a, b) => lowest(a) - lowest(b) || 0)
    const of = (profile, name) => groupsOf(profile).find(one => one.name === name)
    const furthest = one => Math.max(Math.abs(change(one.factor)) + 100 * one.std, stated(one))
    const reach = 1.05 * Math.max(1, ...kinds.flatMap(([, profile]) => groupsOf(profile).map(furthest)))
    const cell = make("div.cell", make("p.caption", "groups"))
    grid.append(cell)
    return plot(cell, {
        name: `change of each group: ${rows.toReversed().slice(0, 40).map(one => `${one.name} ${signed(change(one.factor), 1)} %`).join(", ")}`, small: true, still: true, height: 70 + 26 * rows.length,
        x: { label: "% of the group", range: [-reach, reach], ...inPercent },
        y: { label: null, range: [0, rows.length], splits: () => rows.map((_, i) => i + 0.5), values: () => rows.map(one => one.name) },
        behind(pen) {
            const box = (i, low, high) => pen.area([[low, i + 0.15], [high, i + 0.15], [high, i + 0.85], [low, i + 0.85]])
            pen.style("rejected", { alpha: 0.22 })
            rows.forEach((one, i) => box(i, -stated(one), stated(one)))
            pen.style("ink", { width: 1 })
            pen.line([[0, 0], [0, rows.length]])
            for (const [kind, profile] of kinds) rows.forEach(({ name }, i) => {
                const one = of(profile, name)
                if (!one) return
                pen.style(kind, { alpha: 0.22 })
                box(i, change(one.factor - one.std), change(one.factor + one.std))
                pen.style(kind, { width: 2, dash: kind === "given" && kinds.length > 1 ? [6, 3] : [] })
                pen.line([[change(one.factor), i + 0.15], [change(one.factor), i + 0.85]])
            })
        },
    })
}

export default {
    id: "profile",
    title: "Stiffness and mass, as fitted",
    from: "profile",
    has: data => quantitiesOf(lastOf(data)).length + groupsOf(lastOf(data)).length > 0,
    draw(host, data) {
        const { as_given, with_effects } = data.profile, last = lastOf(data)
        const kinds = [["given", as_given, with_effects ? "without effects" : "as given"], ["effects", with_effects, "with effects"]].filter(([, profile]) => profile)
        const segments = (profile, name) => quantitiesOf(profile).find(each => each.quantity === name)?.segments ?? []
        const stated = one => 100 * one.prior_std / (last.discrepancy?.scatter || 1)
        const all = kinds.flatMap(([, profile]) => quantitiesOf(profile).flatMap(each => each.segments))
        const heights = extent(all.flatMap(one => [one.z_bottom_m, one.z_top_m])) ?? [0, 1], tall = one => one.z_top_m - one.z_bottom_m, enough = SHORT * all.reduce((sum, one) => sum + tall(one), 0)
        const furthest = one => Math.max(Math.abs(change(one.factor)) + 100 * (one.std || 0), stated(one) || 0), most = list => extent([1, ...list.map(furthest)])[1]
        // The furthest, as long as they are short in all.
        let sum = 0
        const sorted = [...all].sort((a, b) => furthest(b) - furthest(a)), short = sorted.filter(one => (sum += tall(one)) < enough), usual = most(sorted.slice(short.length))
        const beyond = short.filter(one => furthest(one) > 3 * usual), reach = 1.05 * most(all.filter(one => !beyond.includes(one)))
        const edge = (list, of) => list.flatMap(one => [[of(one), one.z_bottom_m], [of(one), one.z_top_m]])
        const grid = make("div.multiples.tall")
        host.append(legend([
            { label: "tolerance that study.toml states", colour: "rejected", kind: "band", alpha: 0.4 },
            ...kinds.map(([colour, , label]) => ({ label: `fitted ${label}`, colour })),
            { label: "bands: ± 1 standard deviation", kind: "none" },
            beyond.length && { label: `beyond the scale: ${[...new Set(beyond.map(one => `${metres(one.z_bottom_m)} to ${metres(one.z_top_m)}`))].join(", ")}`, kind: "none" },
        ]), grid)
        const groups = groupsOf(last), drawn = groups.length ? [drawGroups(grid, groups, kinds, stated)] : []
        return freeing(quantitiesOf(last).map(({ quantity, name, segments: own }, i) => {
            const cell = make("div.cell", make("p.caption", name))
            grid.append(cell)
            return plot(cell, {
                name: `${name}, change of each segment: ${own.slice(0, 40).map(one => `${metres(one.z_bottom_m)} ${signed(change(one.factor), 1)} %`).join(", ")}`, small: true, still: true, height: 330,
                x: { label: "% of the table", range: [-reach, reach], ...inPercent },
                y: { label: i ? null : "height in m", range: heights },
                behind(pen) {
                    const band = (list, low, high) => pen.area([...edge(list, high), ...edge(list, low).reverse()])
                    pen.style("rejected", { alpha: 0.22 })
                    band(own, one => -stated(one), stated)
                    for (const [kind, profile] of kinds) {
                        pen.style(kind, { alpha: 0.22 })
                        band(segments(profile, quantity), one => change(one.factor - one.std), one => change(one.factor + one.std))
                    }
                    pen.style("ink", { width: 1 })
                    pen.line([[0, heights[0]], [0, heights[1]]])
                    for (const [kind, profile] of kinds) {
                        pen.style(kind, { width: 2, dash: kind === "given" && kinds.length > 1 ? [6, 3] : [] })
                        pen.line(edge(segments(profile, quantity), one => change(one.factor)))
                    }
                },
            })
        }).concat(drawn))
    },
}
