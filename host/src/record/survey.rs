//! What recordings say of themselves, before a study describes them: channels, rates, units, lengths and times.
//!
//! Paths flow in; one [`Surveyed`] for each run of files with the same channels and rate flows out. What files do not say stays unknown, and columns
//! that can be no channel are left out and told. Files of several loggers that recorded at the same time can be joined then.

use std::path::{Path, PathBuf};

use super::clock::Clock;
use super::columns::{Columns, Selection, is_time_column};
use super::error::{RecordError, listed};
use super::row_reader::Rows;
use super::source_file::SourceFile;
use super::traces;
use crate::study::{Sensor, Setup};

/// No recording has this rate: a reader that compares it with its own says what that is.
const NO_RATE_HZ: f64 = 1e-12;
/// Rates that differ less, relatively, are one.
const SAME_RATE: f64 = 1e-3;
/// The first number of a column is looked for in so many rows; before it, a word makes it a column of words.
const MOST_EMPTY_ROWS: usize = 4096;
/// The unit that Campbell's loggers give a column that counts rows.
const RECORD_NUMBER: &str = "RN";
/// Clocks of loggers may be so far from UTC.
const MOST_AHEAD_NS: i64 = 14 * 3_600 * 1_000_000_000;

/// Files that may become a setup.
#[derive(Debug, Clone, PartialEq)]
pub struct Surveyed {
    /// In the order of time, or each with channels or parts of them.
    pub files: Vec<PathBuf>,
    /// In the files' order.
    pub channels: Vec<SurveyedChannel>,
    /// What is no channel, and why, in a clause for each reason.
    pub left_out: Vec<String>,
    /// Rows a second, of most channels, or the higher rate where two have as many; `None` where the files do not say it.
    pub rate_hz: Option<f64>,
    /// Whether as many channels have another rate.
    pub is_tie: bool,
    /// Rows of all files together, of the channels at the rate; `None` where only reading shows it, or where they cannot be counted.
    pub rows: Option<u64>,
    /// When the first row was, in UTC, where the files say it.
    pub start_utc: Option<String>,
    /// The loggers whose files stand beside each other.
    loggers: Vec<Logger>,
}

/// Files of one logger: the same columns, one after the other.
#[derive(Debug, Clone, PartialEq)]
struct Logger {
    columns: Columns,
    /// First and last row in nanoseconds since 1970, where files say it.
    span_ns: Option<[i64; 2]>,
    /// Whether these times are of the logger's own clock: nobody knows how far it is ahead of UTC.
    is_local: bool,
}

impl Surveyed {
    /// Whether a channel has the rate of most, or says none.
    pub fn is_at_rate(&self, channel: &SurveyedChannel) -> bool {
        self.rate_hz.is_none_or(|of_most_hz| channel.is_at(of_most_hz))
    }

    /// How many loggers it is of.
    pub fn loggers(&self) -> usize {
        self.loggers.len()
    }

    /// Whether times are of loggers' own clocks, which only the user knows: those of all loggers, or of some.
    pub fn has_local_times(&self) -> bool {
        self.loggers.iter().any(|logger| logger.is_local)
    }

    /// Whether loggers with clocks of their own stand beside others that say UTC.
    pub fn has_mixed_clocks(&self) -> bool {
        self.has_local_times() && self.loggers.iter().any(|logger| !logger.is_local)
    }

    /// What is left out for its rate, in a clause for each rate.
    pub fn at_other_rates(&self) -> Vec<String> {
        let Some(kept_hz) = self.rate_hz else { return Vec::new() };
        let mut rates: Vec<(f64, Vec<&str>)> = Vec::new();
        for channel in self.channels.iter().filter(|channel| !self.is_at_rate(channel)) {
            let Some(rate_hz) = channel.rate_hz else { continue };
            match rates.iter_mut().find(|(other_hz, _)| *other_hz == rate_hz) {
                Some((_, names)) => names.push(&channel.name),
                None => rates.push((rate_hz, vec![&channel.name])),
            }
        }
        let tie = if self.is_tie { " (of as many channels each, the higher rate is kept)" } else { "" };
        let clause = |(rate_hz, names): &(f64, Vec<&str>)| {
            let (which, has) = (named(names), if names.len() == 1 { "has" } else { "have" });
            format!(
                "{which} {has} {rate_hz} Hz, where the setup has {kept_hz} Hz{tie}; a setup of its own can have that rate"
            )
        };
        rates.iter().map(clause).collect()
    }

