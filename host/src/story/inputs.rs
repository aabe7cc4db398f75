//! What modes were identified from, and what a model was held against, so that later steps notice where it is no longer the same.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use crc::{CRC_64_XZ, Crc};
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};

use super::case::Case;
use crate::model::Custom;
use crate::model::effect::Effect;
use crate::record::matching_files;
use crate::results::{COVALIDATION_FILE, Results, UPDATE_FILE};
use crate::study::{CustomSource, Model, Study};

const CHECKSUM: Crc<u64> = Crc::<u64>::new(&CRC_64_XZ);
/// Of a recording, so many bytes at either end and its length stand for the whole: recordings have gigabytes.
const END_BYTES: u64 = 4096;

/// What [`Inputs`] calls the effects of a model.
pub(crate) const EFFECTS: &str = "the model's effects";

/// A checksum of everything that modes are identified from, by its name (`[analysis]`, each setup, each recording), or of what a model is
/// held against.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Inputs(BTreeMap<String, String>);

/// What each result of the model was computed from, by the name of its file.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(crate) struct AllInputs {
    /// The file's schema, which is no result.
    #[serde(default, rename = "schema", skip_serializing)]
    _schema: IgnoredAny,
    #[serde(flatten)]
    pub(crate) of_result: BTreeMap<String, Inputs>,
}

impl Inputs {
    /// Those of a study as it stands now. A live setup's windows are left out: they grow on their own.
    pub(super) fn of(study: &Study) -> Self {
        let mut inputs =
            BTreeMap::from([("[analysis]".to_owned(), checksum(format!("{:?}", study.analysis).as_bytes()))]);
        for setup in &study.setups {
            // Where sensors stand and what they are called is read anew by every step.
            let sensors: Vec<_> = setup
                .sensors
                .iter()
                .map(|sensor| (&sensor.channel, &sensor.point, sensor.reference, sensor.sensitivity_v_per_m_s2))
                .collect();
            let mut said =
                format!("{:?}", (&setup.files, &setup.variable, setup.sampling_rate_hz, setup.unit, sensors));
            // Only where there are any, so that studies without keep the checksums that they had.
            if setup.sensors.iter().any(|sensor| sensor.gain.is_some()) {
                said += &format!("{:?}", setup.sensors.iter().map(|sensor| sensor.gain).collect::<Vec<_>>());
            }
            inputs.insert(format!("setup \"{}\"", setup.name), checksum(said.as_bytes()));
            for file in matching_files(setup, &study.folder).unwrap_or_default() {
                // What cannot be read now has changed.
                let sum = of_recording(&file).unwrap_or_default();
                inputs.insert(name(&file, &study.folder), sum);
            }
        }
        Self(inputs)
    }

    /// What decides what is said of a model: its tables and effects, how far it is trusted, the sensors, and the measured modes.
    pub(crate) fn of_model(case: &Case) -> Self {
        let tables = case.model.bytes();
        let effects: Vec<String> = case.model.effects.iter().map(Effect::typed).collect();
        let trust = case.study.model.as_ref().map(|model| {
            let Model { background_stiffness, background_mass, correlation_length_m, prior_odds, .. } = model;
            let customs: Vec<_> = model.customs.iter().map(|one| CustomSource { line: 0, ..one.clone() }).collect();
            let contents: Vec<u8> = case.model.customs.iter().flat_map(Custom::bytes).collect();
            (background_stiffness, background_mass, correlation_length_m, prior_odds, customs, checksum(&contents))
        });
        let sensors: Vec<_> = case
            .sensors
            .iter()
            .map(|one| (&one.channel, &one.point, one.elevation_m, one.direction, one.offset_m, &one.dof))
            .collect();
        let layout = format!("{:?}", case.model.bare().layout());
        let named = [
            ("the model's tables", checksum(&[&tables, layout.as_bytes()].concat())),
            (EFFECTS, checksum(format!("{effects:?}").as_bytes())),
            ("the model's tolerance, odds, groups or custom effects", checksum(format!("{trust:?}").as_bytes())),
            ("the sensors", checksum(format!("{sensors:?}").as_bytes())),
            ("the measured modes", checksum(format!("{:?}", case.measured.modes).as_bytes())),
        ];
        Self(named.into_iter().map(|(name, sum)| (name.to_owned(), sum)).collect())
    }

    /// The same of a result that stands on a model: co-validation predicts by the updated model as well.
    pub(crate) fn for_result(mut self, result: &str, results: &Results) -> Self {
        if result == COVALIDATION_FILE {
            let update = std::fs::read(results.path(UPDATE_FILE)).unwrap_or_default();
            self.0.insert(UPDATE_FILE.to_owned(), checksum(&update));
        }
        self
    }

    /// The names of what differs. Nothing is known of modes that were identified by an older version, or elsewhere.
    pub(crate) fn changed_since<'a>(&'a self, then: &'a Self) -> Vec<&'a str> {
        if then.0.is_empty() {
            return Vec::new();
        }
        let differs = |name: &&String| self.0.get(*name) != then.0.get(*name);
        let mut names: Vec<&str> = self.0.keys().chain(then.0.keys()).filter(differs).map(String::as_str).collect();
        names.sort_unstable();
        names.dedup();
        names
    }
}

/// The file as `study.toml` would name it.
fn name(file: &Path, folder: &Path) -> String {
    file.strip_prefix(folder).unwrap_or(file).display().to_string()
}

