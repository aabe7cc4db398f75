// Numbers as engineers write them.

const minus = text => text.replace("-", "\u2212")
/** What a version of the model is called; its key is also its colour. */
export const KINDS = { given: "model as first given", effects: "model with its effects", updated: "after direct update" }

/** The same of a study's data: an update of the model as given stays in sight while effects come. */
export const kindsOf = d => ({ ...KINDS, updated: KINDS.updated + (d.comparison?.effects && !d.update?.effects?.length ? " of the model as given" : "") })

/** Whether it is a number that can be written or drawn. */
export const known = Number.isFinite
export const clamp = (x, low, high) => Math.min(Math.max(x, low), high)
const raised = n => String(n).replace(/[-\d]/g, c => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)])

/** With this many digits after the point; a dash where there is none. Never "-0.00". */
export function fixed(x, digits) {
    if (!known(x)) return "–"
    const text = x.toFixed(digits)
    return minus(Number(text) === 0 ? text.replace("-", "") : text)
}

/** A setup in a sentence. */
export const inWords = setup => /^setup/i.test(setup) ? setup : "setup " + setup

/** Digits after the point that tell ticks of this step apart. */
export const decimals = step => clamp(-Math.floor(Math.log10(step) + 1e-9), 0, 12)

export const hertz = (x, digits = 4) => fixed(x, digits) + " Hz"
/** A share as a percentage. */
export const percent = (x, digits = 2) => fixed(100 * x, digits) + " %"

/** A height: to a metre from 100 m on, to three digits below. */
export const metres = z => (Math.abs(z) < 100 ? significant(z) : fixed(z, 0)) + " m"

export const signed = (x, digits) => known(x) && Number(x.toFixed(digits)) > 0 ? "+" + fixed(x, digits) : fixed(x, digits)

/** With this many significant digits, as 1.11 × 10⁻¹⁴ where it is large or small. */
export function significant(x, digits = 3) {
    if (!known(x)) return "–"
    if (x === 0) return "0"
    const [front, power] = x.toExponential(digits - 1).split("e")
    return minus(power >= -3 && power < 6 ? String(Number(x.toPrecision(digits))) : front + " × 10" + raised(Number(power)))
}

/** 10⁻⁶, or with its front: 3.1·10⁻⁷. */
export function power(value, digits = 0) {
    if (!(value > 0)) return "–"
    const [front, decade] = value.toExponential(digits).split("e").map((text, i) => i ? Number(text) : text)
    const tens = decade === 0 ? "1" : decade === 1 ? "10" : "10" + raised(decade)
    return front === "1" ? tens : decade === 0 ? front : `${front}·${tens}`
}

/** A value with its standard deviation, both to the deviation's two digits, and to one power of ten where they are large or small. */
export function within(x, std, scale = 1) {
    if (!known(x)) return "–"
    if (!known(std) || std <= 0) return significant(x * scale, 4)
    const decade = Math.floor(Math.log10(scale * Math.max(Math.abs(x), std))), own = decade < -3 || decade > 5 ? decade : 0, by = scale / 10 ** own
    const digits = clamp(1 - Math.floor(Math.log10(std * by)), 0, 8), both = fixed(x * by, digits) + " ± " + fixed(std * by, digits)
    return own ? `(${both}) × 10${raised(own)}` : both
}

/** The modal assurance criterion to four digits, never rounded to a value that it does not reach. */
export function mac(x) {
    if (!known(x)) return "–"
    return fixed(Math.floor(x * 1e4 + 1e-9) / 1e4, 4)
}

export function probability(p) {
    if (!known(p)) return "–"
    if (p < 0.001) return "< 0.1 %"
    if (p > 0.999) return "> 99.9 %"
    return percent(p, 1)
}

export const pvalue = p => !known(p) ? "–" : p < 0.0001 ? "< 0.0001" : fixed(p, 4)

/** The same behind a p: "= 0.0312" or "< 0.0001". */
export const pis = p => (p < 0.0001 ? "" : "= ") + pvalue(p)

export function duration(seconds) {
    if (!known(seconds)) return "–"
    if (seconds < 120) return significant(seconds, 3) + " s"
    if (seconds < 7200) return fixed(seconds / 60, 0) + " min"
    if (seconds < 3 * 86400) return significant(seconds / 3600, 3) + " h"
    return significant(seconds / 86400, 3) + " d"
}

/** One or several by name, "modes 1, 2". */
export const named = (one, list) => `${list.length === 1 ? one : one + "s"} ${list.join(", ")}`
export const plural = (n, one, many = one + "s") => `${n} ${n === 1 ? one : many}`