    /// All that is left out, in sentences that name the files.
    pub fn warnings(&self) -> Vec<String> {
        let file = self.files.first().map(|file| file.display().to_string()).unwrap_or_default();
        let more = self.files.len().saturating_sub(1);
        let files = if more > 0 { format!("{file} and {more} more") } else { file };
        self.left_out
            .iter()
            .cloned()
            .chain(self.at_other_rates())
            .map(|what| format!("{files}: left out: {what}"))
            .collect()
    }
}

/// A channel as its file describes it.
#[derive(Debug, Clone, PartialEq)]
pub struct SurveyedChannel {
    /// What a sensor's `channel` would be.
    pub name: String,
    /// Its own rate.
    pub rate_hz: Option<f64>,
    /// The word for its unit that study.toml has, where it is one of these.
    pub unit: Option<&'static str>,
    /// The file's own word for it.
    pub unit_as_written: Option<String>,
}

impl SurveyedChannel {
    fn is_at(&self, rate_hz: f64) -> bool {
        self.rate_hz.is_none_or(|own_hz| is_same(own_hz, rate_hz))
    }
}

/// Looks into files.
///
/// # Errors
/// [`RecordError`] names the file that cannot be read, or whose format is unknown.
pub fn survey(paths: Vec<PathBuf>) -> Result<Vec<Surveyed>, RecordError> {
    let mut found: Vec<Surveyed> = Vec::new();
    for file in SourceFile::all(paths)? {
        let one = survey_one(&file)?;
        match found.last_mut().filter(|last| last.has_columns_of(&one)) {
            Some(last) => last.append(one),
            None => found.push(one),
        }
    }
    Ok(found)
}

/// Puts loggers with other channels that recorded at the same time into one setup, as a recording stands them beside each other.
pub fn joined(found: Vec<Surveyed>) -> Vec<Surveyed> {
    let mut setups: Vec<Surveyed> = Vec::new();
    for one in found {
        match setups.iter_mut().find(|setup| setup.can_take(&one)) {
            Some(setup) => setup.take(one),
            None => setups.push(one),
        }
    }
    setups
}

impl Surveyed {
    fn is_at_rate_of(&self, other: &Self) -> bool {
        match (self.rate_hz, other.rate_hz) {
            (Some(one_hz), Some(other_hz)) => is_same(one_hz, other_hz),
            (one, other) => one == other,
        }
    }

    fn has_columns_of(&self, other: &Self) -> bool {
        let columns = |one: &Self| one.loggers.iter().map(|logger| logger.columns.clone()).collect::<Vec<_>>();
        columns(self) == columns(other) && self.is_at_rate_of(other)
    }

    /// Takes the files that follow: a channel must be one in all of them.
    fn append(&mut self, next: Self) {
        self.channels.retain(|channel| next.channels.iter().any(|other| other.name == channel.name));
        self.take_files(next.files, next.left_out);
        let rows = self.rows.zip(next.rows).map(|(rows, more)| rows + more);
        self.loggers.iter_mut().zip(&next.loggers).for_each(|(logger, next)| logger.follow(next));
        // Where files say when they were, what is missing between them counts.
        let spans = self.loggers.iter().filter_map(|logger| logger.span_ns);
        let spanned = spans.map(|[start, end]| ((end - start) as f64 * 1e-9 * self.rate_hz.unwrap_or(0.0)).round());
        self.rows = rows.map(|rows| spanned.fold(rows, |rows, spanned| rows.max(spanned as u64)));
    }

    fn take_files(&mut self, files: Vec<PathBuf>, left_out: Vec<String>) {
        self.files.extend(files);
        for what in left_out {
            if !self.left_out.contains(&what) {
                self.left_out.push(what);
            }
        }
    }

