// Starts the page: data in, sections drawn, view followed. Pictures on screen are drawn first, the others while the
// browser has nothing else to do, all of them again before printing.

import { actionsOf, button, can, candidateName, sliders, status, typed } from "@/actions.js"
import { make } from "@/canvas.js"
import { duration, fixed, hertz, known, plural, significant } from "@/numbers.js"
import { pictures } from "@/pictures/all.js"
import { modesOf } from "@/pictures/structure.js"
import { data, isPreview, live, load, on } from "@/store.js"
import { go, place, view } from "@/view.js"

const sections = [
    ["findings", "What was found", "Findings"],
    ["structure", "The structure and its modes", "Structure"],
    ["modes", "Measured modes", "Modes"],
    ["spectra", "Spectra and records", "Spectra"],
    ["model", "The model against the measurement", "Model"],
    ["update", "Direct update and left-out sensors", "Update"],
    ["diagnosis", "What the model lacks", "Diagnosis"],
    ["trends", "Over time", "Trends"],
    ["nodes", "Sensor nodes", "Nodes"],
    ["method", "Method, settings, versions", "Method"],
]
const root = document.documentElement
// "light" or "dark" in the address is the reader's own choice, otherwise that of the system.
const themes = ["auto", "light", "dark"], themed = () => view.get("theme", themes[0])
const themeButton = make("button", { onclick: () => view.set({ theme: [...themes.slice(1), null][themes.indexOf(themed())] }) })
function theme() {
    root.dataset.theme = themed()
    themeButton.textContent = `Colours: ${themed()}`
}
const byId = id => document.getElementById(id)
const guarded = (what, work, otherwise) => { try { return work() } catch (error) { console.error(what, error); return otherwise } }

// ---- a figure for each picture

class Figure {
    constructor(picture) {
        this.picture = picture
        this.says = make("p")
        this.stale = make("p.stale")
        this.host = make("div.host")
        this.element = make("figure", { id: picture.id, class: picture.long ? "waits long" : "waits" },
            make("figcaption", make("h3", picture.title), this.stale, this.says), this.host)
        this.dirty = true
        this.shown = false
    }

    draw() {
        this.dirty = false
        const { picture, host } = this
        const d = data()
        const focused = host.contains(document.activeElement) ? this.controls().indexOf(document.activeElement) : -1
        this.release()
        // The page does not jump while it is empty.
        host.style.minHeight = host.offsetHeight + "px"
        host.replaceChildren()
        const why = d.stale?.[picture.from]
        this.stale.replaceChildren(...why ? sentence(`From an older state: ${why}`) : [])
        // The data say what stands on results alone, the picture what follows the view.
        this.says.textContent = [isPreview() && follows(picture, "preview") && "Preview, not written:", guarded(picture.id, () => picture.says?.(d, view)), signs(d.says?.[picture.id] ?? "")].filter(Boolean).join(" ")
        const free = guarded(picture.id, () => picture.draw(host, d, view) ?? null, false)
        if (free === false) host.replaceChildren(make("p.failed", "This picture could not be drawn."))
        else if (typeof free === "function") this.free = free
        host.style.minHeight = ""
        this.element.classList.remove("waits")
        if (focused >= 0) this.controls()[focused]?.focus({ preventScroll: true })
    }

    // Whether it is to be drawn anew.
    get dirty() { return "dirty" in this.element.dataset }
    set dirty(is) { this.element.toggleAttribute("data-dirty", is) }

    controls() { return [...this.host.querySelectorAll("a, button, input, select, summary, textarea, [tabindex]")] }

    release() {
        if (this.free) guarded(this.picture.id, this.free)
        this.free = null
    }

    drop() {
        this.release()
        sight.unobserve(this.element)
        this.element.remove()
    }
}

const figures = new Map()
const sight = new IntersectionObserver(entries => {
    for (const { target, isIntersecting } of entries) {
        const figure = figures.get(target.id)
        if (figure) figure.shown = isIntersecting
    }
    pump()
}, { rootMargin: "300px" })

let pumping = 0, idling = 0
function pump() {
    pumping ||= requestAnimationFrame(drawShown)
}
function drawShown() {
    pumping = 0
    for (const figure of figures.values()) if (figure.dirty && figure.shown) figure.draw()
    settle()
    idle()
}
const later = globalThis.requestIdleCallback ?? (work => setTimeout(work, 30))
function idle() {
    idling ||= later(() => {
        idling = 0
        const next = [...figures.values()].find(figure => figure.dirty)
        if (next) { next.draw(); settle(); idle() }
    }, { timeout: 500 })
}
function dirty(which = () => true) {
    for (const figure of figures.values()) if (which(figure.picture)) figure.dirty = true
    pump()
}

