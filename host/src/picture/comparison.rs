//! Measured mode shapes over height on the model's curves, a panel a pair.

use plotters::prelude::*;

use super::canvas::{
    Area, Chart, Dashes, DrawResult, FRAME, GIVEN, INK, MEASURED, PictureError, Plane, WITH_EFFECTS, axis_digits,
    fixed, of_direction, picture, sample, sample_mark, signed, width_of,
};
use crate::colour;
use crate::compare::{Comparison, HeightMisfit, ModelView, PairReport, scale};
use crate::model::Assembly;
use crate::modes::{MeasuredMode, MeasuredShape};
use crate::numbers::mac_words;
use crate::study::{Direction, Sensor};

const WHAT: &str = "the comparison";
const MOST_COLUMNS: usize = 6;
const LEAST_COLUMNS: usize = 5;
const WIDTH: u32 = 990;
const PANEL: u32 = 290;
const HEADER: u32 = 92;
/// Points of a model's curve.
const POINTS: usize = 320;
/// Bars reach so far at most: the largest measured component is 1.
const LONGEST_BAR: f64 = 1.6;
/// What stands above the highest sensor may move so many times as far as the sensors and is still drawn at their scale.
const SAME_SCALE: f64 = 2.5;
const MISFIT: RGBColor = colour::HIGH.on_paper();

/// Draws the pairs: full marks with bars of two standard deviations are measured, open marks are the model at the same sensors, curves are the
/// model where most sensors of a direction stand in plan; the last panel is the misfit by height. The model has the colour of one with
/// effects where it has some. `None` where the model is no line, no pair has a shape, or no sensor a height.
///
/// # Errors
/// When drawing fails.
pub fn comparison(
    structure: &str,
    assembly: &Assembly,
    view: &ModelView,
    sensors: &[Sensor],
    measured: &[MeasuredMode],
    comparison: &Comparison,
    has_effects: bool,
) -> Result<Option<String>, PictureError> {
    let verticals = verticals(sensors);
    let shapes: Vec<(&PairReport, &MeasuredShape)> = comparison
        .pairs
        .iter()
        .filter_map(|pair| {
            let mode = measured.iter().find(|mode| mode.number == pair.measured)?;
            Some((pair, mode.shape.as_ref()?))
        })
        .collect();
    let heights = assembly.node_elevations_m();
    let (Some(&top_m), false, false) = (heights.last(), verticals.is_empty(), shapes.is_empty()) else {
        return Ok(None);
    };
    let range_m = [assembly.z_base_m(), top_m];
    let curves = curves(assembly, view, sensors, &verticals, range_m)
        .map_err(|error| PictureError { what: WHAT, reason: error.to_string() })?;
    let count = shapes.len() + 1;
    let rows = count.div_ceil(MOST_COLUMNS);
    let columns = count.div_ceil(rows).max(LEAST_COLUMNS);
    let scene = Scene { sensors, verticals: &verticals, curves: &curves };
    let model = if has_effects { WITH_EFFECTS } else { GIVEN };
    picture(WHAT, (WIDTH, HEADER + PANEL * rows as u32), |root| {
        let (header, body) = root.split_vertically(HEADER);
        draw_header(&header, structure, &verticals, model)?;
        let panels = body.split_evenly((rows, columns));
        for (index, (panel, (pair, shape))) in panels.iter().zip(&shapes).enumerate() {
            let lines = scene.lines(pair, shape, view.shape(pair.model - 1));
            draw(panel, index.is_multiple_of(columns), pair, &lines, range_m, model)?;
        }
        let is_first = shapes.len().is_multiple_of(columns);
        panels.get(shapes.len()).map_or(Ok(()), |panel| draw_misfit(panel, is_first, &comparison.by_height, range_m))
    })
    .map(Some)
}

