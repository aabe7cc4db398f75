//! The singular values over frequency, with modes, forced lines and rejected peaks marked.

use plotters::prelude::*;

use super::canvas::{
    Area, Dashes, DrawResult, FORCED, FRAME, INK, MEASURED, PictureError, Plane, REJECTED, log_range, picture, width_of,
};
use super::units::density_unit;
use crate::colour::{Colour, SERIES};
use crate::identify::{FittedSpectrum, Identification, SingularSpectrum};
use crate::study::Setup;

const WHAT: &str = "the singular values";
const SIZE: (u32, u32) = (960, 540);
/// How strong a singular value is drawn, and how wide: the first most.
const RANKS: [(f64, u32); 4] = [(1.0, 2), (0.72, 1), (0.52, 1), (0.36, 1)];
/// Where title and legend begin, from the left and from the top, and what a row of the legend takes.
const TITLE_AT: (i32, i32) = (12, 8);
const LEGEND_AT: (i32, i32) = (12, 36);
const LEGEND_ROW: i32 = 19;
const LEGEND_SIZE: u32 = 13;
/// What stands right of the curves.
const MARGIN: i32 = 14;

/// A line of the picture: what it is called, its setup's spectrum, the singular value's rank from 0, how it looks.
struct Line<'a> {
    name: String,
    spectrum: &'a SingularSpectrum,
    rank: usize,
    style: ShapeStyle,
}

impl Line<'_> {
    fn values(&self) -> &[f64] {
        &self.spectrum.values[self.rank]
    }
}

/// All singular values of one setup, but the first alone of each of several, whose tangle nobody could read.
fn lines(spectra: &[SingularSpectrum]) -> Vec<Line<'_>> {
    let one = |spectrum, rank, name: String, style| Line { name, spectrum, rank, style };
    match spectra {
        [spectrum] => (0..spectrum.values.len())
            .map(|rank| {
                let name =
                    ["first", "second", "third", "fourth"].get(rank).map_or(String::new(), |&name| name.to_owned());
                let (strength, width) = RANKS[rank.min(RANKS.len() - 1)];
                one(spectrum, rank, name, MEASURED.mix(strength).stroke_width(width))
            })
            .collect(),
        spectra => spectra
            .iter()
            .zip(std::iter::once(MEASURED).chain(SERIES.map(Colour::on_paper)).cycle())
            .filter(|(spectrum, _)| !spectrum.values.is_empty())
            .map(|(spectrum, color)| one(spectrum, 0, spectrum.setup.clone(), color.stroke_width(1)))
            .collect(),
    }
}

/// What the fit of each mode expects at the lines of a spectrum.
fn fits(identification: &Identification, spectrum: &SingularSpectrum) -> Vec<Vec<(f64, f64)>> {
    let spacing_hz = identification.frequency_resolution_hz;
    let fits = identification.modes.iter().flat_map(|mode| &mode.fitted).filter(|fit| fit.setup == spectrum.setup);
    let own = |fit: &FittedSpectrum| fit.frequency_hz.iter().copied().zip(fit.fitted.iter().copied()).collect();
    let lines_hz = || spectrum.frequency_hz.iter().copied();
    fits.map(|fit| fit.on_lines(lines_hz(), spacing_hz).unwrap_or_else(|| own(fit))).collect()
}

