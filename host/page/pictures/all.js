// All pictures and tables: the sections in which they stand, and their order there.

import { tables } from "belfry/tables.js"
import { candidates, fingerprint } from "belfry/pictures/candidates.js"
import covalidation from "belfry/pictures/covalidation.js"
import fits from "belfry/pictures/fits.js"
import { change, frequencyErrors } from "belfry/pictures/frequency-errors.js"
import history from "belfry/pictures/history.js"
import { macs, psi } from "belfry/pictures/matrices.js"
import profile from "belfry/pictures/profile.js"
import psd from "belfry/pictures/psd.js"
import record from "belfry/pictures/record.js"
import singularValues from "belfry/pictures/singular-values.js"
import stabilisation from "belfry/pictures/stabilisation.js"
import { shapes, structure } from "belfry/pictures/structure.js"
import trends from "belfry/pictures/trends.js"
import waterfall from "belfry/pictures/waterfall.js"

const sections = {
    findings: [tables.fall],
    structure: [structure, shapes],
    modes: [tables.modes, fits, stabilisation],
    spectra: [singularValues, psd, record, waterfall],
    model: [frequencyErrors, macs, tables.comparison],
    update: [psi, covalidation],
    diagnosis: [candidates, fingerprint, profile, history],
    trends: [trends, change],
    nodes: [tables.nodes],
    method: [tables.method],
}
export const pictures = Object.entries(sections).flatMap(([section, list]) => list.map(picture => Object.assign(picture, { section })))