// Pictures above a place get their heights as they are drawn; the address's place stays in sight until the reader moves.
let aim = place
const settle = () => { if (aim) byId(aim)?.scrollIntoView() }
for (const moves of ["wheel", "touchstart", "pointerdown", "keydown"]) addEventListener(moves, () => aim = "", { passive: true, capture: true })

// ---- the frame

// A section's element, its actions and its pictures.
const parts = new Map()

function frame() {
    byId("main").replaceChildren(...sections.map(([id, title]) => {
        const actions = make("div.no-print"), body = make("div.pictures")
        const element = make("section", { id, "aria-labelledby": `${id}-title` }, make("h2", { id: `${id}-title`, tabIndex: -1 }, title), actions,
            id === "structure" ? sliders() : "", body)
        parts.set(id, { element, actions, body })
        return element
    }))
    byId("status").replaceWith(status())
}

function header(d) {
    const { study, modes } = d
    const name = study?.name || "A structure without a name"
    document.title = `${name} · Belfry`
    const heights = (study?.sensors ?? []).map(s => s.elevation_m).filter(known)
    const setups = study?.setups ?? [], rate = setups.find(s => s.sampling_rate_hz)?.sampling_rate_hz
    const rows = []
    if (study?.sensors?.length) rows.push(["Measured", [
        plural(study.sensors.length, "channel"),
        heights.length && `from ${fixed(Math.min(...heights), 1)} to ${fixed(Math.max(...heights), 1)} m`,
        setups.length > 1 && plural(setups.length, "setup"),
        modes?.record_s && duration(modes.record_s) + " of record",
        rate && `at ${rate} Hz`,
        modes?.averages && plural(modes.averages, "average")].filter(Boolean).join(", ")])
    const inWords = effect => [candidateName(effect), effect.parameters.map(p => `${effect.parameters.length > 1 ? p.name + " " : ""}${significant(p.value)}${p.unit === "-" ? "" : " " + p.unit}`).join(", ")].filter(Boolean).join(" of ")
    if (d.model) rows.push(["Model", d.model.values?.length ? `with ${d.model.values.map(inWords).join("; ")}` : "as given, without effects"])
    const { written } = d.belfry ?? {}, date = written ? written.replace("T", " at ").replace(/(:\d\d):.*$/, "$1") + " UTC" : ""
    if (date) rows.push([live ? "Shown" : "Written", date])
    byId("header").replaceChildren(
        make("h1", name),
        make("dl.facts", ...rows.flatMap(([term, text]) => [make("dt", term), make("dd", text)])))
}

let modePicker = null
function navigation(d) {
    const there = sections.filter(([id]) => !parts.get(id).element.hidden)
    const links = make("ul", ...there.map(([id, , short]) => make("li", make("a", { href: "#" + id, onclick: event => {
        event.preventDefault()
        go(aim = id)
        byId(`${id}-title`).focus({ preventScroll: true })
    } }, short))))
    const list = d.modes?.modes ?? []
    const choose = () => view.set({ mode: Number(select.value) }), select = make("select", { id: "mode", onchange: choose },
        ...list.map(m => make("option", { value: m.number }, `${m.number} · ${hertz(m.frequency_hz)}`)))
    const step = by => {
        select.selectedIndex = (select.selectedIndex + by + list.length) % list.length
        choose()
    }
    modePicker = () => { select.value = String(view.get("mode", list[0]?.number)); if (select.selectedIndex < 0) select.selectedIndex = 0 }
    modePicker()
    byId("nav").replaceChildren(make("div", links, make("div.mode", {}, ...list.length ? [
        make("label", { for: "mode" }, "Mode"),
        make("button", { "aria-label": "Mode before", onclick: () => step(-1) }, "‹"), select,
        make("button", { "aria-label": "Next mode", onclick: () => step(1) }, "›")] : [], themeButton)))
}

