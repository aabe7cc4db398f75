// The page of a fleet: a list and a map of structures, and a page of each. What the server says is asked for again every few seconds; the address
// after # names the structure that is shown.

import { make } from "@/canvas.js"
import { clamp, duration, fixed, known, named, plural, signed } from "@/numbers.js"

const LOOK_MS = 2000
// A structure's results are some MB after a year.
const LOOK_AT_ONE_MS = 10000
// State, in words, its mark and its colour; the worst first. A mark tells states apart where colours do not.
const STATES = {
    alarm: ["alarm", "▲", "bad"],
    silent: ["silent", "○", "given-text"],
    node_trouble: ["a node", "▼", "given-text"],
    changed: ["changed", "◆", "forced-text"],
    unreadable: ["unreadable", "×", "bad"],
    waiting: ["no result yet", "□", "quiet"],
    learning: ["learning", "◐", "quiet"],
    unchanged: ["unchanged", "●", "effects-text"],
}
const ALARMS = { open: "open", lasting: "lasting", withdrawn: "withdrawn" }
const header = document.getElementById("header"), main = document.getElementById("main")
document.getElementById("nav").hidden = true
// It leads to what a study's page has.
document.querySelector(".skip").remove()
const shape = (tag, attributes, ...children) => {
    const element = document.createElementNS("http://www.w3.org/2000/svg", tag)
    for (const [name, value] of Object.entries(attributes)) name === "fill" || name === "stroke" ? element.style[name] = `var(--${value})` : element.setAttribute(name, value)
    element.append(...children)
    return element
}
const chosen = () => new URLSearchParams(location.hash.slice(1)).get("structure")
const address = key => "#" + new URLSearchParams({ structure: key })
const moment = s => known(s) ? new Date(1000 * s).toISOString().slice(0, 16).replace("T", " ") : "–"
// What is wrong with nodes, in a sentence each.
const troubles = one => Object.entries(one.node_problems).flatMap(([node, problems]) => problems.map(problem => `node ${node} ${problem}`))
const ago = (s, now) => known(s) ? make("span", { title: moment(s) + " UTC" }, duration(Math.max(0, now - s)) + " ago") : "–"
const mark = state => {
    const [words, sign, colour] = STATES[state] ?? [state, "?", "quiet"]
    return make("span.state", { tint: colour }, make("b", { "aria-hidden": "true" }, sign), " " + words)
}

/** What an alarm says, in a sentence. */
function sentence(alarm) {
    const changes = alarm.modes.filter(mode => Math.abs(mode.percent) > 3 * mode.std_percent)
        .sort((a, b) => Math.abs(b.percent / b.std_percent) - Math.abs(a.percent / a.std_percent))
        .map(mode => `mode ${mode.number} by ${signed(mode.percent, 2)} ± ${fixed(mode.std_percent, 2)} %`)
    return `${alarm.between_s.map(moment).join(" to ")}: ${changes.slice(0, 3).join(", ")}${changes.length > 3 ? ` and ${changes.length - 3} more` : ""} (${ALARMS[alarm.state] ?? alarm.state})`
}

function table(label, heads, rows) {
    return make("div.scroll", { role: "region", "aria-label": label, tabIndex: 0 }, make("table", {},
        make("thead", make("tr", ...heads.map(([head, kind]) => make("th", { scope: "col", class: kind }, head)))),
        make("tbody", ...rows.map(cells => make("tr", ...cells.map((cell, i) => make("td", { class: heads[i][1] }, cell)))))))
}

const facts = pairs => make("dl.facts", ...pairs.flatMap(([term, value]) => [make("dt", term), make("dd", value)]))

// ---- all structures

let wanted = null

function list(fleet) {
    const all = fleet.structures, shown = all.filter(one => !wanted || one.state === wanted)
    const counts = Object.keys(STATES).map(state => [state, all.filter(one => one.state === state).length]).filter(([, count]) => count)
    const filter = make("div.controls", { role: "group", "aria-label": "States" },
        ...[[null, all.length], ...counts].map(([state, count]) => make("button", {
            "aria-pressed": String(wanted === state),
            onclick: () => { wanted = state; draw() },
        }, state ? `${STATES[state][0]} ${count}` : `all ${count}`)))
    const order = Object.keys(STATES)
    const rows = [...shown].sort((a, b) => order.indexOf(a.state) - order.indexOf(b.state)).map(one => {
        const alarms = one.alarms.filter(alarm => alarm.state !== "withdrawn")
        return [
            make("a", { href: address(one.key) }, one.name), mark(one.state), ago(one.last_data_s, fleet.at_s), ago(one.last_result_s, fleet.at_s),
            String(one.modes), String(one.nodes), one.why ?? (one.state === "node_trouble" ? troubles(one)[0] : alarms.length ? sentence(alarms.at(-1)) : "–"),
        ]
    })
    const heads = [["Structure"], ["State"], ["Last data"], ["Newest result"], ["Modes", "number"], ["Nodes", "number"], ["What it says", "wrap"]]
    return [
        make("h2", "Structures"), filter, map(shown),
        rows.length ? table("Structures", heads, rows) : make("p.quiet", all.length ? "No structure is in this state." : "No structure has been added yet: `belfry work --from URL --add STUDY` adds one."),
    ]
}