/// Singular values over frequency: those of one setup, or the first of each of several; modes are marked by their numbers, forced lines by F,
/// rejected peaks by crosses below.
///
/// # Errors
/// When nothing was measured, or drawing fails.
pub fn singular_values(
    structure: &str,
    setups: &[Setup],
    identification: &Identification,
) -> Result<String, PictureError> {
    let spectra = &identification.singular_values;
    let lines = lines(spectra);
    let values = || lines.iter().flat_map(|line| line.values().iter().copied()).filter(|v| *v > 0.0 && v.is_finite());
    let highest = values().fold(0.0, f64::max);
    let first_rank = spectra.iter().filter_map(|s| s.values.first()).flatten().copied();
    let first_rank_lowest = first_rank.filter(|v| *v > 0.0 && v.is_finite()).fold(f64::INFINITY, f64::min);
    let (first_hz, last_hz) = spectra
        .first()
        .and_then(|s| Some((*s.frequency_hz.first()?, *s.frequency_hz.last()?)))
        .ok_or(PictureError { what: WHAT, reason: "nothing was measured".to_owned() })?;
    let lowest = values().fold(f64::INFINITY, f64::min).max(first_rank_lowest.min(highest) * 1e-3).max(highest * 1e-12);
    let (bottom, top) = log_range(lowest * 0.5, highest * 4.0);
    let legend = legend(&lines, identification);
    let rows = legend.last().map_or(1, |entry| 1 + (entry.at.1 - LEGEND_AT.1) / LEGEND_ROW);
    picture(WHAT, SIZE, |root| {
        let which = if spectra.len() > 1 {
            "first singular value of each setup's"
        } else {
            "the largest singular values of the"
        };
        let title = format!("{structure}: {which} cross-spectral matrix");
        root.draw(&Text::new(title, TITLE_AT, ("sans-serif", 18)))?;
        for entry in &legend {
            entry.draw(root)?;
        }
        let (_, below) = root.split_vertically(LEGEND_AT.1 + rows * LEGEND_ROW + 4);
        let mut chart = ChartBuilder::on(&below)
            .margin(MARGIN)
            .margin_top(2)
            .x_label_area_size(44)
            .y_label_area_size(76)
            .build_cartesian_2d(first_hz..last_hz, (bottom..top).log_scale())?;
        chart
            .configure_mesh()
            .x_desc("frequency in Hz")
            .y_desc(format!("density in {}", density_unit(setups)))
            .y_label_formatter(&|value| format!("{value:.0e}"))
            .label_style(("sans-serif", 12))
            .axis_desc_style(("sans-serif", 13))
            .light_line_style(WHITE.mix(0.0))
            .bold_line_style(FRAME.mix(0.6))
            .draw()?;
        let plane = Plane::of(&chart, first_hz..last_hz, bottom..top, true);
        for forced in &identification.harmonics {
            let half_hz = forced.wanders_hz;
            let corners = [(forced.frequency_hz - half_hz, bottom), (forced.frequency_hz + half_hz, top)];
            let inside = corners.map(|(hz, value)| (hz.clamp(first_hz, last_hz), value));
            chart.draw_series(std::iter::once(Rectangle::new(inside, FORCED.mix(0.15).filled())))?;
            let line = [(forced.frequency_hz, bottom), (forced.frequency_hz, top)];
            plane.curve(line, Dashes::Short, FORCED.stroke_width(1))?;
        }
        for mode in &identification.modes {
            let line = [(mode.frequency_hz, bottom), (mode.frequency_hz, top)];
            plane.curve(line, Dashes::Full, INK.mix(0.4).stroke_width(1))?;
        }
        for line in lines.iter().rev() {
            let points = line.spectrum.frequency_hz.iter().zip(line.values()).map(|(f, v)| (*f, v.clamp(bottom, top)));
            plane.curve(points, Dashes::Full, line.style)?;
        }
        // Of several setups each has one line, of which fits would make a tangle.
        if let [spectrum] = &spectra[..] {
            for fit in fits(identification, spectrum) {
                let points = fit.into_iter().map(|(hz, value)| (hz, value.clamp(bottom, top)));
                plane.curve(points, Dashes::Short, INK.stroke_width(1))?;
            }
        }
        let rejected = identification.rejected.iter().map(|peak| (peak.frequency_hz, top * 0.4));
        chart.draw_series(rejected.map(|at| Cross::new(at, 3, REJECTED)))?;
        let mode_labels = identification.modes.iter().map(|mode| (mode.number.to_string(), mode.frequency_hz, INK));
        let forced_labels = identification.harmonics.iter().map(|forced| ("F".to_owned(), forced.frequency_hz, FORCED));
        let mut labels: Vec<(String, f64, RGBColor)> = mode_labels.chain(forced_labels).collect();
        labels.sort_by(|a, b| a.1.total_cmp(&b.1));
        let mut ends: Vec<i32> = Vec::new();
        for (label, hz, color) in labels {
            let from = chart.backend_coord(&(hz, top)).0;
            let row = free_row(&mut ends, from, from + 3 + width_of(&label, 14));
            let style = ("sans-serif", 14).into_font().color(&color);
            // Beside the line, not on it.
            let mark = EmptyElement::at((hz, top * 0.9)) + Text::new(label, (3, 14 * row), style);
            chart.draw_series(std::iter::once(mark))?;
        }
        Ok(())
    })
}

