// How does the structure move, and where does the model miss it? One mode in three dimensions, and all modes from three sides.

import { canvas, colour, font, make, printing, size, still } from "@/canvas.js"
import { items, legend } from "@/curves.js"
import { KINDS, clamp, fixed, hertz, known, mac, metres, signed } from "@/numbers.js"
import { cameras, lens, misfits, paint, scales, scene } from "@/structure.js"

// How high the view from above is where it stands below, CSS pixels.
const BELOW = 210

const words = { measured: "measured", ...KINDS }
const keyOf = (s, check) => legend([...s.kinds.map(kind => ({ label: words[kind], colour: kind, kind: kind === "measured" ? "dot" : "line", check: check?.(kind) })), check && { label: "arrow: what the sensor measures of its motion", kind: "none" }])
/** The modes that can be shown: the measured ones, otherwise the model's. */
export const modesOf = d => d.modes?.modes?.length ? d.modes.modes : d.model?.parts?.[0]?.modes ?? []
const at = (d, view) => modesOf(d).some(m => m.number === view.get("mode")) ? view.get("mode") : modesOf(d)[0]?.number
const has = d => modesOf(d).length > 0 && scene(d, modesOf(d)[0].number) !== null

/** Where the model misses, of the last comparison: by height, by group where it is no tower, or by sensor for the view from above. */
function where(d, above) {
    const c = d.comparison?.effects ?? d.comparison?.given
    const rows = ((above ? c?.by_sensor : c?.by_group?.length ? c.by_group : c?.by_height) ?? []).filter(r => known(r.misfit))
    return rows.map(r => ({ misfit: r.misfit, z: r.elevation_m, label: r.group ?? (above ? "ch " + r.channel : metres(r.elevation_m)) })).sort((a, b) => b.misfit - a.misfit)
}