fn draw_header(header: &Area<'_>, structure: &str, verticals: &Verticals, model: RGBColor) -> DrawResult {
    let title = format!("{structure}: the model's mode shapes against the measured ones");
    header.draw(&Text::new(title, (12, 8), ("sans-serif", 18)))?;
    let mut x = 12;
    for (index, (name, _)) in verticals.iter().enumerate() {
        let (dashes, mark) = of_direction(index);
        sample(header, (x, 41), 26, dashes, model.stroke_width(1))?;
        sample_mark(header, (x + 13, 41), mark, 4, model.stroke_width(1))?;
        sample_mark(header, (x + 13, 41), mark, 2, MEASURED.filled())?;
        header.draw(&Text::new(name.clone(), (x + 32, 34), ("sans-serif", 13)))?;
        x += 32 + width_of(name, 13) + 20;
    }
    let words = "full marks, bars of two deviations: measured; open marks, curves: the model";
    header.draw(&Text::new(words, (x, 34), ("sans-serif", 13)))?;
    let words = "Motion over height, without unit: the largest measured is 1. Above each panel: mode, the model's frequency against the measured, MAC.";
    header.draw(&Text::new(words, (12, 54), ("sans-serif", 13)))?;
    let words = "Fine dots lead to sensors that stand elsewhere in plan: torsion moves them otherwise. Above a dotted line curves are divided by the number there.";
    header.draw(&Text::new(words, (12, 72), ("sans-serif", 13)))?;
    Ok(())
}

/// Sensors of one direction, by its name.
type Verticals = Vec<(String, Vec<usize>)>;

fn verticals(sensors: &[Sensor]) -> Verticals {
    // In the order in which the study names them, as the picture of the measured shapes has them.
    let mut verticals = Verticals::new();
    for (index, sensor) in sensors.iter().enumerate() {
        let place = (sensor.elevation_m, sensor.direction, sensor.dof);
        if let ((Some(_), Some(Direction::AzimuthDeg(azimuth_deg)), None), true) = (place, sensor.is_of_a_point()) {
            let name = format!("towards {azimuth_deg}°");
            match verticals.iter_mut().find(|(known, _)| *known == name) {
                Some((_, indices)) => indices.push(index),
                None => verticals.push((name, vec![index])),
            }
        }
    }
    verticals
}

/// A direction's curve of every mode: heights x modes.
struct Curve {
    heights_m: Vec<f64>,
    values: nalgebra::DMatrix<f64>,
}

fn curves(
    assembly: &Assembly,
    view: &ModelView,
    sensors: &[Sensor],
    verticals: &Verticals,
    [base_m, top_m]: [f64; 2],
) -> Result<Vec<Curve>, crate::model::SensorError> {
    let heights_m: Vec<f64> = (0..POINTS).map(|i| base_m + (top_m - base_m) * i as f64 / (POINTS - 1) as f64).collect();
    verticals
        .iter()
        .map(|(_, indices)| {
            // The plan position that most sensors of the direction share; torsion looks different at the others.
            let sharing = |&index: &usize| {
                indices.iter().filter(|&&other| sensors[other].offset_m == sensors[index].offset_m).count()
            };
            let typical = indices.iter().rev().copied().max_by_key(sharing).unwrap_or(indices[0]);
            let along: Vec<Sensor> =
                heights_m.iter().map(|&z_m| Sensor { elevation_m: Some(z_m), ..sensors[typical].clone() }).collect();
            Ok(Curve { heights_m: heights_m.clone(), values: assembly.sensor_rows(&along)? * &view.modes.shapes })
        })
        .collect()
}

/// What is drawn into the panels.
struct Scene<'a> {
    sensors: &'a [Sensor],
    verticals: &'a Verticals,
    curves: &'a [Curve],
}

/// A sensor in a panel.
struct Dot {
    z_m: f64,
    measured: f64,
    std: Option<f64>,
    /// The model at this sensor, wherever it stands in plan.
    model: f64,
    /// The model's curve at this height.
    curve: f64,
}

/// The model's curve of a direction (motion, height), and its sensors.
type OfDirection = (Vec<(f64, f64)>, Vec<Dot>);

/// A pair, at the measured shape's scale.
struct Lines {
    of_directions: Vec<OfDirection>,
    /// What stands above this height moves so much further that it is drawn smaller by this factor.
    reduced: Option<(f64, f64)>,
    /// Motion at the panel's edges: all is inside.
    edge: f64,
}

