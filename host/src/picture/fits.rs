//! Every mode's spectrum behind its modal filter: measured, fitted, how much the measured one scatters by chance, and what the fit
//! leaves of it.

use plotters::prelude::*;

use super::canvas::{
    Area, BAD, Dashes, DrawResult, FRAME, INK, MEASURED, PictureError, Plane, REJECTED, log_range, picture,
};
use super::units::density_unit;
use crate::identify::{FittedSpectrum, Identification, Mode};
use crate::study::Setup;

const COLUMNS: usize = 3;
const PANEL: (u32, u32) = (320, 300);
/// Height of the part of a panel that shows what the fit leaves.
const RESIDUAL: u32 = 82;
const TITLE: u32 = 70;
/// Numbers at the axes.
const LABEL: (&str, u32) = ("sans-serif", 11);
/// What stands left of a panel's axis.
const LABELS: u32 = 52;
/// Standard deviations that hold 95 % of all lines.
const BAND: f64 = 1.96;
/// What is left is drawn up to so many standard deviations at least, and at most: dots beyond stand at the edge.
const LEAST_DRAWN: f64 = 3.0;
const MOST_DRAWN: f64 = 9.0;

/// Draws a panel a mode: the setup that fits worst where there are several. `None` where no spectrum was fitted.
///
/// # Errors
/// When drawing fails.
pub fn fits(
    structure: &str,
    setups: &[Setup],
    identification: &Identification,
) -> Result<Option<String>, PictureError> {
    let panels: Vec<(&Mode, &FittedSpectrum)> =
        identification.modes.iter().filter_map(|mode| Some((mode, worst(&mode.fitted)?))).collect();
    if panels.is_empty() {
        return Ok(None);
    }
    let rows = panels.len().div_ceil(COLUMNS);
    let size = (PANEL.0 * COLUMNS as u32, TITLE + PANEL.1 * rows as u32);
    picture("the fits", size, |root| {
        root.draw(&Text::new(format!("{structure}: modes as fitted"), (12, 8), ("sans-serif", 18)))?;
        let legend = [
            format!(
                "Dots: measured density in {} over frequency in Hz, behind the mode's filter. Line: the fit. Grey: where 95 % of the dots lie if the fit lacks nothing.",
                density_unit(setups)
            ),
            "Below: what the fit leaves of the measured density, in standard deviations. Red dots lie outside of the grey; one of twenty does by chance.".to_owned(),
        ];
        for (line, text) in (0..).zip(legend) {
            root.draw(&Text::new(text, (12, 32 + 16 * line), ("sans-serif", 12)))?;
        }
        let (_, below) = root.split_vertically(TITLE);
        for (area, (mode, spectrum)) in below.split_evenly((rows, COLUMNS)).iter().zip(&panels) {
            draw(area, mode, spectrum)?;
        }
        Ok(())
    })
    .map(Some)
}

/// The setup whose measurement is the furthest from the fit.
fn worst(fitted: &[FittedSpectrum]) -> Option<&FittedSpectrum> {
    let away = |one: &FittedSpectrum| {
        let residuals = one.measured.iter().zip(&one.fitted).map(|(measured, fitted)| (measured / fitted).ln().powi(2));
        residuals.sum::<f64>() / one.fitted.len().max(1) as f64
    };
    fitted.iter().max_by(|a, b| a.is_misfit.cmp(&b.is_misfit).then(away(a).total_cmp(&away(b))))
}

fn draw(area: &Area<'_>, mode: &Mode, spectrum: &FittedSpectrum) -> DrawResult {
    let (Some(&first_hz), Some(&last_hz)) = (spectrum.frequency_hz.first(), spectrum.frequency_hz.last()) else {
        return Ok(());
    };
    let positive =
        || spectrum.measured.iter().chain(&spectrum.fitted).copied().filter(|value| *value > 0.0 && value.is_finite());
    let (low, high) = positive().fold((f64::INFINITY, 0.0_f64), |(low, high), v| (low.min(v), high.max(v)));
    let (low, high) = log_range(0.6 * low, 1.6 * high);
    let warning = if spectrum.is_misfit { ", something else lies here" } else { "" };
    let caption = format!(
        "mode {}: {:.4} Hz, damping {:.2} %{warning}",
        mode.number,
        mode.frequency_hz,
        100.0 * mode.damping_ratio
    );
    area.draw(&Text::new(
        caption,
        (14, 6),
        ("sans-serif", 13).into_font().color(if spectrum.is_misfit { &BAD } else { &INK }),
    ))?;
    let (upper, lower) = area.split_vertically(PANEL.1 - RESIDUAL);
    draw_residuals(&lower, spectrum, first_hz..last_hz)?;
    let mut chart = ChartBuilder::on(&upper)
        .margin(6)
        .margin_top(24)
        .margin_bottom(2)
        .y_label_area_size(LABELS)
        .build_cartesian_2d(first_hz..last_hz, (low..high).log_scale())?;
    chart
        .configure_mesh()
        .disable_mesh()
        .x_labels(0)
        .y_labels(4)
        .label_style(LABEL)
        .y_label_formatter(&|value| format!("{value:.0e}"))
        .axis_style(FRAME)
        .draw()?;
    let fitted = || spectrum.frequency_hz.iter().copied().zip(spectrum.fitted.iter().copied());
    if spectrum.scatter.is_finite() {
        let edge = |sign: f64| (1.0 + sign * BAND * spectrum.scatter).max(0.02);
        let above = fitted().map(|(hz, density)| (hz, (density * edge(1.0)).min(high)));
        let below = fitted().map(|(hz, density)| (hz, (density * edge(-1.0)).max(low)));
        let outline: Vec<(f64, f64)> = above.chain(below.collect::<Vec<_>>().into_iter().rev()).collect();
        chart.draw_series(std::iter::once(Polygon::new(outline, REJECTED.mix(0.22))))?;
    }
    let plane = Plane::of(&chart, first_hz..last_hz, low..high, true);
    let at = [(mode.frequency_hz, low), (mode.frequency_hz, high)];
    plane.curve(at, Dashes::Full, FRAME.stroke_width(1))?;
    plane.curve(fitted(), Dashes::Full, INK.stroke_width(2))?;
    let dots = spectrum.frequency_hz.iter().copied().zip(spectrum.measured.iter().copied());
    dots.filter(|(_, density)| *density > 0.0).try_for_each(|at| plane.dot(at, 2, MEASURED.filled()))
}

