//! Names under which files keep their sampling rate, or the time from one sample to the next.

/// Names that mean samples a second, in lower case and without what stands between letters.
const RATES: [&str; 11] = [
    "samplingratehz",
    "samplingrate",
    "samplerate",
    "sampleratehz",
    "samplingfrequency",
    "samplingfrequencyhz",
    "outputdatarate",
    "fs",
    "fshz",
    "rate",
    "ratehz",
];
/// Names that mean seconds from one sample to the next.
const STEPS: [&str; 7] = ["dt", "dts", "samplinginterval", "sampleinterval", "wfincrement", "timestep", "delta"];

/// The rate in Hz that a number of this name says.
pub(super) fn rate_hz(name: &str, number: f64) -> Option<f64> {
    let plain = name.chars().filter(|c| c.is_alphanumeric()).collect::<String>().to_lowercase();
    let number = (number.is_normal() && number > 0.0).then_some(number)?;
    if RATES.contains(&plain.as_str()) {
        return Some(number);
    }
    STEPS.contains(&plain.as_str()).then(|| number.recip())
}

#[cfg(test)]
mod tests {
    use super::rate_hz;

    #[test]
    fn rates_and_steps_go_by_their_names() {
        assert_eq!(rate_hz("Sampling_Rate (Hz)", 50.0), Some(50.0));
        assert_eq!(rate_hz("dt", 0.02), Some(50.0));
        for (name, number) in [("gain", 50.0), ("fs", 0.0), ("fs", f64::NAN), ("dt", -1.0), ("dt", f64::INFINITY)] {
            assert_eq!(rate_hz(name, number), None, "{name} {number}");
        }
    }
}