    /// Whether another logger's files stand beside these, or follow one of these loggers'.
    fn can_take(&self, other: &Self) -> bool {
        let ([.., _], [theirs]) = (self.loggers.as_slice(), other.loggers.as_slice()) else { return false };
        if self.rate_hz.is_none() || !self.is_at_rate_of(other) {
            return false;
        }
        if let Some(same) = self.loggers.iter().find(|logger| logger.columns == theirs.columns) {
            // Runs of one logger are parted where files of another stand between them.
            return self.loggers.len() > 1 && same.is_followed_by(theirs);
        }
        let has_own_names = |logger: &Logger| {
            let finds = |columns: &Columns, channel: &SurveyedChannel| {
                !matches!(columns.find(&channel.name, Path::new("")), Err(RecordError::UnknownChannel { .. }))
            };
            !other.channels.iter().any(|channel| finds(&logger.columns, channel))
                && !self.channels.iter().any(|channel| finds(&theirs.columns, channel))
        };
        self.loggers.iter().all(has_own_names) && self.loggers.iter().any(|logger| logger.overlaps(theirs))
    }

    fn take(&mut self, other: Self) {
        for theirs in other.loggers {
            match self.loggers.iter_mut().find(|logger| logger.columns == theirs.columns) {
                Some(logger) => logger.follow(&theirs),
                None => {
                    self.channels.extend(other.channels.iter().cloned());
                    self.loggers.push(theirs);
                }
            }
        }
        self.take_files(other.files, other.left_out);
        self.is_tie |= other.is_tie;
        // Only reading them beside each other shows how many rows they make.
        self.rows = None;
        let starts = self.loggers.iter().filter(|logger| !logger.is_local).filter_map(|logger| logger.span_ns);
        self.start_utc =
            starts.map(|[start_ns, _]| start_ns).min().filter(|_| !self.has_mixed_clocks()).map(traces::utc);
    }
}

impl Logger {
    /// Goes on with another run of its files.
    fn follow(&mut self, next: &Self) {
        self.span_ns = self.span_ns.zip(next.span_ns).map(|([start, _], [_, end])| [start, end]);
    }

    /// Whether another run begins where this one ends or later; a clock that runs apart from the rate may say a bit earlier.
    fn is_followed_by(&self, next: &Self) -> bool {
        self.span_ns.zip(next.span_ns).is_some_and(|([from, end], [start, _])| start >= end - (end - from) / 100)
    }

    /// Whether both recorded at the same time, or may have where only one of them says UTC.
    fn overlaps(&self, other: &Self) -> bool {
        let Some(([start, end], [other_start, other_end])) = self.span_ns.zip(other.span_ns) else { return false };
        let leeway_ns = if self.is_local == other.is_local { 0 } else { MOST_AHEAD_NS };
        start < other_end.saturating_add(leeway_ns) && other_start < end.saturating_add(leeway_ns)
    }
}