fn checksum(bytes: &[u8]) -> String {
    format!("{:016x}", CHECKSUM.checksum(bytes))
}

fn of_recording(path: &PathBuf) -> io::Result<String> {
    let mut file = File::open(path)?;
    let bytes = file.metadata()?.len();
    let mut ends = bytes.to_le_bytes().to_vec();
    file.by_ref().take(END_BYTES).read_to_end(&mut ends)?;
    file.seek(SeekFrom::Start(bytes.saturating_sub(END_BYTES)))?;
    file.take(END_BYTES).read_to_end(&mut ends)?;
    Ok(checksum(&ends))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    const STUDY: &str = "[structure]
name = \"tower\"

[analysis]
band_hz = [0.1, 2.0]

[[setup]]
name = \"north\"
files = [\"*.txt\"]
sampling_rate_hz = 10.0
unit = \"m/s2\"

[[setup.sensor]]
channel = \"1\"
node = 1
elevation_m = 10.0
azimuth_deg = 0
";

    fn changed(change: impl FnOnce(&Path)) -> Vec<String> {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
        write("study.toml", STUDY);
        write("a.txt", &"0.5\n".repeat(5000));
        let inputs = || Inputs::of(&Study::load(folder.path()).unwrap());
        let then = inputs();
        let kept: Inputs = serde_json::from_str(&serde_json::to_string(&then).unwrap()).unwrap();
        change(folder.path());
        inputs().changed_since(&kept).into_iter().map(str::to_owned).collect()
    }

    fn edit(folder: &Path, from: &str, to: &str) {
        assert!(STUDY.contains(from));
        fs::write(folder.join("study.toml"), STUDY.replace(from, to)).unwrap();
    }

    #[test]
    fn what_changed_is_named() {
        assert!(changed(|_| {}).is_empty());
        assert_eq!(changed(|folder| edit(folder, "2.0]", "3.0]")), ["[analysis]"]);
        assert_eq!(changed(|folder| edit(folder, "\"m/s2\"", "\"m/s\"")), ["setup \"north\""]);
        let written =
            |name: &'static str, text: String| changed(move |folder| fs::write(folder.join(name), text).unwrap());
        assert_eq!(written("a.txt", "0.6\n".repeat(5000)), ["a.txt"]);
        assert_eq!(written("b.txt", "0.5\n".to_owned()), ["b.txt"]);
        assert_eq!(changed(|folder| fs::remove_file(folder.join("a.txt")).unwrap()), ["a.txt"]);
    }

    #[test]
    fn where_a_sensor_stands_changes_no_modes() {
        assert!(changed(|folder| edit(folder, "elevation_m = 10.0", "elevation_m = 12.0")).is_empty());
    }

    #[test]
    fn what_a_model_is_held_against_is_named_where_it_changes_and_comments_and_times_do_not_count() {
        use crate::study::template::{CANTON_BEAM, CANTON_STUDY};
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
        let modes = |hz: f64| format!("mode,frequency_hz,01,02\n1,{hz},1.0,0.1\n");
        let measured = "\n[measured]\nmodes = \"modes.csv\"\n[[sensor]]\nchannel = \"01\"\nelevation_m = 446.8\nazimuth_deg = 18\n[[sensor]]\nchannel = \"02\"\nelevation_m = 446.8\nazimuth_deg = 108\n";
        // The template's setups have no recordings; its modes come from a file here.
        let (structure, rest) = CANTON_STUDY.split_at(CANTON_STUDY.find("\n[[setup]]").unwrap());
        let model = &rest[rest.find("\n[model]").unwrap()..];
        let study = format!("{structure}{model}{measured}");
        let now = || Inputs::of_model(&Case::load(Study::load(folder.path()).unwrap()).unwrap());
        write("study.toml", &study);
        write("beam.csv", CANTON_BEAM);
        write("modes.csv", &modes(0.11));
        let then = now();
        let changed = || now().changed_since(&then).join(", ");
        write("study.toml", &format!("# looked at\n{study}"));
        write("beam.csv", CANTON_BEAM);
        assert_eq!(changed(), "");
        write("modes.csv", &modes(0.12));
        assert_eq!(changed(), "the measured modes");
        write("modes.csv", &modes(0.11));
        let (head, last) = CANTON_BEAM.trim_end().rsplit_once('\n').unwrap();
        write("beam.csv", head);
        assert!(!last.starts_with('#') && changed() == "the model's tables", "{}", changed());
        write("beam.csv", CANTON_BEAM);
        write("study.toml", &format!("{study}\n[[model.effect]]\nkind = \"base-rotation\"\nvalue = 1e-15\n"));
        assert_eq!(changed(), "the model's effects");
        write("study.toml", &study.replace("background_mass = 0.01", "background_mass = 0.02"));
        assert_eq!(changed(), "the model's tolerance, odds, groups or custom effects");
        write("study.toml", &study.replace("azimuth_deg = 108", "azimuth_deg = 107"));
        assert_eq!(changed(), "the sensors");
    }

    #[test]
    fn nothing_is_said_of_modes_without_inputs() {
        let now = Inputs(BTreeMap::from([("[analysis]".to_owned(), "1".to_owned())]));
        assert!(now.changed_since(&Inputs::default()).is_empty());
    }
}
