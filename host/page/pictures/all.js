// All pictures and tables: the sections in which they stand, and their order there.

import { tables } from "@/tables.js"
import { candidates, fingerprint, fingerprints } from "@/pictures/candidates.js"
import covalidation from "@/pictures/covalidation.js"
import fits from "@/pictures/fits.js"
import { change, frequencyErrors } from "@/pictures/frequency-errors.js"
import history from "@/pictures/history.js"
import { macs, psi } from "@/pictures/matrices.js"
import profile from "@/pictures/profile.js"
import psd from "@/pictures/psd.js"
import record from "@/pictures/record.js"
import singularValues from "@/pictures/singular-values.js"
import stabilisation from "@/pictures/stabilisation.js"
import { shapes, structure } from "@/pictures/structure.js"
import trends from "@/pictures/trends.js"
import waterfall from "@/pictures/waterfall.js"

const sections = {
    findings: [tables.fall],
    structure: [structure, shapes],
    modes: [tables.modes, fits, stabilisation],
    spectra: [singularValues, psd, record, waterfall],
    model: [frequencyErrors, macs, tables.comparison],
    update: [psi, covalidation],
    diagnosis: [candidates, fingerprint, fingerprints, profile, history],
    trends: [trends, change],
    nodes: [tables.nodes],
    method: [tables.method],
}
export const pictures = Object.entries(sections).flatMap(([section, list]) => list.map(picture => Object.assign(picture, { section })))
