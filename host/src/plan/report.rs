//! A plan as it is printed and stored.

use serde::Serialize;

use crate::diagnose::Estimate;

/// What a measurement will show of an effect, before anything is measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Plan {
    /// The effect: `kind` or `kind@where`.
    pub effect: String,
    /// Its values; deviations are null.
    pub parameters: Vec<Estimate>,
    /// What it may be taken for.
    pub rivals: Vec<String>,
    /// Rivals that do the same to every mode at every sensor: a diagnosis names the effect together with them.
    pub twins: Vec<String>,
    /// What was assumed.
    pub assumed: Assumed,
    /// The study's sensors, then with one place more after the other, the one that helps most first.
    pub options: Vec<SensorOption>,
    /// The probability that `shortest_hours` reaches.
    pub wanted_probability: f64,
    /// The shortest record that was considered: four averages of the lowest mode; for shorter ones deviations are guesses.
    pub least_hours: f64,
    /// The longest record that was considered.
    pub longest_hours: f64,
    /// What the reader should know of the model and its sensors.
    pub warnings: Vec<String>,
}

/// What a plan assumes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Assumed {
    /// Damping ratio of every mode.
    pub damping_ratio: f64,
    /// Noise of each sensor in percent of its RMS response, both within the band.
    pub noise_percent: f64,
    /// The band in which modes are looked for.
    pub band_hz: [f64; 2],
    /// Frequencies of the modes that are expected, with the effect.
    pub frequencies_hz: Vec<f64>,
    /// Standard deviations of frequencies in shares of the lower bound (Au 2014).
    pub frequency_std_over_bound: f64,
    /// How many measurements were drawn.
    pub draws: usize,
    /// Their seed.
    pub seed: u64,
}

/// What one set of sensors will show.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SensorOption {
    /// Places that were added to the study's sensors.
    pub added: Vec<String>,
    /// How many sensors there are then.
    pub sensors: usize,
    /// By the record's length.
    pub records: Vec<RecordOutlook>,
    /// The shortest record that reaches the wanted probability; null where none does.
    pub shortest_hours: Option<f64>,
    /// Why none does.
    pub obstacle: Option<Obstacle>,
}

/// What a record of one length will show.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordOutlook {
    /// Length of the record.
    pub hours: f64,
    /// Probability that the effect stands out from the model as it is by 20 to 1.
    pub probability_found: f64,
    /// Probability that a diagnosis names it, and none of the rivals beside it.
    pub probability_named: f64,
    /// Median of the natural logarithm of the evidence for the effect over that for the model as it is.
    pub log_bayes_factor: f64,
    /// The rival that is confused with it most easily; null where there is none.
    pub strongest_rival: Option<String>,
    /// Median of the natural logarithm of the evidence for the effect over that for this rival.
    pub log_bayes_factor_over_rival: Option<f64>,
}

/// Why no record reaches the wanted probability.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Obstacle {
    /// A rival does the same to all modes at these sensors.
    Twins {
        /// The rival.
        rival: String,
    },
    /// An effect of this size lies within the model's tolerance, or within what sound models miss.
    Tolerance {
        /// The size that the longest record would name with the wanted probability, in shares of the given one.
        findable_share: Option<f64>,
        /// The same as a value, for an effect of one value.
        findable: Option<Estimate>,
    },
    /// A rival stays within 20 to 1 too often.
    Rival {
        /// The rival.
        rival: String,
        /// The size that the longest record would name with the wanted probability, in shares of the given one.
        findable_share: Option<f64>,
        /// The same as a value, for an effect of one value.
        findable: Option<Estimate>,
    },
}
