//! How large a hidden effect is: drawn so that what it does to the modes of the band stands out of the background.
//!
//! A kind flows in; an effect with its place and size flows out, or none where the structure cannot show it.

use std::f64::consts::PI;

use nalgebra::{DMatrix, DVector};
use rand::{Rng, RngExt};

use super::body::Body;
use super::effect::Effect;
use super::structures::Structure;
use super::visibility::Measured;

/// Largest sine of the angle between a shape before and after, for what moves shapes and not frequencies.
const TURN: [f64; 2] = [0.1, 0.4];
/// A mode below this share of every channel's squared motion is not seen.
const SEEN: f64 = 2e-3;
const MODES: usize = 24;
/// Modes beyond the band that may pair with its last ones, and how near frequencies of a pair are, as a share.
const SPARE: usize = 4;
const NEAR: f64 = 0.3;
const LEAST_P_DELTA: f64 = 0.015;

/// Undamped modes of the band as the sensors see them.
#[derive(Debug, Clone)]
pub(super) struct Band {
    pub(super) frequencies_hz: Vec<f64>,
    shapes: DMatrix<f64>,
    seen: Vec<bool>,
}

impl Band {
    /// `None` where the structure buckles. `width` counts modes; without it, those below the band's end do.
    pub(super) fn of(body: &Body, structure: &Structure, width: Option<usize>) -> Option<Self> {
        let modes = body.modes(MODES)?;
        let below = modes.frequencies_hz.iter().filter(|&&f| f < structure.band_hz[1]).count();
        let width = width.unwrap_or(below).min(modes.frequencies_hz.len());
        let shapes = body.at_sensors(&modes.shapes).columns(0, width).into_owned();
        let seen = (0..width).map(|mode| {
            let share = |channel: usize| shapes[(channel, mode)].powi(2) / shapes.row(channel).norm_squared();
            (0..shapes.nrows()).map(share).fold(0.0, f64::max) > SEEN
        });
        Some(Self { frequencies_hz: modes.frequencies_hz[..width].to_vec(), seen: seen.collect(), shapes })
    }

    /// Largest relative change of a frequency among modes that are seen, in order.
    pub(super) fn shift(&self, other: &Self) -> f64 {
        let pairs = self.frequencies_hz.iter().zip(&other.frequencies_hz).zip(&self.seen);
        pairs.filter(|(_, seen)| **seen).map(|((f, g), _)| (g / f - 1.0).abs()).fold(0.0, f64::max)
    }

    /// Mean relative difference of frequencies in percent, in order.
    pub(super) fn mean_error_percent(&self, other: &Self) -> f64 {
        let pairs = self.frequencies_hz.iter().zip(&other.frequencies_hz);
        let (sum, count) = pairs.fold((0.0, 0), |(sum, count), (f, g)| (sum + 100.0 * (g / f - 1.0).abs(), count + 1));
        sum / f64::from(count.max(1))
    }

    /// What another body of the structure changes in modes that are seen: logarithms of frequencies, each with its shape of length 1, paired by
    /// resemblance. `None` where it buckles.
    pub(super) fn change_to(&self, body: &Body, structure: &Structure) -> Option<DVector<f64>> {
        let other = Self::of(body, structure, Some(self.frequencies_hz.len() + SPARE))?;
        let [mine, others] = [&self.shapes, &other.shapes].map(|shapes| {
            let lengths = shapes.column_iter().map(|shape| shape.normalize());
            lengths.collect::<Vec<DVector<f64>>>()
        });
        let mut free: Vec<usize> = (0..others.len()).collect();
        let mut changes = Vec::new();
        for mode in self.modes_seen() {
            let likeness = |at: &usize| {
                let apart = (other.frequencies_hz[free[*at]] / self.frequencies_hz[mode]).ln() / NEAR;
                mine[mode].dot(&others[free[*at]]).powi(2) * (-apart * apart).exp()
            };
            let nearest = (0..free.len()).max_by(|a, b| likeness(a).total_cmp(&likeness(b)))?;
            let pair = free.remove(nearest);
            changes.push((other.frequencies_hz[pair] / self.frequencies_hz[mode]).ln());
            let sign = mine[mode].dot(&others[pair]).signum();
            changes.extend((sign * &others[pair] - &mine[mode]).iter());
        }
        Some(DVector::from_vec(changes))
    }

