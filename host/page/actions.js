// What the page can ask the server for. Every action is a command, which stands beside its button; in a report, which has
// no server, there is none of this. One job runs at a time, its state in the status line.

import { make } from "@/canvas.js"
import { fixed, mac, significant } from "@/numbers.js"
import { ask, data, live, on, preview, tell as announce, watch } from "@/store.js"
import { view } from "@/view.js"

/** Whether the page can act: `if (can()) ...`. */
export const can = () => live

// As the server tells it.
let job = null
// The last error, a sentence.
let trouble = ""
let connected = true
// Shows the state in the status line, once there is one.
let tell = () => {}
const busy = () => job?.state === "running"

/** Runs a command, such as `act(["diagnose"])` or `act(["add", "base-rotation"])`. */
async function act(command) {
    if (!live || busy()) return
    job = { command: "belfry " + said(command), state: "running", stage: "starting" }
    return attempt(async () => {
        const answer = await ask("/run", { command })
        // Events may have been faster.
        if (job?.id !== answer.job.id) job = answer.job
    }, () => job = null)
}

/** Asks the server for something; where that fails, undoes what was shown and says why. */
async function attempt(work, undo) {
    trouble = ""
    tell()
    try { await work() } catch (error) {
        undo()
        trouble = error.message
    }
    tell()
}

// A pick shows at once, before the data that have it are there.
let picked = null
/** Picks in study.toml that modes were not identified with yet, whoever made them. */
export const picks = () => picked ?? data()?.picks ?? { added_hz: [], dropped: [], bands: [] }
on(reason => { if (reason === "data") picked = null })

/** Adds a mode at this frequency to the choice in study.toml, or drops it; each takes the other back. `mode` is the number of one that is there. */
export function pick(hz, isAdded, mode) {
    const now = picks(), toggled = (list, one) => list.includes(one) ? list.filter(each => each !== one) : [...list, one]
    return choose({ ...now, ...(mode ? { dropped: toggled(now.dropped, mode) } : { added_hz: toggled(now.added_hz, hz) }) }, isAdded ? { add_hz: [hz] } : { drop_hz: [hz] })
}

/** Lets a mode be fitted to the lines of a band [from, to]; null lets the data choose. */
export function fitTo({ number: mode, frequency_hz: hz }, band_hz) {
    const now = picks()
    return choose({ ...now, bands: [...now.bands.filter(b => b.mode !== mode), { mode, band_hz }] }, { bands: [{ hz, band_hz }] })
}

function choose(after, change) {
    const show = now => {
        picked = now
        announce("picks")
    }
    show(after)
    return attempt(() => ask("/picks", change), () => show(null))
}

/** The command that identifies modes the way it was done last. */
export const identify = ({ method }) => method?.commands.find(([name]) => name === "identify") ?? ["identify"]

const cancel = () => attempt(() => ask("/cancel", {}), () => {})

/** Samples of one channel, as GET /samples answers. */
export const samples = query => ask("/samples?" + new URLSearchParams(query))

