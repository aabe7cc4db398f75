//! `belfry report`: everything known of a study in one HTML file.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, bail};
use clap::Args;
use serde::Serialize;

use super::Console;
use super::interrupt::{alone, leave_nothing_unfinished};
use crate::files::write_anew;
use crate::page::Kind;
use crate::story::Project;

const EXAMPLES: &str = "Examples:
  belfry report canton                        writes canton/results/report.html
  belfry report canton --output tower.html
  belfry report canton --pdf                  also report.pdf, by an installed Chromium
  belfry report canton --open

The report holds what the other commands have found: identify, compare, update, covalidate, diagnose, profile, add. What was not run is not in it, and what is older than the study is marked. It is one file that needs no network; pictures can be zoomed and turned, and it prints to A4.";

/// Write everything known of a study into one HTML file, with all pictures
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    pub study: PathBuf,
    /// Where to write it [default: results/report.html in the study's folder]
    #[arg(long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Also print it to a PDF file of the same name, by an installed Chromium
    #[arg(long)]
    pub pdf: bool,
    /// Open it in the browser
    #[arg(long)]
    pub open: bool,
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Written {
    report: PathBuf,
    pdf: Option<PathBuf>,
    bytes: usize,
    findings: Vec<crate::page::Finding>,
}

/// Programs that print pages, by the names that systems give them.
const BROWSERS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "chrome"];

/// Runs the command.
///
/// # Errors
/// When the study or a result cannot be read, or the report cannot be written.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    leave_nothing_unfinished()?;
    let lock = alone(&arguments.study, console)?;
    let project = Project::open(&arguments.study)?;
    let written = project.report(arguments.output.as_deref())?;
    // A browser may take long to print.
    drop(lock);
    for finding in written.findings.iter().filter(|finding| finding.kind == Kind::Finding) {
        console.say(&finding.text);
    }
    let warnings: Vec<String> =
        written.findings.iter().filter(|one| one.kind == Kind::Warning).map(|one| one.text.clone()).collect();
    console.warn_all(&warnings);
    console.say(format!("Report: {}", written.file.display()));
    let pdf = arguments.pdf.then(|| print(&written.file)).transpose()?;
    if let Some(pdf) = &pdf {
        console.say(format!("Printed: {}", pdf.display()));
    }
    if arguments.open {
        open(&written.file)?;
    }
    console.json("report-1", &Written { report: written.file, pdf, bytes: written.bytes, findings: written.findings })
}

/// Prints a page to a PDF file beside it.
fn print(page: &Path) -> anyhow::Result<PathBuf> {
    let page = std::path::absolute(page).with_context(|| format!("{}: no such path", page.display()))?;
    let pdf = page.with_extension("pdf");
    if pdf == page {
        bail!(
            "{}: the report and what is printed of it would be one file; give --output another ending",
            page.display()
        );
    }
    let Ok(address) = url::Url::from_file_path(&page) else { bail!("{}: no such path", page.display()) };
    // Beside it: some packages of the browser write into the user's folders alone.
    let folder = tempfile::tempdir_in(page.parent().unwrap_or(&page)).context("no folder for what is printed")?;
    let printed = folder.path().join("report.pdf");
    for browser in BROWSERS {
        let mut command = Command::new(browser);
        command.args(["--headless", "--disable-gpu", "--no-pdf-header-footer", "--virtual-time-budget=10000"]);
        // For root, as in containers, Chromium has no sandbox.
        command.args(is_root().then_some("--no-sandbox"));
        command.arg(format!("--print-to-pdf={}", printed.display())).arg(address.as_str());
        match command.output() {
            Ok(output) if output.status.success() && printed.exists() => {
                let placed = std::fs::read(&printed).and_then(|bytes| write_anew(&pdf, &bytes));
                placed.with_context(|| format!("cannot write {}", pdf.display()))?;
                return Ok(pdf);
            }
            Ok(output) => {
                bail!("{browser} cannot print {}: {}", page.display(), String::from_utf8_lossy(&output.stderr).trim())
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
            Err(error) => return Err(error).with_context(|| format!("{browser} does not start")),
        }
    }
    bail!(
        "--pdf needs Chromium (looked for {}); install it, or open {} and print it there",
        BROWSERS.join(", "),
        page.display()
    )
}

/// Opens a page in the user's browser.
pub(super) fn open(page: impl AsRef<std::ffi::OsStr>) -> anyhow::Result<()> {
    open::that_detached(page.as_ref()).with_context(|| format!("no browser opens {}", page.as_ref().display()))
}

/// Whether the user is root.
#[cfg(unix)]
fn is_root() -> bool {
    rustix::process::geteuid().is_root()
}

/// Other systems have no root.
#[cfg(not(unix))]
fn is_root() -> bool {
    false
}