    /// Variances of the numbers of [`Band::change_to`] by measurement.
    pub(super) fn variances(&self, measured: Measured) -> DVector<f64> {
        let of_mode = std::iter::once(measured.frequency).chain(vec![measured.shape; self.shapes.nrows()]);
        let all = self.modes_seen().flat_map(|_| of_mode.clone());
        DVector::from_iterator(self.modes_seen().count() * (1 + self.shapes.nrows()), all.map(|std| std * std))
    }

    fn modes_seen(&self) -> impl Iterator<Item = usize> {
        (0..self.seen.len()).filter(|&mode| self.seen[mode])
    }

    /// Largest sine of the angle between shapes of modes that are seen, in order.
    pub(super) fn turn(&self, other: &Self) -> f64 {
        let sine = |mode: usize| {
            let (a, b) = (self.shapes.column(mode), other.shapes.column(mode));
            (1.0 - (a.dot(&b)).powi(2) / (a.norm_squared() * b.norm_squared())).max(0.0).sqrt()
        };
        let modes = 0..self.seen.len().min(other.seen.len());
        modes.filter(|&mode| self.seen[mode]).map(sine).fold(0.0, f64::max)
    }
}

/// A number between two, evenly in its logarithm.
pub(super) fn log_uniform(random: &mut impl Rng, [low, high]: [f64; 2]) -> f64 {
    (random.random_range(low.ln()..high.ln())).exp()
}

/// Between which bounds an effect is to be felt.
#[derive(Debug, Clone, Copy)]
pub(super) enum Reach {
    /// Largest relative shift of a frequency.
    Shift([f64; 2]),
    /// Largest sine of the angle between a shape before and after.
    Turn([f64; 2]),
}

/// What an effect, of a size between bounds, is to do.
pub(super) struct Wanted<'a> {
    pub(super) bounds: [f64; 2],
    pub(super) change: &'a dyn Fn(&mut Body, f64),
    /// How far.
    pub(super) by: Reach,
}

/// The size with which a change does what `wanted` asks for, on a log scale between its bounds; `None` where no size does.
pub(super) fn sized(sound: &Body, structure: &Structure, wanted: &Wanted<'_>, random: &mut impl Rng) -> Option<f64> {
    let before = Band::of(sound, structure, None)?;
    let (Reach::Shift(range) | Reach::Turn(range)) = wanted.by;
    let done = |size: f64| {
        let mut body = sound.clone();
        (wanted.change)(&mut body, size);
        let after = Band::of(&body, structure, Some(before.frequencies_hz.len()));
        after.map_or(f64::INFINITY, |after| match wanted.by {
            Reach::Shift(_) => before.shift(&after),
            Reach::Turn(_) => before.turn(&after),
        })
    };
    let [mut low, mut high] = wanted.bounds;
    let (least, most) = (done(low), done(high));
    if most < range[0] || least > range[1] {
        return None;
    }
    let target = log_uniform(random, [range[0].max(least), range[1].min(most) * (1.0 + 1e-9)]);
    for _ in 0..12 {
        let middle = (low * high).sqrt();
        if done(middle) < target { low = middle } else { high = middle }
    }
    let size = (low * high).sqrt();
    // Where modes trade places, the change is not monotone.
    (0.8 * range[0]..1.2 * range[1]).contains(&done(size)).then_some(size)
}

