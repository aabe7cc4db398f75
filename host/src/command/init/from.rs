//! study.toml from what recordings say of themselves; what they do not say is marked with TODO and left out, so that a command names it.

use std::path::{Path, PathBuf};

use toml::Value;

use crate::numbers::counted;
use crate::record::survey::{Surveyed, SurveyedChannel};

/// What stands before a line that the user completes.
pub(super) const TO_DO: &str = "TODO";
/// Channels that a node has at most.
const CHANNELS_A_NODE: usize = 4;

/// A study.toml from recordings.
pub(super) struct Draft {
    pub(super) text: String,
    /// Keys that no command does without, which the recordings do not say.
    pub(super) needed: Vec<&'static str>,
    /// What the recordings hold and the study leaves out, or takes for granted, in sentences.
    pub(super) warnings: Vec<String>,
}

/// The study.toml in `folder`.
pub(super) fn study(found: &[Surveyed], folder: &Path) -> Draft {
    let title = folder.file_name().map_or_else(|| "My structure".into(), |name| name.to_string_lossy());
    let mut lines = Lines::default();
    lines.push(format!(
        "# What the recordings say of themselves. Lines with {TO_DO} are what they do not say: complete them. `belfry init` without\n\
         # --from writes a study with every key explained.\n\n[structure]\nname = {}",
        quoted(&title)
    ));
    let mut warnings = Vec::new();
    for (one, number) in found.iter().zip(1..) {
        setup(&mut lines, one, number, found.len() > 1, folder);
        warnings.extend(one.warnings());
        warnings.extend(assumed_of_clocks(one, number));
    }
    if found.len() > 1 {
        warnings.push(format!(
            "{} setups are written: files with the same channels are one, and so are loggers that say in UTC that they recorded at the same time. Name the files of others that did in one setup; setups of different times need `reference = true` at the points that all of them have",
            found.len()
        ));
    }
    lines.push("\n[analysis]\n# band_hz = [0.1, 10.0]          # lowest and highest frequency of interest; chosen from the rate where it is not given");
    Draft { text: lines.text, needed: lines.needed, warnings }
}

/// A study of one setup, in which stand-ins fill what the recordings do not say: whether its files can be read does not depend on that.
pub(super) fn filled(one: &Surveyed, number: usize, folder: &Path) -> String {
    let mut lines = Lines { is_filled: true, ..Lines::default() };
    lines.push("[structure]\nname = \"stand-in\"");
    setup(&mut lines, one, number, false, folder);
    lines.text
}

/// What is taken for granted where the loggers of a setup have clocks of their own.
fn assumed_of_clocks(one: &Surveyed, number: usize) -> Option<String> {
    let is_assumed = one.loggers() > 1 && one.has_local_times() && !one.has_mixed_clocks();
    is_assumed.then(|| {
        format!(
            "setup-{number}: its loggers write times of their own clocks, which are taken for the same; utc_offset_h = 0.0 stands for what they are ahead of UTC: correct it"
        )
    })
}

/// Lines of study.toml.
#[derive(Default)]
struct Lines {
    text: String,
    /// Whether stand-ins are written where the user is to complete a line.
    is_filled: bool,
    needed: Vec<&'static str>,
}

impl Lines {
    fn push(&mut self, line: impl AsRef<str>) {
        self.text.push_str(line.as_ref());
        self.text.push('\n');
    }

    /// A key that the user completes, without which no command reads the study.
    fn needed(&mut self, key: &'static str, stand_in: &str, why: &str) {
        self.completed_by_user(key, stand_in, why);
        if !self.needed.contains(&key) {
            self.needed.push(key);
        }
    }

    /// A key that the user completes.
    fn completed_by_user(&mut self, key: &str, stand_in: &str, why: &str) {
        if self.is_filled {
            self.push(format!("{key} = {stand_in}"));
        } else {
            self.push(format!("{:<32} # {TO_DO}: {why}", format!("# {key} =")));
        }
    }
}