fn survey_one(file: &SourceFile) -> Result<Surveyed, RecordError> {
    let asked = Setup::new("", NO_RATE_HZ, Vec::new());
    let (columns, of_times_hz) = match file.inspect(&asked) {
        Ok(columns) => (columns, None),
        Err(RecordError::RateDiffers { measured_hz, .. }) => {
            // With its own rate its columns are told.
            (file.inspect(&Setup { sampling_rate_hz: measured_hz, ..asked.clone() })?, Some(rounded(measured_hz)))
        }
        Err(error) => return Err(error),
    };
    let said = file.said(&asked)?;
    let names: Vec<String> = match &columns {
        Columns::Named(names) | Columns::Paths(names) => names.clone(),
        Columns::Numbered(count) => (1..=*count).map(|number| number.to_string()).collect(),
        Columns::Responses(names) => names.iter().map(ToString::to_string).collect(),
    };
    let is_time = |name: &str| {
        matches!(columns, Columns::Named(_)) && (is_time_column(name, &[]) || said.time.as_deref() == Some(name))
    };
    let all: Vec<SurveyedChannel> = (0..)
        .zip(&names)
        .map(|(at, name)| {
            let (rate_hz, unit_as_written) = said.channels.get::<usize>(at).cloned().unwrap_or_default();
            let unit = unit_as_written.as_deref().and_then(unit_of);
            let rate_hz = rate_hz.map(rounded).or(of_times_hz);
            SurveyedChannel { name: name.clone(), rate_hz, unit, unit_as_written }
        })
        .collect();
    let (mut channels, mut left_out) = usable_channels(all, is_time);
    left_out.extend(said.others.clone());
    let with_rate = Setup { sampling_rate_hz: of_times_hz.unwrap_or(1.0), ..asked.clone() };
    if file.may_hold_words() {
        let words = columns_of_words(file, &with_rate, &columns, &channels);
        // Where all are words the file is no table of numbers: what reads it says where it is wrong.
        if words.len() < channels.len() && !words.is_empty() {
            let holds = if words.len() == 1 { "holds" } else { "hold" };
            left_out.push(format!("{} {holds} no numbers", named(&words)));
            channels.retain(|channel| !words.contains(&channel.name));
        }
    }
    let rate_hz = most_common(channels.iter().filter_map(|channel| channel.rate_hz));
    let is_kept = |channel: &&SurveyedChannel| rate_hz.is_none_or(|rate_hz| channel.is_at(rate_hz));
    let kept = channels.iter().filter(is_kept).map(|channel| Sensor::new(channel.name.clone(), 1)).collect();
    let counted = Setup { sampling_rate_hz: rate_hz.unwrap_or(1.0), sensors: kept, ..asked };
    // What cannot be counted cannot be read: whoever reads it says why.
    let rows = file.count_rows(&counted, &mut Clock::new(counted.sampling_rate_hz)).ok();
    let is_known = |start_ns: &i64| *start_ns > 0;
    let start_ns = if counted.sensors.len() == channels.len() {
        said.start_ns.filter(is_known)
    } else {
        file.said(&counted).ok().and_then(|said| said.start_ns).filter(is_known)
    };
    let local_ns = said.local_ns.filter(is_known);
    let end_ns = |start_ns: i64| Some(start_ns.saturating_add((rows? as f64 / rate_hz? * 1e9) as i64));
    let span_ns = start_ns.or(local_ns).and_then(|start_ns| Some([start_ns, end_ns(start_ns)?]));
    let logger = Logger { columns, span_ns, is_local: local_ns.is_some() };
    let rates = channels.iter().filter_map(|channel| channel.rate_hz);
    Ok(Surveyed {
        is_tie: rate_hz.is_some_and(|rate_hz| has_tie(rates, rate_hz)),
        files: file.paths().map(Path::to_path_buf).collect(),
        channels,
        left_out,
        rate_hz,
        rows,
        start_utc: start_ns.map(traces::utc),
        loggers: vec![logger],
    })
}

/// Channels that a sensor can name, and clauses about the others.
fn usable_channels(all: Vec<SurveyedChannel>, is_time: impl Fn(&str) -> bool) -> (Vec<SurveyedChannel>, Vec<String>) {
    let mut left_out = Vec::new();
    let numbers = |is_so: &dyn Fn(&SurveyedChannel) -> bool| -> Vec<usize> {
        (1..).zip(&all).filter(|(_, channel)| is_so(channel)).map(|(number, _)| number).collect()
    };
    let counts = |channel: &SurveyedChannel| channel.unit_as_written.as_deref() == Some(RECORD_NUMBER);
    let is_nameless = |channel: &SurveyedChannel| channel.name.trim().is_empty();
    let is_again = |channel: &SurveyedChannel| all.iter().filter(|other| other.name == channel.name).count() > 1;
    let nameless = numbers(&is_nameless);
    match nameless.as_slice() {
        [] => {}
        [one] => left_out.push(format!("column {one} has no name; give it one to use it")),
        several => left_out.push(format!("columns {} have no names; give them names to use them", listed(several, ""))),
    }
    let mut told: Vec<&str> = Vec::new();
    for channel in all.iter().filter(|channel| !is_nameless(channel) && is_again(channel)) {
        if !told.contains(&channel.name.as_str()) {
            told.push(&channel.name);
            let columns = numbers(&|other| other.name == channel.name);
            left_out.push(format!(
                "columns {} are all called {}; give each a name of its own to use them",
                listed(columns, ""),
                listed([channel.name.escape_debug()], "`"),
            ));
        }
    }
    let counting: Vec<&str> =
        all.iter().filter(|channel| counts(channel)).map(|channel| channel.name.as_str()).collect();
    if !counting.is_empty() {
        left_out.push(format!("{} counts rows", named(&counting)));
    }
    let is_channel = |channel: &&SurveyedChannel| {
        !is_time(&channel.name) && !is_nameless(channel) && !is_again(channel) && !counts(channel)
    };
    let channels = all.iter().filter(is_channel).cloned().collect();
    (channels, left_out)
}

