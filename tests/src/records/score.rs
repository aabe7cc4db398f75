//! How `belfry identify` stands to the truth, mode by mode.

use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use crate::npy::write_npy;
use nalgebra::{Complex, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use super::cases::Case;
use super::fault::Fault;
use super::record::record;
use super::structure::Structure;
use super::whole_mode::{self, WholeMode};
use crate::belfry_command;
use crate::statistics::rms;

/// Share of each channel's root mean square that is sensor noise.
const NOISE: f64 = 0.03;
/// Found: within 2 % of the frequency or five times the lower bound, whichever is larger, with at least this MAC.
const NEAR: f64 = 0.02;
const LEAST_MAC: f64 = 0.5;
/// A mode of a pair that is said to be known by its plane alone: with this share in the plane of the two true modes, which are less than a
/// bandwidth apart, and enough channels for a plane to be seldom met by chance.
const LEAST_IN_PLANE: f64 = 0.9;
const PLANE_CHANNELS: usize = 6;
/// A machine is told where a tone is listed within this share of its frequency.
const MACHINE_NEAR: f64 = 0.005;
/// A mode can be seen where the bound of its frequency and of its damping is below these shares.
const SEEN: [f64; 2] = [0.02, 0.5];

/// One mode over all seeds.
#[derive(Debug, Clone, Default)]
pub struct ModeScore {
    /// Of how many records.
    pub records: usize,
    /// In how many it can be seen and is not found.
    pub missed: usize,
    /// (estimate - truth) / stated deviation of the frequency...
    pub frequency_z: Vec<f64>,
    /// ...of the damping ratio...
    pub damping_z: Vec<f64>,
    /// ...and of the shape's components.
    pub shape_z: Vec<f64>,
    /// Error of the frequency over the least deviation possible (Au 2014).
    pub frequency_over_bound: Vec<f64>,
    /// Error of the damping ratio over the least deviation possible.
    pub damping_over_bound: Vec<f64>,
    /// Frequency and shape together.
    pub whole: Vec<WholeMode>,
    /// Least MAC.
    pub least_mac: Option<f64>,
}

/// A case over all seeds.
#[derive(Debug, Clone, Default)]
pub struct CaseScore {
    /// Mode by mode, lowest first.
    pub modes: Vec<ModeScore>,
    /// Modes found that are none, seed by seed: frequency in Hz.
    pub invented_hz: Vec<(u64, f64)>,
    /// Records that were refused: seed and reason.
    pub refused: Vec<(u64, String)>,
    /// What was said of faults and doubts.
    pub warnings: Vec<String>,
    /// Records in which a machine is told, and records with one.
    pub machines: [usize; 2],
    /// Modes of which the second opinion says that it agrees, that it differs, and that it has none such.
    pub opinions: [usize; 3],
    /// Seconds that the first method took, and the second opinion.
    pub seconds: [f64; 2],
}

/// Makes a case's record of a seed in `folder`, identifies it by `method` (as `belfry identify --method` has it) and scores the
/// answer.
///
/// # Errors
/// What cannot be written or understood.
pub fn run(case: &Case, seed: u64, method: &str, folder: &Path, into: &mut CaseScore) -> Result<(), String> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let structure = case.build.structure(&mut random);
    let channels = structure.places.len();
    let failed = |error: std::io::Error| format!("{}: {error}", folder.display());
    fs::create_dir_all(folder).map_err(failed)?;
    for (setup, kept) in setups(case, channels).iter().enumerate() {
        let mut samples = record(&structure, case.load, case.rate_hz, case.seconds, NOISE, &mut random);
        if let Some(fault) = case.fault {
            fault.damage(&mut samples, &structure, case.rate_hz, &mut random);
        }
        let rows = samples.chunks(channels);
        let samples: Vec<f32> = rows.flat_map(|row| kept.iter().map(|&channel| row[channel])).collect();
        write_npy(&folder.join(format!("{}.npy", name(setup))), &samples, kept.len()).map_err(failed)?;
    }
    fs::write(folder.join("study.toml"), study_toml(case, &structure)).map_err(failed)?;
    let options = ["--direct", "--json", "--method", method];
    let output = belfry_command().arg("identify").arg(folder).args(options).output().map_err(failed)?;
    // Nothing that stands still has a mode to find.
    let stands_still = case.fault == Some(Fault::StandsStill);
    let modes = if stands_still { 0 } else { structure.frequencies_hz.len() };
    into.modes.resize(modes, ModeScore::default());
    if !output.status.success() {
        let error = String::from_utf8_lossy(&output.stderr);
        if !(stands_still && error.contains("no modes were found")) {
            into.refused.push((seed, error.trim().to_owned()));
        }
        return Ok(());
    }
    let report: Value = serde_json::from_slice(&output.stdout).map_err(|error| error.to_string())?;
    for warning in report["warnings"].as_array().into_iter().flatten().filter_map(Value::as_str) {
        into.warnings.push(format!("seed {seed}: {warning}"));
    }
    let timings = &report["timings"];
    for (seconds, key) in into.seconds.iter_mut().zip(["modes_s", "second_opinion_s"]) {
        *seconds += timings[key].as_f64().unwrap_or(0.0);
    }
    if let Some(Fault::Machine(machine)) = case.fault {
        let hz = machine.frequency_hz(&structure);
        let told =
            report["harmonics"].as_array().into_iter().flatten().filter_map(|tone| tone["frequency_hz"].as_f64());
        into.machines[0] += usize::from(told.into_iter().any(|found| (found / hz - 1.0).abs() < MACHINE_NEAR));
        into.machines[1] += 1;
    }
    if method == "both" {
        for mode in report["modes"].as_array().into_iter().flatten() {
            let place = mode["second_opinion"]["agrees"].as_bool().map_or(2, |agrees| usize::from(!agrees));
            into.opinions[place] += 1;
        }
    }
    let found: Vec<Found> = report["modes"].as_array().into_iter().flatten().map(Found::of).collect();
    into.add(case, seed, &structure, &found);
    Ok(())
}

