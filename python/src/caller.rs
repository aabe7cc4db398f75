//! Whoever calls from Python: hears of progress, may interrupt, and is told of errors by exceptions.

use std::io::ErrorKind;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::Context;
use belfry_host::command::FailureReport;
use belfry_host::files::FolderLock;
use belfry_host::progress::{OnProgress, Progress, give_up, unless_given_up};
use belfry_host::story::Project;
use belfry_host::study::{STUDY_FILE, Study};
use pyo3::prelude::*;
use pyo3::types::PyType;

/// How often Python is asked for signals, and hears of progress within a stage.
const ASKED_EVERY: Duration = Duration::from_millis(50);

/// Does work without Python's lock. Where a signal or `on_progress`, called with stage, pieces done and their number, raises an exception,
/// the work is given up and the exception goes on.
pub(crate) fn work<T: Send>(
    py: Python<'_>,
    on_progress: Option<Py<PyAny>>,
    work: impl FnOnce(OnProgress<'_>) -> anyhow::Result<T> + Send,
) -> PyResult<T> {
    py.detach(|| {
        let mut raised = None;
        let mut told: Option<(&'static str, Instant)> = None;
        let done = unless_given_up(|| {
            work(&mut |Progress { stage, done, total }| {
                let is_due =
                    |(before, at): (&str, Instant)| before != stage || done == total || at.elapsed() >= ASKED_EVERY;
                if !told.is_none_or(is_due) {
                    return;
                }
                told = Some((stage, Instant::now()));
                let heard = Python::attach(|py| {
                    py.check_signals()?;
                    if let Some(on_progress) = &on_progress {
                        on_progress.call1(py, (stage, done, total))?;
                    }
                    Ok(())
                });
                if let Err(exception) = heard {
                    raised = Some(exception);
                    give_up();
                }
            })
        });
        match (done, raised) {
            (_, Some(exception)) => Err(exception),
            (Some(done), None) => done.map_err(|error| exception(&error)),
            // Nothing gives up but what has raised something.
            (None, None) => Err(exception(&anyhow::anyhow!("the work was given up"))),
        }
    })
}

/// The package's exception, which says of an error what the program prints of it.
pub(crate) fn exception(error: &anyhow::Error) -> PyErr {
    let FailureReport { message, causes } = FailureReport::of(error);
    raised("BelfryError", message, causes)
}

/// The package's exception of an argument that cannot be meant; `message` begins with the argument's name.
pub(crate) fn wrong_argument(message: String) -> PyErr {
    raised("ArgumentError", message, Vec::new())
}

fn raised(kind: &str, message: String, causes: Vec<String>) -> PyErr {
    Python::attach(|py| {
        let of_package = || py.import("belfry._errors")?.getattr(kind)?.cast_into::<PyType>().map_err(PyErr::from);
        match of_package() {
            Ok(kind) => PyErr::from_type(kind, (message, causes)),
            Err(broken) => broken,
        }
    })
}

/// Opens a study of which no other program changes anything until the lock is dropped; there is none where nothing can be written into its
/// folder, of which whatever writes there says so.
pub(crate) fn open_alone(path: &Path, on_progress: OnProgress<'_>) -> anyhow::Result<(Project, Option<FolderLock>)> {
    let folder = Study::folder_of(path);
    let lock = if folder.join(STUDY_FILE).exists() { alone(folder, on_progress)? } else { None };
    Ok((Project::open(path)?, lock))
}

/// Waits for other programs, and asks for signals meanwhile.
fn alone(folder: &Path, on_progress: OnProgress<'_>) -> anyhow::Result<Option<FolderLock>> {
    loop {
        match FolderLock::at_once(folder) {
            Ok(Some(lock)) => return Ok(Some(lock)),
            Ok(None) => {
                on_progress(Progress { stage: "waiting for another command", done: 0, total: 1 });
                thread::sleep(ASKED_EVERY);
            }
            Err(error) if matches!(error.kind(), ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem) => {
                return Ok(None);
            }
            Err(error) => return Err(error).with_context(|| format!("{} cannot be changed", folder.display())),
        }
    }
}
