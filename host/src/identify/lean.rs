//! Inclinometers that are mounted the other way about than study.toml says.
//!
//! Modes and the setups' sensors flow in; a sentence for each suspicion flows out. A structure leans towards where it moves further with
//! height, so what an inclinometer reads has the sign of the slope that the other sensors of its direction show at its height. A reversed
//! one has the other sign in all modes. Nothing is asked of its size.

use super::result::Mode;
use super::setup::{MeasuredSetup, each_once, of_setup};
use super::ssi::component_of;
use crate::study::{Motion, Sensor, Setup, Unit};

/// Modes that are looked at: of the others the slope between sensors is not that at the inclinometer.
const MOST_MODES: usize = 3;
/// Directions within so many degrees are one.
const SAME_DIRECTION_DEG: f64 = 10.0;
/// A mode moves in a direction where the largest component there is this share of the largest of all.
const MOVES: f64 = 0.3;
/// A tilt counts where it is known within this share of itself...
const KNOWN: f64 = 0.3;
/// ...and is so many times the slope, at least and at most: what is far off is another fault.
const PLAUSIBLE: [f64; 2] = [0.2, 5.0];
/// Sensors closer than this, in m, stand at one height.
const SAME_HEIGHT_M: f64 = 0.01;

/// Says which inclinometers the modes contradict.
pub(crate) fn lean_suspicions(modes: &[Mode], measured: &[MeasuredSetup<'_>]) -> Vec<String> {
    suspicions(modes, &measured.iter().map(|m| m.setup).collect::<Vec<_>>())
}

fn suspicions(modes: &[Mode], setups: &[&Setup]) -> Vec<String> {
    let tilts = setups
        .iter()
        .flat_map(|setup| setup.sensors.iter().filter(|sensor| is_tilt(sensor)).map(|sensor| (*setup, sensor)));
    let sentence = |(setup, sensor): (&Setup, &Sensor)| {
        let reversed = reversed_in(modes, setups, &setup.name, sensor);
        let hz: Vec<String> = reversed.iter().map(|hz| format!("{hz:.4}")).collect();
        (!hz.is_empty()).then(|| format!(
                "channel \"{}\"{} seems to be reversed: in {} at {} Hz it leans to one side, and the sensors of its direction show a lean to the other. Turn its azimuth_deg in study.toml by 180 degrees, unless these are reversed",
                sensor.channel,
                of_setup(&setup.name, setups.len() > 1),
                if hz.len() == 1 { "the mode" } else { "the modes" },
                hz.join(", ")
            ))
    };
    each_once(tilts).filter_map(sentence).collect()
}

fn is_tilt(sensor: &Sensor) -> bool {
    sensor.unit.map(Unit::motion) == Some(Motion::Tilt)
}

/// Frequencies in Hz of the modes that contradict an inclinometer's sign; none where one confirms it.
fn reversed_in(modes: &[Mode], setups: &[&Setup], setup: &str, tilt: &Sensor) -> Vec<f64> {
    let Some(z_m) = tilt.elevation_m else { return Vec::new() };
    let mut reversed = Vec::new();
    let mut looked_at = 0;
    for mode in modes {
        let motion = motion_along(mode, setups, tilt);
        let (Some(slope), Some(component)) = (slope(&motion, z_m), component_of(&mode.shape, setup, tilt)) else {
            continue;
        };
        // So many heights show the slopes of one mode less; a single one that of the lowest.
        if looked_at >= (motion.len() - 1).clamp(1, MOST_MODES) {
            break;
        }
        looked_at += 1;
        let ratio = component.re / slope;
        let is_known = component.std < KNOWN * component.re.abs();
        let [least, most] = PLAUSIBLE;
        if !is_known || !(least..most).contains(&ratio.abs()) {
            continue;
        }
        if ratio > 0.0 {
            return Vec::new();
        }
        reversed.push(mode.frequency_hz);
    }
    reversed
}

/// Height in m and component along an inclinometer's direction of the points that move, lowest first, one a height; none where the mode
/// moves in other directions.
fn motion_along(mode: &Mode, setups: &[&Setup], tilt: &Sensor) -> Vec<(f64, f64)> {
    let Some([x, y, _]) = tilt.direction.map(|direction| direction.cosines()) else { return Vec::new() };
    let mut here: Vec<(f64, f64)> = Vec::new();
    let mut largest = 0.0_f64;
    for setup in setups {
        for sensor in setup.sensors.iter().filter(|sensor| sensor.is_of_a_point()) {
            let (Some(z_m), Some(direction)) = (sensor.elevation_m, sensor.direction) else { continue };
            let Some(component) = component_of(&mode.shape, &setup.name, sensor) else { continue };
            largest = largest.max(component.re.abs());
            let [along_x, along_y, _] = direction.cosines();
            let along = x * along_x + y * along_y;
            if along.abs() > SAME_DIRECTION_DEG.to_radians().cos() {
                here.push((z_m, along.signum() * component.re));
            }
        }
    }
    if here.iter().map(|(_, value)| value.abs()).fold(0.0, f64::max) < MOVES * largest {
        return Vec::new();
    }
    here.sort_by(|a, b| a.0.total_cmp(&b.0));
    let one_a_height = |here: &[(f64, f64)]| {
        let count = here.len() as f64;
        (here[0].0, here.iter().map(|(_, value)| value).sum::<f64>() / count)
    };
    here.chunk_by(|a, b| b.0 - a.0 < SAME_HEIGHT_M).map(one_a_height).collect()
}

/// The slope at a height, from the heights beside it; where there is only one, from the ground.
fn slope(motion: &[(f64, f64)], z_m: f64) -> Option<f64> {
    let above = motion.iter().position(|(at_m, _)| *at_m > z_m).unwrap_or(motion.len());
    let upper = above.clamp(1, motion.len().max(2) - 1);
    let (low, high) = match motion {
        [] => return None,
        [only] => ((0.0, 0.0), *only),
        _ => (motion[upper - 1], motion[upper]),
    };
    let slope = (high.1 - low.1) / (high.0 - low.0);
    (slope.is_finite() && slope != 0.0).then_some(slope)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::identify::accuracy::tests::found;
    use crate::identify::result::ShapeComponent;
    use crate::study::Study;

    const HEIGHT_M: f64 = 100.0;

    /// A setup of accelerometers along X at these heights, and of an inclinometer at 80 m towards `azimuth_deg`.
    fn setup(heights_m: &[f64], azimuth_deg: f64) -> Setup {
        // A node a sensor.
        let sensor = |node: usize, name: String, z_m: f64, azimuth_deg: f64, unit: &str| {
            format!(
                "[[setup.sensor]]\nchannel = \"{name}\"\nnode = {node}\nelevation_m = {z_m:.1}\nazimuth_deg = {azimuth_deg:.1}\nunit = \"{unit}\"\n"
            )
        };
        let mut text = "[structure]\nname = \"T\"\n[[setup]]\nname = \"s\"\nfiles = [\"a.csv\"]\nsampling_rate_hz = 50.0\nunit = \"m/s2\"\n".to_owned();
        for (node, z_m) in (2..).zip(heights_m) {
            text += &sensor(node, format!("a{z_m}"), *z_m, 0.0, "m/s2");
        }
        text += &sensor(1, "tilt".to_owned(), 80.0, azimuth_deg, "rad");
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("study.toml"), text).unwrap();
        Study::load(folder.path()).unwrap().setups.remove(0)
    }

    /// What is told of it where the inclinometer really points to +X; modes bend along X as 1 - cos(kz) with `quarters` of a period.
    fn told(setup: &Setup, quarters: &[f64]) -> Vec<String> {
        let mode = |(number, quarters): (usize, &f64)| {
            let k = quarters * PI / 2.0 / HEIGHT_M;
            let value = |sensor: &Sensor| {
                let z_m = sensor.elevation_m.unwrap();
                if is_tilt(sensor) { k * (k * z_m).sin() } else { 1.0 - (k * z_m).cos() }
            };
            let component = |sensor: &Sensor| ShapeComponent {
                channel: sensor.channel.clone(),
                point: sensor.point.clone(),
                re: value(sensor),
                im: 0.0,
                std: 1e-4,
            };
            let shape = setup.sensors.iter().map(component).collect();
            Mode { number: number + 1, frequency_hz: (number + 1) as f64, shape, ..found().modes.remove(0) }
        };
        let modes: Vec<Mode> = quarters.iter().enumerate().map(mode).collect();
        suspicions(&modes, &[setup])
    }

    #[test]
    fn a_tower_leans_towards_where_it_moves_further_with_height() {
        let heights = [20.0, 40.0, 60.0, 80.0, 100.0];
        assert_eq!(told(&setup(&heights, 0.0), &[1.0, 3.0]), Vec::<String>::new());
        let reversed = told(&setup(&heights, 180.0), &[1.0, 3.0]);
        assert!(
            matches!(reversed.as_slice(), [one] if one.contains("channel \"tilt\" seems to be reversed")),
            "{reversed:?}"
        );
        assert!(reversed[0].contains("modes at 1.0000, 2.0000 Hz"), "{reversed:?}");
        assert_eq!(told(&setup(&heights, 90.0), &[1.0, 3.0]), Vec::<String>::new(), "no other sensor of its direction");
    }

    #[test]
    fn one_accelerometer_beside_it_is_enough_for_the_lowest_mode() {
        assert_eq!(told(&setup(&[80.0], 0.0), &[1.0, 3.0]), Vec::<String>::new());
        let reversed = told(&setup(&[80.0], 180.0), &[1.0, 3.0]);
        assert!(matches!(reversed.as_slice(), [one] if one.contains("in the mode at 1.0000 Hz")), "{reversed:?}");
    }
}