/// The channels of each setup, the references first.
fn setups(case: &Case, channels: usize) -> Vec<Vec<usize>> {
    let Some(roving) = case.roving else { return vec![(0..channels).collect()] };
    let others: Vec<usize> = (0..channels).filter(|channel| !roving.references.contains(channel)).collect();
    let each = others.len().div_ceil(roving.setups);
    others.chunks(each).map(|others| [&roving.references[..], others].concat()).collect()
}

fn name(setup: usize) -> String {
    format!("setup-{}", setup + 1)
}

fn study_toml(case: &Case, structure: &Structure) -> String {
    let mut text = format!("[structure]\nname = {:?}\n", case.name);
    for (setup, kept) in setups(case, structure.places.len()).iter().enumerate() {
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "\n[[setup]]\nname = {0:?}\nfiles = [\"{0}.npy\"]\nsampling_rate_hz = {1:?}\nunit = \"m/s2\"",
            name(setup),
            case.rate_hz
        );
        for (column, &channel) in kept.iter().enumerate() {
            let (z_m, azimuth_deg) = structure.places[channel];
            let reference = case.roving.is_some_and(|roving| roving.references.contains(&channel));
            // A column is a channel, whose point says where it is on the structure.
            let _ = writeln!(
                text,
                "\n[[setup.sensor]]\nchannel = \"{:02}\"\npoint = \"{}\"\nnode = {}\nelevation_m = {z_m:?}\nazimuth_deg = {azimuth_deg:?}\nreference = {reference}",
                column + 1,
                channel + 1,
                column / 4 + 1
            );
        }
    }
    text
}

/// A mode as it was found.
struct Found {
    frequency_hz: f64,
    frequency_std_hz: f64,
    damping_ratio: f64,
    damping_ratio_std: f64,
    /// By the structure's channel, counted from 0.
    shape: Vec<(usize, Complex<f64>, f64)>,
    /// How its errors are correlated.
    scatter: Value,
    /// Whether it is told as one of a pair of which only the plane is known.
    is_paired: bool,
}

impl Found {
    fn of(mode: &Value) -> Self {
        let number = |name: &str| mode[name].as_f64().unwrap_or(f64::NAN);
        let part = |part: &Value| {
            let channel = part["point"].as_str()?.parse::<usize>().ok()?.checked_sub(1)?;
            Some((channel, Complex::new(part["re"].as_f64()?, part["im"].as_f64()?), part["std"].as_f64()?))
        };
        Self {
            frequency_hz: number("frequency_hz"),
            frequency_std_hz: number("frequency_std_hz"),
            damping_ratio: number("damping_ratio"),
            damping_ratio_std: number("damping_ratio_std"),
            shape: mode["shape"].as_array().into_iter().flatten().filter_map(part).collect(),
            scatter: mode["covariance_factor"].clone(),
            is_paired: !mode["pair_with"].is_null(),
        }
    }

    /// The true shape at the channels that were kept, of the length and phase of the estimate (least squares).
    fn truth(&self, truth: &DVector<f64>) -> Vec<Complex<f64>> {
        let power: f64 = self.shape.iter().map(|(channel, _, _)| truth[*channel].powi(2)).sum();
        let along: Complex<f64> = self.shape.iter().map(|(channel, value, _)| value * truth[*channel]).sum();
        self.shape.iter().map(|(channel, _, _)| along / power * truth[*channel]).collect()
    }

