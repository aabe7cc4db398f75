//! Mode shapes over height, a panel a mode, with standard deviations; beside the truth where it is known.

use std::collections::BTreeMap;

use plotters::prelude::*;

use super::canvas::{
    Area, Dashes, DrawResult, FRAME, INK, MEASURED, PictureError, Plane, fixed, of_direction, picture, sample,
    sample_mark, width_of,
};
use crate::identify::{Identification, Mode};
use crate::study::{Direction, Sensor, Setup};

const MOST_COLUMNS: usize = 7;
const WIDTH: u32 = 966;
const WIDEST_PANEL: u32 = 200;
const PANEL: u32 = 262;
const HEADER: u32 = 84;
/// Motion at a panel's edge; the largest component is 1.
const EDGE: f64 = 1.3;
/// Points that make a curve; two do not.
const CURVE: usize = 3;

/// The true shape that belongs to a measured mode: motion by point name, largest 1.
pub type TrueShape = BTreeMap<String, f64>;

/// A measurement point: one direction at one height.
struct MeasuredPoint<'a> {
    sensor: &'a Sensor,
    elevation_m: f64,
    /// Which of the directions it is.
    direction: usize,
}

/// Draws the shapes of all modes; marks with bars of two standard deviations are measured, lines join the points of one vertical and
/// direction, fine dots those of one height and direction, open marks are the truth (one entry a mode, in the modes' order). `None` where no sensor has a height and a direction that is not upwards.
///
/// # Errors
/// When drawing fails.
pub fn mode_shapes(
    structure: &str,
    setups: &[Setup],
    identification: &Identification,
    truth: &[Option<TrueShape>],
) -> Result<Option<String>, PictureError> {
    let points_by_name = points_by_name(setups);
    let Some(top_m) = points_by_name.values().map(|point| point.elevation_m).max_by(f64::total_cmp) else {
        return Ok(None);
    };
    if identification.modes.is_empty() {
        return Ok(None);
    }
    let bottom_m = points_by_name.values().map(|point| point.elevation_m).fold(0.0, f64::min);
    let count = identification.modes.len();
    let rows = count.div_ceil(MOST_COLUMNS);
    let columns = count.div_ceil(rows);
    let panel_width = (WIDTH / columns as u32).min(WIDEST_PANEL);
    picture("the mode shapes", (WIDTH, HEADER + PANEL * rows as u32), |root| {
        let (header, body) = root.split_vertically(HEADER);
        draw_header(&header, structure, &points_by_name, truth.iter().any(Option::is_some))?;
        let (body, _) = body.split_horizontally(panel_width * columns as u32);
        for (index, (panel, mode)) in body.split_evenly((rows, columns)).iter().zip(&identification.modes).enumerate() {
            let label = format!("{}: {:.3} Hz", mode.number, mode.frequency_hz);
            let is_first = index % columns == 0;
            let mut chart = ChartBuilder::on(panel)
                .caption(label, ("sans-serif", 14))
                .margin(6)
                .x_label_area_size(18)
                .y_label_area_size(if is_first { 40 } else { 6 })
                .build_cartesian_2d(-EDGE..EDGE, bottom_m..top_m * 1.05)?;
            chart
                .configure_mesh()
                .disable_x_mesh()
                .disable_y_mesh()
                .x_labels(3)
                .y_labels(if is_first { 5 } else { 0 })
                .axis_style(FRAME)
                .x_label_formatter(&|motion| fixed(*motion, 0))
                .y_label_formatter(&|m| format!("{} m", fixed(*m, 0)))
                .label_style(("sans-serif", 12))
                .draw()?;
            let plane = Plane::of(&chart, -EDGE..EDGE, bottom_m..top_m * 1.05, false);
            plane.curve([(0.0, bottom_m), (0.0, top_m * 1.05)], Dashes::Full, FRAME.stroke_width(1))?;
            draw_mode(&plane, mode, &points_by_name, truth.get(index).and_then(Option::as_ref))?;
        }
        Ok(())
    })
    .map(Some)
}

