//! How `belfry identify` stands to the truth, mode by mode.

use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::path::Path;

use nalgebra::DVector;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use super::cases::Case;
use super::fault::{Fault, Sign, is_reported};
use super::found::Found;
use super::structure::Structure;
use super::study::write_study;
use super::whole_mode::{self, WholeMode};
use crate::belfry_command;
use crate::statistics::{beyond, rms, unknown, z};

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
    /// (estimate - truth) / stated deviation of the frequency, NaN where no deviation is stated...
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
    /// Records that were refused and should not have been: seed and reason. Their modes are missed.
    pub refused: Vec<(u64, String)>,
    /// What was said of faults and doubts.
    pub warnings: Vec<String>,
    /// Records in which a machine is told, and records with one.
    pub machines: [usize; 2],
    /// Records in which a fault of a sensor or recorder is told, and records with one.
    pub faults: [usize; 2],
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
    let failed = |error: std::io::Error| format!("{}: {error}", folder.display());
    let signs = write_study(case, &structure, folder, &mut random).map_err(failed)?;
    let options = ["--direct", "--json", "--method", method];
    let output = belfry_command().arg("identify").arg(folder).args(options).output().map_err(failed)?;
    let recorded = Recorded { case, seed, structure: &structure, signs: &signs };
    if output.status.success() {
        let report: Value = serde_json::from_slice(&output.stdout).map_err(|error| error.to_string())?;
        into.judge(&recorded, Ok(&report));
        if method == "both" {
            into.count_opinions(&report);
        }
    } else {
        into.judge(&recorded, Err(String::from_utf8_lossy(&output.stderr).trim()));
    }
    Ok(())
}

/// A record and what is true of it.
struct Recorded<'a> {
    case: &'a Case,
    seed: u64,
    structure: &'a Structure,
    /// What warnings have to say of its fault.
    signs: &'a [Sign],
}

/// A true mode.
struct TrueMode {
    frequency_hz: f64,
    damping_ratio: f64,
    shape: DVector<f64>,
    /// Least deviation possible of the frequency in Hz and of the damping ratio (Au 2014).
    bounds: [f64; 2],
    /// The shape of the mode that is nearest in frequency, and how far away it is in Hz.
    neighbour: (DVector<f64>, f64),
}

impl TrueMode {
    fn of(case: &Case, structure: &Structure, mode: usize) -> Self {
        let (hz, zeta) = (structure.frequencies_hz[mode], structure.damping[mode]);
        let cycles = hz * case.seconds * case.roving.map_or(1.0, |roving| roving.setups as f64);
        Self {
            frequency_hz: hz,
            damping_ratio: zeta,
            shape: structure.shapes.column(mode).into_owned(),
            bounds: [hz * (zeta / (TAU * cycles)).sqrt(), (zeta / (TAU * cycles)).sqrt()],
            neighbour: neighbour(structure, mode),
        }
    }

    fn can_be_seen(&self, rate_hz: f64) -> bool {
        self.bounds[0] < SEEN[0] * self.frequency_hz
            && self.bounds[1] < SEEN[1] * self.damping_ratio
            && self.frequency_hz < 0.4 * rate_hz
    }

    /// How like it a found mode is; `None` where that is another one.
    fn likeness(&self, found: &Found) -> Option<f64> {
        let near_hz = (NEAR * self.frequency_hz).max(5.0 * self.bounds[0]);
        let off_hz = found.frequency_hz - self.frequency_hz;
        let mac = found.mac(&self.shape);
        let (neighbour, neighbour_hz) = &self.neighbour;
        let is_pair = found.is_paired
            && found.shape.len() >= PLANE_CHANNELS
            && *neighbour_hz < 2.0 * self.damping_ratio * self.frequency_hz;
        let is_alike = || mac > LEAST_MAC || (is_pair && found.in_plane(&self.shape, neighbour) > LEAST_IN_PLANE);
        (off_hz.abs() < near_hz && is_alike()).then(|| mac - (off_hz / near_hz).powi(2))
    }
}

impl ModeScore {
    /// Holds an estimate against the truth.
    fn hold(&mut self, truth: &TrueMode, estimate: &Found) {
        let off_hz = estimate.frequency_hz - truth.frequency_hz;
        let damping_off = estimate.damping_ratio - truth.damping_ratio;
        self.frequency_z.push(z(off_hz, estimate.frequency_std_hz));
        self.damping_z.push(z(damping_off, estimate.damping_ratio_std));
        self.frequency_over_bound.push(off_hz / truth.bounds[0]);
        self.damping_over_bound.push(damping_off / truth.bounds[1]);
        let mac = estimate.mac(&truth.shape);
        self.least_mac = Some(self.least_mac.map_or(mac, |least| least.min(mac)));
        let shape = estimate.truth(&truth.shape);
        let mut errors = vec![off_hz];
        errors.extend(estimate.shape.iter().zip(&shape).map(|((_, value, _), truth)| (value - truth).re));
        let mut stds = vec![estimate.frequency_std_hz];
        stds.extend(estimate.shape.iter().map(|(_, _, std)| *std));
        let largest = estimate.shape.iter().map(|(_, value, _)| value.norm()).fold(0.0, f64::max);
        for ((_, value, std), error) in estimate.shape.iter().zip(&errors[1..]) {
            // The largest component is 1 by definition.
            if value.norm() < largest {
                self.shape_z.push(z(*error, *std));
            }
        }
        let along = DVector::from_iterator(shape.len(), shape.iter().map(|value| value.re));
        let (errors, stds) = (DVector::from_vec(errors), DVector::from_vec(stds));
        self.whole.extend(WholeMode::of(&errors, &stds, &estimate.scatter, &along));
    }
}