// `belfry diagnose` in a sentence becomes code, the hyphen before a number a minus.
const sentence = text => String(text ?? "").split("\x60").map((part, i) => i % 2 ? make("code", part) : signs(part))
const signs = text => text.replace(/(^|[ (])-(?=\d)/g, "$1\u2212")

// The command that a finding asks for, such as "add base-rotation": to type, and to run where a server answers.
function asked(text) {
    if (!text) return []
    const command = text.split(" ")
    // Collecting ends when it is stopped: that is for a terminal.
    return [" ", can() && text !== "collect" && button("Run", command, { class: "no-print", "aria-label": `Run ${text}` }), " ", typed(command)].filter(Boolean)
}

function findings(d) {
    const { body } = parts.get("findings"), list = d.findings?.length ? d.findings : [{ kind: "next", text: "Nothing has been computed yet.", command: "identify" }]
    const words = { warning: "Note: ", next: "Next: " }
    body.querySelector(".findings")?.remove()
    body.prepend(make("ul.findings", ...list.map(f => make("li", { class: words[f.kind] ? f.kind : "finding" },
        words[f.kind] && make("b", words[f.kind]), ...sentence(f.text), ...asked(f.command)))))
}

function place_pictures(d) {
    for (const picture of pictures) {
        const there = guarded(picture.id, () => Boolean(picture.has(d)), false)
        const old = figures.get(picture.id)
        if (there && !old) figures.set(picture.id, new Figure(picture))
        if (!there && old) { old.drop(); figures.delete(picture.id) }
    }
    for (const [id, { element, body, actions }] of parts) {
        let before = id === "findings" ? body.querySelector(".findings") : null
        for (const picture of pictures) {
            const figure = picture.section === id && figures.get(picture.id)
            if (!figure) continue
            const wanted = before ? before.nextSibling : body.firstChild
            if (figure.element !== wanted) { body.insertBefore(figure.element, wanted); sight.observe(figure.element) }
            before = figure.element
        }
        const bar = guarded(id, () => actionsOf(id, d), null)
        actions.replaceChildren(...(bar ? [bar] : []))
        element.hidden = !body.children.length && !bar
    }
}

// What changes without new data.
const CHANGES = { preview: ["model", "mac", "comparison"], picks: ["picks"] }

const follows = (p, reason) => p.uses ? p.uses.some(u => CHANGES[reason].includes(u)) : reason === "preview" && ["structure", "model"].includes(p.section)

function show(reason) {
    const d = data()
    if (!d) return
    document.querySelector("main > p.failed")?.remove()
    if (reason !== "data") {
        dirty(p => follows(p, reason))
        // A slider does not wait for the next frame.
        return drawShown()
    }
    view.know(modesOf(d))
    // What is built anew takes the focus with it; its like in the same place gets it, or what stands there first.
    const held = document.activeElement, around = held?.closest("section, nav, #nav"), words = held?.textContent
    guarded("header", () => header(d))
    guarded("findings", () => findings(d))
    place_pictures(d)
    guarded("navigation", () => navigation(d))
    if (around && !held.isConnected) {
        const all = [...around.querySelectorAll("button, a, select, h2")], like = all.find(one => one.textContent === words) ?? all.find(one => one.closest(".actions")) ?? all[0]
        like?.focus({ preventScroll: true })
    }
    byId("end").textContent = `Written by Belfry ${d.belfry?.version ?? ""}. All quantities in SI units.`
    dirty()
}

function printing(begins) {
    root.classList.toggle("printing", begins)
    for (const figure of figures.values()) if (begins) figure.draw(); else figure.dirty = true
    // On paper nothing can be unfolded; what is drawn anew is folded again.
    if (begins) for (const folded of document.querySelectorAll("figure details")) folded.open = true
    if (!begins) pump()
}

async function start() {
    theme()
    frame()
    on(reason => show(reason))
    view.follow(names => {
        if (names.includes("theme")) { theme(); dirty() }
        if (names.includes("mode")) modePicker?.()
        if (can() && names.includes("candidate")) parts.get("diagnosis").actions.replaceChildren(...[actionsOf("diagnosis", data())].filter(Boolean))
        dirty(p => p.follows?.some(name => names.includes(name)))
    })
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => dirty())
    addEventListener("beforeprint", () => printing(true))
    addEventListener("afterprint", () => printing(false))
    let width = byId("main").clientWidth
    new ResizeObserver(() => {
        const now = byId("main").clientWidth
        if (now === width || root.classList.contains("printing")) return
        width = now
        dirty()
    }).observe(byId("main"))
    try { await load() } catch (error) {
        byId("main").prepend(make("p.failed", live ? error.message : "The data in this file are damaged: " + error.message))
    }
}

start()