/// An effect of a kind on a structure, which moves a frequency by a share between bounds; `None` where this draw cannot be seen.
pub(super) fn draw(
    kind: &str,
    sound: &Body,
    structure: &Structure,
    shift: [f64; 2],
    random: &mut impl Rng,
) -> Option<Effect> {
    let before = Band::of(sound, structure, None)?;
    let (height, base) = (structure.height_m(), structure.base_m());
    let (first, last) = (sound.elements.first()?, sound.elements.last()?);
    let z_m = base + height * random.random_range(0.1..0.95);
    let here = &sound.elements[sound.element_at(z_m)];
    let mass = sound.total_mass_kg();
    let sign = if random.random_bool(0.5) { 1.0 } else { -1.0 };
    let ratio = if random.random_bool(1.0 / 3.0) { log_uniform(random, [0.3, 3.0]) } else { 1.0 };
    let joint = height / (0.5 * (here.bending_n_m2[0] + here.bending_n_m2[1]));
    let stiff = mass * (2.0 * PI * before.frequencies_hz[0]).powi(2);
    let at = structure.segment_at(z_m).max(2);
    let segments = [at, (at + random.random_range(0..3)).min(structure.segments.len() - 1)];
    let middle_m = 0.5 * (structure.segments[segments[0]].z_bottom_m + structure.segments[segments[1]].z_top_m);
    let (sin, cos) = random.random_range(0.0..2.0 * PI).sin_cos();
    let gyration = (structure.segments[0].inertia_kg_m2[2] / structure.segments[0].mass_top_kg).sqrt();
    let (bounds, make): ([f64; 2], Box<dyn Fn(f64) -> Effect>) = match kind {
        "stiffness-scale" => ([0.03, 0.4], Box::new(move |v| Effect::StiffnessScale(sign * v))),
        "mass-scale" => ([0.03, 0.4], Box::new(move |v| Effect::MassScale(sign * v))),
        "base-rotation" => {
            let unit = height / first.bending_n_m2[0];
            ([1e-4 * unit, 1e2 * unit], Box::new(move |v| Effect::BaseRotation([v, v * ratio])))
        }
        "base-translation" => ([1e-5 / stiff, 1.0 / stiff], Box::new(move |v| Effect::BaseTranslation([v, v * ratio]))),
        "shear-flexibility" => ([0.03, 20.0], Box::new(Effect::ShearFlexibility)),
        "rotary-inertia" => ([0.2, 5.0], Box::new(Effect::RotaryInertia)),
        "added-mass" => ([1e-4 * mass, 0.3 * mass], Box::new(move |mass_kg| Effect::AddedMass { z_m, mass_kg })),
        "stiffness-loss" => {
            ([0.2, 0.7], Box::new(move |relative| Effect::StiffnessLoss { z_m: middle_m, segments, relative }))
        }
        "connection-flexibility" => {
            ([1e-4 * joint, 1e2 * joint], Box::new(move |flexibility| Effect::Connection { z_m, flexibility }))
        }
        "outrigger" => ([1e-3 / joint, 1e3 / joint], Box::new(move |stiffness| Effect::Outrigger { z_m, stiffness })),
        "lateral-support" => {
            ([1e-4 * stiff, 1e3 * stiff], Box::new(move |v| Effect::LateralSupport { z_m, stiffness: [v, v * ratio] }))
        }
        "soil-springs" => {
            let soft = stiff / height;
            let z_m = base + height * random.random_range(0.05..0.3);
            ([1e-4 * soft, 1e4 * soft], Box::new(move |v| Effect::SoilSprings { z_m, stiffness: [v, v * ratio] }))
        }
        "mass-eccentricity" => {
            ([0.01 * gyration, 0.5 * gyration], Box::new(move |v| Effect::MassEccentricity([v * cos, v * sin])))
        }
        "p-delta" => return whole_weight(&before, sound, structure),
        "tuned-mass-damper" => {
            let mode = random.random_range(0..2);
            return Some(Effect::TunedMassDamper {
                z_m: main_top(structure, last.segment) - height * random.random_range(0.0..0.08),
                mass_kg: mass * random.random_range(0.01..0.02),
                frequency_hz: before.frequencies_hz[mode] * random.random_range(0.92..1.03),
                damping_ratio: random.random_range(0.03..0.08),
            });
        }
        _ => return turned_or_heard(kind, &before, sound, structure, random),
    };
    let by = if kind == "mass-eccentricity" { Reach::Turn(TURN) } else { Reach::Shift(shift) };
    let change = |body: &mut Body, size: f64| make(size).apply(body, structure);
    sized(sound, structure, &Wanted { bounds, change: &change, by }, random).map(make)
}

