//! The singular values over frequency, with modes, forced lines and rejected peaks marked.

use plotters::prelude::*;

use super::canvas::{Area, DIRECTIONS, DrawResult, MODE, PictureError, picture};
use crate::identify::Identification;

const WHAT: &str = "the singular values";
const SIZE: (u32, u32) = (960, 540);
/// Height of title and legend.
const TITLE: u32 = 56;
const RANKS: [RGBColor; 4] =
    [RGBColor(31, 87, 147), RGBColor(214, 124, 38), RGBColor(90, 150, 90), RGBColor(160, 160, 160)];

/// Forced lines.
const FORCED: RGBColor = DIRECTIONS[3];
/// Rejected peaks.
const REJECTED: RGBColor = RGBColor(120, 120, 120);
/// Where title and legend begin, from the left and from the top, and how much room a letter of the legend takes.
const TITLE_AT: (i32, i32) = (12, 8);
const LEGEND_AT: (i32, i32) = (12, 34);
const LETTER: i32 = 6;

/// Singular values over frequency (one thin line a setup and rank); modes are marked by their numbers, forced lines by F, rejected
/// peaks by crosses below.
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
    let (bottom, top) = (lowest * 0.5, highest * 4.0);
    picture(WHAT, SIZE, |root| {
        let title = format!("{structure}: the largest singular values of the cross-spectral matrix");
        root.draw(&Text::new(title, TITLE_AT, ("sans-serif", 18)))?;
        draw_legend(root, identification)?;
        let (_, below) = root.split_vertically(TITLE);
        let mut chart = ChartBuilder::on(&below)
            .margin(12)
            .margin_top(2)
            .x_label_area_size(44)
            .y_label_area_size(76)
            .build_cartesian_2d(first_hz..last_hz, (bottom..top).log_scale())?;
        chart
            .configure_mesh()
            .x_desc("frequency in Hz")
            .y_desc("density in (m/s²)²/Hz")
            .y_label_formatter(&|value| format!("{value:.0e}"))
            .light_line_style(WHITE.mix(0.0))
            .bold_line_style(RGBColor(228, 228, 228))
            .draw()?;
        for forced in &identification.harmonics {
            let half_hz = forced.wanders_hz;
            let corners = [(forced.frequency_hz - half_hz, bottom), (forced.frequency_hz + half_hz, top)];
            let inside = corners.map(|(hz, value)| (hz.clamp(first_hz, last_hz), value));
            chart.draw_series(std::iter::once(Rectangle::new(inside, FORCED.mix(0.15).filled())))?;
            let line = [(forced.frequency_hz, bottom), (forced.frequency_hz, top)];
            chart.draw_series(DashedLineSeries::new(line, 5, 4, FORCED.stroke_width(1)))?;
        }
        for mode in &identification.modes {
            let line = [(mode.frequency_hz, bottom), (mode.frequency_hz, top)];
            chart.draw_series(LineSeries::new(line, MODE.mix(0.45).stroke_width(1)))?;
        }
        for spectrum in spectra {
            for (rank, values) in spectrum.values.iter().enumerate().rev() {
                let color = RANKS[rank.min(RANKS.len() - 1)];
                let points = spectrum.frequency_hz.iter().zip(values).map(|(f, v)| (*f, v.max(bottom)));
                chart.draw_series(LineSeries::new(points, color.stroke_width(2)))?;
            }
        }
        let rejected = identification.rejected.iter().map(|peak| (peak.frequency_hz, top * 0.4));
        chart.draw_series(rejected.map(|at| Cross::new(at, 3, REJECTED)))?;
        let mode_labels = identification.modes.iter().map(|mode| (mode.number.to_string(), mode.frequency_hz, MODE));
        let forced_labels = identification.harmonics.iter().map(|forced| ("F".to_owned(), forced.frequency_hz, FORCED));
        for (label, hz, color) in mode_labels.chain(forced_labels) {
            let style = ("sans-serif", 14).into_font().color(&color);
            // Beside the line, not on it.
            let mark = EmptyElement::at((hz, top * 0.9)) + Text::new(label, (3, 0), style);
            chart.draw_series(std::iter::once(mark))?;
        }
        Ok(())
    })
}

/// Draws what the marks mean, of those that there are.
fn draw_legend(root: &Area<'_>, identification: &Identification) -> DrawResult {
    let is_several = identification.singular_values.len() > 1;
    let ranks = identification.singular_values.iter().map(|spectrum| spectrum.values.len()).max().unwrap_or(0);
    let first = if is_several { "Lines of each setup: first" } else { "Lines: first" };
    let mut entries: Vec<(String, RGBColor)> = [first, "second", "third", "fourth"]
        .iter()
        .zip(RANKS)
        .take(ranks)
        .map(|(rank, color)| ((*rank).to_owned(), color))
        .collect();
    let marks = [
        (!identification.modes.is_empty(), "1, 2, ... modes", MODE),
        (!identification.harmonics.is_empty(), "F forced lines: machinery or vortices", FORCED),
        (!identification.rejected.is_empty(), "x rejected peaks", REJECTED),
    ];
    entries
        .extend(marks.into_iter().filter(|(is_there, ..)| *is_there).map(|(_, text, color)| (text.to_owned(), color)));
    let (mut x, y) = LEGEND_AT;
    for (text, color) in entries {
        let width = LETTER * text.len() as i32 + 24;
        root.draw(&Text::new(text, (x, y), ("sans-serif", 12).into_font().color(&color)))?;
        x += width;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::accuracy::tests::found;
    use crate::identify::{Harmonic, Rejected, RejectedBecause, SingularSpectrum};

    #[test]
    fn forced_lines_and_rejected_peaks_are_marked_apart_from_modes_and_explained() {
        let mut identification = found();
        let frequency_hz: Vec<f64> = (1..100).map(|line| 0.1 * f64::from(line)).collect();
        let values = vec![frequency_hz.iter().map(|hz| 1.0 / hz).collect()];
        identification.singular_values = vec![SingularSpectrum { setup: "first".to_owned(), frequency_hz, values }];
        let plain = singular_values("Tower", &identification).unwrap();
        assert!(!plain.contains("forced lines") && !plain.contains("rejected peaks"));
        let kurtosis = 1.5;
        let harmonic = Harmonic { frequency_hz: 2.5, kurtosis, wanders_hz: 0.1, on_share: 1.0, on_by_part: Vec::new() };
        identification.harmonics = vec![harmonic];
        identification.rejected = vec![Rejected { frequency_hz: 4.0, because: RejectedBecause::Shape }];
        let marked = singular_values("Tower", &identification).unwrap();
        assert!(marked.contains("F forced lines: machinery or vortices") && marked.contains("x rejected peaks"));
        // Text of their own, and what stands at their frequencies.
        let of = |svg: &str, color: &str| svg.matches(color).count();
        assert!(of(&marked, "#825AA0") > 10 && of(&plain, "#825AA0") == 0, "the dashes of a forced line");
        assert_eq!((of(&marked, "#787878"), of(&plain, "#787878")), (3, 0), "two strokes of a cross, and the legend");
    }
}
