//! Channels that the shapes themselves contradict: reversed, exchanged, or in another unit.
//!
//! Modes and the setups' sensors flow in; a sentence for each suspicion flows out. The lowest modes of a tall structure are smooth over
//! the height, so a channel that is wrong makes them rough, and what mends it makes them smooth again. No model is needed.

use super::result::Mode;
use super::setup::{MeasuredSetup, of_setup};
use super::ssi::component_of;
use crate::study::{Sensor, Setup};

/// Modes that are looked at: higher ones are not smooth from one sensor to the next.
const LOWEST_MODES: usize = 4;
/// A mode counts where its components are known within this share of its largest.
const KNOWN: f64 = 0.1;
/// Sensors of one direction, within so many degrees, at so many heights at least show whether a shape is smooth.
const SAME_DIRECTION_DEG: f64 = 10.0;
const LEAST_HEIGHTS: usize = 4;
/// Sensors closer than this share of the height of all stand at one height.
const SAME_HEIGHT: f64 = 0.01;
/// There must be so much roughness, in squares of a shape of unit length; what mends the channels must leave no more than this share
/// of it, and each step no more than this share of what was left.
const ROUGH: f64 = 0.05;
const LEFT: f64 = 0.25;
const STEP: f64 = 0.6;
/// The channel must then move as its neighbours do: within this share of what lies between them, in root mean square...
const AS_EXPECTED: f64 = 0.35;
/// ...where that is at least this much of a shape of unit length.
const EXPECTED: f64 = 0.1;
/// Exchanged channels are looked for among so many at most.
const MOST_PAIRED: usize = 64;
/// More faults than this are no slips of single channels.
const MOST: usize = 3;
/// A channel that reads so many times too much or too little has another unit or an amplifier's wrong step; less is a gain that belongs to
/// the model's comparison.
const SLIP: f64 = 5.0;
/// Ratios of units that are mixed up, and within which factor (ln) the others' shapes show them.
const UNITS: [f64; 4] = [9.806_65, 1.0 / 9.806_65, 1000.0, 0.001];
const UNIT_NEAR: f64 = 0.25;

/// What may be wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    Reversed(usize),
    /// What it reads must be taken so many times.
    Unit(usize, f64),
    Exchanged(usize, usize),
}

/// A channel with a place: its names, and its components in the modes.
struct Channel<'a> {
    setup: &'a str,
    sensor: &'a Sensor,
    values: Vec<f64>,
}

/// Channels of one direction (1, or -1 for those that count the other way), lowest first.
struct Line {
    channels: Vec<(usize, f64, f64)>,
}

/// A suspicion.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Suspicion {
    /// What seems to be wrong: `reversed`, `unit` or `exchanged`.
    pub(crate) kind: &'static str,
    /// The setup.
    pub(crate) setup: String,
    /// The channels.
    pub(crate) channels: Vec<String>,
    /// A sentence.
    pub(crate) words: String,
}