    fn mac(&self, truth: &DVector<f64>) -> f64 {
        let inside: f64 = self.truth(truth).iter().map(|value| value.norm_sqr()).sum();
        let whole: f64 = self.shape.iter().map(|(_, value, _)| value.norm_sqr()).sum();
        if whole > 0.0 { inside / whole } else { 0.0 }
    }

    /// The share of the shape that lies in the plane of two true ones.
    fn in_plane(&self, one: &DVector<f64>, other: &DVector<f64>) -> f64 {
        let at_channels = |shape: &DVector<f64>| {
            DVector::from_iterator(self.shape.len(), self.shape.iter().map(|(channel, _, _)| shape[*channel]))
        };
        let (one, other) = (at_channels(one).normalize(), at_channels(other));
        let other = (&other - &one * one.dot(&other)).normalize();
        let along = |direction: &DVector<f64>| {
            self.shape.iter().zip(direction.iter()).map(|((_, value, _), part)| value * *part).sum::<Complex<f64>>()
        };
        let whole: f64 = self.shape.iter().map(|(_, value, _)| value.norm_sqr()).sum();
        if whole > 0.0 { (along(&one).norm_sqr() + along(&other).norm_sqr()) / whole } else { 0.0 }
    }
}

impl CaseScore {
    fn add(&mut self, case: &Case, seed: u64, structure: &Structure, found: &[Found]) {
        let mut used = vec![false; found.len()];
        for (mode, score) in self.modes.iter_mut().enumerate() {
            let (hz, zeta) = (structure.frequencies_hz[mode], structure.damping[mode]);
            let shape = structure.shapes.column(mode).into_owned();
            let cycles = hz * case.seconds * case.roving.map_or(1.0, |roving| roving.setups as f64);
            let bounds = [hz * (zeta / (TAU * cycles)).sqrt(), (zeta / (TAU * cycles)).sqrt()];
            score.records += 1;
            let (neighbour, neighbour_hz) = neighbour(structure, mode);
            let near_hz = (NEAR * hz).max(5.0 * bounds[0]);
            let best = (0..found.len())
                .filter(|&at| !used[at] && (found[at].frequency_hz - hz).abs() < near_hz)
                .filter(|&at| {
                    let is_pair = found[at].shape.len() >= PLANE_CHANNELS && neighbour_hz < 2.0 * zeta * hz;
                    let in_plane = || found[at].in_plane(&shape, &neighbour);
                    found[at].mac(&shape) > LEAST_MAC || (found[at].is_paired && is_pair && in_plane() > LEAST_IN_PLANE)
                })
                .max_by(|&a, &b| {
                    let likeness =
                        |at: usize| found[at].mac(&shape) - ((found[at].frequency_hz - hz) / near_hz).powi(2);
                    likeness(a).total_cmp(&likeness(b))
                });
            let Some(at) = best else {
                let can_be_seen = bounds[0] < SEEN[0] * hz && bounds[1] < SEEN[1] * zeta && hz < 0.4 * case.rate_hz;
                score.missed += usize::from(can_be_seen);
                continue;
            };
            used[at] = true;
            let estimate = &found[at];
            score.frequency_z.push((estimate.frequency_hz - hz) / estimate.frequency_std_hz);
            score.damping_z.push((estimate.damping_ratio - zeta) / estimate.damping_ratio_std);
            score.frequency_over_bound.push((estimate.frequency_hz - hz) / bounds[0]);
            score.damping_over_bound.push((estimate.damping_ratio - zeta) / bounds[1]);
            let mac = estimate.mac(&shape);
            score.least_mac = Some(score.least_mac.map_or(mac, |least| least.min(mac)));
            let truth = estimate.truth(&shape);
            let mut errors = vec![estimate.frequency_hz - hz];
            errors.extend(estimate.shape.iter().zip(&truth).map(|((_, value, _), truth)| (value - truth).re));
            let mut stds = vec![estimate.frequency_std_hz];
            stds.extend(estimate.shape.iter().map(|(_, _, std)| *std));
            let real_truth = DVector::from_iterator(truth.len(), truth.iter().map(|value| value.re));
            let (errors, stds) = (DVector::from_vec(errors), DVector::from_vec(stds));
            score.whole.extend(WholeMode::of(&errors, &stds, &estimate.scatter, &real_truth));
            let largest = estimate.shape.iter().map(|(_, value, _)| value.norm()).fold(0.0, f64::max);
            for ((_, value, std), truth) in estimate.shape.iter().zip(&truth) {
                // The largest component is 1 by definition.
                if value.norm() < largest {
                    score.shape_z.push((value - truth).re / std);
                }
            }
        }
        let invented = found.iter().zip(&used).filter(|(_, used)| !**used);
        self.invented_hz.extend(invented.map(|(mode, _)| (seed, mode.frequency_hz)));
    }

