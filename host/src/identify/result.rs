//! The result of an identification, as it is printed and stored.

use num_complex::Complex64;
use serde::ser::SerializeStruct;
use serde::{Deserialize, Serialize};

use super::covariance::CovarianceFactor;
use super::fit::Basis;
use super::kurtosis::HARMONIC_KURTOSIS;
use super::ssi::{OUTER_MARGIN_LINES, SecondOpinion, StabilisationDiagram, SubspacePole};
use super::tone::LOBE_LINES;

/// What is found within so many lines and this share of a mode's bandwidth together is that mode.
const SAME_LINES: f64 = 1.0;
const SAME_OF_BANDWIDTH: f64 = 0.5;
/// A mode whose bandwidth is less than so many lines may hide others on the same line.
const NARROW_LINES: f64 = 0.5;

/// The modes of a structure, with how much data stands behind them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Identification {
    /// The modes, lowest frequency first.
    pub modes: Vec<Mode>,
    /// Segments averaged, all setups together.
    pub averages: usize,
    /// Time that the averages cover, all setups together, in s.
    #[serde(default)]
    pub record_s: f64,
    /// Distance between spectral lines in Hz.
    pub frequency_resolution_hz: f64,
    /// Forced lines that are no modes.
    pub harmonics: Vec<Harmonic>,
    /// What was picked and is no mode, lowest first.
    #[serde(default)]
    pub rejected: Vec<Rejected>,
    /// What the reader should know.
    pub warnings: Vec<String>,
    /// Stable poles of the subspaces, setup by setup, that are none of the modes.
    #[serde(default)]
    pub other_poles: Vec<SubspacePole>,
    /// The stabilisation diagrams, for pictures; not part of the printed JSON.
    #[serde(skip)]
    pub stabilisation: Vec<StabilisationDiagram>,
    /// The singular values from which modes were picked, for pictures; not part of the printed JSON.
    #[serde(skip)]
    pub singular_values: Vec<SingularSpectrum>,
    /// What the fit stands on, for another one; not part of the printed JSON.
    #[serde(skip)]
    pub(super) basis: Basis,
}

impl Identification {
    /// Whether most modes, with peaks that may be some, are far narrower than a line: finer lines would show more of them.
    pub fn has_narrow_modes(&self) -> bool {
        let narrow_hz = NARROW_LINES * self.frequency_resolution_hz;
        let narrow = self.modes.iter().filter(|mode| mode.bandwidth_hz() < narrow_hz).count();
        let peaks = self.rejected.iter().filter(|peak| peak.because == RejectedBecause::Undamped).count();
        narrow > 0 && 2 * (narrow + peaks) > self.modes.len() + peaks
    }

    /// Whether a mode is so near to an end of the band that the subspace cannot be asked.
    pub fn is_at_end(&self, mode: &Mode) -> bool {
        let margin_hz = OUTER_MARGIN_LINES * self.frequency_resolution_hz;
        let of = |setup: &SingularSpectrum| Some([*setup.frequency_hz.first()?, *setup.frequency_hz.last()?]);
        let ends_hz = self.singular_values.first().and_then(of);
        ends_hz.is_some_and(|[low, high]| mode.frequency_hz < low + margin_hz || mode.frequency_hz > high - margin_hz)
    }

    /// Takes back what the warnings say of a mode that is no longer listed.
    pub(super) fn say_no_more_of(&mut self, mode: &Mode) {
        let (place, hz) = (place(mode.frequency_hz), in_hz(mode.frequency_hz));
        let is_of_pair = |warning: &str| {
            let names = warning.strip_prefix(PAIR).and_then(|rest| rest.split(" Hz").next());
            names.is_some_and(|names| names.split(' ').any(|name| name == hz))
        };
        self.warnings.retain(|warning| !warning.starts_with(&place) && !is_of_pair(warning));
    }