export const structure = {
    id: "structure-3d", title: "The structure", follows: ["mode", "hidden"], uses: ["model", "comparison"], has,
    says(d, view) {
        const mode = at(d, view), s = scene(d, mode), parts = [`Mode ${mode} at ${hertz(modesOf(d).find(m => m.number === mode)?.frequency_hz)}${s.character ? ", " + s.character : ""}.`]
        for (const name of ["given", "effects"]) {
            const pair = d.comparison?.[name]?.pairs?.find(p => p.measured === mode)
            if (pair) parts.push(`The ${words[name]} has it at ${hertz(pair.model_hz)} (${signed(pair.frequency_error_percent, 2)} %), MAC ${mac(pair.mac)}.`)
        }
        const worst = where(d)[0]
        if (worst) parts.push(`Over all modes the shapes miss most at ${worst.label} (misfit ${fixed(worst.misfit, 3)}).`)
        if (s.undetermined) parts.push(`A dashed outline ${s.kinds.length > 1 ? "turns as the model does" : "does not turn"}, because the sensors there do not show it.`)
        return parts.join(" ")
    },
    draw(host, d, view) {
        const s = scene(d, at(d, view))
        // Most of the mode's motion is seen from there.
        const free = [s.towards - 0.4, 0.3]
        const width = Math.max(260, host.clientWidth), height = s.isLong ? 400 : printing() ? 420 : width < 560 ? 470 : 600
        // The view from above stands beside the other, or below it where there is no room.
        const isBeside = width > 640, all = isBeside ? height : height + BELOW
        const camera = () => { const c = view.get("camera"); return Array.isArray(c) && c.length === 2 && c.every(known) ? c : free }
        const amplitude = () => { const a = view.get("amplitude"); return typeof a === "number" ? clamp(a, 0, 3) : 1 }
        const hidden = items(view.get("hidden")), shown = kind => !hidden.includes(kind), playing = () => !view.get("paused"), runs = () => playing() && !still()

        const key = keyOf(s, kind => ({ checked: shown(kind), onchange: () => {
            const others = hidden.filter(one => one !== kind)
            view.set({ hidden: shown(kind) ? [...others, kind] : others.length ? others : null })
        } }))
        const sides = Object.entries({ x: "Side X", y: "Side Y", above: "Above", free: "Free" }).map(([name, label]) =>
            [cameras[name] ?? free, make("button", { onclick: () => view.set({ camera: cameras[name] ?? null }) }, label)])
        const play = make("button", { hidden: still(), onclick: () => view.set({ paused: playing() || null }) })
        const slider = make("input", { type: "range", min: 0, max: 3, step: 0.05, oninput: () => view.set({ amplitude: Number(slider.value) === 1 ? null : Number(slider.value) }) })
        slider.value = String(amplitude())
        const stage = make("div.structure", { tabIndex: 0, role: "group", "aria-label": "Camera. Drag, or use the arrow keys, to turn the structure." })
        host.append(key,
            make("div.controls.no-print", play, make("fieldset", { "aria-label": "Seen from" }, ...sides.map(([, b]) => b)), make("label", "Amplitude", slider)), stage)

        // What stands still lies below what moves. No more pixels than the screen has where it moves, for 60 frames a second.
        const below = canvas(structure.says(d, view)), element = make("canvas.over", { "aria-hidden": "true" })
        stage.append(below, element)
        const quiet = size(below, width, all), pen = size(element, width, all, still() || matchMedia("(min-resolution: 1.5dppx)").matches ? 2 : 1)
        let view3, inset, strip, rows, frame = 0, onScreen = true, painted = false
        function look() {
            const c = camera(), above = Math.sin(c[1]) > 0.87
            rows = where(d, above)
            const plan = !above && isBeside ? Math.min(300, Math.round(width * 0.26)) : 0
            strip = width - plan - (rows.length ? misfits.width : 10)
            view3 = lens(s, c, [62, 26, Math.max(60, strip - 74), height - 84], amplitude(), shown)
            const box = isBeside ? [width - plan + 8, 40, plan - 16, height - 110] : [62, height + 24, width - 124, BELOW - 40]
            inset = !above && lens(s, cameras.above, box, amplitude(), shown)
            const chosen = sides.findIndex(([side]) => String(side) === String(c))
            sides.forEach(([, b], i) => b.setAttribute("aria-pressed", String(i === (chosen < 0 ? sides.length - 1 : chosen))))
            quiet.clearRect(0, 0, width, all)
            // Seen from above there is no second view below.
            stage.style.height = `${inset ? all : height}px`
            for (const v of [view3, inset]) if (v) paint(quiet, s, v, { phase: 0, shown: kind => kind === "rest" })
            scales(quiet, s, view3, height)
            misfits(quiet, view3, rows, d.comparison?.effects ? "misfit with effects" : "misfit as given", strip, height)
            if (inset) {
                quiet.fillStyle = colour("ink")
                quiet.textAlign = "left"
                quiet.font = font(11)
                quiet.fillText("from above: X to the right, Y up", isBeside ? inset.left : 8, isBeside ? 12 : height + 10)
            }
            picture()
        }
        function picture() {
            // One swing in 2 s, whatever the mode's frequency.
            const how = { phase: runs() ? Math.cos(performance.now() / 1000 * Math.PI) : 1, amplitude: amplitude(), shown: kind => kind !== "rest" && shown(kind) }
            // Printed as vectors, it would erase what lies below.
            if (painted) pen.clearRect(0, 0, width, all)
            painted = true
            paint(pen, s, view3, how)
            if (inset) paint(pen, s, inset, how)
        }
        function tick() {
            frame = 0
            picture()
            if (runs() && onScreen) frame = requestAnimationFrame(tick)
        }
        function run() {
            play.textContent = playing() ? "Pause" : "Play"
            frame ||= requestAnimationFrame(tick)
        }

        const turn = (da, de) => {
            const round = v => Math.round(v * 1000) / 1000, [a, e] = camera()
            view.set({ camera: [round(a + da), round(clamp(e + de, -0.2, cameras.above[1]))] })
        }
        stage.addEventListener("keydown", event => {
            const step = { ArrowLeft: [-0.087, 0], ArrowRight: [0.087, 0], ArrowUp: [0, 0.087], ArrowDown: [0, -0.087] }[event.key]
            if (!step) return
            event.preventDefault()
            turn(...step)
        })
        let grip = null
        element.addEventListener("pointerdown", event => { grip = [event.clientX, event.clientY]; element.setPointerCapture(event.pointerId) })
        element.addEventListener("pointermove", event => {
            if (!grip) return
            turn((grip[0] - event.clientX) * 0.008, (event.clientY - grip[1]) * 0.008)
            grip = [event.clientX, event.clientY]
        })
        for (const ends of ["pointerup", "pointercancel"]) element.addEventListener(ends, () => grip = null)
        const unfollow = view.follow(names => {
            if (names.includes("amplitude")) slider.value = String(amplitude())
            if (names.includes("paused")) run()
            if (names.includes("camera") || names.includes("amplitude")) look()
        })
        const sight = new IntersectionObserver(([entry]) => { onScreen = entry.isIntersecting; if (onScreen) run() })
        sight.observe(element)
        look()
        run()
        return () => { unfollow(); sight.disconnect(); cancelAnimationFrame(frame) }
    },
}