fn points_by_name(setups: &[Setup]) -> BTreeMap<&str, MeasuredPoint<'_>> {
    let mut directions: Vec<Direction> = Vec::new();
    let mut points_by_name = BTreeMap::new();
    for sensor in setups.iter().flat_map(|setup| &setup.sensors) {
        let (Some(elevation_m), Some(direction)) = (sensor.elevation_m, sensor.direction) else { continue };
        if !sensor.is_of_a_point() || direction == Direction::Up {
            continue;
        }
        let index = directions.iter().position(|other| *other == direction).unwrap_or_else(|| {
            directions.push(direction);
            directions.len() - 1
        });
        points_by_name.insert(sensor.point.as_str(), MeasuredPoint { sensor, elevation_m, direction: index });
    }
    points_by_name
}

fn draw_header(
    header: &Area<'_>,
    structure: &str,
    points_by_name: &BTreeMap<&str, MeasuredPoint<'_>>,
    truth: bool,
) -> DrawResult {
    let text = |words: &str, x: i32, y: i32, size: i32| Text::new(words.to_owned(), (x, y), ("sans-serif", size));
    header.draw(&text(&format!("{structure}: mode shapes"), 12, 10, 20))?;
    let mut legend: Vec<(String, usize)> = Vec::new();
    for point in points_by_name.values() {
        let label = match point.sensor.direction {
            Some(Direction::AzimuthDeg(azimuth)) => Some(format!("towards {azimuth}°")),
            Some(Direction::Inclined { azimuth_deg, inclination_deg }) => {
                Some(format!("towards {azimuth_deg}°, {inclination_deg}° up"))
            }
            Some(Direction::Up) | None => None,
        };
        if let Some(label) = label.filter(|label| !legend.iter().any(|(other, _)| other == label)) {
            legend.push((label, point.direction));
        }
    }
    let mut x = 14;
    for (label, direction) in &legend {
        let (dashes, mark) = of_direction(*direction);
        sample(header, (x, 45), 26, dashes, MEASURED.stroke_width(1))?;
        sample_mark(header, (x + 13, 45), mark, 3, MEASURED.filled())?;
        header.draw(&text(label, x + 32, 38, 13))?;
        x += 32 + width_of(label, 13) + 20;
    }
    let rest = if truth { "bars: two standard deviations; open: truth" } else { "bars: two standard deviations" };
    header.draw(&text(rest, x, 38, 13))?;
    let words = "Motion over height, without unit: the largest of each mode is 1. Fine dots join sensors of one height and direction: torsion moves them apart.";
    header.draw(&text(words, 14, 58, 13))?;
    Ok(())
}

fn draw_mode(
    plane: &Plane<'_>,
    mode: &Mode,
    points_by_name: &BTreeMap<&str, MeasuredPoint<'_>>,
    truth: Option<&TrueShape>,
) -> DrawResult {
    join(plane, mode, points_by_name)?;
    for component in &mode.shape {
        let Some(point) = points_by_name.get(component.point.as_str()) else { continue };
        let (x, y) = (component.re, point.elevation_m);
        if component.std.is_finite() {
            let bar = [((x - 2.0 * component.std).max(-EDGE), y), ((x + 2.0 * component.std).min(EDGE), y)];
            plane.curve(bar, Dashes::Full, MEASURED.stroke_width(1))?;
        }
        let (_, mark) = of_direction(point.direction);
        plane.mark((x, y), mark, 2, MEASURED.filled())?;
        if let Some(&true_x) = truth.and_then(|truth| truth.get(&component.point)) {
            plane.mark((true_x, y), mark, 4, INK.stroke_width(1))?;
        }
    }
    Ok(())
}

/// Points of one direction at one height.
struct Level {
    elevation_m: f64,
    motions: Vec<f64>,
}