/** Structures at their places, north up, a degree of longitude as long as it is there; nothing where none has a place. */
function map(structures) {
    const placed = structures.filter(one => one.place_deg)
    if (!placed.length) return null
    const width = clamp(main.clientWidth - 40, 320, 1140), height = Math.max(260, Math.round(0.37 * width)), rim = 46
    const north = placed.map(one => one.place_deg[0]), east = placed.map(one => one.place_deg[1])
    const middle = values => (Math.min(...values) + Math.max(...values)) / 2
    const [latitude, longitude] = [middle(north), middle(east)], narrow = Math.max(0.05, Math.cos(latitude * Math.PI / 180))
    const span = values => Math.max(...values) - Math.min(...values)
    const degree = Math.min((width - 2 * rim) / Math.max(span(east) * narrow, 0.02), (height - 2 * rim) / Math.max(span(north), 0.02))
    const x = place => width / 2 + (place[1] - longitude) * narrow * degree, y = place => height / 2 - (place[0] - latitude) * degree
    const picture = shape("svg", { viewBox: `0 0 ${width} ${height}`, role: "group", "aria-label": "Map of the structures", class: "map" })
    // Lines of latitude and longitude at round degrees.
    const step = [30, 10, 5, 2, 1, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01].find(step => step * degree < 160) ?? 0.01
    const digits = Math.max(0, Math.ceil(-Math.log10(step)))
    const round = (from, to) => { const lines = []; for (let at = Math.ceil(from / step) * step; at <= to; at += step) lines.push(at); return lines }
    for (const at of round(longitude - width / 2 / degree / narrow, longitude + width / 2 / degree / narrow)) {
        picture.append(shape("line", { x1: x([0, at]), x2: x([0, at]), y1: 0, y2: height, stroke: "line" }),
            shape("text", { x: x([0, at]) + 4, y: height - 6, fill: "quiet" }, fixed(Math.abs(at), digits) + (at < 0 ? "° W" : "° E")))
    }
    for (const at of round(latitude - height / 2 / degree, latitude + height / 2 / degree)) {
        picture.append(shape("line", { x1: 0, x2: width, y1: y([at, 0]), y2: y([at, 0]), stroke: "line" }),
            shape("text", { x: 4, y: y([at, 0]) - 4, fill: "quiet" }, fixed(Math.abs(at), digits) + (at < 0 ? "° S" : "° N")))
    }
    const isCrowded = placed.length > 40
    for (const one of placed) {
        const [words, sign, colour] = STATES[one.state] ?? STATES.waiting, at = one.place_deg
        const link = shape("a", { href: address(one.key), "aria-label": `${one.name}: ${words}` })
        link.append(shape("title", {}, `${one.name}: ${words}`), shape("circle", { cx: x(at), cy: y(at), r: 13, class: "target" }),
            shape("text", { x: x(at), y: y(at) + 6, "text-anchor": "middle", class: "sign", fill: colour }, sign))
        if (!isCrowded) link.append(shape("text", { x: x(at) + 12, y: y(at) + 5, fill: "ink" }, one.name))
        picture.append(link)
    }
    return make("figure", picture)
}

// ---- one structure

/** Frequencies of a mode in the newest intervals, in percent about their mean. */
function course(number, intervals) {
    const seen = intervals.map(one => [one.end_s, one.seen?.modes.find(mode => mode.number === number)?.frequency_hz]).filter(([, hz]) => known(hz))
    if (seen.length < 2) return null
    const mean = seen.reduce((sum, [, hz]) => sum + hz, 0) / seen.length
    const width = 340, height = 96, times = seen.map(([at]) => at), values = seen.map(([, hz]) => 100 * (hz / mean - 1))
    const most = Math.max(0.01, ...values.map(Math.abs)), span = times.at(-1) - times[0] || 1
    const x = at => 6 + (width - 12) * (at - times[0]) / span, y = value => height / 2 - (height / 2 - 8) * value / most
    const caption = `Mode ${number}: ${fixed(seen.at(-1)[1], 4)} Hz, within ± ${fixed(most, 2)} % of its mean in ${duration(span)}`
    const picture = shape("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": caption })
    picture.append(shape("line", { x1: 0, x2: width, y1: y(0), y2: y(0), stroke: "line" }))
    values.forEach((value, i) => picture.append(shape("circle", { cx: x(times[i]), cy: y(value), r: 1.8, fill: "measured" })))
    return make("figure.course", make("figcaption", make("p", caption)), picture)
}