fn setup(lines: &mut Lines, one: &Surveyed, number: usize, has_others: bool, folder: &Path) {
    lines.push(format!("\n[[setup]]\nname = \"setup-{number}\""));
    let files: Vec<String> = one.files.iter().map(|file| quoted(&pattern_of(&within(file, folder)))).collect();
    lines.push(format!("files = [{}]", files.join(", ")));
    match one.rate_hz {
        Some(rate_hz) => lines.push(format!("sampling_rate_hz = {rate_hz:?}")),
        None => lines.needed("sampling_rate_hz", "50.0", "the files do not say it; rows per second"),
    }
    clocks(lines, one);
    let kept = || one.channels.iter().filter(|channel| one.is_at_rate(channel));
    let unit = kept().find_map(|channel| channel.unit);
    match unit {
        Some(unit) => lines.push(format!("unit = {}", quoted(unit))),
        None => lines.needed("unit", "\"m/s2\"", "the files do not say it; m/s2, g, V, m/s, m, rad or strain"),
    }
    let start = one.start_utc.as_ref().map(|start| format!(" from {start} on")).unwrap_or_default();
    match (one.loggers(), one.rows) {
        (2.., _) => lines.push(format!("# {} loggers beside each other{start}", one.loggers())),
        (_, Some(rows)) => {
            let seconds = one.rate_hz.map(|rate_hz| format!(", {:.1} s", rows as f64 / rate_hz)).unwrap_or_default();
            lines.push(format!("# {}{seconds}{start}", counted(rows, "row")));
        }
        (_, None) => {}
    }
    lines.push(format!(
        "# {TO_DO}: where each sensor is (identification needs none of it): elevation_m, azimuth_deg, offset_m"
    ));
    if has_others {
        lines.push(format!("# {TO_DO}: reference = true for a sensor at a point that all setups have: their shapes are put together over it"));
        if !lines.needed.contains(&"reference") {
            lines.needed.push("reference");
        }
    }
    for what in one.left_out.iter().cloned().chain(one.at_other_rates()) {
        lines.push(format!("# left out: {what}"));
    }
    for (at, channel) in kept().enumerate() {
        sensor(lines, channel, at / CHANNELS_A_NODE + 1, unit);
    }
}

/// How far loggers' own clocks are ahead of UTC. Among loggers that say UTC the user must say it; among themselves it only tells when the
/// recording was.
fn clocks(lines: &mut Lines, one: &Surveyed) {
    const AHEAD: &str = "hours by which the logger's clock is ahead of UTC";
    if one.has_mixed_clocks() {
        lines.needed("utc_offset_h", "0.0", &format!("{AHEAD}; the other loggers say UTC"));
    } else if one.has_local_times() && one.loggers() > 1 {
        lines.push(format!("{:<32} # {TO_DO}: {AHEAD}", "utc_offset_h = 0.0"));
    } else if one.has_local_times() {
        lines.completed_by_user(
            "utc_offset_h",
            "0.0",
            &format!("{AHEAD}; without it nobody knows when the recording was"),
        );
    }
}

fn sensor(lines: &mut Lines, channel: &SurveyedChannel, node: usize, of_setup: Option<&str>) {
    lines.push(format!("\n[[setup.sensor]]\nchannel = {}\nnode = {node}", quoted(&channel.name)));
    match (channel.unit, &channel.unit_as_written) {
        (Some(unit), _) if Some(unit) != of_setup => lines.push(format!("unit = {}", quoted(unit))),
        (None, Some(written)) if !written.trim().is_empty() => lines.push(format!(
            "# {TO_DO}: its unit is `{}` by the file, which is none of those that are known",
            written.escape_debug()
        )),
        _ => {}
    }
    if channel.unit == Some("V") {
        lines.needed("sensitivity_v_per_m_s2", "1.0", "volts per m/s2");
    }
}