    /// A table with a line a mode, and what was invented, refused and said.
    pub fn table(&self) -> String {
        let mut text =
            "mode  records  missed  f: z rms  >2 %  >3 %  error/bound   damping: z rms  error/bound   shape: z rms  >3 %  least MAC\n"
                .to_owned();
        for (index, mode) in self.modes.iter().enumerate() {
            // Writing to a string cannot fail.
            let _ = writeln!(
                text,
                "{:4}  {:7}  {:6}  {:8.2}  {:4.0}  {:4.0}  {:11.2}   {:14.2}  {:11.2}   {:12.2}  {:4.1}  {:9}",
                index + 1,
                mode.records,
                mode.missed,
                rms(&mode.frequency_z),
                beyond(&mode.frequency_z, 2.0),
                beyond(&mode.frequency_z, 3.0),
                rms(&mode.frequency_over_bound),
                rms(&mode.damping_z),
                rms(&mode.damping_over_bound),
                rms(&mode.shape_z),
                beyond(&mode.shape_z, 3.0),
                mode.least_mac.map_or("-".to_owned(), |mac| format!("{mac:.4}"))
            );
        }
        let _ = writeln!(text, "{}", self.line());
        for (seed, hz) in &self.invented_hz {
            let _ = writeln!(text, "seed {seed}: {hz:.4} Hz is no mode");
        }
        for (seed, reason) in &self.refused {
            let _ = writeln!(text, "seed {seed}: refused: {reason}");
        }
        for warning in &self.warnings {
            let _ = writeln!(text, "{warning}");
        }
        text
    }

    /// All modes together.
    fn line(&self) -> String {
        let all = |of: fn(&ModeScore) -> &Vec<f64>| self.modes.iter().flat_map(of).copied().collect::<Vec<f64>>();
        let (frequency_z, damping_z) = (all(|mode| &mode.frequency_z), all(|mode| &mode.damping_z));
        let [agree, differ, without] = self.opinions;
        let machines = match self.machines {
            [_, 0] => String::new(),
            [told, records] => format!("; machines told in {told} of {records} records"),
        };
        let opinions = if agree + differ + without > 0 {
            format!("; second opinion: agrees on {agree}, differs on {differ}, has none on {without}")
        } else {
            String::new()
        };
        format!(
            "all: {} found, {} missed, {} invented; z rms f {:.2} ({:.0} % beyond 3), damping {:.2} ({:.0} %), shape {:.2}; error/bound f {:.2}, damping {:.2}; {}{opinions}{machines}; {:.2} s and {:.2} s",
            frequency_z.len(),
            self.modes.iter().map(|mode| mode.missed).sum::<usize>(),
            self.invented_hz.len(),
            rms(&frequency_z),
            beyond(&frequency_z, 3.0),
            rms(&damping_z),
            beyond(&damping_z, 3.0),
            rms(&all(|mode| &mode.shape_z)),
            rms(&all(|mode| &mode.frequency_over_bound)),
            rms(&all(|mode| &mode.damping_over_bound)),
            whole_mode::in_words(&self.modes.iter().flat_map(|mode| mode.whole.iter().copied()).collect::<Vec<_>>()),
            self.seconds[0],
            self.seconds[1]
        )
    }
}

/// The shape of the mode whose frequency is nearest to a mode's, and how far away it is in Hz.
fn neighbour(structure: &Structure, mode: usize) -> (DVector<f64>, f64) {
    let distance_hz = |other: usize| (structure.frequencies_hz[other] - structure.frequencies_hz[mode]).abs();
    let others = (0..structure.frequencies_hz.len()).filter(|other| *other != mode);
    let nearest = others.min_by(|&a, &b| distance_hz(a).total_cmp(&distance_hz(b)));
    let shape = structure.shapes.column(nearest.unwrap_or(mode)).into_owned();
    (shape, nearest.map_or(f64::INFINITY, distance_hz))
}

/// Percent of magnitudes beyond a limit.
fn beyond(values: &[f64], limit: f64) -> f64 {
    100.0 * values.iter().filter(|value| value.abs() > limit).count() as f64 / values.len().max(1) as f64
}
