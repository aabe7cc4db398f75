//! `belfry identify`: modes from a study's recordings.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::Args;
use comfy_table::{CellAlignment, Table, presets::UTF8_FULL_CONDENSED};
use serde::Serialize;

use super::Console;
use super::case::{results_folder, write_json, write_result};
use super::route::RouteArguments;
use super::trends::{self, follow_study};
use crate::fleet::FleetReport;
use crate::identify::accuracy::{RecordNeeded, Wish, record_needed};
use crate::identify::{Identification, Mode, identify};
use crate::measure::{Measurement, Route, measure};
use crate::picture::{self, TrueShape};
use crate::spectra::LineGrid;
use crate::study::Study;
use crate::trend::Trend;

const EXAMPLES: &str = "Examples:
  belfry identify canton                       through simulated sensor nodes and their serial lines
  belfry identify canton --direct              straight from the recording; the two agree
  belfry identify canton --damaged-frames 2    on lines that damage 2 % of all frames
  belfry identify canton --json > modes.json
  belfry identify canton --every 1h            what becomes of the modes over the hours (done of itself where a setup
                                               has temperatures)
  belfry identify canton --frequency-within 0.05 --damping-within 5    the record that this would need

`best` in the table is the least deviation that any method could reach on this record (Au 2014). Modes are picked
automatically; in [analysis] of study.toml, add_modes_hz and drop_modes_hz change the choice, modes_hz makes it.

Writes modes.json, singular_values.svg and mode_shapes.svg (with --every also trends.csv and trends.svg) into the study's
folder `results`.";

/// What is identified, in the study's results.
const MODES_FILE: &str = "modes.json";

/// Find the modes: frequency, damping and shape, each with its standard deviation
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    pub study: PathBuf,
    /// Follow the modes over intervals of this length, such as 1h or 30min
    #[arg(long, value_name = "DURATION", value_parser = interval)]
    pub every: Option<Duration>,
    /// Say how long a record would know every frequency within PERCENT (one standard deviation)
    #[arg(long, value_name = "PERCENT", value_parser = share)]
    pub frequency_within: Option<f64>,
    /// Say how long a record would know every damping ratio within PERCENT [default: 10]
    #[arg(long, value_name = "PERCENT", value_parser = share)]
    pub damping_within: Option<f64>,
    /// How spectra are made of the recordings
    #[command(flatten)]
    pub route: RouteArguments,
}

/// An interval of a second at least.
fn interval(text: &str) -> Result<Duration, String> {
    match humantime::parse_duration(text) {
        Ok(duration) if duration >= Duration::from_secs(1) => Ok(duration),
        Ok(_) => Err("expected a second at least".to_owned()),
        Err(error) => Err(format!("{error}; expected a length of time such as 1h or 30min")),
    }
}

/// A wished standard deviation in percent, as a share.
fn share(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(percent) if percent > 0.0 && percent <= 100.0 => Ok(percent / 100.0),
        _ => Err("expected a number above 0, up to 100".to_owned()),
    }
}

impl Arguments {
    /// What is wished; damping within a tenth where nothing is.
    fn wish(&self) -> Wish {
        match (self.frequency_within, self.damping_within) {
            (None, None) => Wish { frequency: None, damping: Some(0.1) },
            (frequency, damping) => Wish { frequency, damping },
        }
    }
}

/// What `--json` prints and `results/modes.json` holds.
#[derive(Debug, Serialize)]
pub struct Report {
    #[serde(flatten)]
    identification: Identification,
    segments: SegmentReport,
    /// The record that a wished accuracy would need.
    #[serde(skip_serializing_if = "Option::is_none")]
    record_needed: Option<Vec<RecordNeeded>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    link: Option<LinkReport>,
    /// The modes over the hours.
    #[serde(skip_serializing_if = "Option::is_none")]
    trends: Option<Trend>,
    timings: TimingReport,
    #[serde(skip)]
    grid: LineGrid,
}

#[derive(Debug, Serialize)]
struct SegmentReport {
    points: usize,
    decimated_rate_hz: f64,
    duration_s: f64,
    /// Why these, and the band where it was chosen.
    reasons: Vec<String>,
}

#[derive(Debug, Serialize)]
struct LinkReport {
    windows: u64,
    lost_windows: u64,
    damaged_frames: u64,
    parts_asked_again: u64,
    bytes_per_second_and_channel: f64,
}

#[derive(Debug, Serialize)]
struct TimingReport {
    recorded_s: f64,
    counting_s: f64,
    reading_s: f64,
    spectra_s: f64,
    averaging_s: f64,
    modes_s: f64,
    times_faster_than_real_time: f64,
}