/// A file's name as `files` takes it: one that is no pattern is escaped.
fn pattern_of(name: &str) -> String {
    if glob::Pattern::new(name).is_ok() { name.to_owned() } else { glob::Pattern::escape(name) }
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
    use crate::record::survey::{joined, survey};
    use crate::study::Study;

    fn drafted(names: &[&str]) -> Draft {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests-data"));
        study(&survey(names.iter().map(|name| folder.join(name)).collect()).unwrap(), folder)
    }

    fn made(names: &[&str]) -> String {
        drafted(names).text
    }

    /// Tables of these contents in a folder of their own.
    fn of_tables(files: &[(&str, &str)]) -> Draft {
        let folder = tempfile::tempdir().unwrap();
        let write = |(name, text): &(&str, &str)| {
            let file = folder.path().join(name);
            std::fs::write(&file, text).unwrap();
            file
        };
        study(&joined(survey(files.iter().map(write).collect()).unwrap()), folder.path())
    }

    #[test]
    fn a_recording_that_says_all_makes_a_study_that_reads_it() {
        let draft = drafted(&["h5py_channels.h5"]);
        let study = Study::from_text(&draft.text, Path::new("tests-data")).unwrap();
        let setup = &study.setups[0];
        assert_eq!((setup.files[0].as_str(), setup.sampling_rate_hz), ("h5py_channels.h5", 50.0));
        assert_eq!(setup.sensors[1].channel, "run 1/top-y");
        assert!(draft.needed.is_empty() && draft.warnings.is_empty(), "{:?} {:?}", draft.needed, draft.warnings);
    }

    #[test]
    fn what_files_do_not_say_is_marked_and_named_when_it_is_needed() {
        for (files, missing) in [(["same.npy"], "sampling_rate_hz"), (["obspy_steim1.mseed"], "unit")] {
            let draft = drafted(&files);
            let text = &draft.text;
            assert!(text.contains(&format!("# {missing} =")) && text.contains(TO_DO), "{text}");
            assert!(draft.needed.contains(&missing), "{:?}", draft.needed);
            let error = Study::from_text(text, Path::new("tests-data")).unwrap_err().to_string();
            assert!(error.contains(missing), "{error}");
        }
        assert!(made(&["obspy_steim1.mseed"]).contains("from 2026-03-01T12:00:00.000Z on"));
    }

    #[test]
    fn what_is_left_out_stands_in_the_study_and_is_told() {
        let draft = of_tables(&[("a.csv", "x,note\n1,calm\n")]);
        assert!(draft.text.contains("# left out: channel `note` holds no numbers"), "{}", draft.text);
        assert!(draft.text.contains("# 1 row\n") && !draft.text.contains("channel = \"note\""), "{}", draft.text);
        assert!(draft.warnings[0].contains("a.csv: left out: channel `note`"), "{:?}", draft.warnings);
    }

    #[test]
    fn clocks_of_loggers_are_asked_for_where_they_matter() {
        let toa5 = |channel: &str, unit: &str| {
            let rows = (0..50).map(|row| format!("\"2026-03-01 12:00:00.{:02}\",{row}\r\n", 2 * row));
            format!(
                "\"TOA5\",\"mast\"\r\n\"TIMESTAMP\",\"{channel}\"\r\n\"TS\",\"{unit}\"\r\n\"\",\"Smp\"\r\n{}",
                rows.collect::<String>()
            )
        };
        let (low, top) = (toa5("low", "g"), toa5("top", "g"));
        let alone = of_tables(&[("a.dat", &low)]);
        assert!(alone.text.contains("# utc_offset_h =") && alone.needed.is_empty(), "{}", alone.text);
        assert!(Study::from_text(&alone.text, Path::new("")).is_ok());
        let both = of_tables(&[("a.dat", &low), ("b.dat", &top)]);
        let study = Study::from_text(&both.text, Path::new("")).unwrap();
        assert_eq!((study.setups.len(), study.setups[0].utc_offset_h), (1, Some(0.0)));
        assert!(both.text.contains("# 2 loggers beside each other"), "{}", both.text);
        assert!(both.warnings.iter().any(|told| told.contains("utc_offset_h = 0.0")), "{:?}", both.warnings);
        let table: String = (0..50).map(|row| format!("{:.2},1\n", 1_772_366_400.0 + 0.02 * f64::from(row))).collect();
        let mixed = of_tables(&[("a.csv", &format!("time,x\ns,g\n{table}")), ("b.dat", &top)]);
        assert_eq!(mixed.needed, ["utc_offset_h"], "{}", mixed.text);
        // Other channels without any time: setups of their own, which must share a point.
        let apart = of_tables(&[("a.csv", "x\ng\n1\n"), ("b.csv", "y\ng\n1\n")]);
        assert!(apart.needed.contains(&"reference") && apart.warnings[0].contains("2 setups"), "{:?}", apart.warnings);
    }

    #[test]
    fn names_that_are_no_patterns_are_escaped() {
        assert_eq!(pattern_of("a[1].csv"), "a[1].csv");
        let escaped = pattern_of("a[.csv");
        assert!(glob::Pattern::new(&escaped).unwrap().matches("a[.csv"), "{escaped}");
    }
}
