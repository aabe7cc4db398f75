//! The modes of a record followed over its hours, as a table.

use std::io;

use crate::trend::Trend;

/// A row an interval and mode, as CSV.
pub(super) fn csv(trend: &Trend) -> io::Result<Vec<u8>> {
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record([
        "setup",
        "start_s",
        "end_s",
        "averages",
        "temperature_degc",
        "mode",
        "frequency_hz",
        "frequency_std_hz",
        "damping_ratio",
        "damping_ratio_std",
        "mac",
        "response_rms",
    ])?;
    for interval in &trend.intervals {
        for mode in &interval.modes {
            table.write_record([
                interval.setup.clone(),
                interval.start_s.to_string(),
                interval.end_s.to_string(),
                interval.averages.to_string(),
                interval.temperature_degc.map_or(String::new(), |degrees| format!("{degrees:.3}")),
                mode.number.to_string(),
                format!("{:.7}", mode.frequency_hz),
                format!("{:.7}", mode.frequency_std_hz),
                format!("{:.6}", mode.damping_ratio),
                format!("{:.6}", mode.damping_ratio_std),
                format!("{:.5}", mode.mac),
                format!("{:.5e}", mode.response_rms),
            ])?;
        }
    }
    table.into_inner().map_err(|error| error.into_error())
}