    /// What was rejected with the reasons, and how to keep one; `None` where there is nothing.
    pub fn rejected_in_words(&self) -> Option<String> {
        let mut reasons: Vec<(RejectedBecause, Vec<String>)> = Vec::new();
        for one in &self.rejected {
            let hz = format!("{:.4}", one.frequency_hz);
            match reasons.iter_mut().find(|(because, _)| *because == one.because) {
                Some((_, all)) => all.push(hz),
                None => reasons.push((one.because, vec![hz])),
            }
        }
        let each: Vec<String> =
            reasons.iter().map(|(because, all)| format!("{} Hz ({because})", all.join(", "))).collect();
        if each.is_empty() {
            return None;
        }
        let keep = self.rejected.iter().find(|one| one.because.can_be_added());
        let keep = keep.map(|one| {
            let hz = format!("{:.4}", one.frequency_hz);
            let all = self.rejected.iter().all(|one| one.because.can_be_added());
            let which = if all { "one".to_owned() } else { format!("that at {hz} Hz") };
            format!(" To keep {which}, name it: add_modes_hz = [{hz}] in [analysis].")
        });
        Some(format!("Rejected: {}.{}", each.join("; "), keep.unwrap_or_default()))
    }
}

/// A mode of vibration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Mode {
    /// Counts from 1.
    pub number: usize,
    /// Natural frequency in Hz.
    pub frequency_hz: f64,
    /// Its standard deviation.
    pub frequency_std_hz: f64,
    /// Damping ratio (1 is critical).
    pub damping_ratio: f64,
    /// Its standard deviation.
    pub damping_ratio_std: f64,
    /// Lower bound of the frequency's standard deviation on this record (Au 2014), in Hz.
    pub frequency_std_bound_hz: f64,
    /// The same of the damping ratio.
    pub damping_ratio_std_bound: f64,
    /// The mode shape, largest component 1; the points of all setups.
    pub shape: Vec<ShapeComponent>,
    /// Modal phase collinearity: 1 for a shape whose points move in phase or against phase.
    pub phase_collinearity: f64,
    /// The least of all setups before imaginary parts that are as large as their scatter were taken for noise.
    #[serde(default = "not_known")]
    pub phase_collinearity_as_measured: f64,
    /// Spectral lines, of those that it was fitted to, in the half-power bandwidth: with less than one, damping is read from the
    /// window's own shape.
    #[serde(default = "not_known")]
    pub lines_in_bandwidth: f64,
    /// How far the fit is from the measured spectrum, over what that scatters: about 1, or less, where nothing is missing in the
    /// fit. The largest of all setups; none where it was not fitted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub misfit: Option<f64>,
    /// The mode's spectrum in every setup, measured and fitted, for pictures; not part of the printed JSON.
    #[serde(skip)]
    pub fitted: Vec<FittedSpectrum>,
    /// The band that the user has chosen for its fit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub band_hz: Option<[f64; 2]>,
    /// The frequency at which study.toml asks for it, where it does: the mode may lie beside.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub asked_hz: Option<f64>,
    /// The mode that it is a pair with: the record does not tell their directions apart.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pair_with: Option<usize>,
    /// Which method gives its values.
    #[serde(default)]
    pub method: ModeMethod,
    /// What subspace identification says of the mode; none where it has no such mode, or was not asked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub second_opinion: Option<SecondOpinion>,
    /// How the errors of its numbers are correlated; none where the method does not tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub covariance_factor: Option<CovarianceFactor>,
    /// The pick of the fit's basis that it comes from.
    #[serde(skip)]
    pub(crate) pick: Option<usize>,
}

/// How sentences begin that say something of a mode.
pub(super) fn place(frequency_hz: f64) -> String {
    format!("mode at {} Hz", in_hz(frequency_hz))
}

/// The same of two.
pub(super) fn pair_of(lower_hz: f64, upper_hz: f64) -> String {
    format!("{PAIR}{} and {} Hz", in_hz(lower_hz), in_hz(upper_hz))
}

const PAIR: &str = "the modes at ";

/// A frequency as sentences have it.
fn in_hz(frequency_hz: f64) -> String {
    format!("{frequency_hz:.4}")
}

/// The method that a mode's values come from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModeMethod {
    /// The fit of spectra.
    #[default]
    Spectra,
    /// The subspace: with both methods, the fit does not resolve the mode.
    Subspace,
}

impl Mode {
    /// Whether something else lies where the mode is, in any setup: it may be several in one.
    pub fn is_misfit(&self) -> bool {
        self.fitted.iter().any(|one| one.is_misfit)
    }

    /// Whether what is found at a frequency is this mode.
    pub(super) fn covers(&self, frequency_hz: f64, spacing_hz: f64) -> bool {
        (frequency_hz - self.frequency_hz).abs() < SAME_LINES * spacing_hz + SAME_OF_BANDWIDTH * self.bandwidth_hz()
    }

