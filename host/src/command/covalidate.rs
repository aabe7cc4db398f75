//! `belfry covalidate`: predicts left-out sensors through the model's shapes.

use std::path::PathBuf;

use clap::Args;

use super::interrupt::{alone, leave_nothing_unfinished};
use super::text::{Columns, or_dash};
use super::{Console, RangeArguments, RouteArguments};
use crate::story::{ChannelReport, CovalidationReport, CovalidationRequest, Project, Stretch};
use crate::study::{Motion, Setup};

const EXAMPLES: &str = "Examples:
  belfry covalidate canton                             two channels, chosen
  belfry covalidate canton --channels 09,12            these
  belfry covalidate canton --channels 09,12 --direct   straight from the recording
  belfry covalidate canton --start-s 3600 --duration-s 2000

The motion of the left-out channels in the analysis band is predicted from the others: y_d = chi_d (chi_sᵀ chi_s)⁻¹ chi_sᵀ y_s (Lei, Wang, Shen 2012, eq. 16), and E_d = |prediction - measured| / |measured|. Columns: the model as first given, after the last `belfry update`, with the effects that study.toml puts into the model ([[model.effect]]), and with the measured mode shapes themselves, which is about what noise and other modes leave.

Writes covalidation.json, covalidation.csv (the curves) and covalidation.svg into `results`.";

/// Predict left-out sensors from the others through the model's shapes
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    pub study: PathBuf,
    /// Channels to leave out and to predict [default: the two that the others predict best]
    #[arg(long, value_name = "CHANNELS", value_delimiter = ',', value_parser = name)]
    pub channels: Vec<String>,
    /// Numbers of the measured modes whose partners predict, as in 1,2,5 [default: all that have one]
    #[arg(long, value_name = "NUMBERS", value_delimiter = ',')]
    pub modes: Vec<usize>,
    /// The setup to take, where several have the channels [default: the first]
    #[arg(long, value_name = "NAME")]
    pub setup: Option<String>,
    /// Where in the recording to start, in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, value_parser = seconds)]
    pub start_s: f64,
    /// How much of it to take, in seconds [default: all]
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    pub duration_s: Option<f64>,
    /// Which windows of a live setup are taken
    #[command(flatten)]
    pub range: RangeArguments,
    /// How the recording is read
    #[command(flatten)]
    pub route: RouteArguments,
}

fn name(text: &str) -> Result<String, String> {
    match text.trim() {
        "" => Err("expected names of channels, with a comma between two".to_owned()),
        name => Ok(name.to_owned()),
    }
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds >= 0.0 && seconds.is_finite() => Ok(seconds),
        _ => Err("expected seconds, 0 or more".to_owned()),
    }
}

/// Runs the command.
///
/// # Errors
/// When the study has no recording or no model, a channel is unknown, or the kept sensors cannot tell the modes apart.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    leave_nothing_unfinished()?;
    let _lock = alone(&arguments.study, console)?;
    let mut project = Project::open(&arguments.study)?;
    let range = arguments.range.range_of(project.study())?;
    project.analyse_only(range);
    let request = CovalidationRequest {
        channels: arguments.channels.clone(),
        modes: arguments.modes.clone(),
        setup: arguments.setup.clone(),
        stretch: Stretch { start_s: arguments.start_s, duration_s: arguments.duration_s },
        route: arguments.route.route(),
    };
    let report = covalidate_project(&mut project, &request, console)?;
    console.json("covalidate-1", &report)
}

/// Predicts and tells.
pub(super) fn covalidate_project(
    project: &mut Project,
    request: &CovalidationRequest,
    console: &Console,
) -> anyhow::Result<CovalidationReport> {
    console.warn_all(&project.case()?.warnings);
    let report = console.with_progress(|on_progress| project.covalidate(request, on_progress))?;
    console.warn_all(&report.warnings);
    if request.channels.is_empty() {
        let names: Vec<&str> = report.channels.iter().map(|channel| channel.channel.as_str()).collect();
        console.say(format!(
            "No --channels were given: {} chosen, as the others see the motion there best.",
            if let [name] = names[..] { format!("{name} is") } else { format!("{} are", names.join(" and ")) }
        ));
    }
    let measures = |setup: &&Setup| {
        let has = |channel: &ChannelReport| setup.sensors.iter().any(|sensor| sensor.channel == channel.channel);
        request.setup.as_ref().is_none_or(|name| *name == setup.name) && report.channels.iter().all(has)
    };
    let unit = project.study().setups.iter().find(measures).map_or(Motion::Acceleration, Setup::motion).unit();
    tell(&report, unit, &project.results().path("covalidation.svg"), console);
    Ok(report)
}

/// `unit` is that of the motion.
fn tell(report: &CovalidationReport, unit: &str, picture: &std::path::Path, console: &Console) {
    console.say(format!(
        "\nLeft-out channels from the {} others, through {} modes, {:.0} s, {:.3} to {:.3} Hz",
        report.kept_channels.len(),
        report.modes.len(),
        report.compared_s,
        report.band_hz[0],
        report.band_hz[1]
    ));
    let rms = format!("RMS {unit}");
    let mut table = Columns::new([
        "channel",
        &rms,
        "predicted",
        "noise gain",
        "E_d % model",
        "after Psi",
        "with effects",
        "measured shapes",
    ])
    .expendable(&[2, 3]);
    for channel in &report.channels {
        let errors = channel.error_percent;
        table.row([
            channel.channel.clone(),
            format!("{:.3e}", channel.rms_measured),
            channel.rms_predicted.model.map_or_else(|| "-".to_owned(), |rms| format!("{rms:.3e}")),
            format!("{:.2}", channel.noise_gain),
            or_dash(errors.model, 2),
            or_dash(errors.updated, 2),
            or_dash(errors.with_effects, 2),
            or_dash(errors.measured_shapes, 2),
        ]);
    }
    console.say(table);
    console.detail(
        "E_d judges the span of the model's shapes, not its frequencies. A Psi update turns the shapes within that span, so it cannot change E_d, however good its frequencies and MAC look. E_d falls when the model gains physics that its shapes lacked. It does not fall to zero: the noise of the channel itself stays, that of the kept channels (times the noise gain), and the motion of modes that are not among those used. The measured shapes show about how much that is; they have seen the left-out channels, so they may be a little better than true shapes. Compare only results with the same modes and channels.",
    );
    console.detail(format!("Curves: {}", report.curves.display()));
    console.detail(format!("Picture: {}", picture.display()));
}