impl Scene<'_> {
    /// A pair's lines, `model` being the shape at all sensors.
    fn lines(&self, pair: &PairReport, shape: &MeasuredShape, model: &[f64]) -> Lines {
        let scale = scale(model, shape);
        let mode = pair.model - 1;
        let dot = |sensor: usize, curve: &Curve| {
            let position = shape.sensors.iter().position(|&known| known == sensor)?;
            let z_m = self.sensors[sensor].elevation_m?;
            Some(Dot {
                z_m,
                measured: shape.values[position],
                std: shape.stds.as_ref().map(|stds| stds[position]).filter(|std| std.is_finite()),
                model: scale * model[sensor],
                curve: scale * curve.at(z_m, mode),
            })
        };
        let of_directions: Vec<OfDirection> = self
            .verticals
            .iter()
            .zip(self.curves)
            .map(|((_, indices), curve)| {
                let values = curve.values.column(mode);
                let line =
                    curve.heights_m.iter().zip(values.iter()).map(|(&z_m, &value)| (scale * value, z_m)).collect();
                (line, indices.iter().filter_map(|&sensor| dot(sensor, curve)).collect())
            })
            .collect();
        let dots = || of_directions.iter().flat_map(|(_, dots)| dots);
        let highest_m = dots().map(|dot| dot.z_m).fold(f64::NEG_INFINITY, f64::max);
        let furthest = |is_above: bool| {
            let points =
                of_directions.iter().flat_map(|(line, _)| line).filter(|point| (point.1 > highest_m) == is_above);
            points.map(|point| point.0.abs()).fold(0.0, f64::max)
        };
        let of_dots = dots().flat_map(|dot| {
            let end = dot.measured.abs() + 2.0 * dot.std.unwrap_or(0.0);
            [dot.measured.abs(), end.min(LONGEST_BAR), dot.model.abs()]
        });
        let (inner, above) = (of_dots.fold(furthest(false), f64::max), furthest(true));
        let reduced = (inner > 0.0 && above > SAME_SCALE * inner).then(|| (highest_m, round_factor(above / inner)));
        let edge = 1.08 * inner.max(above / reduced.map_or(1.0, |(_, factor)| factor));
        Lines { of_directions, reduced, edge: if edge > 0.0 { edge } else { 1.0 } }
    }
}

/// The next of 1, 2, 5, 10, 20, 50, ... that is at least this.
fn round_factor(least: f64) -> f64 {
    let decade = 10f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0, 10.0].map(|front| front * decade).into_iter().find(|factor| *factor >= least).unwrap_or(least)
}

fn heights([base_m, top_m]: [f64; 2]) -> std::ops::Range<f64> {
    base_m..top_m + 0.02 * (top_m - base_m)
}

/// A panel over height, with the heights' numbers where it is the first of a row.
fn over_height<'a, 'b>(
    panel: &'a Area<'b>,
    is_first: bool,
    caption: &str,
    motion: std::ops::Range<f64>,
    range_m: [f64; 2],
    label: &dyn Fn(&f64) -> String,
) -> DrawResult<Chart<'a, 'b>> {
    let mut chart = ChartBuilder::on(panel)
        .caption(caption, ("sans-serif", 13))
        .margin(5)
        .margin_right(9)
        .x_label_area_size(20)
        .y_label_area_size(if is_first { 46 } else { 8 })
        .build_cartesian_2d(motion, heights(range_m))?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .light_line_style(WHITE)
        .bold_line_style(FRAME.mix(0.5))
        .x_labels(3)
        .y_labels(5)
        .x_label_formatter(label)
        .y_label_formatter(&|z_m| if is_first { format!("{} m", fixed(*z_m, 0)) } else { String::new() })
        .axis_style(FRAME)
        .label_style(("sans-serif", 12))
        .draw()?;
    Ok(chart)
}