    /// Half-power bandwidth 2 zeta f in Hz.
    pub fn bandwidth_hz(&self) -> f64 {
        2.0 * self.damping_ratio * self.frequency_hz
    }
}

/// Of files of earlier versions.
fn not_known() -> f64 {
    f64::NAN
}

/// A mode's spectrum behind its modal filter.
#[derive(Debug, Clone, PartialEq)]
pub struct FittedSpectrum {
    /// The setup's name.
    pub setup: String,
    /// Frequencies in Hz.
    pub frequency_hz: Vec<f64>,
    /// Measured densities.
    pub measured: Vec<f64>,
    /// Those that the fit expects.
    pub fitted: Vec<f64>,
    /// Relative standard deviation of a measured density.
    pub scatter: f64,
    /// Whether more is left than chance leaves.
    pub is_misfit: bool,
}

impl FittedSpectrum {
    /// What the fit of a narrow mode, which has finer lines of its own, expects at lines of this spacing: a Hann window spreads its peak over
    /// them. Of lines further than one beyond the fit's own there is nothing. `None` where its own are no finer.
    pub(crate) fn on_lines(&self, lines_hz: impl Iterator<Item = f64>, spacing_hz: f64) -> Option<Vec<(f64, f64)>> {
        let own_hz = self.frequency_hz.windows(2).map(|pair| pair[1] - pair[0]).fold(f64::INFINITY, f64::min);
        if own_hz >= FINER * spacing_hz {
            return None;
        }
        let ends = self.frequency_hz.first().copied().zip(self.frequency_hz.last().copied());
        let expected = |at_hz: f64| {
            let mut sums = (0.0, 0.0);
            for (other_hz, density) in self.frequency_hz.iter().zip(&self.fitted) {
                let weight = hann_power((other_hz - at_hz) / spacing_hz);
                sums = (sums.0 + weight * density, sums.1 + weight);
            }
            (at_hz, sums.0 / sums.1)
        };
        let is_near =
            |hz: &f64| ends.is_some_and(|(first, last)| (first - spacing_hz..=last + spacing_hz).contains(hz));
        Some(lines_hz.filter(is_near).map(expected).collect())
    }
}

/// Lines are finer than others from this share of their spacing on.
const FINER: f64 = 0.75;

/// The power that a Hann window lets through so many lines away, 1 at none (Harris 1978, "On the use of windows for harmonic analysis with
/// the discrete Fourier transform", eq. 27).
fn hann_power(lines: f64) -> f64 {
    // Where the quotient below is 0/0.
    const NEAR: f64 = 1e-6;
    if lines.abs() < NEAR {
        return 1.0;
    }
    if (lines.abs() - 1.0).abs() < NEAR {
        return 0.25;
    }
    let x = std::f64::consts::PI * lines;
    (x.sin() / (x * (1.0 - lines * lines))).powi(2)
}

/// A mode shape at one measurement point.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShapeComponent {
    /// The channel's name; `setup/channel` in studies of several setups, where names recur.
    pub channel: String,
    /// The measurement point's name.
    pub point: String,
    /// Real part.
    pub re: f64,
    /// Imaginary part.
    pub im: f64,
    /// Standard deviation of the component's real part: of what scatters, half the variance of both parts.
    pub std: f64,
}

impl ShapeComponent {
    /// Real and imaginary part in one.
    pub(crate) fn value(&self) -> Complex64 {
        Complex64::new(self.re, self.im)
    }
}

/// A forced line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Harmonic {
    /// Frequency in Hz.
    pub frequency_hz: f64,
    /// Kurtosis of the band-passed response: 1.5 for a steady harmonic, 3 for a mode.
    pub kurtosis: f64,
    /// How far its frequency wanders to either side, at most; 0 for one that stays at a spectral line.
    #[serde(default)]
    pub wanders_hz: f64,
    /// Share of the time that it is there.
    #[serde(default = "always")]
    pub on_share: f64,
    /// Part by part of the record, the share of the time that it is there; empty where it is always.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub on_by_part: Vec<OnInPart>,
}