export const shapes = {
    id: "mode-shapes", title: "All mode shapes", follows: ["mode"], uses: ["model", "comparison"], long: true, has,
    says(d) {
        const turning = modesOf(d).map(m => m.number).filter(n => scene(d, n).character === "torsion")
        const isLong = modesOf(d).some(m => scene(d, m.number).isLong)
        return `${modesOf(d).length} modes, each ${isLong ? "from beside" : "from side X, from side Y and from above"}` + (turning.length ? `; torsion: mode ${turning.join(", ")}` : "") + (printing() ? "." : ". Choose one to see it above.")
    },
    draw(host, d, view) {
        const chosen = at(d, view), grid = make("div.shapes")
        host.append(keyOf(scene(d, chosen)), grid)
        const cells = modesOf(d).map(({ number, frequency_hz }) => {
            const s = scene(d, number), name = `${number} · ${hertz(frequency_hz, 3)}`
            const sheet = canvas(s.character || "its shape")
            const cell = make("button", { "aria-label": `Mode ${name}, ${s.character || "its shape"}`, "aria-pressed": String(number === chosen), onclick: () => view.set({ mode: number }) }, make("span", name), sheet)
            grid.append(cell)
            return { cell, sheet, s }
        })
        const width = Math.max(110, (cells[0]?.cell.clientWidth ?? 0) - 10), height = 158, side = Math.floor(width * 0.28)
        // What lies along the ground is seen from beside it alone.
        const isLong = cells.some(c => c.s.isLong)
        const panels = isLong ? [["", [cells[0].s.towards - 0.4, 0.3], [4, 6, width - 8, height - 12]]] : [["X", cameras.x, [3, 4, side - 6, height - 24]], ["Y", cameras.y, [side + 3, 4, side - 6, height - 24]], ["above", cameras.above, [2 * side + 4, 12, width - 2 * side - 8, height - 40]]]
        for (const { sheet, s } of cells) {
            const pen = size(sheet, width, height)
            const both = Math.min(...panels.slice(0, isLong ? 1 : 2).map(([, camera, box]) => lens(s, camera, box, 1).scale))
            for (const [label, camera, box] of panels) {
                paint(pen, s, lens(s, camera, box, 1, undefined, label === "above" ? Infinity : both), { phase: 1, small: true })
                pen.fillStyle = colour("quiet")
                pen.font = font(11)
                pen.textAlign = "center"
                pen.fillText(label, box[0] + box[2] / 2, height - 5)
            }
        }
    },
}
