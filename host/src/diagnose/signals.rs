//! Effects that show outside the modes' frequencies and shapes: forced lines, and trends over the hours.

use serde::Deserialize;

use crate::model::effect::{Effect, Where};

/// What identification has seen besides modes.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
pub struct Signals {
    /// Segments averaged.
    #[serde(default)]
    pub averages: usize,
    /// Forced lines.
    #[serde(default)]
    pub harmonics: Vec<Line>,
    /// How modes go with temperature and level, where identification followed them.
    #[serde(default)]
    pub trends: Option<Trends>,
}

/// A forced line.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Line {
    /// Its frequency in Hz.
    pub frequency_hz: f64,
    /// Kurtosis of the band-passed response.
    pub kurtosis: f64,
    /// Share of the time that it is there.
    #[serde(default = "always")]
    pub on_share: f64,
}

fn always() -> f64 {
    1.0
}

/// Modes over the hours.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
pub struct Trends {
    /// Mode by mode.
    #[serde(default)]
    pub modes: Vec<ModeTrend>,
}

/// A mode over the hours.
#[derive(Debug, Clone, Copy, Default, PartialEq, Deserialize)]
pub struct ModeTrend {
    /// Its number.
    #[serde(default)]
    pub number: usize,
    /// Change of frequency in percent a kelvin.
    #[serde(default)]
    pub percent_per_kelvin: Option<Slope>,
    /// Change of frequency in percent a decade of response.
    #[serde(default)]
    pub percent_per_decade: Option<Slope>,
}

/// A slope with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Slope {
    /// The slope.
    pub value: f64,
    /// Its standard deviation.
    pub std: f64,
}

/// An effect that a signal shows.
#[derive(Debug, Clone)]
pub(super) struct Signal {
    pub(super) effect: Effect,
    /// Standard deviation of its value, where it has one.
    pub(super) std: Option<f64>,
    pub(super) log_bayes_factor: f64,
    /// Squared deviations of what the effect leaves.
    pub(super) chi_squared: f64,
    /// Of how many numbers, less those fitted.
    pub(super) degrees_of_freedom: usize,
    /// What shows it.
    pub(super) reason: String,
}

/// Kurtosis of a mode's band-passed response, which is Gaussian, and of a steady tone.
const KURTOSIS_OF_A_MODE: f64 = 3.0;
const KURTOSIS_OF_A_TONE: f64 = 1.5;

/// The effects that signals show, but those that the model has.
pub fn shown_effects(signals: &Signals, present: &[Effect]) -> Vec<Effect> {
    shown(signals, present, &[]).into_iter().map(|signal| signal.effect).collect()
}

/// All effects that signals show, but those that the model has; kinds in `without` are not considered.
pub(super) fn shown(signals: &Signals, present: &[Effect], without: &[String]) -> Vec<Signal> {
    let mut shown = all_shown(signals, present);
    shown.retain(|signal| !without.iter().any(|kind| kind == signal.effect.kind()));
    shown
}

/// All effects that signals show, but those that the model has.
pub(super) fn all_shown(signals: &Signals, present: &[Effect]) -> Vec<Signal> {
    let mut shown = Vec::new();
    let averages = signals.averages.max(4) as f64;
    for line in &signals.harmonics {
        // The sample kurtosis of a Gaussian signal scatters by sqrt(24/n) over n independent samples (Kendall and Stuart 1969,
        // section 12.18), of which a segment's line has about two.
        let std = (24.0 / (2.0 * averages)).sqrt();
        // While it is there.
        let kurtosis = line.kurtosis * line.on_share;
        let square = |expected: f64| ((kurtosis - expected) / std).powi(2);
        let place = Where::Frequency(rounded(line.frequency_hz));
        if let Ok(effect) = Effect::new("harmonic", Some(place), &[line.frequency_hz]) {
            shown.push(Signal {
                effect,
                std: None,
                log_bayes_factor: 0.5 * (square(KURTOSIS_OF_A_MODE) - square(KURTOSIS_OF_A_TONE)),
                chi_squared: square(KURTOSIS_OF_A_TONE),
                degrees_of_freedom: 1,
                reason: format!(
                    "the line at {:.4} Hz has a kurtosis of {kurtosis:.2} ± {std:.2}; a steady tone has {KURTOSIS_OF_A_TONE}, a mode {KURTOSIS_OF_A_MODE}",
                    line.frequency_hz
                ),
            });
        }
    }
    let modes = signals.trends.as_ref().map_or(&[][..], |trends| &trends.modes);
    let slopes = |of: fn(&ModeTrend) -> Option<Slope>| -> Vec<Slope> {
        modes.iter().filter_map(of).filter(|slope| slope.std.is_finite() && slope.std > 0.0).collect()
    };
    shown.extend(common_slope("temperature-stiffness", &slopes(|mode| mode.percent_per_kelvin), (0.002, "% a kelvin")));
    let by_level = slopes(|mode| mode.percent_per_decade);
    shown.extend(common_slope("amplitude-stiffness", &by_level, (0.02, "% a decade of response")));
    shown.retain(|signal| {
        let same = |effect: &Effect| effect.to_string() == signal.effect.to_string();
        !present.iter().any(same)
    });
    shown
}

/// The stiffness' slope that all modes share: frequencies go by half of it.
fn common_slope(kind: &str, slopes: &[Slope], (typical, unit): (f64, &str)) -> Option<Signal> {
    if slopes.is_empty() {
        return None;
    }
    let weights: f64 = slopes.iter().map(|slope| slope.std.powi(-2)).sum();
    let mean = slopes.iter().map(|slope| slope.value * slope.std.powi(-2)).sum::<f64>() / weights;
    let left: f64 = slopes.iter().map(|slope| ((slope.value - mean) / slope.std).powi(2)).sum();
    // Modes that disagree make the mean less sure.
    let scatter = (left / (slopes.len() as f64 - 1.0).max(1.0)).max(1.0);
    // Percent of frequency to a share of stiffness.
    let (value, std) = (0.02 * mean, 0.02 * (scatter / weights).sqrt());
    let ratio = typical / std;
    let log_bayes_factor = 0.5 * ((value / std).powi(2) - (1.0 + ratio * ratio).ln() - (value / typical).powi(2));
    let effect = Effect::new(kind, None, &[value]).ok()?;
    let reason = format!(
        "over the hours the frequencies of {} modes go together, by {mean:+.3} ± {:.3} {unit}",
        slopes.len(),
        50.0 * std
    );
    let degrees_of_freedom = slopes.len() - 1;
    Some(Signal { effect, std: Some(std), log_bayes_factor, chi_squared: left, degrees_of_freedom, reason })
}

/// To 0.1 mHz, as places are written.
fn rounded(frequency_hz: f64) -> f64 {
    (1e4 * frequency_hz).round() / 1e4
}