/// Runs the command.
///
/// # Errors
/// When the study or all of its recordings cannot be read, or hold too little for modes.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    let study = Study::load(&arguments.study)?;
    let mut report = identify_study(&study, arguments.route.route(), console)?;
    let wish = arguments.wish();
    report.record_needed = Some(record_needed(&report.identification, wish));
    write_results(&study, &report, &[])?;
    let is_asked = arguments.every.is_some();
    if let Some(every) = arguments.every.or_else(|| every_of_temperature(&study, &report)) {
        let modes = &report.identification.modes;
        let trend = follow_study(&study, modes, &report.grid, every, arguments.route.route(), console);
        // What was identified stays, also where it cannot be followed.
        match trend.context("the modes are identified, but cannot be followed") {
            Ok(trend) => {
                report.trends = Some(trend);
                write_json(&study, MODES_FILE, &report)?;
            }
            Err(error) if is_asked => return Err(error),
            Err(error) => console.warn(format_args!("{error:#}")),
        }
    }
    console.json(&report)?;
    console.say(format!("\n{}\n", modes_table(&report.identification)));
    for harmonic in &report.identification.harmonics {
        console.say(format!(
            "Forced line at {:.4} Hz (kurtosis {:.2}; a mode has 3): machinery or vortices, not a mode.",
            harmonic.frequency_hz, harmonic.kurtosis
        ));
    }
    for sentence in needs(&report, wish) {
        console.say(sentence);
    }
    console.say(summary(&report));
    if let Some(trend) = &report.trends {
        trends::tell(&study, trend, console);
    }
    console.say(format!("Modes and pictures are in {}.", results_folder(&study).display()));
    if study.model.is_some() {
        console.say(format!("Next: belfry compare {}    the model against these modes", study.folder.display()));
    }
    Ok(())
}

/// Measures, identifies, and warns.
pub(super) fn identify_study(study: &Study, route: Route, console: &Console) -> anyhow::Result<Report> {
    let start = Instant::now();
    let label = match route {
        Route::Nodes(_) => "nodes and link",
        Route::Direct => "spectra",
    };
    let bar = console.progress(0, label);
    let measurement = measure(study, route, &mut |done, total| {
        bar.set_length(total);
        bar.set_position(done);
    });
    bar.finish_and_clear();
    let measurement = measurement?;
    let modes_start = Instant::now();
    let mut identification = identify(&measurement.setups, &study.analysis.modes)?;
    let modes = modes_start.elapsed();
    let mut warnings = measurement.warnings.clone();
    warnings.append(&mut identification.warnings);
    identification.warnings = warnings;
    for warning in &identification.warnings {
        console.warn(warning);
    }
    Ok(report(identification, &measurement, modes, start.elapsed()))
}

impl Report {
    /// The modes.
    pub fn identification(&self) -> &Identification {
        &self.identification
    }
}

fn report(identification: Identification, measurement: &Measurement<'_>, modes: Duration, all: Duration) -> Report {
    let grid = measurement.plan.grid;
    let timings = measurement.timings;
    Report {
        identification,
        segments: SegmentReport {
            points: grid.segment,
            decimated_rate_hz: grid.sampling_rate_hz,
            duration_s: 1.0 / grid.spacing_hz(),
            reasons: measurement.reasons.clone(),
        },
        record_needed: None,
        trends: None,
        grid,
        link: link_report(&measurement.fleets),
        timings: TimingReport {
            recorded_s: measurement.duration_s,
            counting_s: timings.counting.as_secs_f64(),
            reading_s: timings.reading.as_secs_f64(),
            spectra_s: timings.spectra.as_secs_f64(),
            averaging_s: timings.averaging.as_secs_f64(),
            modes_s: modes.as_secs_f64(),
            times_faster_than_real_time: measurement.duration_s / all.as_secs_f64(),
        },
    }
}

fn link_report(fleets: &[FleetReport]) -> Option<LinkReport> {
    let nodes = || fleets.iter().flat_map(|fleet| &fleet.nodes);
    let channel_seconds: f64 =
        fleets.iter().map(|f| f.duration_s * f.nodes.iter().map(|node| node.channels as f64).sum::<f64>()).sum();
    (!fleets.is_empty()).then(|| LinkReport {
        windows: nodes().map(|node| node.session.windows).sum(),
        lost_windows: nodes().map(|node| node.session.lost_windows).sum(),
        damaged_frames: nodes().map(|node| node.to_host.damaged + node.to_node.damaged).sum(),
        parts_asked_again: nodes().map(|node| node.session.asked_again).sum(),
        bytes_per_second_and_channel: nodes().map(|node| node.to_host.bytes).sum::<u64>() as f64 / channel_seconds,
    })
}

/// Where a setup has temperatures, modes are followed without being asked: over this share of the record at a time.
const SHARE_OF_RECORD: f64 = 1.0 / 16.0;

fn every_of_temperature(study: &Study, report: &Report) -> Option<Duration> {
    study.setups.iter().any(|setup| setup.temperature.is_some()).then_some(())?;
    let record_s = report.identification.record_s / study.setups.len() as f64;
    // To a minute, as a user would say it.
    Duration::try_from_secs_f64(60.0 * (SHARE_OF_RECORD * record_s / 60.0).round().max(1.0)).ok()
}

