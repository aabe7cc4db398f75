//! `belfry identify`: modes from a study's recordings.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};

use super::Console;
use super::interrupt::{alone, leave_nothing_unfinished};
use super::range::RangeArguments;
use super::route::RouteArguments;
use super::text::{Columns, in_shell, next_lines};
use super::trends;
use crate::identify::accuracy::{RecordNeeded, Wish};
use crate::identify::ssi::SecondOpinion;
use crate::identify::{Harmonic, Identification, ModeMethod, OnInPart};
use crate::statistics::places;
use crate::story::{IdentifyRequest, Method, ModesReport, Project};

const EXAMPLES: &str = "Examples:
  belfry identify canton                       through simulated sensor nodes
  belfry identify canton --direct              straight from the recording
  belfry identify canton --damaged-frames 2    lines damage 2 % of all frames
  belfry identify canton --json > modes.json
  belfry identify canton --every 1h            follow the modes over the hours
  belfry identify tower --last 7d              the last week of a live setup
  belfry identify canton --frequency-within 0.05 --damping-within 5
  belfry identify canton --method subspace     modes by the second method alone

Modes are picked automatically. In [analysis] of study.toml, add_modes_hz and drop_modes_hz change the choice, modes_hz makes it. `best` in the table is the lower bound of the standard deviation on this record (Au 2014). `lines` are spectral lines in the mode's bandwidth, with less than one damping is hardly resolved. `misfit` is about 1, or less, where nothing is missing in the fit. `collinearity` is 1 where all points move in phase, after imaginary parts no larger than their scatter were taken off; warnings name it as measured. `agrees` says whether subspace identification, a method with other assumptions, has the same mode within the standard deviations of both (`-`: it has no such mode; `end`: the mode is too near to the band's end to ask; `alone`: it alone has the mode, and the values are its own). Where a setup has temperatures, modes are followed over the hours without --every.

Writes modes.json, singular_values.svg, mode_shapes.svg, fits.svg (every mode measured and fitted), stabilisation.svg and stabilisation.json (with --every also trends.csv and trends.svg) into the study's folder `results`.";

/// Find the modes: frequency, damping and shape, with standard deviations
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    pub study: PathBuf,
    /// Follow the modes over intervals of this length, such as 1h or 30min
    #[arg(long, value_name = "DURATION", value_parser = interval)]
    pub every: Option<Duration>,
    /// Fit the spectra, identify the subspace, or fit and take the subspace for a second opinion
    #[arg(long, value_enum, default_value_t = MethodArgument::Both)]
    pub method: MethodArgument,
    /// Say how long a record must be to determine every frequency within PERCENT (one standard deviation)
    #[arg(long, value_name = "PERCENT", value_parser = share)]
    pub frequency_within: Option<f64>,
    /// Say how long a record must be to determine every damping ratio within PERCENT [default: 10 without --frequency-within]
    #[arg(long, value_name = "PERCENT", value_parser = share)]
    pub damping_within: Option<f64>,
    /// Which windows of a live setup are analysed
    #[command(flatten)]
    pub range: RangeArguments,
    /// How spectra are made of the recordings
    #[command(flatten)]
    pub route: RouteArguments,
}

/// How modes are identified.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MethodArgument {
    /// A maximum-likelihood fit of the spectra, with a second opinion by the subspace
    Both,
    /// The fit of the spectra alone
    Spectra,
    /// Covariance-driven subspace identification (SSI-cov) alone
    #[value(alias = "ssi")]
    Subspace,
}

impl MethodArgument {
    fn method(self) -> Method {
        match self {
            Self::Both => Method::Both,
            Self::Spectra => Method::Spectra,
            Self::Subspace => Method::Subspace,
        }
    }
}

/// An interval of a second at least.
pub(super) fn interval(text: &str) -> Result<Duration, String> {
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
    /// What is wished.
    fn wish(&self) -> Wish {
        match (self.frequency_within, self.damping_within) {
            (None, None) => Wish::default(),
            (frequency, damping) => Wish { frequency, damping },
        }
    }
}

/// What a forced line is, and how it is told from a mode.
fn forced(harmonic: &Harmonic) -> String {
    let how = if harmonic.on_share < 1.0 {
        format!(", there {:.0} % of the time{}", 100.0 * harmonic.on_share, when(&harmonic.on_by_part))
    } else if harmonic.wanders_hz > 0.0 {
        format!(", wandering within ± {:.4} Hz", harmonic.wanders_hz)
    } else {
        String::new()
    };
    let (hz, what) = (harmonic.frequency_hz, "machinery or vortices, not a mode");
    if harmonic.is_told_by_kurtosis() {
        return format!("Forced line at {hz:.4} Hz{how} (kurtosis {:.2}; a mode has 3): {what}.", harmonic.kurtosis);
    }
    format!("Forced line at {hz:.4} Hz{how} (steadier than a mode's frequency can be): {what}.")
}