/// How much of a part of the record a forced line is there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OnInPart {
    /// The setup's name.
    pub setup: String,
    /// Where the part begins in what was averaged of the setup, in s.
    pub from_s: f64,
    /// Where it ends.
    pub to_s: f64,
    /// The share of it.
    pub on_share: f64,
}

impl Harmonic {
    /// Whether its kurtosis tells it from a mode; otherwise its frequency is known better than that of any mode could be.
    pub fn is_told_by_kurtosis(&self) -> bool {
        self.kurtosis * self.on_share < HARMONIC_KURTOSIS
    }

    /// Whether what is found at a frequency may be this forced line.
    pub(super) fn covers(&self, frequency_hz: f64, spacing_hz: f64) -> bool {
        (frequency_hz - self.frequency_hz).abs() < LOBE_LINES * spacing_hz + self.wanders_hz
    }
}

fn always() -> f64 {
    1.0
}

/// A peak that was picked and is no mode.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Rejected {
    /// Where it was picked, or fitted, in Hz.
    pub frequency_hz: f64,
    /// Why it is no mode.
    pub because: RejectedBecause,
}

impl Serialize for Rejected {
    /// Writes what a reason means as well, for those who read the file and not these names.
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut fields = serializer.serialize_struct("Rejected", 4)?;
        fields.serialize_field("frequency_hz", &self.frequency_hz)?;
        fields.serialize_field("because", &self.because)?;
        fields.serialize_field("in_words", &self.because.to_string())?;
        fields.serialize_field("can_be_added", &self.because.can_be_added())?;
        fields.end()
    }
}

/// Why a peak is no mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RejectedBecause {
    /// It is a second sight of the stronger mode beside it.
    Double,
    /// In most setups the fit finds no resonance near it.
    NotShown,
    /// Less damping than any structure has.
    Undamped,
    /// More damping than any structure has.
    Overdamped,
    /// Its shape changes from segment to segment.
    Shape,
    /// Its frequency changes from segment to segment.
    Frequency,
    /// Its damping is hardly known, and the subspace has no such mode.
    Unseen,
    /// Its damping is hardly known, and no mode of the record is known well.
    Uncertain,
    /// It is narrower than a line, with a small share of the other modes' damping: a machine's, or a cable's.
    Narrow,
    /// It is wide and far from the measured spectrum: a resonance in the place of several.
    Bridge,
    /// Its fit did not move with the data.
    Stuck,
    /// Its parts move at all phases.
    Phases,
    /// The pole explains too little of the response at its frequency.
    Weak,
    /// The pole returns at too few orders.
    Unstable,
    /// The pole's damping is mostly noise.
    Damping,
    /// Not all setups have the pole.
    NotInAllSetups,
}

impl RejectedBecause {
    /// Whether the user may have it as a mode all the same: there is a resonance.
    pub fn can_be_added(self) -> bool {
        !matches!(self, Self::Double | Self::NotShown | Self::NotInAllSetups)
    }
}

impl std::fmt::Display for RejectedBecause {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(match self {
            Self::Double => "it is a second sight of the stronger mode beside it",
            Self::NotShown => "the fit finds no resonance near it",
            Self::Undamped => "it is sharper than any structure's resonance",
            Self::Overdamped => "it is wider than any structure's resonance",
            Self::Shape => "its shape is mostly noise",
            Self::Frequency => "its frequency is mostly noise",
            Self::Unseen => "its damping is hardly known, and the subspace has no such mode",
            Self::Uncertain => "its damping is hardly known, and no mode of the record is known well",
            Self::Narrow => "it is narrower than a line and has less than a tenth of the other modes' damping, as of a machine, or a cable",
            Self::Bridge => "it is wide and far from the measured spectrum, as of several modes in one",
            Self::Stuck => "the fit there ran into a limit",
            Self::Phases => "its parts move at all phases",
            Self::Weak => "it explains less than half of the response there",
            Self::Unstable => "it returns at too few orders",
            Self::Damping => "its damping is mostly noise",
            Self::NotInAllSetups => "not all setups have it",
        })
    }
}

/// The singular values of one setup over frequency.
#[derive(Debug, Clone, PartialEq)]
pub struct SingularSpectrum {
    /// The setup's name.
    pub setup: String,
    /// Frequencies in Hz.
    pub frequency_hz: Vec<f64>,
    /// Singular values in (m/s²)²/Hz, largest first: one vector a rank (at most four).
    pub values: Vec<Vec<f64>>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::accuracy::tests::found;