fn draw(
    panel: &Area<'_>,
    is_first: bool,
    pair: &PairReport,
    lines: &Lines,
    range_m: [f64; 2],
    model: RGBColor,
) -> DrawResult {
    let mac = pair.mac.map_or_else(String::new, |mac| format!(", MAC {}", mac_words(mac, 4)));
    let caption = format!("{}: {} %{mac}", pair.measured, signed(pair.frequency_error_percent, 1));
    let edge = lines.edge;
    let label = |motion: &f64| fixed(*motion, axis_digits(2.0 * edge).min(1));
    let mut chart = over_height(panel, is_first, &caption, -edge..edge, range_m, &label)?;
    let [base_m, top_m] = range_m;
    let plane = Plane::of(&chart, -edge..edge, heights(range_m), false);
    plane.curve([(0.0, base_m), (0.0, top_m)], Dashes::Full, FRAME.stroke_width(1))?;
    if let Some((above_m, factor)) = lines.reduced {
        let ends = [(-edge, above_m), (edge, above_m)];
        plane.curve(ends, Dashes::Dots, INK.mix(0.6).stroke_width(1))?;
        let words = Text::new(format!("÷ {factor:.0}"), (3, -14), ("sans-serif", 12));
        chart.draw_series(std::iter::once(EmptyElement::at((-edge, above_m)) + words))?;
    }
    for (index, (line, dots)) in lines.of_directions.iter().enumerate() {
        let (dashes, mark) = of_direction(index);
        // Where the scale changes, the curve begins anew.
        let above_m = lines.reduced.map_or(f64::INFINITY, |(above_m, _)| above_m);
        for part in line.chunk_by(|a, b| (a.1 > above_m) == (b.1 > above_m)) {
            let factor = lines.reduced.filter(|_| part[0].1 > above_m).map_or(1.0, |(_, factor)| factor);
            let points = part.iter().map(|&(motion, z_m)| (motion / factor, z_m));
            plane.curve(points, dashes, model.stroke_width(1))?;
        }
        for dot in dots {
            let off = [(dot.curve, dot.z_m), (dot.model, dot.z_m)];
            plane.curve(off, Dashes::Fine, model.stroke_width(1))?;
            if let Some(std) = dot.std {
                let ends = [dot.measured - 2.0 * std, dot.measured + 2.0 * std];
                let bar = ends.map(|end| (end.clamp(-edge, edge), dot.z_m));
                plane.curve(bar, Dashes::Full, MEASURED.stroke_width(1))?;
            }
            plane.mark((dot.measured, dot.z_m), mark, 2, MEASURED.filled())?;
            plane.mark((dot.model, dot.z_m), mark, 4, model.stroke_width(1))?;
        }
    }
    Ok(())
}

/// The shapes' misfit by height.
fn draw_misfit(panel: &Area<'_>, is_first: bool, levels: &[HeightMisfit], range_m: [f64; 2]) -> DrawResult {
    let largest = levels.iter().map(|level| level.misfit).fold(f64::MIN_POSITIVE, f64::max);
    let label = |misfit: &f64| fixed(*misfit, axis_digits(largest));
    let mut chart = over_height(panel, is_first, "misfit by height", 0.0..1.1 * largest, range_m, &label)?;
    for level in levels {
        let bar = [(0.0, level.elevation_m), (level.misfit, level.elevation_m)];
        chart.draw_series(LineSeries::new(bar, MISFIT.stroke_width(5)))?;
    }
    Ok(())
}