/// Says which channels the modes contradict.
pub(crate) fn suspicions(modes: &[Mode], measured: &[MeasuredSetup<'_>]) -> Vec<Suspicion> {
    let modes: Vec<&Mode> = modes.iter().take(LOWEST_MODES).filter(|mode| is_known(mode)).collect();
    let mut channels: Vec<Channel<'_>> = Vec::new();
    for m in measured {
        for sensor in &m.setup.sensors {
            let values: Option<Vec<f64>> =
                modes.iter().map(|mode| Some(component_of(&mode.shape, &m.setup.name, sensor)?.re)).collect();
            let is_again = sensor.reference && channels.iter().any(|other| other.sensor.point == sensor.point);
            if let Some(values) = values.filter(|_| !is_again) {
                channels.push(Channel { setup: &m.setup.name, sensor, values });
            }
        }
    }
    let found = suspected(&channels, &lines(&channels));
    let of_setup = |at: usize| channels.get(at).map_or_else(String::new, |channel| channel.setup.to_owned());
    let name = |at: &usize| channels.get(*at).map(|channel| channel.sensor.channel.clone());
    let suspicion = |fault: Fault| Suspicion {
        kind: fault.kind(),
        setup: of_setup(fault.channels()[0]),
        channels: fault.channels().iter().filter_map(name).collect(),
        words: sentence(&channels, fault, measured.len() > 1),
    };
    found.into_iter().map(suspicion).collect()
}

/// Whether sensors stand so that shapes can tell anything of their channels: in one direction, at enough heights.
pub(crate) fn can_be_asked(setups: &[Setup]) -> bool {
    let channel = |(setup, sensor)| Channel { setup, sensor, values: Vec::new() };
    let sensors = setups.iter().flat_map(|setup| setup.sensors.iter().map(|sensor| (setup.name.as_str(), sensor)));
    !lines(&sensors.map(channel).collect::<Vec<_>>()).is_empty()
}

/// What is wrong with channels: each fault makes the shapes smoother, and all together leave them smooth.
fn suspected(channels: &[Channel<'_>], lines: &[Line]) -> Vec<Fault> {
    let mut values: Vec<Vec<f64>> = channels.iter().map(|channel| channel.values.clone()).collect();
    let first = roughness(lines, &values);
    let (mut left, mut found) = (first, Vec::new());
    while found.len() < MOST && left > LEFT * ROUGH {
        let mended = |fault: Fault| (roughness(lines, &with(&values, fault)), fault);
        let best = faults(channels, lines, &values).into_iter().map(mended).min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((after, fault)) = best.filter(|(after, _)| *after < STEP * left) else { break };
        values = with(&values, fault);
        left = after;
        found.push(fault);
    }
    let is_smooth = |fault: &Fault| fault.channels().iter().all(|&at| is_as_expected(lines, &values, at));
    if first < ROUGH || left > LEFT * first || !found.iter().all(is_smooth) {
        return Vec::new();
    }
    found
}

impl Fault {
    fn kind(self) -> &'static str {
        match self {
            Self::Reversed(_) => "reversed",
            Self::Unit(..) => "unit",
            Self::Exchanged(..) => "exchanged",
        }
    }

    /// The channels that it is of.
    fn channels(self) -> Vec<usize> {
        match self {
            Self::Reversed(at) | Self::Unit(at, _) => vec![at],
            Self::Exchanged(one, other) => vec![one, other],
        }
    }
}

fn is_known(mode: &Mode) -> bool {
    let largest = mode.shape.iter().map(|part| part.re.hypot(part.im)).fold(0.0, f64::max);
    mode.shape.iter().all(|part| part.std <= KNOWN * largest)
}

/// Horizontal channels by direction, where they stand at enough heights.
fn lines(channels: &[Channel<'_>]) -> Vec<Line> {
    let mut lines: Vec<([f64; 2], Line)> = Vec::new();
    for (at, channel) in channels.iter().enumerate() {
        let (Some(z_m), Some(direction)) = (channel.sensor.elevation_m, channel.sensor.direction) else { continue };
        let [x, y, up] = direction.cosines();
        if !channel.sensor.is_of_a_point() || up.abs() > SAME_DIRECTION_DEG.to_radians().sin() {
            continue;
        }
        let along = |line: &[f64; 2]| line[0] * x + line[1] * y;
        match lines.iter_mut().find(|(line, _)| along(line).abs() > SAME_DIRECTION_DEG.to_radians().cos()) {
            Some((line, members)) => members.channels.push((at, along(line).signum(), z_m)),
            None => lines.push(([x, y], Line { channels: vec![(at, 1.0, z_m)] })),
        }
    }
    let mut lines: Vec<Line> = lines.into_iter().map(|(_, line)| line).collect();
    for line in &mut lines {
        line.channels.sort_by(|a, b| a.2.total_cmp(&b.2));
        let (lowest_m, highest_m) = (line.channels[0].2, line.channels[line.channels.len() - 1].2);
        // A straight line through two that are close would be anything.
        let mut before_m = f64::NEG_INFINITY;
        for (_, _, z_m) in &mut line.channels {
            if *z_m - before_m < SAME_HEIGHT * (highest_m - lowest_m) {
                *z_m = before_m;
            }
            before_m = *z_m;
        }
    }
    lines.retain(|line| {
        let heights = line.channels.iter().map(|(_, _, z_m)| *z_m).collect::<Vec<_>>();
        1 + heights.windows(2).filter(|pair| pair[1] > pair[0]).count() >= LEAST_HEIGHTS
    });
    lines
}

/// What the other channels of a line let expect at one of them, by mode: what lies on a straight line between the next heights, at the
/// ends on that through the next two; where others stand at its height, the mean of that and theirs.
fn expected(line: &Line, values: &[Vec<f64>], place: usize) -> Option<Vec<f64>> {
    let z_m = line.channels[place].2;
    let mean_at = |height_m: f64| {
        let there: Vec<&(usize, f64, f64)> = line
            .channels
            .iter()
            .enumerate()
            .filter(|(other, channel)| *other != place && channel.2 == height_m)
            .map(|(_, channel)| channel)
            .collect();
        let modes = values.first().map_or(0, Vec::len);
        let mean =
            |mode: usize| there.iter().map(|(at, sign, _)| sign * values[*at][mode]).sum::<f64>() / there.len() as f64;
        (!there.is_empty()).then(|| (0..modes).map(mean).collect::<Vec<f64>>())
    };
    let same = mean_at(z_m);
    let mut heights: Vec<f64> = line.channels.iter().map(|(_, _, z_m)| *z_m).collect();
    heights.dedup();
    let below: Vec<f64> = heights.iter().copied().filter(|height| *height < z_m).collect();
    let above: Vec<f64> = heights.iter().copied().filter(|height| *height > z_m).collect();
    let ends = match (below.as_slice(), above.as_slice()) {
        ([.., below], [above, ..]) => Some((*below, *above)),
        ([.., a, b], []) | ([], [a, b, ..]) => Some((*a, *b)),
        _ => None,
    };
    let between = ends.and_then(|(a, b)| {
        let (at_a, at_b) = (mean_at(a)?, mean_at(b)?);
        let share = (z_m - a) / (b - a);
        Some(at_a.iter().zip(&at_b).map(|(a, b)| a + share * (b - a)).collect::<Vec<f64>>())
    });
    match (same, between) {
        // Of two at one height that differ, the heights beside tell which is wrong.
        (Some(same), Some(between)) => Some(same.iter().zip(&between).map(|(a, b)| 0.5 * (a + b)).collect()),
        (same, between) => same.or(between),
    }
}

/// Squared differences of all channels from what is expected, over the squared lengths of the shapes, the mean of the modes.
fn roughness(lines: &[Line], values: &[Vec<f64>]) -> f64 {
    let modes = values.first().map_or(0, Vec::len);
    let mut sums = vec![(0.0, 0.0); modes];
    for line in lines {
        for (place, (at, sign, _)) in line.channels.iter().enumerate() {
            let Some(expected) = expected(line, values, place) else { continue };
            for (mode, sum) in sums.iter_mut().enumerate() {
                let value = sign * values[*at][mode];
                *sum = (sum.0 + (value - expected[mode]).powi(2), sum.1 + value * value);
            }
        }
    }
    sums.iter().filter(|sum| sum.1 > 0.0).map(|(rough, whole)| rough / whole).sum::<f64>() / modes.max(1) as f64
}

/// What a channel reads in each mode and what the others of its line let expect there, both in shares of the mode's length.
fn against_others(lines: &[Line], values: &[Vec<f64>], at: usize) -> Option<Vec<[f64; 2]>> {
    let (line, place) = lines.iter().find_map(|line| {
        let place = line.channels.iter().position(|(channel, ..)| *channel == at)?;
        Some((line, place))
    })?;
    let sign = line.channels[place].1;
    let of_mode = |(mode, expected): (usize, f64)| {
        let whole: f64 = values.iter().map(|channel| channel[mode].powi(2)).sum();
        let length = whole.max(f64::MIN_POSITIVE).sqrt();
        [sign * values[at][mode] / length, expected / length]
    };
    Some(expected(line, values, place)?.into_iter().enumerate().map(of_mode).collect())
}

/// Whether a channel moves as the others of its line let expect, and they let expect something.
fn is_as_expected(lines: &[Line], values: &[Vec<f64>], at: usize) -> bool {
    let Some(pairs) = against_others(lines, values, at) else { return false };
    let off: f64 = pairs.iter().map(|[value, expected]| (value - expected).powi(2)).sum();
    let size: f64 = pairs.iter().map(|[_, expected]| expected.powi(2)).sum();
    off < AS_EXPECTED * AS_EXPECTED * size && size > EXPECTED * EXPECTED * pairs.len() as f64
}

/// How many times too little a channel reads, by least squares over the modes, where that is no small matter.
fn slip(lines: &[Line], values: &[Vec<f64>], at: usize) -> Option<f64> {
    let pairs = against_others(lines, values, at)?;
    let product: f64 = pairs.iter().map(|[value, expected]| value * expected).sum();
    let square: f64 = pairs.iter().map(|[value, _]| value * value).sum();
    let ratio = product / square;
    let unit = UNITS.into_iter().find(|unit| (ratio / unit).ln().abs() < UNIT_NEAR);
    (ratio.is_finite() && ratio > 0.0 && ratio.ln().abs() > SLIP.ln()).then(|| unit.unwrap_or(ratio))
}

fn faults(channels: &[Channel<'_>], lines: &[Line], values: &[Vec<f64>]) -> Vec<Fault> {
    let members: Vec<usize> = lines.iter().flat_map(|line| line.channels.iter().map(|(at, ..)| *at)).collect();
    let of_one = members.iter().flat_map(|&at| {
        std::iter::once(Fault::Reversed(at)).chain(slip(lines, values, at).map(|ratio| Fault::Unit(at, ratio)))
    });
    // Pairs grow as the square of the channels, and each costs as much as all channels.
    let most = if members.len() > MOST_PAIRED { 0 } else { members.len() };
    let pairs = (0..most).flat_map(|one| (one + 1..most).map(move |other| (one, other)));
    let pairs = pairs.map(|(one, other)| (members[one].min(members[other]), members[one].max(members[other])));
    // Cables are exchanged where they are plugged in.
    let exchanged = pairs.filter(|&(one, other)| channels[one].setup == channels[other].setup);
    of_one.chain(exchanged.map(|(one, other)| Fault::Exchanged(one, other))).collect()
}

fn with(values: &[Vec<f64>], fault: Fault) -> Vec<Vec<f64>> {
    let mut values = values.to_vec();
    match fault {
        Fault::Reversed(at) => values[at].iter_mut().for_each(|value| *value = -*value),
        Fault::Unit(at, ratio) => values[at].iter_mut().for_each(|value| *value *= ratio),
        Fault::Exchanged(one, other) => values.swap(one, other),
    }
    values
}

fn sentence(channels: &[Channel<'_>], fault: Fault, has_setups: bool) -> String {
    let name = |at: usize| {
        let channel = &channels[at];
        format!("{}{}", channel.sensor.channel, of_setup(channel.setup, has_setups))
    };
    let (what, effect) = match fault {
        Fault::Reversed(at) => (
            format!("channel {} seems to be reversed", name(at)),
            format!("sensor-polarity@{}", channels[at].sensor.channel),
        ),
        Fault::Unit(at, ratio) => (
            format!("channel {} seems to read {}", name(at), slipped(ratio)),
            format!("sensor-gain@{}", channels[at].sensor.channel),
        ),
        Fault::Exchanged(one, other) => (
            format!("channels {} and {} seem to be exchanged", name(one), name(other)),
            format!("sensor-swap@{}+{}", channels[one].sensor.channel, channels[other].sensor.channel),
        ),
    };
    format!(
        "{what}: only then are the lowest shapes smooth over the height. Check the cable and study.toml; belfry diagnose weighs {effect}"
    )
}

/// How wrong a channel reads, for one whose values must be taken `ratio` times.
fn slipped(ratio: f64) -> String {
    let times = ratio.max(1.0 / ratio);
    let times = if times > 100.0 { format!("{times:.0}") } else { format!("{times:.1}") };
    let how = if ratio > 1.0 { "too little" } else { "too much" };
    let unit = if ratio == UNITS[0] { ", as numbers in g do" } else { "" };
    format!("about {times} times {how}{unit}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::{Direction, Unit};

    fn sensor(elevation_m: f64, direction: Direction, unit: Option<Unit>) -> Sensor {
        Sensor { elevation_m: Some(elevation_m), direction: Some(direction), unit, ..Sensor::new("1", 1) }
    }

    /// Four modes of a cantilever at eight heights, seen along X and Y, damaged by `change`; what is found wrong.
    fn found(change: impl Fn(&mut Vec<Vec<f64>>)) -> Vec<Fault> {
        // Every other pair counts the other way.
        let azimuth_deg = |at: usize| if at.is_multiple_of(2) { 0.0 } else { 90.0 } + 180.0 * (at / 2 % 2) as f64;
        let elevation_m = |at: usize| 10.0 * (at / 2 + 1) as f64 + 0.05 * (at % 2) as f64;
        let sensors: Vec<Sensor> =
            (0..16).map(|at| sensor(elevation_m(at), Direction::AzimuthDeg(azimuth_deg(at)), None)).collect();
        let wave = |mode: usize, z_m: f64| (std::f64::consts::PI * ((mode / 2) as f64 + 0.5) * z_m / 80.0).sin();
        let value = |at: usize, mode: usize| {
            let sign = if (at / 2).is_multiple_of(2) { 1.0 } else { -1.0 };
            let along = if at % 2 == mode % 2 { 1.0 } else { 0.3 };
            sign * along * wave(mode, sensors[at].elevation_m.unwrap())
        };
        let mut values: Vec<Vec<f64>> = (0..16).map(|at| (0..4).map(|mode| value(at, mode)).collect()).collect();
        change(&mut values);
        let channels: Vec<Channel<'_>> =
            sensors.iter().zip(values).map(|(sensor, values)| Channel { setup: "one", sensor, values }).collect();
        let mut found = suspected(&channels, &lines(&channels));
        found.sort_by_key(|fault| fault.channels());
        found
    }

    #[test]
    fn a_reversed_an_exchanged_and_a_misread_channel_are_found_and_a_sound_structure_is_left_alone() {
        assert_eq!(found(|_| ()), []);
        assert_eq!(found(|values| values[9].iter_mut().for_each(|value| *value = -*value)), [Fault::Reversed(9)]);
        assert_eq!(found(|values| values.swap(8, 13)), [Fault::Exchanged(8, 13)]);
        for ratio in UNITS {
            let misread = found(|values| values[10].iter_mut().for_each(|value| *value /= ratio));
            assert_eq!(misread, [Fault::Unit(10, ratio)], "{ratio}");
        }
        // A step of an amplifier.
        for ratio in [100.0, 0.025] {
            let misread = found(|values| values[10].iter_mut().for_each(|value| *value /= ratio));
            assert!(matches!(misread.as_slice(), [Fault::Unit(10, found)] if (found / ratio).ln().abs() < 0.25));
        }
        let both = found(|values| {
            values[6].iter_mut().for_each(|value| *value = -*value);
            values.swap(11, 14);
        });
        assert_eq!(both, [Fault::Reversed(6), Fault::Exchanged(11, 14)]);
        // A gain of its own is no slip of a unit.
        assert_eq!(found(|values| values[10].iter_mut().for_each(|value| *value *= 3.0)), []);
    }

    #[test]
    fn of_two_channels_at_one_height_the_wrong_one_is_named() {
        // Two of one direction at every other height.
        let elevations_m = [10.0, 20.0, 20.0, 30.0, 40.0, 40.0, 50.0, 60.0];
        let sensors = elevations_m.map(|elevation_m| sensor(elevation_m, Direction::AzimuthDeg(0.0), None));
        let wave = |mode: usize, z_m: f64| (std::f64::consts::PI * (mode as f64 + 0.5) * z_m / 60.0).sin();
        for wrong in [4, 5] {
            for (ratio, fault) in [
                (-1.0, Fault::Reversed(wrong)),
                (UNITS[0], Fault::Unit(wrong, UNITS[0])),
                (UNITS[1], Fault::Unit(wrong, UNITS[1])),
            ] {
                let channels: Vec<Channel<'_>> = sensors
                    .iter()
                    .enumerate()
                    .map(|(at, sensor)| {
                        let factor = if at == wrong { 1.0 / ratio } else { 1.0 };
                        let values = (0..2).map(|mode| factor * wave(mode, sensor.elevation_m.unwrap())).collect();
                        Channel { setup: "one", sensor, values }
                    })
                    .collect();
                let found = suspected(&channels, &lines(&channels));
                // With few sensors a wrong gain may pass; its neighbour is never blamed for it.
                let may_pass = ratio > 0.0 && found.is_empty();
                assert!(may_pass || found == [fault], "{wrong} {ratio}: {found:?}");
            }
        }
    }

    #[test]
    fn without_four_heights_of_one_direction_shapes_tell_nothing_of_channels() {
        let at = |elevation_m: f64| sensor(elevation_m, Direction::AzimuthDeg(0.0), None);
        let can = |sensors: Vec<Sensor>| can_be_asked(&[Setup::new("one", 50.0, sensors)]);
        assert!(can([10.0, 20.0, 30.0, 40.0].map(at).to_vec()));
        assert!(!can([10.0, 20.0, 30.0, 30.0].map(at).to_vec()));
        assert!(!can((0..6).map(|number| Sensor::new(number.to_string(), 1)).collect()));
    }

    #[test]
    fn what_is_not_horizontal_motion_is_in_no_line() {
        let up: Vec<Sensor> = (0..6).map(|_| sensor(1.0, Direction::Up, None)).collect();
        let tilt: Vec<Sensor> = (0..6).map(|_| sensor(1.0, Direction::AzimuthDeg(0.0), Some(Unit::Radian))).collect();
        for sensors in [up, tilt, Vec::new()] {
            let channels: Vec<Channel<'_>> =
                sensors.iter().map(|sensor| Channel { setup: "one", sensor, values: vec![1.0] }).collect();
            assert!(lines(&channels).is_empty() && suspected(&channels, &lines(&channels)).is_empty());
        }
    }
}
