//! The study of a case: what an engineer would own, with nothing in it of what is hidden. The truth stands beside it, in a file
//! that belfry does not read.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use super::cases::Case;
use super::damped::DampedMode;
use super::recording::record;
use super::table::{channel_name, segments_csv};

/// Writes the study with its recording into a folder, which is made.
pub(super) fn write(case: &Case, folder: &Path) -> Result<(), String> {
    let failed = |error: std::io::Error| format!("{}: {error}", folder.display());
    fs::create_dir_all(folder).map_err(failed)?;
    let recording = record(case)?;
    recording.write_npy(&folder.join("recording.npy")).map_err(failed)?;
    if let Some(temperatures) = &recording.temperatures {
        let mut text = "time_s,temperature_degc\n".to_owned();
        for (time_s, degc) in temperatures {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{time_s},{degc:.3}");
        }
        fs::write(folder.join("temperature.csv"), text).map_err(failed)?;
    }
    fs::write(folder.join("beam.csv"), segments_csv(&case.structure.segments)).map_err(failed)?;
    fs::write(folder.join("study.toml"), study_toml(case, recording.temperatures.is_some())).map_err(failed)?;
    fs::write(folder.join("truth.json"), truth_json(case)?.to_string()).map_err(failed)
}

/// What is hidden, and the exact modes at the sensors, clock offsets left out.
fn truth_json(case: &Case) -> Result<serde_json::Value, String> {
    let mode = |mode: &DampedMode| {
        let shape: Vec<_> = mode.shape.iter().map(|part| [part.re, part.im]).collect();
        serde_json::json!({"frequency_hz": mode.frequency_hz(), "damping_ratio": mode.damping_ratio(), "shape": shape})
    };
    let modes: Vec<_> = case.damped_modes()?.iter().map(mode).collect();
    Ok(serde_json::json!({"truth": case.truth(), "modes": modes}))
}

fn study_toml(case: &Case, temperature: bool) -> String {
    let structure = &case.structure;
    let temperature = if temperature { "temperature = \"temperature.csv\"\n" } else { "" };
    let mut text = format!(
        "[structure]\nname = {:?}\n\n[[setup]]\nname = \"one\"\nfiles = [\"recording.npy\"]\nsampling_rate_hz = {:?}\n\
         unit = \"m/s2\"\n{temperature}\n",
        structure.name, structure.sampling_rate_hz
    );
    for (at, channel) in structure.channels.iter().enumerate() {
        let [x, y] = channel.offset_m;
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "[[setup.sensor]]\nchannel = \"{}\"\nnode = {}\nelevation_m = {:?}\nazimuth_deg = {:?}\noffset_m = [{x:?}, {y:?}]\n",
            channel_name(at),
            channel.node,
            channel.elevation_m,
            channel.azimuth_deg
        );
    }
    let [low_hz, high_hz] = structure.band_hz;
    let _ = write!(
        text,
        "[analysis]\nband_hz = [{low_hz:?}, {high_hz:?}]\n\n[model]\nbeam = \"beam.csv\"\nbackground_stiffness = 0.03\n\
         background_mass = 0.01\ncorrelation_length_m = {:?}\n",
        structure.correlation_length_m()
    );
    text
}