/// Joins the points: a line for each vertical, the points of one direction and plan position; fine dots from one to the other where several of
/// a direction stand at one height.
fn join(plane: &Plane<'_>, mode: &Mode, points_by_name: &BTreeMap<&str, MeasuredPoint<'_>>) -> DrawResult {
    let mut verticals: BTreeMap<String, Vec<(&MeasuredPoint<'_>, f64)>> = BTreeMap::new();
    for component in &mode.shape {
        let Some(point) = points_by_name.get(component.point.as_str()) else { continue };
        let key = format!("{:?} {:?}", point.sensor.direction, point.sensor.offset_m);
        verticals.entry(key).or_default().push((point, component.re));
    }
    let mut levels: BTreeMap<String, Level> = BTreeMap::new();
    for mut points in verticals.into_values() {
        points.sort_by(|(a, _), (b, _)| a.elevation_m.total_cmp(&b.elevation_m));
        for &(&MeasuredPoint { sensor, elevation_m, .. }, motion) in &points {
            let key = format!("{:?} {elevation_m:.2}", sensor.direction);
            let new = Level { elevation_m, motions: Vec::new() };
            levels.entry(key).or_insert(new).motions.push(motion);
        }
        if let (true, Some((first, _))) = (points.len() >= CURVE, points.first()) {
            let line = points.iter().map(|(point, motion)| (*motion, point.elevation_m));
            plane.curve(line, of_direction(first.direction).0, MEASURED.mix(0.6).stroke_width(1))?;
        }
    }
    for Level { elevation_m, mut motions } in levels.into_values() {
        motions.sort_by(f64::total_cmp);
        if let [least, .., most] = motions[..] {
            let ends = [(least, elevation_m), (most, elevation_m)];
            plane.curve(ends, Dashes::Fine, MEASURED.mix(0.7).stroke_width(1))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::ShapeComponent;
    use crate::identify::accuracy::tests::found;
    use crate::study::{Study, template};

    /// Lengths of the dotted lines of the tower's mode, drawn with this motion at the sensors that have one; pixels.
    fn joints(motion: impl Fn(&Sensor) -> Option<f64>) -> Vec<f64> {
        let study = Study::from_text(template::CANTON_STUDY, std::path::Path::new("canton")).unwrap();
        let component = |sensor: &Sensor| {
            let (channel, point) = (sensor.channel.clone(), sensor.point.clone());
            Some(ShapeComponent { channel, point, re: motion(sensor)?, im: 0.0, std: f64::NAN })
        };
        let mut identification = found();
        identification.modes[0].shape = study.sensors().iter().filter_map(component).collect();
        let svg = mode_shapes("Tower", &study.setups, &identification, &[]).unwrap().unwrap();
        let length = |line: &str| {
            let mut points = line.split("points=\"").nth(1).unwrap().split([',', ' ', '"']);
            let from: f64 = points.next().unwrap().parse().unwrap();
            (points.nth(1).unwrap().parse::<f64>().unwrap() - from).abs()
        };
        svg.lines()
            .filter(|line| line.starts_with("<polyline") && line.contains("opacity=\"0.7\""))
            .map(length)
            .collect()
    }

    /// Sensors of one direction move together in bending, apart in torsion by the arms of their offsets, and dotted lines show it.
    #[test]
    fn torsion_joins_sensors_of_one_height() {
        let bending = joints(|sensor| sensor.elevation_m.map(|z_m| z_m / 450.0));
        let torsion = joints(|sensor| {
            let [along_x, along_y, _] = sensor.direction?.cosines();
            Some((sensor.offset_m[0] * along_y - sensor.offset_m[1] * along_x) / 7.0)
        });
        assert!(bending.iter().all(|length| *length < 1.0), "{bending:?}: four pairs stand on each other");
        assert_eq!(
            torsion.iter().filter(|length| **length > 20.0).count(),
            2,
            "{torsion:?}: two of the pairs are apart"
        );
    }

    /// Dots mean sensors of one height and direction, so one of them alone has none.
    #[test]
    fn a_point_alone_is_joined_to_nothing() {
        let one = |channel: &'static str| joints(move |sensor| (sensor.channel == channel).then_some(1.0));
        assert!(one("08").is_empty(), "{:?}", one("08"));
        let study = Study::from_text(template::CANTON_STUDY, std::path::Path::new("canton")).unwrap();
        let sensors = study.sensors();
        let pair = sensors.iter().find_map(|one| {
            let is_beside = |other: &&Sensor| {
                one.channel != other.channel && one.elevation_m == other.elevation_m && one.direction == other.direction
            };
            sensors.iter().find(is_beside).map(|other| (one.channel.clone(), other.channel.clone()))
        });
        let (left, right) = pair.unwrap();
        let apart = joints(|sensor| {
            let is_left = sensor.channel == left;
            (is_left || sensor.channel == right).then_some(if is_left { -0.5 } else { 0.5 })
        });
        assert!(apart.len() == 1 && apart[0] > 20.0, "{apart:?}");
    }
}
