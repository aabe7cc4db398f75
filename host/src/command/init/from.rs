//! study.toml from what recordings say of themselves; what they do not say is marked with TODO and left out, so that a command names it.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use toml::Value;

use crate::record::survey::{Surveyed, SurveyedChannel};

/// What stands before a line that the user completes.
pub(super) const TO_DO: &str = "TODO";
/// Channels that a node has at most.
const CHANNELS_A_NODE: usize = 4;

/// The text of study.toml in `folder`.
pub(super) fn study(found: &[Surveyed], folder: &Path) -> String {
    let title = folder.file_name().map_or_else(|| "My structure".into(), |name| name.to_string_lossy());
    let mut text = format!(
        "# What the recordings say of themselves. Lines with {TO_DO} are what they do not say: complete them. `belfry init` without\n\
         # --from writes a study with every key explained.\n\n[structure]\nname = {}\n",
        quoted(&title)
    );
    for (number, one) in found.iter().enumerate() {
        // Writing to a string cannot fail.
        let _ = setup(&mut text, one, number + 1, folder);
    }
    text + "\n[analysis]\n# band_hz = [0.1, 10.0]          # lowest and highest frequency of interest; chosen from the rate where it is not given\n"
}

fn setup(text: &mut String, one: &Surveyed, number: usize, folder: &Path) -> std::fmt::Result {
    writeln!(text, "\n[[setup]]\nname = \"setup-{number}\"")?;
    let files: Vec<String> = one.files.iter().map(|file| quoted(&within(file, folder))).collect();
    writeln!(text, "files = [{}]", files.join(", "))?;
    match one.rate_hz {
        Some(rate_hz) => writeln!(text, "sampling_rate_hz = {rate_hz:?}")?,
        None => writeln!(text, "# sampling_rate_hz =             # {TO_DO}: the files do not say it; rows per second")?,
    }
    let mut units = one.channels.iter().filter_map(|channel| channel.unit);
    let unit = units.next();
    match unit {
        Some(unit) => writeln!(text, "unit = {}", quoted(unit))?,
        None => writeln!(
            text,
            "# unit =                         # {TO_DO}: the files do not say it; m/s2, g, V, m/s, m, rad or strain"
        )?,
    }
    let seconds = one.rate_hz.map(|rate_hz| format!(", {:.1} s", one.rows as f64 / rate_hz)).unwrap_or_default();
    let start = one.start_utc.as_ref().map(|start| format!(" from {start} on")).unwrap_or_default();
    writeln!(text, "# {} rows{seconds}{start}", one.rows)?;
    writeln!(
        text,
        "# {TO_DO}: where each sensor is (identification needs none of it): elevation_m, azimuth_deg, offset_m"
    )?;
    let mut sensors = 0;
    for channel in &one.channels {
        if let Some(rate_hz) = channel.rate_hz.filter(|_| !one.is_at_rate(channel)) {
            writeln!(text, "# left out: {}, which has {rate_hz} Hz", quoted(&channel.name))?;
            continue;
        }
        sensor(text, channel, sensors / CHANNELS_A_NODE + 1, unit)?;
        sensors += 1;
    }
    Ok(())
}

fn sensor(text: &mut String, channel: &SurveyedChannel, node: usize, of_setup: Option<&str>) -> std::fmt::Result {
    writeln!(text, "\n[[setup.sensor]]\nchannel = {}\nnode = {node}", quoted(&channel.name))?;
    match (channel.unit, &channel.unit_as_written) {
        (Some(unit), _) if Some(unit) != of_setup => writeln!(text, "unit = {}", quoted(unit))?,
        (None, Some(written)) => {
            writeln!(
                text,
                "# {TO_DO}: its unit is {} by the file, which is none of those that are known",
                quoted(written)
            )?;
        }
        _ => {}
    }
    if channel.unit == Some("V") {
        writeln!(text, "# sensitivity_v_per_m_s2 =       # {TO_DO}: volts per m/s2")?;
    }
    Ok(())
}

/// A path as study.toml has it: from the study's folder where it is inside, else the whole of it.
fn within(file: &Path, folder: &Path) -> String {
    let whole = |path: &Path| -> PathBuf { std::path::absolute(path).unwrap_or_else(|_| path.to_owned()) };
    let (file, folder) = (whole(file), whole(folder));
    file.strip_prefix(&folder).unwrap_or(&file).to_string_lossy().into_owned()
}

/// A string as TOML writes it.
fn quoted(text: &str) -> String {
    Value::String(text.to_owned()).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::survey::survey;
    use crate::study::Study;

    fn made(names: &[&str]) -> String {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests-data"));
        study(&survey(names.iter().map(|name| folder.join(name)).collect()).unwrap(), folder)
    }

    #[test]
    fn a_recording_that_says_all_makes_a_study_that_reads_it() {
        let text = made(&["h5py_channels.h5"]);
        let study = Study::from_text(&text, Path::new("tests-data")).unwrap();
        let setup = &study.setups[0];
        assert_eq!((setup.files[0].as_str(), setup.sampling_rate_hz), ("h5py_channels.h5", 50.0));
        assert_eq!(setup.sensors[1].channel, "run 1/top-y");
    }

    #[test]
    fn what_files_do_not_say_is_marked_and_named_when_it_is_needed() {
        for (files, missing) in [(["same.npy"], "sampling_rate_hz"), (["obspy_steim1.mseed"], "unit")] {
            let text = made(&files);
            assert!(text.contains(&format!("# {missing} =")) && text.contains(TO_DO), "{text}");
            let error = Study::from_text(&text, Path::new("tests-data")).unwrap_err().to_string();
            assert!(error.contains(missing), "{error}");
        }
        assert!(made(&["obspy_steim1.mseed"]).contains("from 2026-03-01T12:00:00.000Z on"));
    }
}
