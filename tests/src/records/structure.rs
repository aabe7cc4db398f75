//! Structures as lists of modes: frequencies, damping ratios that differ from mode to mode, shapes that need not be orthogonal.

use nalgebra::{DMatrix, DVector};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

/// A structure as its sensors see it.
#[derive(Debug, Clone)]
pub(super) struct Structure {
    /// Natural frequencies in Hz, ascending.
    pub(super) frequencies_hz: Vec<f64>,
    /// Damping ratios.
    pub(super) damping: Vec<f64>,
    /// Shapes, channels x modes, the largest component 1.
    pub(super) shapes: DMatrix<f64>,
    /// Height and azimuth of each channel.
    pub(super) places: Vec<(f64, f64)>,
    /// Where wind acts, lowest first: height in m, and each mode's displacement along X and Y there.
    pub(super) levels: Vec<(f64, [DVector<f64>; 2])>,
}

/// The name of the channel in a column of the recording, counted from 0.
pub(super) fn channel_name(column: usize) -> String {
    format!("{:02}", column + 1)
}

/// Frequency in Hz, damping ratio and shape.
type Mode = (f64, f64, DVector<f64>);

/// Levels at which wind acts.
const LEVELS: usize = 12;

/// Azimuths of the two channels of a level.
const AZIMUTHS_DEG: [f64; 2] = [0.0, 90.0];

impl Structure {
    /// A cantilever that bends along two axes turned from the sensors' by some degrees, with `channels` at equal distances
    /// up its height. Its second family of modes is `apart` half-power bandwidths above the first: the frequency ratio is
    /// 1 + 2 · apart · ζ.
    ///
    /// Shapes are those of a uniform shear cantilever, sin((k + ½) π z/H). At few sensors neighbouring modes are far from
    /// orthogonal.
    pub(super) fn tower(
        channels: usize,
        first_hz: f64,
        modes: usize,
        damping: [f64; 2],
        apart: f64,
        random: &mut impl Rng,
    ) -> Self {
        let levels = channels.div_ceil(2);
        let height_m = 100.0;
        let places: Vec<(f64, f64)> = (0..channels)
            .map(|channel| (height_m * ((channel / 2) as f64 + 1.0) / levels as f64, AZIMUTHS_DEG[channel % 2]))
            .collect();
        let turned = random.random_range(0.1..0.6_f64);
        let wave = |order: usize, z_m: f64| (std::f64::consts::PI * (order as f64 + 0.5) * z_m / height_m).sin();
        let mut order: Vec<(Mode, (usize, f64))> = (0..modes)
            .map(|mode| {
                let (order, family) = (mode / 2, mode % 2);
                let zeta = damping[0] * (damping[1] / damping[0]).powf(random.random::<f64>());
                // Between a shear beam (1, 3, 5) and a bending one (1, 6.3, 17.5).
                let ratio = (2.0 * order as f64 + 1.0).powf(1.35);
                let shift = if family == 0 { 1.0 } else { 1.0 + 2.0 * apart * zeta };
                let direction = turned + family as f64 * std::f64::consts::FRAC_PI_2;
                let shape = places
                    .iter()
                    .map(|&(z_m, azimuth_deg)| wave(order, z_m) * (azimuth_deg.to_radians() - direction).cos());
                ((first_hz * ratio * shift, zeta, DVector::from_iterator(channels, shape)), (order, direction))
            })
            .collect();
        order.sort_by(|a, b| a.0.0.total_cmp(&b.0.0));
        let levels = (1..=LEVELS).map(|level| {
            let z_m = height_m * level as f64 / LEVELS as f64;
            let along = |azimuth: f64| {
                let of =
                    |(_, (order, direction)): &(Mode, (usize, f64))| wave(*order, z_m) * (azimuth - direction).cos();
                DVector::from_iterator(modes, order.iter().map(of))
            };
            (z_m, [along(0.0), along(std::f64::consts::FRAC_PI_2)])
        });
        let levels = levels.collect();
        Self::of(order.into_iter().map(|(mode, _)| mode).collect(), places, levels)
    }

    /// Modes with random shapes; neighbours' have the correlation `alike`. Each mode is `apart` half-power bandwidths (of the mean
    /// damping) from the one before.
    pub(super) fn random(
        channels: usize,
        first_hz: f64,
        modes: usize,
        damping: [f64; 2],
        apart: f64,
        alike: f64,
        random: &mut impl Rng,
    ) -> Self {
        let places =
            (0..channels).map(|channel| (10.0 * (channel / 2 + 1) as f64, AZIMUTHS_DEG[channel % 2])).collect();
        let mut hz = first_hz;
        let mut last: Option<DVector<f64>> = None;
        let mut all = Vec::new();
        for _ in 0..modes {
            let zeta = damping[0] * (damping[1] / damping[0]).powf(random.random::<f64>());
            let fresh = DVector::from_fn(channels, |_, _| StandardNormal.sample(random));
            let shape = match &last {
                Some(last) => {
                    let other: DVector<f64> = &fresh - last * (last.dot(&fresh) / last.norm_squared());
                    last.normalize() * alike + other.normalize() * (1.0 - alike * alike).sqrt()
                }
                None => fresh,
            };
            all.push((hz, zeta, shape.clone()));
            last = Some(shape);
            hz *= 1.0 + apart * 2.0 * (damping[0] * damping[1]).sqrt();
        }
        Self::of(all, places, Vec::new())
    }

    fn of(modes: Vec<Mode>, places: Vec<(f64, f64)>, levels: Vec<(f64, [DVector<f64>; 2])>) -> Self {
        let shapes: Vec<DVector<f64>> = modes.iter().map(|(_, _, shape)| shape / shape[shape.icamax()]).collect();
        Self {
            frequencies_hz: modes.iter().map(|mode| mode.0).collect(),
            damping: modes.iter().map(|mode| mode.1).collect(),
            shapes: DMatrix::from_columns(&shapes),
            places,
            levels,
        }
    }
}
