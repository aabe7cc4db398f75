//! `belfry archive`: the collected windows themselves, checked, repaired, pruned and written elsewhere.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, bail};
use belfry_shared::time::HostTime;
use clap::{Args, Subcommand};
use serde::Serialize;

use super::Console;
use super::interrupt::leave_nothing_unfinished;
use super::range::{RangeArguments, duration};
use super::text::{Columns, in_shell};
use crate::archive::{Archive, ArchiveError, CheckReport, Damage, DamagedHour, ListedLoss, PruneReport, moment};
use crate::collect::{Clock, SystemClock};
use crate::heartbeats::{self, HEARTBEATS_FILE};
use crate::numbers::{counted, is_or_are};
use crate::study::Study;
use crate::window::LossReason;

const EXAMPLES: &str = "Examples:
  belfry archive check tower
  belfry archive repair tower
  belfry archive prune tower --keep 30d --dry-run
  belfry archive export tower --last 7d --output week.sqlite
  belfry archive export tower --from 2026-11-02 --to 2026-11-03 --output day.csv

Every window has a checksum. Damaged windows are left out of every analysis, with a warning; `check` lists them, and `repair` saves what can be saved. Nothing is ever dropped unless you prune.";

/// Check, repair, prune or export the windows that nodes have sent
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    #[command(subcommand)]
    step: Step,
}

#[derive(Debug, Subcommand)]
enum Step {
    /// Hold every row against its checksum, and have SQLite check the file; nothing is changed
    Check(Check),
    /// Save what is not damaged into a new archive; the old one is kept under another name
    Repair(Repair),
    /// Drop windows that are older than what is to be kept
    Prune(Prune),
    /// Write the windows of a range of time into another archive, or a table
    Export(Export),
}

#[derive(Debug, Args)]
struct Check {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    study: PathBuf,
}

#[derive(Debug, Args)]
#[command(
    after_help = "A row of which a single bit has changed is mended from its checksum. Stop `belfry collect` first; nodes keep their windows meanwhile. It takes as much room again as the archive has."
)]
struct Repair {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    study: PathBuf,
}

#[derive(Debug, Args)]
#[command(
    after_help = "What is kept is counted back from the newest window, so that nothing is dropped while nobody collects. It works while `belfry collect` runs. To do it every night, have cron run: belfry archive prune STUDY --keep 90d"
)]
struct Prune {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    study: PathBuf,
    /// How much to keep, such as 30d or 1year
    #[arg(long, value_name = "DURATION", value_parser = duration)]
    keep: Duration,
    /// Say what would be dropped, and drop nothing
    #[arg(long)]
    dry_run: bool,
}

#[derive(Debug, Args)]
#[command(
    after_help = "A file that ends in .sqlite is an archive as `belfry collect` writes it: put it into another study's folder as archive.sqlite. One that ends in .csv has a row for each line of each channel. Lines of all nodes side by side, and averaged spectra, come from `belfry export --of lines` and `--of psd`, which take the same ranges."
)]
struct Export {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    study: PathBuf,
    #[command(flatten)]
    range: RangeArguments,
    /// The file to write, ending in .sqlite or .csv
    #[arg(long, value_name = "FILE")]
    output: PathBuf,
}

/// What `belfry archive prune --json` prints.
#[derive(Debug, Serialize)]
struct Pruned<'a> {
    #[serde(flatten)]
    found: &'a PruneReport,
    /// Windows that were dropped, or would be.
    windows: u64,
    /// Heartbeats from before.
    heartbeats: u64,
    dry_run: bool,
}

/// What `belfry archive export --json` prints.
#[derive(Debug, Serialize)]
struct Exported<'a> {
    file: &'a Path,
    windows: u64,
    damages: &'a [Damage],
}

/// Runs the command.
///
/// # Errors
/// When there is no archive, it is damaged (on a check), or cannot be read or written.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    leave_nothing_unfinished()?;
    match &arguments.step {
        Step::Check(check) => run_check(&folder(&check.study)?, console),
        Step::Repair(repair) => run_repair(&folder(&repair.study)?, console),
        Step::Prune(prune) => run_prune(prune, console),
        Step::Export(export) => run_export(export, console),
    }
}