/// Draws what the fit leaves, line by line, in standard deviations of a measured density.
fn draw_residuals(area: &Area<'_>, spectrum: &FittedSpectrum, band_hz: std::ops::Range<f64>) -> DrawResult {
    let residuals = residuals(spectrum);
    let largest = residuals.iter().map(|(_, residual)| residual.abs()).fold(0.0, f64::max);
    let reach = (1.1 * largest).clamp(LEAST_DRAWN, MOST_DRAWN);
    let mut chart = ChartBuilder::on(area)
        .margin(6)
        .margin_top(8)
        .x_label_area_size(22)
        .y_label_area_size(LABELS)
        .build_cartesian_2d(band_hz.clone(), -reach..reach)?;
    chart
        .configure_mesh()
        .disable_mesh()
        .x_labels(4)
        .y_labels(3)
        .label_style(LABEL)
        .y_label_formatter(&|value| if *value == 0.0 { "0".to_owned() } else { format!("{value:+.0}") })
        .axis_style(FRAME)
        .draw()?;
    if residuals.is_empty() {
        let text =
            Text::new("the standard deviation of a line is not known", (LABELS as i32 + 14, 22), ("sans-serif", 11));
        area.draw(&text)?;
        return Ok(());
    }
    let corners = [(band_hz.start, -BAND), (band_hz.end, BAND)];
    chart.draw_series(std::iter::once(Rectangle::new(corners, REJECTED.mix(0.22).filled())))?;
    chart.draw_series(LineSeries::new([(band_hz.start, 0.0), (band_hz.end, 0.0)], INK.stroke_width(1)))?;
    let plane = Plane::of(&chart, band_hz, -reach..reach, false);
    residuals.into_iter().try_for_each(|(hz, residual)| {
        let color = if residual.abs() > BAND { BAD } else { MEASURED };
        plane.dot((hz, residual.clamp(-reach, reach)), 2, color.filled())
    })
}

/// Frequency in Hz of each line, and measured less fitted density there in standard deviations; none where these are not known.
fn residuals(spectrum: &FittedSpectrum) -> Vec<(f64, f64)> {
    let lines = spectrum.frequency_hz.iter().zip(&spectrum.measured).zip(&spectrum.fitted);
    let residual = |((hz, measured), fitted): ((&f64, &f64), &f64)| (*hz, (measured / fitted - 1.0) / spectrum.scatter);
    lines.map(residual).filter(|(_, residual)| residual.is_finite()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::accuracy::tests::found;

    fn spectrum(scatter: f64) -> FittedSpectrum {
        FittedSpectrum {
            setup: "first".to_owned(),
            frequency_hz: vec![1.0, 1.1, 1.2],
            measured: vec![1.1, 4.0, 0.7],
            fitted: vec![1.0, 4.0, 1.0],
            scatter,
            is_misfit: false,
        }
    }

    #[test]
    fn any_numbers_make_a_picture() {
        let mut identification = found();
        identification.modes.truncate(1);
        for wrong in [0.0, f64::INFINITY, f64::NAN, -1.0, f64::MAX, f64::MIN_POSITIVE] {
            for measured in [vec![wrong; 3], vec![1.0, wrong, 2.0]] {
                let fitted = vec![wrong, 1.0, wrong];
                identification.modes[0].fitted = vec![FittedSpectrum { measured, fitted, ..spectrum(0.1) }];
                assert!(fits("Tower", &[], &identification).unwrap().is_some());
            }
        }
    }

    #[test]
    fn what_is_left_is_drawn_in_standard_deviations_and_red_where_chance_seldom_leaves_it() {
        let expected = [(1.0, 1.0), (1.1, 0.0), (1.2, -3.0)];
        for (found, expected) in residuals(&spectrum(0.1)).into_iter().zip(expected) {
            assert!((found.0 - expected.0).abs() < 1e-12 && (found.1 - expected.1).abs() < 1e-9, "{found:?}");
        }
        assert!(residuals(&spectrum(f64::NAN)).is_empty());
        let mut identification = found();
        identification.modes.truncate(1);
        let drawn = |scatter: f64, identification: &mut Identification| {
            identification.modes[0].fitted = vec![spectrum(scatter)];
            fits("Tower", &[], identification).unwrap().unwrap()
        };
        let circles = |svg: &str| svg.matches("<circle").count();
        let red = |svg: &str| svg.lines().filter(|line| line.contains("<circle") && line.contains("#B3261E")).count();
        let svg = drawn(0.1, &mut identification);
        assert_eq!((circles(&svg), red(&svg)), (6, 1), "three dots above and three below");
        let svg = drawn(f64::NAN, &mut identification);
        assert!(circles(&svg) == 3 && svg.contains("the standard deviation of a line is not known"), "{svg}");
    }
}
