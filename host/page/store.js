// The data that all pictures show: from the file itself in a report, from the server where it is live. A preview of other
// effects (a slider) lies over it until it is taken away; it never mixes with what is on disk.

const listeners = new Set()
let stored = null
// The preview, or null.
let laid = null

/** True where a server answers, false in a report. */
export const live = !document.getElementById("data")

/** The data as pictures should show them, null before they are there. */
export const data = () => laid ?? stored
export const isPreview = () => laid !== null

/** Calls `listener(reason)` with "data", "preview" or "picks" when what to show has changed. */
export function on(listener) {
    listeners.add(listener)
    return () => listeners.delete(listener)
}
export const tell = reason => { for (const listener of listeners) listener(reason) }

export async function ask(path, body) {
    let answer, json = null
    try {
        answer = await fetch(path, body === undefined ? {}
            : { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body) })
    } catch {
        throw new Error("The server does not answer. Is `belfry serve` still running?")
    }
    try { json = await answer.json() } catch { /* an empty answer is fine where none is expected */ }
    if (!answer.ok) throw new Error(json?.error ?? `The server refused with status ${answer.status}.`)
    return json
}

let loading = null
export function load() {
    return loading ??= (async () => {
        try {
            stored = live ? await ask("/data") : JSON.parse(document.getElementById("data").textContent)
            laid = null
            tell("data")
        } finally { loading = null }
    })()
}

/** Shows `{ model, mac, comparison }` of other effects over the data; null shows the data again. */
export function preview(answer) {
    if (!answer && !laid) return
    laid = null
    if (answer && stored) {
        const part = answer.model && { ...answer.model, name: "effects" }
        const others = (stored.model?.parts ?? []).filter(p => p.name !== "effects")
        laid = {
            ...stored,
            model: { ...stored.model, parts: part ? [...others, part] : others },
            mac: [...(stored.mac ?? []).filter(m => m.what !== "effects"), ...(answer.mac ? [{ ...answer.mac, what: "effects" }] : [])],
            comparison: { ...stored.comparison, effects: answer.comparison ?? null },
        }
    }
    tell("preview")
}

/** Follows the server: new data when the study changes, `hear(job)` while something runs, `hear(null, connected)`. */
export function watch(hear) {
    if (!live) return
    const events = new EventSource("/events")
    events.onopen = () => hear(null, true)
    // The browser connects again by itself.
    events.onerror = () => hear(null, false)
    events.onmessage = event => {
        let said
        try { said = JSON.parse(event.data) } catch { return }
        if (said.job) hear(said.job, true)
        if (said.version != null && said.version !== stored?.version) again(hear, said.version)
    }
}
let isBroken = false
async function again(hear, version) {
    // A load under way may have begun before the change, or after it.
    const wanted = loading
    try { await wanted } catch { /* it is loaded anew */ }
    try {
        if (isBroken || stored?.version !== version) await load()
        // What was wrong with it is mended.
        if (isBroken) hear({ command: "The study can be shown again." }, true)
        isBroken = false
    } catch (error) {
        isBroken = true
        hear({ command: "The study cannot be shown", state: "failed", output: error.message }, true)
    }
}