/// The folder of a study, which is one.
fn folder(study: &Path) -> anyhow::Result<PathBuf> {
    Ok(Study::load(study)?.folder)
}

fn run_check(folder: &Path, console: &Console) -> anyhow::Result<()> {
    let report = Archive::check(folder)?;
    console.json("archive-check-1", &report)?;
    let CheckReport { archive, version, bytes, sound_windows, damages, structure, lost, lost_in_repairs, is_sound } =
        &report;
    for line in losses(lost).into_iter().chain(repairs(lost_in_repairs)) {
        console.say(line);
    }
    let size = format!("{:.1} MB", *bytes as f64 * 1e-6);
    let windows = of_nodes(*sound_windows);
    if *version == 1 && *is_sound {
        console.say(format!("{}, {size}: {windows}. Its tables are of version 1 and have no checksums, so changed numbers cannot be told; whatever reads it next brings it up to date.", archive.display()));
        return Ok(());
    }
    if *is_sound {
        console.say(format!("{}, {size}: {windows}, all sound.", archive.display()));
        return Ok(());
    }
    for damage in damages {
        console.say(damage);
    }
    for line in structure {
        console.say(format!("SQLite: {line}"));
    }
    bail!(
        "{} is damaged: {windows} {} sound; analyses leave out what is not. `belfry archive repair {}` saves what can be saved",
        archive.display(),
        is_or_are(*sound_windows),
        in_shell(folder)
    )
}

fn of_nodes(windows: u64) -> String {
    format!("{} of nodes", counted(windows, "window"))
}

/// What is lost, by node and reason.
fn losses(lost: &[ListedLoss]) -> Vec<String> {
    let mut sums: BTreeMap<(u16, LossReason), (u64, u64)> = BTreeMap::new();
    for listed in lost {
        // What has come all the same is not lost.
        if listed.windows() == Some(0) {
            continue;
        }
        let (windows, unknown) = sums.entry((listed.loss.node, listed.loss.reason)).or_default();
        match listed.windows() {
            Some(count) => *windows += count,
            None => *unknown += 1,
        }
    }
    let line = |((node, reason), (windows, unknown)): (&(u16, LossReason), &(u64, u64))| {
        let more = if *unknown == 0 {
            String::new()
        } else {
            format!("; {unknown} times it may have made more, which nobody knows")
        };
        format!("node {node}: {} {} lost: {reason}{more}", counted(*windows, "window"), is_or_are(*windows))
    };
    sums.iter().map(line).collect()
}

/// What repairs could not save, by setup.
fn repairs(hours: &[DamagedHour]) -> Vec<String> {
    let line = |hours: &[DamagedHour]| {
        let first = hours.first()?;
        let windows = counted(hours.iter().map(|hour| hour.windows).sum(), "window");
        let (setup, since) = (&first.setup, moment((first.start_s * 1e6) as i64));
        Some(format!(
            "setup \"{setup}\": repairs could not save {windows}, begun in {} from {since} on",
            counted(hours.len() as u64, "hour")
        ))
    };
    hours.chunk_by(|one, next| one.setup == next.setup).filter_map(line).collect()
}

fn run_repair(folder: &Path, console: &Console) -> anyhow::Result<()> {
    let report = Archive::repair(folder)?;
    console.json("archive-repair-1", &report)?;
    let Some(kept_as) = &report.kept_as else {
        console.say(format!("{} is sound; nothing was done.", report.archive.display()));
        return Ok(());
    };
    for damage in &report.lost {
        console.say(format!("not saved: {damage}"));
    }
    console.say(format!(
        "{} {} saved; {} of which one bit was flipped {} mended. The damaged archive is {}: delete it when you no longer need it.",
        of_nodes(report.windows),
        is_or_are(report.windows),
        counted(report.mended, "row"),
        is_or_are(report.mended),
        kept_as.display()
    ));
    Ok(())
}