/// Writes modes and pictures into the study; `truth` is one shape a mode, where it is known.
pub(super) fn write_results(study: &Study, report: &Report, truth: &[Option<TrueShape>]) -> anyhow::Result<()> {
    write_json(study, MODES_FILE, report)?;
    let picture = picture::singular_values(&study.structure.name, &report.identification)?;
    write_result(study, "singular_values.svg", picture.as_bytes())?;
    if let Some(picture) = picture::mode_shapes(&study.structure.name, &study.setups, &report.identification, truth)? {
        write_result(study, "mode_shapes.svg", picture.as_bytes())?;
    }
    Ok(())
}

/// The modes as a table; `best` is what no method can go below on the record at hand.
pub(super) fn modes_table(identification: &Identification) -> Table {
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED);
    table.set_header([
        "mode",
        "frequency Hz",
        "± Hz",
        "best ±",
        "damping %",
        "± %",
        "best ±",
        "collinearity",
        "moves most at",
    ]);
    for mode in &identification.modes {
        let most = mode.shape.iter().max_by(|a, b| a.re.hypot(a.im).total_cmp(&b.re.hypot(b.im)));
        table.add_row([
            mode.number.to_string(),
            format!("{:.*}", frequency_digits(mode), mode.frequency_hz),
            deviation(mode.frequency_std_hz, frequency_digits(mode)),
            deviation(mode.frequency_std_bound_hz, frequency_digits(mode)),
            format!("{:.2}", 100.0 * mode.damping_ratio),
            deviation(100.0 * mode.damping_ratio_std, 2),
            deviation(100.0 * mode.damping_ratio_std_bound, 2),
            format!("{:.3}", mode.phase_collinearity),
            most.map_or(String::new(), |component| component.point.clone()),
        ]);
    }
    align_right(&mut table, 8);
    table
}

/// Aligns the first `count` columns to the right, as numbers stand.
pub(super) fn align_right(table: &mut Table, count: usize) {
    for column in table.column_iter_mut().take(count) {
        column.set_cell_alignment(CellAlignment::Right);
    }
}

/// Digits that show the deviation of a frequency with two places, between four and seven.
fn frequency_digits(mode: &Mode) -> usize {
    let places = 1.0 - mode.frequency_std_hz.min(mode.frequency_std_bound_hz).log10().floor();
    if places.is_finite() { places.clamp(4.0, 7.0) as usize } else { 4 }
}

/// How much more record a wish takes, a sentence a wish.
fn needs(report: &Report, wish: Wish) -> Vec<String> {
    let needed = report.record_needed.as_deref().unwrap_or_default();
    let hours = report.identification.record_s / 3600.0;
    let say = |what: &str, share: Option<f64>, of: fn(&RecordNeeded) -> (Option<f64>, Option<f64>)| {
        let percent = 100.0 * share?;
        let most = |a: &&RecordNeeded, b: &&RecordNeeded| of(a).0.unwrap_or(0.0).total_cmp(&of(b).0.unwrap_or(0.0));
        let worst = needed.iter().filter(|mode| of(mode).0.is_some()).max_by(most)?;
        let (needed_h, best_h) = of(worst);
        let needed_h = needed_h?;
        let unknown: Vec<String> =
            needed.iter().filter(|mode| of(mode).0.is_none()).map(|mode| mode.mode.to_string()).collect();
        Some(if needed_h <= hours && unknown.is_empty() {
            format!("Every {what} is known within {percent} %.")
        } else if needed_h <= hours {
            format!(
                "The {what} is known within {percent} % but of mode {}: this record does not say how well.",
                unknown.join(", ")
            )
        } else {
            format!(
                "For every {what} within {percent} % record {needed_h:.1} h instead of {hours:.1} h; mode {} needs most, and the best possible method would need {:.1} h for it.",
                worst.mode,
                best_h.unwrap_or(f64::NAN)
            )
        })
    };
    [
        say("frequency", wish.frequency, |mode| (mode.frequency_h, mode.frequency_best_h)),
        say("damping", wish.damping, |mode| (mode.damping_h, mode.damping_best_h)),
    ]
    .into_iter()
    .flatten()
    .collect()
}

fn deviation(value: f64, digits: usize) -> String {
    if value.is_finite() { format!("{value:.digits$}") } else { "unknown".to_owned() }
}

/// What stands behind the modes, in two or three sentences.
pub(super) fn summary(report: &Report) -> String {
    let mut text = report.segments.reasons.join("\n");
    if let Some(link) = &report.link {
        text += &format!(
            "\n{} windows came over the link, {} lost; {:.2} bytes a second and channel on the wire",
            link.windows, link.lost_windows, link.bytes_per_second_and_channel
        );
        if link.damaged_frames > 0 {
            text += &format!(
                "; {} frames were damaged, {} ranges asked again",
                link.damaged_frames, link.parts_asked_again
            );
        }
        text += ".";
    }
    let t = &report.timings;
    text += &format!(
        "\n{:.0} s of recording were analysed {:.0} times faster than they were recorded: counting {:.2} s, reading {:.2} s, spectra {:.2} s, averaging {:.2} s, modes {:.2} s.",
        t.recorded_s, t.times_faster_than_real_time, t.counting_s, t.reading_s, t.spectra_s, t.averaging_s, t.modes_s
    );
    text
}