const quoted = word => /^[\w@.:=,+/-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`

/** A command as one would type it. */
function said([name, ...words]) {
    return [name, data()?.study?.folder ?? ".", ...words.map(quoted)].join(" ")
}

/** A command to read and copy. */
export function typed(command) {
    const text = typeof command === "string" ? command : "belfry " + said(command)
    const copy = make("button.copy", { "aria-label": `Copy ${text}`, onclick: async () => {
        const old = copy.textContent
        try { await navigator.clipboard.writeText(text); copy.textContent = "copied" } catch {
            // No clipboard: it stands selected instead.
            getSelection().selectAllChildren(code)
            copy.textContent = "selected"
        }
        setTimeout(() => copy.textContent = old, 1500)
    } }, "copy")
    const code = make("code", text)
    return make("span.command", code, copy)
}

/** A button that runs a command. */
export function button(label, command, properties = {}) {
    return make("button", { "aria-disabled": busy() ? "true" : null, "data-runs": "1", ...properties, onclick: () => act(command) }, label)
}

const name = effect => effect.split("=")[0]
/** A candidate as `belfry add` takes it. */
export const candidateName = c => c.where ? `${c.effect}@${c.where}` : c.effect

/** Whether an effect is in the model. */
export const isIn = (d, text) => (d.model?.effects ?? []).some(e => name(e) === text)

/** Whether one of these names, or things with an effect, is this candidate. */
export const isAmong = (c, names) => [names ?? []].flat().some(name => [c.effect, candidateName(c)].includes(name?.effect ?? name))

/** The name of the effect that the diagnosis would add: the reader's candidate, otherwise the best. */
function chosen({ diagnosis }) {
    const possible = (diagnosis?.candidates ?? []).filter(c => c && c.admissible !== false), is = names => possible.find(c => isAmong(c, names)), c = is(view.get("candidate")) ?? is(diagnosis?.best)
    return c && candidateName(c)
}

/** The actions of a section, each with its command. */
export function actionsOf(section, d) {
    if (!live || !d) return null
    const { modes: has, model: modelled } = d, effects = d.model?.effects ?? []
    const text = chosen(d), last = effects.length > 0 && name(effects.at(-1)), undo = last && [`Undo: remove ${last}`, ["remove", last]]
    const isRecorded = d.study?.setups?.some(s => !s.live), routes = [["Identify modes", ["identify"]], isRecorded && ["Identify modes straight from the recording", ["identify", "--direct"]]]
    const list = {
        spectra: routes,
        modes: routes,
        model: has && d.study?.has_model && [["Compare with the model", ["compare"]], undo],
        update: has && modelled && [["Update directly", ["update"]], ["Predict left-out sensors", ["covalidate"]]],
        diagnosis: has && modelled && [["Ask what is missing", ["diagnose"]],
            text && !isIn(d, text) && [`Add ${text} to the model`, ["add", text]],
            undo,
            ["Fit the stiffness profile", ["profile"]]],
    }[section]
    const rows = (list || []).filter(Boolean)
    if (!rows.length) return null
    return make("div.actions.no-print", ...rows.map(([label, command]) => make("div.action", button(label, command), typed(command))))
}

/** Sliders for the values of the model's effects. The model follows at once; nothing is written. */
export function sliders() {
    const host = make("div.sliders.no-print")
    let effects = [], built = null, wanted = false, flying = false, changed = false

    // As GET /try and the address have them.
    const words = () => effects.map(one => candidateName(one) + (one.parameters.length ? "=" : "") + one.parameters.map(p => `${p.name}=${p.now ?? p.value}`).join(","))

    // One request at a time; the newest values follow when it is back.
    async function send() {
        if (flying || !wanted) return
        wanted = false
        flying = true
        let said
        try {
            const answer = await ask("/try?" + new URLSearchParams(words().map(word => ["effect", word])))
            const { mean_abs_frequency_error_percent: error, mean_mac } = answer.comparison
            said = `A preview, nothing is written: mean error of frequencies ${fixed(error, 2)} %, mean MAC ${mac(mean_mac)}. The commands fit the values themselves.`
            // Not after a reset meanwhile.
            if (changed) preview(answer)
        } catch (error) { said = error.message }
        flying = false
        const note = host.querySelector(".note")
        if (note) note.textContent = said
        send()
    }

    function build(reason) {
        const values = data()?.model?.values ?? [], key = JSON.stringify(values)
        if (reason !== "data") return
        // The same effects: new data have taken a preview away, and the values that it shows stand.
        if (key === built) {
            wanted = changed
            return send()
        }
        // Values in the address are of the effects that there were.
        if (built) {
            built = ""
            view.set({ try: null })
        }
        built = key
        effects = structuredClone(values)
        const tried = [view.get("try") ?? []].flat().map(word => String(word).match(/^([^=]*)=(.*)$/) ?? [])
        for (const one of effects) for (const pair of tried.find(([, name]) => name === candidateName(one))?.[2].split(",") ?? []) {
            const [name, value] = pair.split("="), p = one.parameters.find(p => p.name === name)
            if (p?.value && Number(value) / p.value >= 0.1 && Number(value) / p.value <= 10) p.now = Number(value)
        }
        changed = wanted = effects.some(one => one.parameters.some(p => p.now))
        const rows = []
        for (const effect of effects) for (const p of effect.parameters) {
            const fitted = p.value
            if (!fitted) continue
            const id = `slider-${rows.length}`, output = make("output", { htmlFor: id })
            const say = value => input.ariaValueText = output.textContent = `${significant(value)} ${p.unit.replace(/^-$/, "")}, ${value === fitted ? "as fitted" : `${significant(value / fitted)} times the fitted`}`
            const input = make("input", { id, type: "range", min: "-1", max: "1", step: "0.01", oninput: () => {
                const value = Number(input.value) ? Number((fitted * 10 ** input.value).toPrecision(5)) : fitted
                say(p.now = value)
                changed = wanted = true
                view.set({ try: words() })
                send()
            } })
            input.value = String(Math.log10((p.now ?? fitted) / fitted))
            say(p.now ?? fitted)
            rows.push(make("label", { for: id }, `${candidateName(effect)}, ${p.name}`), input, output)
        }
        host.replaceChildren(...rows.length ? [make("p", "Try other values of the model's effects: frequencies, shapes and MAC follow."), ...rows,
            make("button", { onclick: () => {
                view.set({ try: null })
                host.querySelector("button").focus()
            } }, "Reset to the fitted values"),
            make("span.note.quiet", { role: "status" }, "From a tenth to ten times the fitted value. A value of your own cannot be kept: belfry add fits all of them.")] : [])
        send()
    }
    if (live) {
        on(build)
        view.follow(names => {
            if (!names.includes("try") || !built || String(view.get("try")) === String(words())) return
            built = ""
            build("data")
            if (!changed) preview(null)
        })
    }
    return host
}

/** The status line: what runs, how far it is, what went wrong. */
export function status() {
    const line = make("section.status.no-print", { "aria-label": "Status", hidden: !live })
    if (!live) return line
    const text = make("span", { role: "status", "aria-live": "polite" })
    const bar = make("progress", { "aria-label": "Progress", hidden: true, max: 1 })
    const stop = make("button", { hidden: true, onclick: cancel }, "Cancel")
    const close = make("button", { onclick: () => { job = null; trouble = ""; tell() } }, "Close")
    const output = make("details", { hidden: true }, make("summary", "What the command says"), make("pre", { tabIndex: 0 }))
    line.append(text, bar, stop, close, output)
    tell = () => {
        const runs = busy(), seconds = job?.elapsed_s > 0 ? ` (${significant(job.elapsed_s, 2)} s)` : ""
        const parts = [trouble, job && ({
                running: `${job.command}: ${job.stage || "running"}${job.total ? `, ${job.done} of ${job.total}` : ""}${seconds}`,
                done: `${job.command}: done${seconds}.`,
                failed: `${job.command} failed${seconds}.`,
                cancelled: `${job.command}: cancelled. What it had not finished stays as it was.`,
            }[job.state] ?? job.command), !connected && "Not connected: what is shown may be old."]
        text.textContent = parts.filter(Boolean).join(" ") || "Ready."
        line.classList.toggle("failed", Boolean(trouble) || job?.state === "failed" || !connected)
        bar.hidden = !runs
        if (runs && job.total) bar.value = job.done / job.total
        else bar.removeAttribute("value")
        stop.hidden = !runs
        close.hidden = runs || !(job || trouble)
        const words = job?.output ?? ""
        output.hidden = !words
        output.lastChild.textContent = words
        output.open = output.open && Boolean(words) || job?.state === "failed"
        for (const element of document.querySelectorAll("[data-runs]")) runs ? element.setAttribute("aria-disabled", "true") : element.removeAttribute("aria-disabled")
    }
    watch((news, open) => {
        connected = open
        if (news) job = news
        tell()
    })
    tell()
    return line
}