/// The first row in which a label from here to there meets none before it; `ends` is where the last label of each row ends.
fn free_row(ends: &mut Vec<i32>, from: i32, to: i32) -> i32 {
    let row = ends.iter().position(|end| *end < from).unwrap_or(ends.len());
    ends.resize(ends.len().max(row + 1), 0);
    ends[row] = to;
    row as i32
}

/// What a colour means: a line, or a mark that the words name.
struct Entry {
    words: String,
    at: (i32, i32),
    color: RGBColor,
    line: Option<ShapeStyle>,
}

impl Entry {
    const LINE: i32 = 20;

    fn draw(&self, root: &Area<'_>) -> DrawResult {
        let (mut x, y) = self.at;
        if let Some(style) = self.line {
            root.draw(&PathElement::new([(x, y + 7), (x + Self::LINE, y + 7)], style))?;
            x += Self::LINE + 6;
        }
        root.draw(&Text::new(self.words.clone(), (x, y), ("sans-serif", LEGEND_SIZE).into_font().color(&self.color)))?;
        Ok(())
    }
}

/// What the lines and marks mean, of those that there are, in rows.
fn legend(lines: &[Line<'_>], identification: &Identification) -> Vec<Entry> {
    let of_lines = lines.iter().filter(|line| !line.name.is_empty()).map(|line| {
        let name = line.name.clone();
        (name, INK, Some(line.style))
    });
    let has_fits =
        identification.singular_values.len() == 1 && identification.modes.iter().any(|mode| !mode.fitted.is_empty());
    let marks = [
        (has_fits, "- - fit of each mode", INK),
        (!identification.modes.is_empty(), "1, 2, ... modes", INK),
        (!identification.harmonics.is_empty(), "F forced lines: machinery or vortices", FORCED),
        (!identification.rejected.is_empty(), "x rejected peaks", REJECTED),
    ];
    let marks =
        marks.into_iter().filter(|(is_there, ..)| *is_there).map(|(_, words, color)| (words.to_owned(), color, None));
    let mut at = LEGEND_AT;
    let mut entries = Vec::new();
    for (words, color, line) in of_lines.chain(marks) {
        let width = width_of(&words, LEGEND_SIZE) + line.map_or(0, |_| Entry::LINE + 6) + 22;
        if at.0 > LEGEND_AT.0 && at.0 + width > SIZE.0 as i32 {
            at = (LEGEND_AT.0, at.1 + LEGEND_ROW);
        }
        entries.push(Entry { words, at, color, line });
        at.0 += width;
    }
    entries
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
        let plain = singular_values("Tower", &[], &identification).unwrap();
        assert!(!plain.contains("forced lines") && !plain.contains("rejected peaks"));
        let kurtosis = 1.5;
        let harmonic = Harmonic { frequency_hz: 2.5, kurtosis, wanders_hz: 0.1, on_share: 1.0, on_by_part: Vec::new() };
        identification.harmonics = vec![harmonic];
        identification.rejected = vec![Rejected { frequency_hz: 4.0, because: RejectedBecause::Shape }];
        let marked = singular_values("Tower", &[], &identification).unwrap();
        assert!(marked.contains("F forced lines: machinery or vortices") && marked.contains("x rejected peaks"));
        // Text of their own, and what stands at their frequencies.
        let of = |svg: &str, color: &str| svg.matches(color).count();
        assert!(of(&marked, "#AD8400") > of(&plain, "#AD8400") && of(&plain, "#AD8400") == 0, "a forced line");
        assert_eq!((of(&marked, "#555555"), of(&plain, "#555555")), (3, 0), "two strokes of a cross, and the legend");
    }

    #[test]
    fn fits_stand_on_the_curves_of_one_setup() {
        let mut identification = found();
        let frequency_hz: Vec<f64> = (1..100).map(|line| 0.1 * f64::from(line)).collect();
        let fit = FittedSpectrum {
            setup: "first".to_owned(),
            frequency_hz: frequency_hz[20..40].to_vec(),
            measured: vec![1.0; 20],
            fitted: vec![0.5; 20],
            scatter: 0.1,
            is_misfit: false,
        };
        let spectrum = |setup: &str| SingularSpectrum {
            setup: setup.to_owned(),
            frequency_hz: frequency_hz.clone(),
            values: vec![vec![1.0; 99]],
        };
        identification.frequency_resolution_hz = 0.1;
        identification.singular_values = vec![spectrum("first")];
        let dashed = |identification: &Identification| {
            let svg = singular_values("Tower", &[], identification).unwrap();
            (svg.matches("stroke-dasharray").count(), svg.contains("fit of each mode"))
        };
        assert_eq!(dashed(&identification), (0, false));
        identification.modes[0].fitted = vec![fit];
        assert_eq!(dashed(&identification), (1, true));
        identification.singular_values.push(spectrum("second"));
        assert_eq!(dashed(&identification), (0, false));
    }

    /// As one flipped bit in a recording leaves them, and as a silent structure does.
    #[test]
    fn any_numbers_make_a_picture() {
        let mut identification = found();
        let frequency_hz: Vec<f64> = (1..10).map(f64::from).collect();
        for wrong in [0.0, f64::INFINITY, f64::NAN, -1.0, f64::MAX, f64::MIN_POSITIVE] {
            for count in [1, 9] {
                let row: Vec<f64> = (0..9).map(|at| if at < count { wrong } else { 1.0 }).collect();
                let values = vec![row.clone(), row];
                let setup = "first".to_owned();
                identification.singular_values =
                    vec![SingularSpectrum { setup, frequency_hz: frequency_hz.clone(), values }];
                assert!(singular_values("Tower", &[], &identification).unwrap().contains("</svg>"));
            }
        }
    }

    /// Of one setup all singular values, of each of several the first, with its name.
    #[test]
    fn several_setups_show_a_curve_each() {
        let mut identification = found();
        let spectrum = |setup: usize| SingularSpectrum {
            setup: format!("level {setup}"),
            frequency_hz: (1..100).map(|line| 0.1 * f64::from(line)).collect(),
            values: (0..4).map(|rank| vec![10f64.powi(-rank); 99]).collect(),
        };
        // Curves are the only lines of many points.
        let curves = |identification: &Identification| {
            let svg = singular_values("Tower", &[], identification).unwrap();
            let curves =
                svg.lines().filter(|line| line.starts_with("<polyline") && line.matches(',').count() > 50).count();
            (curves, svg)
        };
        identification.singular_values = vec![spectrum(1)];
        let (of_one, svg) = curves(&identification);
        assert_eq!(of_one, 4);
        assert!(svg.contains("fourth") && !svg.contains("level 1"));
        identification.singular_values = (1..=9).map(spectrum).collect();
        let (of_nine, svg) = curves(&identification);
        assert_eq!(of_nine, 9);
        assert!(!svg.contains("fourth") && (1..=9).all(|setup| svg.contains(&format!("level {setup}"))));
    }

    #[test]
    fn labels_that_would_meet_stand_below_each_other() {
        let mut ends = Vec::new();
        let labels = [(0, 10), (8, 20), (9, 22), (15, 25), (30, 40)];
        assert_eq!(labels.map(|(from, to)| free_row(&mut ends, from, to)), [0, 1, 2, 0, 0]);
    }
}