/// When a forced line was there most: the parts of the record with at least half of the largest share, joined.
fn when(parts: &[OnInPart]) -> String {
    let most = parts.iter().map(|part| part.on_share).fold(0.0, f64::max);
    let is_on = |part: &&OnInPart| part.on_share >= 0.5 * most;
    let setups: BTreeSet<&str> = parts.iter().map(|part| part.setup.as_str()).collect();
    let mut spans: Vec<(&str, f64, f64)> = Vec::new();
    for part in parts.iter().filter(is_on) {
        match spans.last_mut() {
            Some((setup, _, to_s)) if *setup == part.setup && *to_s == part.from_s => *to_s = part.to_s,
            _ => spans.push((&part.setup, part.from_s, part.to_s)),
        }
    }
    if spans.is_empty() || parts.iter().all(|part| is_on(&part)) {
        return ", on and off throughout the record".to_owned();
    }
    let hours = |(setup, from_s, to_s): &(&str, f64, f64)| {
        let of = if setups.len() > 1 { format!(" of \"{setup}\"") } else { String::new() };
        format!("{:.2} to {:.2} h{of}", from_s / 3600.0, to_s / 3600.0)
    };
    format!(", most at {} of the averaged record", spans.iter().map(hours).collect::<Vec<_>>().join(", "))
}

/// Runs the command.
///
/// # Errors
/// When the study or all of its recordings cannot be read, hold too little for modes, or hold none.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    leave_nothing_unfinished()?;
    let _lock = alone(&arguments.study, console)?;
    let mut project = Project::open(&arguments.study)?;
    let range = arguments.range.range_of(project.study())?;
    project.analyse_only(range);
    let wish = arguments.wish();
    let (route, method) = (arguments.route.route(), arguments.method.method());
    let request = IdentifyRequest { route, method, every: arguments.every, wish: Some(wish) };
    let report = console.with_progress(|on_progress| project.identify(&request, on_progress))?;
    tell_warnings(&report, console);
    console.json("identify-1", &report)?;
    console.say(format!("\n{}\n", modes_table(&report.identification, method == Method::Both)));
    for harmonic in &report.identification.harmonics {
        console.say(forced(harmonic));
    }
    if let Some(first) = report.identification.harmonics.first() {
        console.say(format!(
            "A mode of next to no damping looks like one in a short record: to have it as a mode, name it: add_modes_hz = [{:.4}] in [analysis].",
            first.frequency_hz
        ));
    }
    if let Some(sentence) = report.identification.rejected_in_words() {
        console.say(sentence);
    }
    for sentence in needs(&report, wish) {
        console.say(sentence);
    }
    console.say(summary(&report));
    if let Some(trend) = &report.trends {
        trends::tell(project.results(), trend, console);
    }
    console.say(format!("Modes and pictures are in {}.", project.results().folder().display()));
    if project.study().model.is_some() {
        let study = in_shell(&project.study().folder);
        console.say(next_lines(&[(format!("compare {study}"), "the model against these modes")]));
    }
    Ok(())
}

/// What the reader should know of modes and trends.
pub(super) fn tell_warnings(report: &ModesReport, console: &Console) {
    console.warn_all(&report.identification.warnings);
    if let Some(trend) = &report.trends {
        console.warn_all(&trend.warnings);
    }
}

/// Decimal places that a table shows at most.
const MOST_PLACES: usize = 9;
/// Of what is as many times as large two figures are shown, and one of itself.
const ONE_FIGURE: f64 = 10.0;