/// The top of what carries nearly all mass: dampers do not hang in a mast.
fn main_top(structure: &Structure, last: usize) -> f64 {
    let heaviest = structure.segments.iter().map(|segment| segment.mass_top_kg).fold(0.0, f64::max);
    let main = structure.segments.iter().rev().find(|segment| segment.mass_top_kg > 0.05 * heaviest);
    main.unwrap_or(&structure.segments[last]).z_top_m
}

/// The weight above, where it can be seen.
fn whole_weight(before: &Band, sound: &Body, structure: &Structure) -> Option<Effect> {
    let mut body = sound.clone();
    Effect::PDelta.apply(&mut body, structure);
    let after = Band::of(&body, structure, Some(before.frequencies_hz.len()))?;
    let lower = 1.0 - after.frequencies_hz[0] / before.frequencies_hz[0];
    (lower >= LEAST_P_DELTA).then_some(Effect::PDelta)
}

/// What is drawn directly: turned axes, sensors, clocks, tones, weather.
fn turned_or_heard(
    kind: &str,
    before: &Band,
    sound: &Body,
    structure: &Structure,
    random: &mut impl Rng,
) -> Option<Effect> {
    let channels = structure.channels.len();
    let channel = random.random_range(0..channels);
    let node = structure.channels[channel].node;
    let sign = if random.random_bool(0.5) { 1.0 } else { -1.0 };
    let [low_hz, high_hz] = structure.band_hz;
    let effect = match kind {
        "axis-rotation" => Effect::AxisRotation(sign * log_uniform(random, [4.0, 15.0])),
        "sensor-gain" => {
            let wrong = |factor: &f64| !(0.9..1.1).contains(factor);
            let factor = std::iter::repeat_with(|| random.random_range(0.6..1.6)).find(wrong)?;
            Effect::SensorGain { channel, factor }
        }
        "sensor-polarity" => Effect::SensorPolarity(channel),
        "sensor-swap" => {
            let other = (channel + random.random_range(1..channels)) % channels;
            Effect::SensorSwap([channel.min(other), channel.max(other)])
        }
        "sensor-rotation" => Effect::SensorRotation {
            node: random.random_bool(0.7).then_some(node),
            angle_deg: sign * log_uniform(random, [8.0, 30.0]),
        },
        "clock-offset" => {
            let phase_deg = random.random_range(5.0..40.0);
            return Some(Effect::ClockOffset { node, delay_s: sign * phase_deg / 180.0 / (low_hz + high_hz) });
        }
        "harmonic" => {
            let frequency_hz = log_uniform(random, [1.5 * low_hz, 0.95 * high_hz]);
            let apart = before.frequencies_hz.iter().map(|f| (f / frequency_hz - 1.0).abs()).fold(1.0, f64::min);
            return (apart > 0.05).then_some(Effect::Harmonic(frequency_hz));
        }
        "temperature-stiffness" => {
            return Some(Effect::TemperatureStiffness(-log_uniform(random, [4e-4, 1.5e-3])));
        }
        _ => return None,
    };
    let mut body = sound.clone();
    effect.apply(&mut body, structure);
    let after = Band::of(&body, structure, Some(before.frequencies_hz.len()))?;
    (before.turn(&after) > TURN[0]).then_some(effect)
}
