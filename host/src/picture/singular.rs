//! The singular values over frequency, with the modes marked.

use plotters::prelude::*;

use super::canvas::{MODE, PictureError, picture};
use crate::identify::Identification;

const WHAT: &str = "the singular values";
const SIZE: (u32, u32) = (960, 520);
const RANKS: [RGBColor; 4] =
    [RGBColor(31, 87, 147), RGBColor(214, 124, 38), RGBColor(90, 150, 90), RGBColor(160, 160, 160)];

/// Singular values over frequency (one thin line a setup and rank), the modes marked.
///
/// # Errors
/// When nothing was measured, or drawing fails.
pub fn singular_values(structure: &str, identification: &Identification) -> Result<String, PictureError> {
    let spectra = &identification.singular_values;
    let values = || spectra.iter().flat_map(|s| s.values.iter().flatten().copied()).filter(|v| *v > 0.0);
    let highest = values().fold(0.0, f64::max);
    let first_rank_lowest =
        spectra.iter().filter_map(|s| s.values.first()).flatten().copied().fold(f64::INFINITY, f64::min);
    let (first_hz, last_hz) = spectra
        .first()
        .and_then(|s| Some((*s.frequency_hz.first()?, *s.frequency_hz.last()?)))
        .ok_or(PictureError { what: WHAT, reason: "nothing was measured".to_owned() })?;
    let lowest = values().fold(f64::INFINITY, f64::min).max(first_rank_lowest * 1e-3).max(highest * 1e-12);
    picture(WHAT, SIZE, |root| {
        let mut chart = ChartBuilder::on(root)
            .caption(
                format!("{structure}: the largest singular values of the cross-spectral matrix, and the modes"),
                ("sans-serif", 20),
            )
            .margin(12)
            .x_label_area_size(44)
            .y_label_area_size(76)
            .build_cartesian_2d(first_hz..last_hz, (lowest * 0.5..highest * 3.0).log_scale())?;
        chart
            .configure_mesh()
            .x_desc("frequency in Hz")
            .y_desc("density in (m/s²)²/Hz")
            .y_label_formatter(&|value| format!("{value:.0e}"))
            .light_line_style(WHITE.mix(0.0))
            .bold_line_style(RGBColor(228, 228, 228))
            .draw()?;
        for mode in &identification.modes {
            let line = [(mode.frequency_hz, lowest * 0.5), (mode.frequency_hz, highest * 3.0)];
            chart.draw_series(LineSeries::new(line, MODE.mix(0.45).stroke_width(1)))?;
        }
        for spectrum in spectra {
            for (rank, values) in spectrum.values.iter().enumerate().rev() {
                let color = RANKS[rank.min(RANKS.len() - 1)];
                let points = spectrum.frequency_hz.iter().zip(values).map(|(f, v)| (*f, v.max(lowest * 0.5)));
                chart.draw_series(LineSeries::new(points, color.stroke_width(2)))?;
            }
        }
        for mode in &identification.modes {
            let label = format!("{}", mode.number);
            let style = ("sans-serif", 14).into_font().color(&MODE);
            chart.draw_series(std::iter::once(Text::new(label, (mode.frequency_hz, highest * 2.6), style)))?;
        }
        Ok(())
    })
}
