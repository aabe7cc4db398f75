// What the reader looks at: the chosen mode, candidate, zoom, camera. It stands in the address after `#`, so that a link
// shows the same. Values are numbers, strings or arrays; `#structure&mode=0.1552Hz&camera=[0.5,0.2]` also names a place.

const listeners = new Set()
const state = new Map()
// The section or picture that the address names.
export let place = ""

const decode = text => { try { return JSON.parse(text) } catch { return text } }
// A string that reads as a number, such as channel "12", keeps its quotes.
const encode = value => typeof value === "string" && decode(value) === value ? value : JSON.stringify(value)
const escape = text => encodeURIComponent(text).replace(/%(5B|5D|2C|3A|2F|40)/g, decodeURIComponent)

function read() {
    state.clear()
    place = ""
    for (const part of location.hash.slice(1).split("&").filter(Boolean)) {
        const [name, text] = part.split("=")
        try {
            if (text === undefined) place = decodeURIComponent(name)
            else state.set(decodeURIComponent(name), decode(decodeURIComponent(text)))
        } catch { /* a damaged part of an address is left out */ }
    }
}

// Numbers of modes change when modes are identified again, so the chosen one stands by its frequency. It is the nearest mode within this
// share of it. Older links have its number.
const SAME_MODE = 0.01
let modes = []
function numberOf(mode) {
    if (typeof mode !== "string") return mode
    const off = m => Math.abs(m.frequency_hz / parseFloat(mode) - 1)
    return modes.filter(m => off(m) <= SAME_MODE).sort((a, b) => off(a) - off(b))[0]?.number
}
function settle() {
    const hz = modes.find(m => m.number === state.get("mode"))?.frequency_hz
    if (hz) state.set("mode", hz + "Hz")
}

/** The modes that there are now. */
function know(list) {
    modes = list
    settle()
}

let timer = 0
// Browsers allow few changes of the address a second; dragging makes many.
function write() {
    timer ||= setTimeout(() => {
        timer = 0
        const parts = [...state].map(([name, value]) => `${escape(name)}=${escape(encode(value))}`)
        if (place) parts.unshift(escape(place))
        try { history.replaceState(null, "", "#" + parts.join("&")) } catch { /* no address to write to */ }
    }, 150)
}

/** The value of `name`, or `otherwise` where the address has none. */
const get = (name, otherwise = null) => (name === "mode" ? numberOf(state.get(name)) : state.get(name)) ?? otherwise

/** Listeners hear the names of what differs after some work. */
function change(work) {
    const before = new Map(state)
    work()
    settle()
    const changed = [...new Set([...before.keys(), ...state.keys()])].filter(name => JSON.stringify(before.get(name)) !== JSON.stringify(state.get(name)))
    if (changed.length) for (const listener of listeners) listener(changed)
}

/** Changes values; null takes one out. */
function set(values) {
    change(() => { for (const [name, value] of Object.entries(values)) value == null ? state.delete(name) : state.set(name, value) })
    write()
}

/** Calls `listener` with the names that changed. Returns what ends it. */
function follow(listener) {
    listeners.add(listener)
    return () => listeners.delete(listener)
}

export function go(to) {
    place = to
    write()
    document.getElementById(to)?.scrollIntoView()
}

read()
addEventListener("hashchange", () => {
    change(read)
    if (place) document.getElementById(place)?.scrollIntoView()
})

export const view = { get, set, follow, know }