function one(detail, now) {
    const newest = detail.intervals.at(-1), judgement = detail.judgement ?? {}
    const numbers = [...new Set(detail.intervals.flatMap(one => one.seen?.modes.map(mode => mode.number) ?? []))].sort((a, b) => a - b)
    const alarms = [...detail.alarms].reverse()
    const lost = judgement.lost_modes ?? []
    return [
        make("p", make("a", { href: "#" }, "All structures")),
        facts([
            ["State", mark(detail.state)], ["Last data", ago(detail.last_data_s, now)],
            ["Newest result", make("span", ago(detail.last_result_s, now), newest ? `, of ${plural(newest.windows, "window")} in ${duration(detail.every_s)}` : "")],
            ["Days judged", known(judgement.days) ? `${judgement.days}${judgement.missing_days ? `, ${judgement.missing_days} more are needed` : ""}${judgement.frost_days ? `, ${judgement.frost_days} left out for frost` : ""}` : "–"],
        ]),
        make("h2", "Changes"),
        alarms.length ? make("ul.findings", ...alarms.map(alarm => make("li", { class: alarm.state === "open" ? "warning" : "" }, sentence(alarm)))) : make("p.quiet", "None."),
        lost.length ? make("p.failed", `Not seen for a week: ${named("mode", lost)}.`) : null,
        make("h2", "Modes"),
        numbers.length ? table("Modes", [["Mode", "number"], ["Hz now", "number"], ["± Hz", "number"], ["in % of intervals", "number"]], numbers.map(number => {
            const seen = detail.intervals.map(one => one.seen?.modes.find(mode => mode.number === number)).filter(Boolean), last = seen.at(-1)
            return [String(number), fixed(last.frequency_hz, 4), fixed(last.frequency_std_hz, 4), fixed(100 * seen.length / detail.intervals.length, 0)]
        })) : make("p.quiet", "No interval has shown one yet."),
        make("div.courses", ...numbers.map(number => course(number, detail.intervals)).filter(Boolean)),
        make("h2", "Nodes"),
        table("Nodes", [["Node", "number"], ["Last data"], ["Problems", "wrap"]], Object.entries(detail.nodes_seen_s).map(([node, seen]) => [node, ago(seen, now), (detail.node_problems[node] ?? []).join("; ") || "–"])),
        newest?.warnings.length ? make("ul.findings", ...newest.warnings.map(warning => make("li.warning", warning))) : null,
    ]
}

// ---- what is shown

let fleet = null, detail = null, detailAt = 0, trouble = "", drawn = ""

function draw() {
    const key = chosen(), now = fleet?.at_s ?? Date.now() / 1000
    if (!fleet?.structures) return void main.replaceChildren(make("p.quiet", trouble || "Loading"))
    const isOne = key && detail?.key === key
    const title = isOne ? detail.name : "Fleet"
    document.title = title
    header.replaceChildren(make("h1", title), make("p.quiet", `${plural(fleet.structures.length, "structure")}, ${plural(fleet.workers, "worker")} at work, ${moment(fleet.at_s)} UTC`),
        ...trouble ? [make("p.failed", { role: "status" }, trouble)] : [])
    // What is the same stays, so that a reader's place and selection do.
    const text = JSON.stringify([key, isOne ? detail : fleet.structures, wanted, Math.floor(now / 10)])
    if (text === drawn) return
    drawn = text
    const focused = document.activeElement?.closest("main") ? document.activeElement.textContent : null
    main.replaceChildren(...(key ? isOne ? one(detail, now) : [make("p", make("a", { href: "#" }, "All structures")), make("p.quiet", trouble || "Loading")] : list(fleet)).filter(Boolean))
    if (focused) [...main.querySelectorAll("a, button")].find(element => element.textContent === focused)?.focus()
}

async function ask(path) {
    const answer = await fetch(path)
    const said = await answer.json()
    if (!answer.ok) throw new Error(said.error)
    return said
}

async function look() {
    try {
        const said = await ask("/data")
        if (said.structures) fleet = said
        trouble = said.error ? `The server: ${said.error}` : ""
        const key = chosen()
        if (key && (detail?.key !== key || Date.now() - detailAt > LOOK_AT_ONE_MS)) {
            const found = await ask("/structure?" + new URLSearchParams({ key }))
            if (chosen() === key) [detail, detailAt] = [found, Date.now()]
        }
    } catch (error) {
        trouble = error instanceof TypeError ? "`belfry serve` has ended." : error.message
    }
    draw()
}

addEventListener("resize", () => { drawn = ""; draw() })
addEventListener("hashchange", () => { draw(); scrollTo(0, 0); look() })
setInterval(look, LOOK_MS)
look()
