//! The stabilisation diagrams: poles of all orders over frequency, stable ones marked, the first singular value behind.

use plotters::prelude::*;

use super::canvas::{Area, Dashes, DrawResult, INK, MEASURED, PictureError, Plane, REJECTED, picture};
use crate::identify::ssi::StabilisationDiagram;
use crate::identify::{Identification, SingularSpectrum};

const WIDTH: u32 = 960;
const PANEL: u32 = 360;
const TITLE: u32 = 36;

/// Draws a panel a setup. `None` where no subspace was identified.
///
/// # Errors
/// When drawing fails.
pub fn stabilisation(structure: &str, identification: &Identification) -> Result<Option<String>, PictureError> {
    let diagrams = &identification.stabilisation;
    if diagrams.is_empty() {
        return Ok(None);
    }
    let size = (WIDTH, TITLE + PANEL * diagrams.len() as u32);
    picture("the stabilisation diagram", size, |root| {
        let title = format!("{structure}: poles by order of the model; blue ones are stable, lines are the modes");
        root.draw(&Text::new(title, (12, 10), ("sans-serif", 18)))?;
        let (_, mut rest) = root.split_vertically(TITLE);
        for diagram in diagrams {
            let (area, below) = rest.split_vertically(PANEL);
            let spectrum = identification.singular_values.iter().find(|spectrum| spectrum.setup == diagram.setup);
            draw(&area, diagram, spectrum, identification)?;
            rest = below;
        }
        Ok(())
    })
    .map(Some)
}

fn draw(
    area: &Area<'_>,
    diagram: &StabilisationDiagram,
    spectrum: Option<&SingularSpectrum>,
    identification: &Identification,
) -> DrawResult {
    let Some(spectrum) = spectrum else { return Ok(()) };
    let (Some(&first_hz), Some(&last_hz)) = (spectrum.frequency_hz.first(), spectrum.frequency_hz.last()) else {
        return Ok(());
    };
    let stable_orders = diagram.stable.iter().flat_map(|pole| pole.orders.iter().copied());
    let highest = diagram.poles.iter().map(|pole| pole.order).chain(stable_orders).max().unwrap_or(1) as f64 + 1.0;
    let mut chart = ChartBuilder::on(area)
        .caption(&diagram.setup, ("sans-serif", 14))
        .margin(8)
        .x_label_area_size(40)
        .y_label_area_size(56)
        .build_cartesian_2d(first_hz..last_hz, 0.0..highest)?;
    chart
        .configure_mesh()
        .disable_mesh()
        .x_desc("frequency in Hz")
        .y_desc("order of the model")
        .y_label_formatter(&|order| format!("{order:.0}"))
        .draw()?;
    let plane = Plane::of(&chart, first_hz..last_hz, 0.0..highest, false);
    if let Some(values) = spectrum.values.first() {
        let logs = || values.iter().filter(|value| **value > 0.0).map(|value| value.log10());
        let (low, high) = logs().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        // Its own logarithmic scale, from the bottom of the panel to its top.
        let scale = highest / (high - low).max(f64::MIN_POSITIVE);
        let points = spectrum.frequency_hz.iter().zip(values).filter(|(_, value)| **value > 0.0);
        let points = points.map(|(hz, value)| (*hz, (value.log10() - low) * scale));
        plane.curve(points, Dashes::Full, REJECTED.mix(0.6).stroke_width(1))?;
    }
    for mode in &identification.modes {
        let line = [(mode.frequency_hz, 0.0), (mode.frequency_hz, highest)];
        plane.curve(line, Dashes::Full, INK.mix(0.4).stroke_width(1))?;
    }
    for pole in &diagram.poles {
        plane.dot((pole.frequency_hz, pole.order as f64), 1, REJECTED.mix(0.7).filled())?;
    }
    let mut stable =
        diagram.stable.iter().flat_map(|pole| pole.orders.iter().map(|&order| (pole.frequency_hz, order as f64)));
    stable.try_for_each(|at| plane.dot(at, 2, MEASURED.filled()))
}
