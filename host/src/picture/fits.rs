//! Every mode's spectrum behind its modal filter: measured, fitted, and how much the measured one scatters by chance.

use plotters::prelude::*;

use super::canvas::{Area, BESIDE, DrawResult, FRAME, MODE, PictureError, picture};
use crate::identify::{FittedSpectrum, Identification, Mode};

const COLUMNS: usize = 3;
const PANEL: (u32, u32) = (320, 230);
const TITLE: u32 = 52;
/// Standard deviations that hold 95 % of all lines.
const BAND: f64 = 1.96;

/// Draws a panel a mode: the setup that fits worst where there are several. `None` where no spectrum was fitted.
///
/// # Errors
/// When drawing fails.
pub fn fits(structure: &str, identification: &Identification) -> Result<Option<String>, PictureError> {
    let panels: Vec<(&Mode, &FittedSpectrum)> =
        identification.modes.iter().filter_map(|mode| Some((mode, worst(&mode.fitted)?))).collect();
    if panels.is_empty() {
        return Ok(None);
    }
    let rows = panels.len().div_ceil(COLUMNS);
    let size = (PANEL.0 * COLUMNS as u32, TITLE + PANEL.1 * rows as u32);
    picture("the fits", size, |root| {
        root.draw(&Text::new(format!("{structure}: modes as fitted"), (12, 8), ("sans-serif", 18)))?;
        let legend = "Dots: measured density behind the mode's filter. Line: the fit. Grey: where 95 % of the dots lie if nothing is missing in the fit.";
        root.draw(&Text::new(legend, (12, 32), ("sans-serif", 12)))?;
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
    let positive = || spectrum.measured.iter().chain(&spectrum.fitted).copied().filter(|value| *value > 0.0);
    let (low, high) = positive().fold((f64::INFINITY, 0.0_f64), |(low, high), v| (low.min(v), high.max(v)));
    let (low, high) = (0.6 * low, 1.6 * high);
    let warning = if spectrum.is_misfit { ", not explained whole" } else { "" };
    let caption = format!(
        "mode {}: {:.4} Hz, damping {:.2} %{warning}",
        mode.number,
        mode.frequency_hz,
        100.0 * mode.damping_ratio
    );
    area.draw(&Text::new(
        caption,
        (14, 6),
        ("sans-serif", 13).into_font().color(if spectrum.is_misfit { &MODE } else { &BLACK }),
    ))?;
    let mut chart = ChartBuilder::on(area)
        .margin(6)
        .margin_top(24)
        .x_label_area_size(22)
        .y_label_area_size(52)
        .build_cartesian_2d(first_hz..last_hz, (low..high).log_scale())?;
    chart
        .configure_mesh()
        .disable_mesh()
        .x_labels(4)
        .y_labels(4)
        .y_label_formatter(&|value| format!("{value:.0e}"))
        .axis_style(FRAME)
        .draw()?;
    let fitted = || spectrum.frequency_hz.iter().copied().zip(spectrum.fitted.iter().copied());
    if spectrum.scatter.is_finite() {
        let edge = |sign: f64| (1.0 + sign * BAND * spectrum.scatter).max(0.02);
        let above = fitted().map(|(hz, density)| (hz, (density * edge(1.0)).min(high)));
        let below = fitted().map(|(hz, density)| (hz, (density * edge(-1.0)).max(low)));
        let outline: Vec<(f64, f64)> = above.chain(below.collect::<Vec<_>>().into_iter().rev()).collect();
        chart.draw_series(std::iter::once(Polygon::new(outline, FRAME.mix(0.6))))?;
    }
    chart.draw_series(std::iter::once(PathElement::new(
        [(mode.frequency_hz, low), (mode.frequency_hz, high)],
        FRAME.stroke_width(1),
    )))?;
    chart.draw_series(LineSeries::new(fitted(), MODE.stroke_width(2)))?;
    let dots = spectrum.frequency_hz.iter().copied().zip(spectrum.measured.iter().copied());
    chart.draw_series(dots.filter(|(_, density)| *density > 0.0).map(|at| Circle::new(at, 2, BESIDE.filled())))?;
    Ok(())
}