impl Curve {
    /// Value at a height, between the curve's points.
    fn at(&self, z_m: f64, mode: usize) -> f64 {
        let above = self.heights_m.partition_point(|&height| height < z_m).clamp(1, self.heights_m.len() - 1);
        let (low, high) = (self.heights_m[above - 1], self.heights_m[above]);
        let share = ((z_m - low) / (high - low)).clamp(0.0, 1.0);
        self.values[(above - 1, mode)] * (1.0 - share) + self.values[(above, mode)] * share
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use nalgebra::DVector;

    use super::*;
    use crate::compare::compare;
    use crate::model::{BeamTable, Structure};
    use crate::study::{Study, template};

    struct Tower {
        assembly: Assembly,
        view: ModelView,
        sensors: Vec<Sensor>,
    }

    /// The Canton Tower: 20 sensors at 8 heights, at two of them in pairs that stand apart in plan; a mast of 164 m above.
    fn tower() -> Tower {
        let beam = BeamTable::from_reader(template::CANTON_BEAM.as_bytes(), Path::new("beam.csv")).unwrap();
        let sensors = Study::from_text(template::CANTON_STUDY, Path::new("canton")).unwrap().sensors();
        let assembly = Structure::new(beam).assemble();
        let view = ModelView::of(&assembly, &sensors).unwrap();
        Tower { assembly, view, sensors }
    }

    /// The model's own modes as measured ones.
    fn measured(view: &ModelView, modes: std::ops::Range<usize>) -> Vec<MeasuredMode> {
        let one = |mode: usize| {
            let shape = DVector::from_column_slice(view.shape(mode));
            let values = &shape / shape.amax();
            MeasuredMode {
                covariance_factor: None,
                number: mode + 1,
                frequency_hz: view.modes.frequency_hz[mode],
                frequency_std_hz: None,
                stated: None,
                damping_ratio: None,
                damping_ratio_std: None,
                shape: Some(MeasuredShape {
                    imaginary: None,
                    sensors: (0..values.len()).collect(),
                    stds: None,
                    values,
                }),
            }
        };
        modes.map(one).collect()
    }

    /// Of a model that is right every circle stands around its dot, also off the axis in torsion, and nothing crosses an edge.
    #[test]
    fn a_right_model_is_at_the_sensors_and_inside_the_panel() {
        let Tower { assembly, view, sensors } = tower();
        let measured = measured(&view, 0..12);
        let comparison = compare(&view, &measured, &sensors, None);
        let verticals = verticals(&sensors);
        let range_m = [assembly.z_base_m(), *assembly.node_elevations_m().last().unwrap()];
        let curves = curves(&assembly, &view, &sensors, &verticals, range_m).unwrap();
        let scene = Scene { sensors: &sensors, verticals: &verticals, curves: &curves };
        let (mut off_the_curve, mut reduced) = (0, 0);
        for (pair, mode) in comparison.pairs.iter().zip(&measured) {
            let lines = scene.lines(pair, mode.shape.as_ref().unwrap(), view.shape(pair.model - 1));
            for (line, dots) in &lines.of_directions {
                for dot in dots {
                    assert!((dot.measured - dot.model).abs() < 1e-9, "mode {}: {}", pair.measured, dot.z_m);
                    off_the_curve += usize::from((dot.curve - dot.model).abs() > 0.1);
                }
                for &(motion, z_m) in line {
                    let factor = lines.reduced.filter(|(above_m, _)| z_m > *above_m).map_or(1.0, |(_, factor)| factor);
                    assert!((motion / factor).abs() < lines.edge, "mode {}: {motion} at {z_m} m", pair.measured);
                }
            }
            // The sensors are never drawn small because of a mast that swings.
            assert!(lines.edge < 1.1 * SAME_SCALE * LONGEST_BAR, "mode {}: {}", pair.measured, lines.edge);
            reduced += usize::from(lines.reduced.is_some());
        }
        assert!(off_the_curve >= 2 && reduced >= 1, "{off_the_curve} in torsion, {reduced} with a mast that swings");
    }

    #[test]
    fn every_sensor_has_its_circle_and_a_mac_is_never_rounded_up() {
        let Tower { assembly, view, sensors } = tower();
        let mut measured = measured(&view, 0..3);
        // A MAC of about 0.99997, and a frequency that rounds to nothing.
        let length = measured[1].shape.as_ref().unwrap().values.norm();
        measured[1].shape.as_mut().unwrap().values[0] += 5.5e-3 * length;
        measured[1].frequency_hz *= 1.0 + 1e-6;
        let result = compare(&view, &measured, &sensors, None);
        let mac = result.pairs[1].mac.unwrap();
        assert!((0.99995..1.0).contains(&mac), "{mac}");
        let svg = comparison("Tower", &assembly, &view, &sensors, &measured, &result, false).unwrap().unwrap();
        assert!(svg.contains("2: 0.0 %, MAC 0.9999") && !svg.contains("2: 0.0 %, MAC 1.0000"));
        assert!(!svg.contains("-0.0") && !svg.contains("\u{2212}0.0"));
        // Dots and circles of the first direction, squares of the other; one each in the legend.
        let marks =
            |tag: &str, what: &str| svg.lines().filter(|line| line.starts_with(tag) && line.contains(what)).count();
        let (measured, model) = ("#0068A8", "#B83200");
        assert_eq!(marks("<circle", measured) + marks("<polygon", measured), 3 * 20 + 2);
        let is_closed = |line: &&str| line.matches(',').count() == 5;
        let squares =
            svg.lines().filter(|line| line.starts_with("<polyline") && line.contains(model)).filter(is_closed);
        assert_eq!(marks("<circle", model) + squares.count(), 3 * 20 + 2, "around them");
    }

    #[test]
    fn factors_are_round() {
        assert_eq!([1.0, 1.1, 3.0, 5.1, 48.0].map(round_factor), [1.0, 2.0, 5.0, 10.0, 50.0]);
    }
}