/// Names of the channels whose first cell that is not empty is a word.
fn columns_of_words(file: &SourceFile, setup: &Setup, columns: &Columns, channels: &[SurveyedChannel]) -> Vec<String> {
    let names: Vec<String> = channels.iter().map(|channel| channel.name.clone()).collect();
    // Most files have none, and show it in their first row.
    if first_number(file, setup, columns, &names) == Some(true) {
        return Vec::new();
    }
    let is_words = |name: &String| first_number(file, setup, columns, std::slice::from_ref(name)) == Some(false);
    names.iter().filter(|name| is_words(name)).cloned().collect()
}

/// Whether the first row of some columns without an empty cell has numbers (`true`), or words before it (`false`); `None` where there is neither.
fn first_number(file: &SourceFile, setup: &Setup, columns: &Columns, names: &[String]) -> Option<bool> {
    let sensors = names.iter().map(|name| Sensor::new(name.clone(), 1)).collect();
    let setup = Setup { sensors, ..setup.clone() };
    let is_word =
        |error: &RecordError| matches!(error, RecordError::NotANumber { .. } | RecordError::ParquetType { .. });
    let selection = Selection::new(&setup, columns, &file.path).ok()?;
    let mut reader = match file.open(&setup) {
        Ok(reader) => reader,
        Err(error) => return is_word(&error).then_some(false),
    };
    let mut clock = Clock::new(setup.sampling_rate_hz);
    let mut values = Vec::new();
    for _ in 0..MOST_EMPTY_ROWS {
        values.clear();
        match reader.read(1, &mut Rows { selection: &selection, clock: &mut clock, values: &mut values }) {
            Ok(0) => return None,
            Ok(_) if values.iter().any(|value| value.is_nan()) => {}
            Ok(_) => return Some(true),
            Err(error) => return is_word(&error).then_some(false),
        }
    }
    None
}

/// Channels in a clause, as study.toml and a terminal can have them.
fn named(names: &[impl AsRef<str>]) -> String {
    let what = if names.len() == 1 { "channel" } else { "channels" };
    format!("{what} {}", listed(names.iter().map(|name| name.as_ref().escape_debug().to_string()), "`"))
}

/// A rate without what single precision and the rounding of times make of it: 50 and not 49.99999.
fn rounded(rate_hz: f64) -> f64 {
    const AS_GOOD_AS_WHOLE: f64 = 1e-5;
    let whole = rate_hz.round();
    if whole > 0.0 && (rate_hz / whole - 1.0).abs() < AS_GOOD_AS_WHOLE { whole } else { rate_hz }
}

/// The rate of most; of two that as many have, the higher.
fn most_common(rates_hz: impl Iterator<Item = f64> + Clone) -> Option<f64> {
    let count = |rate_hz: f64| count_at(rates_hz.clone(), rate_hz);
    rates_hz.clone().max_by(|a, b| count(*a).cmp(&count(*b)).then(a.total_cmp(b)))
}

/// Whether another rate has as many channels.
fn has_tie(rates_hz: impl Iterator<Item = f64> + Clone, kept_hz: f64) -> bool {
    let count = |rate_hz: f64| count_at(rates_hz.clone(), rate_hz);
    let kept = count(kept_hz);
    rates_hz.clone().any(|rate_hz| !is_same(rate_hz, kept_hz) && count(rate_hz) == kept)
}

