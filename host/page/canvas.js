// What all canvases of our own share: sharp pixels on screen and paper, the page's colours, small elements.

import { clamp } from "@/numbers.js"

/**
 * An element such as `make("p.quiet", { title: "Why" }, "text", child)`; properties may be left out, text stays text. `aria-*`, `role` and
 * `for` become attributes; `tint` is a colour of style.css.
 */
export function make(tag, properties, ...children) {
    const [kind, ...classes] = tag.split("."), element = document.createElement(kind)
    element.classList.add(...classes)
    if (kind === "button") element.type = kind
    if (properties == null || typeof properties !== "object" || properties instanceof Node) children.unshift(properties)
    else for (const [name, value] of Object.entries(properties)) {
        if (value == null || value === false) continue
        if (name === "class") element.classList.add(...value.split(" ").filter(Boolean))
        else if (name === "tint") element.style.color = `var(--${value})`
        else if (name.startsWith("on")) element.addEventListener(name.slice(2), value)
        else if (name in element && !name.startsWith("aria")) element[name] = value
        else element.setAttribute(name, value)
    }
    element.append(...children.filter(child => child != null && child !== false))
    return element
}

const colours = new Map()
/** A colour of style.css, such as "measured", as it is now (both schemes, print). Painters ask for every dot; it is read once a frame. */
export function colour(name, alpha = 1) {
    if (!colours.size) queueMicrotask(() => colours.clear())
    if (!colours.has(name)) colours.set(name, getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim() || "#767676")
    return colours.get(name) + (alpha < 1 ? Math.round(255 * alpha).toString(16).padStart(2, "0") : "")
}

/** A canvas that shows what the sentence says. */
export const canvas = sentence => make("canvas", { role: "img", "aria-label": sentence })

/** Gives a canvas this size in CSS pixels, with at least two device pixels for each, so that it prints sharp. */
export function size(element, width, height, ratio = clamp(devicePixelRatio || 1, 2, 3)) {
    element.width = Math.round(width * ratio)
    element.height = Math.round(height * ratio)
    element.style.width = width + "px"
    element.style.height = height + "px"
    const pen = element.getContext("2d")
    pen.setTransform(ratio, 0, 0, ratio, 0, 0)
    pen.font = font(12)
    return pen
}

export const font = (pixels, weight = "") => `${weight} ${pixels}px system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif`.trim()

/** Mixes two #rrggbb colours; `part` of the second. */
export function mix(a, b, part) {
    const number = hex => [1, 3, 5].map(i => parseInt(hex.slice(i, i + 2), 16))
    const p = clamp(part, 0, 1), x = number(a), y = number(b)
    return "#" + x.map((v, i) => Math.round(v + (y[i] - v) * p).toString(16).padStart(2, "0")).join("")
}

/** A bar of the colours that `hue` has from 0 to 1. */
export function ramp(pen, x, y, length, hue) {
    for (let i = 0; i < length; i++) {
        pen.fillStyle = hue(i / (length - 1))
        pen.fillRect(x + i, y, 1.4, 9)
    }
}

/** Black or white, whichever is read better on this #rrggbb. */
export function inkOn(hex) {
    const [r, g, b] = [1, 3, 5].map(i => parseInt(hex.slice(i, i + 2), 16) / 255).map(c => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4)
    return 0.2126 * r + 0.7152 * g + 0.0722 * b > 0.18 ? "#000000" : "#ffffff"
}

/** Whether it is drawn for paper. */
export const printing = () => document.documentElement.classList.contains("printing")
export const still = () => matchMedia("(prefers-reduced-motion: reduce)").matches || printing()
// Smaller text is not read on paper: 8 points.
export const LEAST_PRINTED = 10.7