impl CaseScore {
    /// Takes in what belfry says of a record: its report, or why it refuses.
    fn judge(&mut self, recorded: &Recorded<'_>, answer: Result<&Value, &str>) {
        let &Recorded { case, seed, structure, signs } = recorded;
        // Nothing that stands still has a mode to find, and to say so is right.
        let stands_still = case.fault == Some(Fault::StandsStill);
        let modes = if stands_still { 0 } else { structure.frequencies_hz.len() };
        self.modes.resize(modes, ModeScore::default());
        let list = |key: &str| answer.ok().and_then(|report| report[key].as_array()).into_iter().flatten();
        let warnings: Vec<&str> = match answer {
            Ok(_) => list("warnings").filter_map(Value::as_str).collect(),
            Err(error) => error.lines().collect(),
        };
        match answer {
            Ok(report) => {
                self.warnings.extend(warnings.iter().map(|warning| format!("seed {seed}: {warning}")));
                for (seconds, key) in self.seconds.iter_mut().zip(["modes_s", "second_opinion_s"]) {
                    *seconds += report["timings"][key].as_f64().unwrap_or(0.0);
                }
            }
            Err(error) if stands_still && error.contains("no modes were found") => {}
            Err(error) => self.refused.push((seed, error.to_owned())),
        }
        if let Some(Fault::Machine(machine)) = case.fault {
            let hz = machine.frequency_hz(structure);
            let mut tones = list("harmonics").filter_map(|tone| tone["frequency_hz"].as_f64());
            self.machines[0] += usize::from(tones.any(|found| (found / hz - 1.0).abs() < MACHINE_NEAR));
            self.machines[1] += 1;
        }
        if !signs.is_empty() {
            self.faults[0] += usize::from(is_reported(signs, &warnings));
            self.faults[1] += 1;
        }
        self.add(case, seed, structure, &list("modes").map(Found::of).collect::<Vec<_>>());
    }

    fn count_opinions(&mut self, report: &Value) {
        for mode in report["modes"].as_array().into_iter().flatten() {
            let place = mode["second_opinion"]["agrees"].as_bool().map_or(2, |agrees| usize::from(!agrees));
            self.opinions[place] += 1;
        }
    }

    fn add(&mut self, case: &Case, seed: u64, structure: &Structure, found: &[Found]) {
        let mut used = vec![false; found.len()];
        for (mode, score) in self.modes.iter_mut().enumerate() {
            let truth = TrueMode::of(case, structure, mode);
            score.records += 1;
            let unused = (0..found.len()).filter(|&at| !used[at]);
            let alike = unused.filter_map(|at| Some((at, truth.likeness(&found[at])?)));
            let Some((at, _)) = alike.max_by(|(_, a), (_, b)| a.total_cmp(b)) else {
                score.missed += usize::from(truth.can_be_seen(case.rate_hz));
                continue;
            };
            used[at] = true;
            score.hold(&truth, &found[at]);
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
        let in_records = |what: &str, [told, records]: [usize; 2]| match records {
            0 => String::new(),
            _ => format!("; {what} told in {told} of {records} records"),
        };
        let (machines, faults) = (in_records("machines", self.machines), in_records("fault", self.faults));
        let any = |count: usize, what: &str| if count > 0 { format!("; {count} {what}") } else { String::new() };
        let refused = any(self.refused.len(), "refused");
        let shape_z = all(|mode| &mode.shape_z);
        let unknown =
            any([&frequency_z, &damping_z, &shape_z].map(|z| unknown(z)).iter().sum(), "of unknown deviation");
        let opinions = if agree + differ + without > 0 {
            format!("; second opinion: agrees on {agree}, differs on {differ}, has none on {without}")
        } else {
            String::new()
        };
        format!(
            "all: {} found, {} missed, {} invented; z rms f {:.2} ({:.0} % beyond 3), damping {:.2} ({:.0} %), shape {:.2}; error/bound f {:.2}, damping {:.2}; {}{opinions}{machines}{faults}{refused}{unknown}; {:.2} s and {:.2} s",
            frequency_z.len(),
            self.modes.iter().map(|mode| mode.missed).sum::<usize>(),
            self.invented_hz.len(),
            rms(&frequency_z),
            beyond(&frequency_z, 3.0),
            rms(&damping_z),
            beyond(&damping_z, 3.0),
            rms(&shape_z),
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

#[cfg(test)]
#[path = "score_tests.rs"]
mod tests;