    #[test]
    fn a_narrow_fit_is_spread_over_wide_lines_and_keeps_its_power() {
        // Half a line of this spacing wide, on lines that are ten times as fine.
        let spacing_hz = 0.01;
        let bell = |hz: f64| 1.0 / (1.0 + ((hz - 1.0) / (0.25 * spacing_hz)).powi(2));
        let frequency_hz: Vec<f64> = (0..=1000).map(|line| 0.5 + 0.001 * f64::from(line)).collect();
        let fit = FittedSpectrum {
            setup: "first".to_owned(),
            fitted: frequency_hz.iter().map(|hz| bell(*hz)).collect(),
            measured: Vec::new(),
            frequency_hz,
            scatter: 0.1,
            is_misfit: false,
        };
        let lines = (0..200).map(|line| spacing_hz * f64::from(line));
        assert_eq!(fit.on_lines(lines.clone(), 0.1 * spacing_hz), None);
        let expected = fit.on_lines(lines, spacing_hz).unwrap();
        let ends = [expected[0].0, expected.last().unwrap().0];
        assert!((ends[0] - 0.49).abs() < 1e-9 && (ends[1] - 1.51).abs() < 1e-9, "{ends:?}");
        let highest = expected.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        assert!((highest.0 - 1.0).abs() < 1e-9 && (0.3..0.6).contains(&highest.1), "{highest:?}");
        let spread = expected.iter().map(|at| at.1).sum::<f64>() * spacing_hz;
        let own = fit.fitted.iter().sum::<f64>() * 0.001;
        assert!((spread / own - 1.0).abs() < 0.02, "{spread} {own}");
    }

    #[test]
    fn a_rejected_peak_is_written_with_its_reason_in_words_and_read_back() {
        let narrow = Rejected { frequency_hz: 2.5, because: RejectedBecause::Narrow };
        let json = serde_json::to_value(narrow).expect("it is plain data");
        assert_eq!(json["because"], "narrow");
        assert_eq!(json["in_words"], RejectedBecause::Narrow.to_string());
        assert_eq!(serde_json::from_value::<Rejected>(json).expect("it is what was written"), narrow);
    }

    #[test]
    fn what_has_no_resonance_is_not_advised() {
        let rejected = |frequency_hz: f64, because| Rejected { frequency_hz, because };
        let said = |rejected: &[Rejected]| {
            Identification { rejected: rejected.to_vec(), ..found() }.rejected_in_words().unwrap()
        };
        let (double, narrow) = (rejected(0.5, RejectedBecause::Double), rejected(2.5, RejectedBecause::Narrow));
        assert!(said(&[narrow]).ends_with("To keep one, name it: add_modes_hz = [2.5000] in [analysis]."));
        assert!(
            said(&[double, narrow])
                .ends_with("To keep that at 2.5000 Hz, name it: add_modes_hz = [2.5000] in [analysis].")
        );
        assert!(!said(&[double]).contains("To keep"));
    }

    #[test]
    fn what_is_said_of_a_mode_goes_with_it_and_what_is_said_of_others_stays() {
        let said = [place(1.25), pair_of(1.25, 1.26), pair_of(1.2, 1.25), place(1.2501), pair_of(0.25, 11.25)];
        let mut identification = Identification { warnings: said.to_vec(), ..found() };
        let gone = Mode { frequency_hz: 1.25, ..identification.modes.remove(0) };
        identification.say_no_more_of(&gone);
        assert_eq!(identification.warnings, said[3..]);
    }

    #[test]
    fn finer_lines_are_wanted_where_most_modes_and_sharp_peaks_are_narrower_than_half_a_line() {
        let sharp = Rejected { frequency_hz: 0.2, because: RejectedBecause::Undamped };
        let with = |spacing_hz: f64, rejected: Vec<Rejected>| Identification {
            frequency_resolution_hz: spacing_hz,
            rejected,
            ..found()
        };
        // The mode's bandwidth is 0.0019 Hz.
        assert!(with(0.01, Vec::new()).has_narrow_modes());
        assert!(!with(0.003, Vec::new()).has_narrow_modes());
        assert!(!with(0.001, vec![sharp; 3]).has_narrow_modes(), "peaks of noise alone are no reason");
    }
}