fn count_at(rates_hz: impl Iterator<Item = f64>, rate_hz: f64) -> usize {
    rates_hz.filter(|other_hz| is_same(*other_hz, rate_hz)).count()
}

fn is_same(one_hz: f64, other_hz: f64) -> bool {
    (one_hz / other_hz - 1.0).abs() < SAME_RATE
}

/// The unit of study.toml that a file's word stands for.
fn unit_of(written: &str) -> Option<&'static str> {
    let plain: String = written.chars().filter(|c| !matches!(c, ' ' | '^' | '*' | '[' | ']' | '(' | ')')).collect();
    Some(match plain.replace('²', "2").to_lowercase().as_str() {
        "m/s2" | "m/s/s" | "ms-2" | "m/sec2" | "m.s-2" => "m/s2",
        "g" | "gn" | "g0" | "grav" => "g",
        "v" | "volt" | "volts" => "V",
        "m/s" | "ms-1" | "m/sec" => "m/s",
        "m" | "meter" | "metre" | "meters" | "metres" => "m",
        "rad" | "radian" | "radians" => "rad",
        "strain" | "m/m" => "strain",
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tables of these contents, looked into.
    fn tables(files: &[(&str, &str)]) -> Vec<Surveyed> {
        let folder = tempfile::tempdir().unwrap();
        let path = |(name, text): &(&str, &str)| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            path
        };
        survey(files.iter().map(path).collect()).unwrap()
    }

    /// Rows of 50 Hz, from some seconds since 1970 on.
    fn unix_times(channels: &[&str], from_s: f64, rows: u32) -> String {
        let cells = |row: u32| format!(",{row}").repeat(channels.len());
        let row = |row: u32| format!("{:.2}{}\n", from_s + 0.02 * f64::from(row), cells(row));
        format!("time,{}\n{}", channels.join(","), (0..rows).map(row).collect::<String>())
    }

    /// The same as a Campbell logger writes it, from 12:00:`from_s` on.
    fn toa5(channel: &str, from_s: u32, rows: u32) -> String {
        let row = |row: u32| {
            format!("\"2026-03-01 12:00:{:02}.{:02}\",{row},{row},\"OK\"\r\n", from_s + row / 50, row % 50 * 2)
        };
        format!(
            "\"TOA5\",\"mast\"\r\n\"TIMESTAMP\",\"RECORD\",\"{channel}\",\"State\"\r\n\"TS\",\"RN\",\"g\",\"\"\r\n\"\",\"\",\"Smp\",\"Smp\"\r\n{}",
            (0..rows).map(row).collect::<String>()
        )
    }

    #[test]
    fn columns_that_can_be_no_channel_are_left_out_and_told() {
        let one = &tables(&[("a.csv", "x,note,twice,,twice,y\n1,,2,3,4,5\n1,calm,2,3,4,5\n")])[0];
        assert_eq!(names(one), ["x", "y"]);
        let told = one.warnings().join("\n");
        for part in [
            "a.csv: left out: column 4 has no name",
            "columns 3, 5 are all called `twice`",
            "channel `note` holds no numbers",
        ] {
            assert!(told.contains(part), "{part} is not in\n{told}");
        }
        let logger = &tables(&[("a.dat", &toa5("top", 0, 60))])[0];
        assert_eq!((names(logger), logger.rate_hz, logger.rows), (vec!["top"], Some(50.0), Some(60)));
        let told = logger.warnings().join("\n");
        assert!(told.contains("`RECORD` counts rows") && told.contains("`State` holds no numbers"), "{told}");
        // Words alone are a file that is no table: whoever reads it says so.
        let text = &tables(&[("a.txt", "some words\nand more\n")])[0];
        assert_eq!((names(text), text.warnings().len()), (vec!["1", "2"], 0));
        // One bad cell makes no column of words.
        assert_eq!(names(&tables(&[("a.csv", "x,y\n1,2\n1,bad\n")])[0]), ["x", "y"]);
    }

    #[test]
    fn of_several_rates_most_channels_decide_and_of_as_many_the_higher() {
        let channel = |name: &str, rate_hz: f64| SurveyedChannel {
            name: name.to_owned(),
            rate_hz: Some(rate_hz),
            unit: None,
            unit_as_written: None,
        };
        let rates = |rates_hz: &[f64]| {
            let kept_hz = most_common(rates_hz.iter().copied()).unwrap();
            (kept_hz, has_tie(rates_hz.iter().copied(), kept_hz))
        };
        assert_eq!(rates(&[5.0, 50.0]), (50.0, true));
        assert_eq!(rates(&[50.0, 5.0]), (50.0, true));
        assert_eq!(rates(&[5.0, 50.0, 5.0]), (5.0, false));
        let mut one = look(&["same.npy"]).remove(0);
        (one.rate_hz, one.is_tie) = (Some(50.0), true);
        one.channels = vec![channel("fast", 50.0), channel("slow", 5.0)];
        let told = one.warnings();
        assert_eq!(told.len(), 1, "{told:?}");
        assert!(
            told[0].contains("`slow` has 5 Hz, where the setup has 50 Hz (of as many channels each, the higher rate"),
            "{told:?}"
        );
        assert!(!told[0].contains("fast"), "{told:?}");
    }

    #[test]
    fn loggers_that_recorded_at_the_same_time_become_one_setup() {
        const START_S: f64 = 1_772_366_400.0;
        let of = |files: &[(&str, &str)]| joined(tables(files));
        let (x, y) = (unix_times(&["x"], START_S, 200), unix_times(&["y"], START_S + 1.0, 100));
        let both = of(&[("x.csv", &x), ("y.csv", &y)]);
        assert_eq!((both.len(), names(&both[0]), both[0].loggers(), both[0].rows), (1, vec!["x", "y"], 2, None));
        assert_eq!(both[0].start_utc.as_deref(), Some("2026-03-01T12:00:00.000Z"));
        // Another day, or the same name: setups of their own.
        let later = unix_times(&["y"], START_S + 86_400.0, 100);
        assert_eq!(of(&[("x.csv", &x), ("y.csv", &later)]).len(), 2);
        let again = unix_times(&["z", "x"], START_S, 200);
        assert_eq!(of(&[("x.csv", &x), ("z.csv", &again)]).len(), 2);
        // A second file of the first logger behind one of the other.
        let next = unix_times(&["x"], START_S + 4.0, 50);
        let three = of(&[("x1.csv", &x), ("y.csv", &y), ("x2.csv", &next)]);
        assert_eq!((three.len(), three[0].files.len(), three[0].loggers()), (1, 3, 2));
        // Of a Campbell logger nobody knows how far its clock is ahead of UTC.
        let mixed = of(&[("x.csv", &x), ("t.dat", &toa5("top", 0, 60))]);
        assert_eq!((mixed.len(), names(&mixed[0])), (1, vec!["x", "top"]));
        assert!(mixed[0].has_mixed_clocks() && mixed[0].start_utc.is_none());
        let campbell = of(&[("a.dat", &toa5("low", 0, 60)), ("b.dat", &toa5("top", 1, 60))]);
        assert_eq!((campbell.len(), names(&campbell[0])), (1, vec!["low", "top"]));
        assert!(campbell[0].has_local_times() && !campbell[0].has_mixed_clocks());
    }

    fn look(names: &[&str]) -> Vec<Surveyed> {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests-data"));
        survey(names.iter().map(|name| folder.join(name)).collect()).unwrap()
    }

    fn names(one: &Surveyed) -> Vec<&str> {
        one.channels.iter().map(|channel| channel.name.as_str()).collect()
    }

    #[test]
    fn files_of_other_programs_say_channels_rates_and_units() {
        for (file, channels, units) in [
            ("h5py_channels.h5", ["run 1/top-x", "run 1/top-y"], Some("m/s2")),
            ("h5py_matrix.h5", ["1", "2"], None),
            ("soundfile_pcm24.wav", ["1", "2"], None),
            ("obspy_steim2.mseed", ["XX.MAST.00.HNX", "XX.MAST.00.HNY"], None),
            ("interleaved.tdms", ["run 1/top-x", "run 1/top-y"], None),
        ] {
            let found = look(&[file]);
            assert_eq!(found.len(), 1);
            assert_eq!(
                (names(&found[0]), found[0].rate_hz, found[0].rows),
                (channels.to_vec(), Some(50.0), Some(300)),
                "{file}"
            );
            assert!(found[0].channels.iter().all(|channel| channel.unit == units), "{file}");
        }
        let tdms = &look(&["nptdms.tdms"])[0];
        // Its channel of words is none.
        assert_eq!(names(tdms), ["run 1/top-x", "run 1/top-y"]);
        assert_eq!(tdms.channels[0].unit, Some("m/s2"));
        assert_eq!(tdms.channels[0].unit_as_written.as_deref(), Some("m/s^2"));
        let numbers = &look(&["same.npy"])[0];
        assert_eq!((names(numbers), numbers.rate_hz, numbers.rows), (vec!["1", "2"], None, Some(300)));
    }

    #[test]
    fn loggers_say_units_and_when_they_began() {
        let one = &look(&["gantner.dat"])[0];
        assert_eq!((one.rate_hz, one.rows, one.channels[5].name.as_str()), (Some(1000.0), Some(500), "TC1"));
        assert_eq!(one.channels[5].unit_as_written.as_deref(), Some("°C"));
        let one = &look(&["udbf_little.dat"])[0];
        assert_eq!((names(one), one.rate_hz, one.rows), (vec!["top-x", "top-y"], Some(50.0), Some(300)));
        assert_eq!(one.channels[0].unit, Some("m/s2"));
        assert_eq!(one.start_utc.as_deref(), Some("2026-03-01T12:00:00.250Z"));
        let folder = tempfile::tempdir().unwrap();
        let table = folder.path().join("a.csv");
        std::fs::write(&table, "time,x\ns,g\n1772366400.25,1\n1772366400.27,2\n1772366400.29,3\n").unwrap();
        let one = &survey(vec![table]).unwrap()[0];
        assert_eq!(
            (one.rate_hz.map(f64::round), one.start_utc.as_deref()),
            (Some(50.0), Some("2026-03-01T12:00:00.250Z"))
        );
        assert_eq!(one.channels[0].unit, Some("g"));
    }

    #[test]
    fn what_is_no_channel_in_hdf5_is_told_and_times_say_the_rate() {
        let one = &look(&["h5py_gap.h5"])[0];
        assert_eq!((names(one), one.rate_hz), (vec!["short", "top-x", "top-y"], Some(50.0)));
        assert_eq!(one.start_utc.as_deref(), Some("2026-03-01T12:00:00.250Z"));
        assert_eq!(one.left_out, ["`weights` (10), much shorter than the longest channel and without a rate"]);
        let one = &look(&["scipy_vectors.mat"])[0];
        assert_eq!((names(one), one.rate_hz, one.rows), (vec!["top_x", "top_y"], Some(50.0), Some(300)));
    }

    #[test]
    fn a_time_column_says_the_rate_and_is_no_channel() {
        let table = &look(&["pyarrow_gzip.parquet"])[0];
        assert_eq!(table.rate_hz, Some(50.0));
        assert!(!names(table).contains(&"time_s"));
    }

    #[test]
    fn traces_share_a_line_of_time_and_others_become_setups_of_their_own() {
        let found = look(&["obspy_HNX.sac", "obspy_HNY.sac", "soundfile_float.wav", "soundfile_pcm24.wav"]);
        assert_eq!(found.iter().map(|one| one.files.len()).collect::<Vec<_>>(), [2, 2]);
        assert_eq!(names(&found[0]), ["XX.MAST.00.HNX", "XX.MAST.00.HNY"]);
        assert_eq!(found[0].start_utc.as_deref(), Some("2026-03-01T12:00:00.000Z"));
        assert_eq!(found[1].rows, Some(600));
        let parts = look(&["obspy_part1.mseed", "obspy_part2.mseed"]);
        assert_eq!((parts.len(), parts[0].rows, parts[0].rate_hz), (1, Some(300), Some(50.0)));
    }
}