/// The modes as a table; `best` is what no method can go below on the record at hand, `agrees` what a second method says.
fn modes_table(identification: &Identification, has_second_opinion: bool) -> Columns {
    let mut headings = vec![
        "mode",
        "frequency Hz",
        "± Hz",
        "best ±",
        "damping %",
        "± %",
        "best ±",
        "lines",
        "misfit",
        "collinearity",
        "moves most at",
    ];
    if has_second_opinion {
        headings.push("agrees");
    }
    let mut table = Columns::new(headings).expendable(&[6, 3, 9, 10, 7, 8]);
    for mode in &identification.modes {
        let most = mode.shape.iter().max_by(|a, b| a.re.hypot(a.im).total_cmp(&b.re.hypot(b.im)));
        let of_frequency = places(&[mode.frequency_std_hz, ONE_FIGURE * mode.frequency_std_bound_hz], 3, MOST_PLACES);
        let (damping_std, damping_bound) = (100.0 * mode.damping_ratio_std, 100.0 * mode.damping_ratio_std_bound);
        let of_damping = places(&[damping_std, ONE_FIGURE * damping_bound], 2, MOST_PLACES);
        let mut row = vec![
            mode.number.to_string(),
            format!("{:.of_frequency$}", mode.frequency_hz),
            deviation(mode.frequency_std_hz, of_frequency),
            deviation(mode.frequency_std_bound_hz, of_frequency),
            format!("{:.of_damping$}", 100.0 * mode.damping_ratio),
            deviation(damping_std, of_damping),
            deviation(damping_bound, of_damping),
            format!("{:.1}", mode.lines_in_bandwidth),
            mode.misfit.map_or("-".to_owned(), |misfit| format!("{misfit:.1}")),
            format!("{:.3}", mode.phase_collinearity),
            most.map_or(String::new(), |component| component.point.clone()),
        ];
        if has_second_opinion {
            let agrees = |opinion: &SecondOpinion| if opinion.agrees { "yes" } else { "no" };
            row.push(match mode.method {
                ModeMethod::Spectra => {
                    let none = if identification.is_at_end(mode) { "end" } else { "-" };
                    mode.second_opinion.as_ref().map_or(none, agrees).to_owned()
                }
                ModeMethod::Subspace => "alone".to_owned(),
            });
        }
        table.row(row);
    }
    table
}

/// How much more record a wish takes, a sentence a wish.
fn needs(report: &ModesReport, wish: Wish) -> Vec<String> {
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
            format!("Every {what} is determined within {percent} %.")
        } else if needed_h <= hours {
            format!(
                "Every {what} is determined within {percent} %, except {} {}, whose uncertainty cannot be estimated from this record.",
                if unknown.len() == 1 { "that of mode" } else { "those of modes" },
                unknown.join(", ")
            )
        } else {
            format!(
                "To determine every {what} within {percent} %, record {needed_h:.1} h instead of {hours:.1} h. Mode {} needs the longest; the best possible method would need {:.1} h.",
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
pub(super) fn summary(report: &ModesReport) -> String {
    let mut text = report.segments.reasons.join("\n");
    if let Some(link) = &report.link {
        text += &format!(
            "\n{} windows came over the link, {} lost; {:.2} bytes per second and channel on the wire",
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
        "\n{:.0} s of recording were analysed {:.0} times faster than they were recorded: counting {:.2} s, reading {:.2} s, spectra {:.2} s, averaging {:.2} s, modes {:.2} s, second opinion {:.2} s.",
        t.recorded_s,
        t.times_faster_than_real_time,
        t.counting_s,
        t.reading_s,
        t.spectra_s,
        t.averaging_s,
        t.modes_s,
        t.second_opinion_s
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::accuracy::tests::found;

    #[test]
    fn a_forced_line_says_what_tells_it_from_a_mode() {
        let line = |kurtosis: f64, on_share: f64| {
            forced(&Harmonic { frequency_hz: 2.5, kurtosis, wanders_hz: 0.0, on_share, on_by_part: Vec::new() })
        };
        assert!(line(1.5, 1.0).contains("(kurtosis 1.50; a mode has 3)"), "{}", line(1.5, 1.0));
        assert!(line(4.4, 0.34).contains("there 34 % of the time"), "{}", line(4.4, 0.34));
        let steady = line(3.2, 1.0);
        assert!(!steady.contains("kurtosis") && steady.contains("steadier than a mode's"), "{steady}");
    }

    #[test]
    fn deviations_have_two_figures_and_none_is_printed_as_nothing() {
        let mut identification = found();
        let mode = &mut identification.modes[0];
        (mode.frequency_hz, mode.frequency_std_hz, mode.frequency_std_bound_hz) = (3.123_456_789, 3.2e-6, 9e-7);
        (mode.damping_ratio, mode.damping_ratio_std, mode.damping_ratio_std_bound) = (2.5e-4, 2.3e-6, 1.9e-7);
        let row = |identification: &Identification| -> Vec<String> {
            let table = modes_table(identification, false).to_string();
            let row = table.lines().find(|line| line.contains("│    1 ┆")).unwrap();
            row.split('┆').map(|cell| cell.trim().to_owned()).skip(1).take(6).collect()
        };
        assert_eq!(row(&identification), ["3.1234568", "0.0000032", "0.0000009", "0.02500", "0.00023", "0.00002"]);
        let mode = &mut identification.modes[0];
        (mode.frequency_std_hz, mode.damping_ratio_std, mode.damping_ratio) = (0.012, f64::INFINITY, 0.012);
        (mode.frequency_std_bound_hz, mode.damping_ratio_std_bound) = (0.004, 0.001);
        assert_eq!(row(&identification), ["3.123", "0.012", "0.004", "1.20", "unknown", "0.10"]);
    }
}