fn run_prune(arguments: &Prune, console: &Console) -> anyhow::Result<()> {
    let folder = folder(&arguments.study)?;
    let now = HostTime::since_epoch(SystemClock::new().unix());
    // Whether there is one, before one is made.
    opened(&folder)?;
    let mut archive = Archive::create(&folder)?;
    let found = archive.prunable(arguments.keep, now)?;
    let windows = found.windows();
    let Some(before) = &found.before else {
        bail!(match found.kept_windows {
            0 => "the archive has no windows",
            _ => "all windows are dated later than now, so that nothing can be counted back: set this computer's clock",
        })
    };
    if !found.nodes.is_empty() {
        let mut table = Columns::new(["setup", "node", "windows", "first", "last"]);
        for node in &found.nodes {
            let (number, count) = (node.node.to_string(), node.windows.to_string());
            table.row([node.setup.clone(), number, count, node.first.clone(), node.last.clone()]);
        }
        console.say(table);
    }
    let kept = found.kept_windows;
    if arguments.dry_run {
        console.say(format!("{} began before {before} and would be dropped; {kept} would stay.", of_nodes(windows)));
    } else {
        archive.prune_patiently(&found, &mut |error| {
            console.warn(format_args!("{error}; trying again for some minutes"))
        })?;
        console.say(format!(
            "{} that began before {before} {} dropped; {kept} stay.",
            of_nodes(windows),
            is_or_are(windows)
        ));
    }
    let heartbeats = heartbeats::prune(&folder, found.before(), arguments.dry_run)
        .with_context(|| format!("{} cannot be pruned", folder.join(HEARTBEATS_FILE).display()))?;
    if heartbeats > 0 {
        console.say(format!("The same of {} from before.", counted(heartbeats, "heartbeat")));
    }
    console.json("archive-prune-1", &Pruned { found: &found, windows, heartbeats, dry_run: arguments.dry_run })
}

fn run_export(arguments: &Export, console: &Console) -> anyhow::Result<()> {
    let (range, output) = (arguments.range.range()?, &arguments.output);
    let folder = folder(&arguments.study)?;
    let archive = opened(&folder)?;
    let ending = output.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase();
    let real = |path: &Path| path.canonicalize().ok();
    if real(output).is_some_and(|output| Some(output) == real(archive.file())) {
        bail!("{} is the archive itself: name another file", output.display());
    }
    let extract = match ending.as_str() {
        "sqlite" => {
            refuse_taken(output)?;
            archive.extract_archive(&range, output)?
        }
        "csv" => archive.extract_csv(&range, output)?,
        _ => bail!("--output {}: expected a file that ends in .sqlite or .csv", output.display()),
    };
    for damage in &extract.damages {
        console.warn(format_args!("damaged, and left out: {damage}"));
    }
    if extract.windows == 0 {
        console.warn("no window is in it: the archive has none, or none of this range of time");
    }
    console
        .json("archive-export-1", &Exported { file: output, windows: extract.windows, damages: &extract.damages })?;
    console.say(format!("{}: {}", output.display(), of_nodes(extract.windows)));
    Ok(())
}

/// That nothing stands where an archive would be written: it may be the only copy of another study's windows. A log that a killed program has
/// left beside it would be taken for the new one's.
fn refuse_taken(output: &Path) -> anyhow::Result<()> {
    let log = PathBuf::from(format!("{}-wal", output.display()));
    if let Some(taken) = [output, &log].into_iter().find(|file| file.symlink_metadata().is_ok()) {
        bail!("{} is there already: name another file, or move it away", taken.display());
    }
    Ok(())
}

fn opened(folder: &Path) -> anyhow::Result<Archive> {
    let absent = || ArchiveError::absent(folder.join(crate::archive::ARCHIVE_FILE));
    Archive::open(folder)?.ok_or_else(absent).context("run `belfry collect` first")
}
