//! What all requests share: the study's folder, the session's secrets, what is known of the study's state, and the command that runs.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime};

use serde::Serialize;
use tokio::sync::watch;

use super::GRACE;
use super::job::{JobState, JobStatus, Order, Stepper, follow};
use super::samples::Loaded;
use crate::files::{LOCK_FILE, UNFINISHED_SUFFIX};
use crate::page::PageData;
use crate::story::{Case, Project, StoryError};
use crate::study::Study;

/// How often files are looked at.
const LOOK_EVERY: Duration = Duration::from_millis(400);

/// What a window has to know.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct News {
    /// Counts changes of the study's files.
    pub(super) version: u64,
    /// The command that runs, or ran last.
    pub(super) job: Option<JobStatus>,
}

/// What all requests share.
pub(super) struct Shared {
    folder: PathBuf,
    stepper: Stepper,
    news: watch::Sender<News>,
    is_ended: watch::Sender<bool>,
    jobs: AtomicU64,
    /// The process that runs.
    running: Mutex<Option<u32>>,
    is_cancelled: AtomicBool,
    /// The study's files at the last look.
    files: Mutex<Vec<FileState>>,
    /// The page's data and the model, of a version.
    data: Mutex<Option<(u64, Arc<String>)>>,
    case: Mutex<Option<(u64, Arc<Case>)>>,
    /// The recording that was looked into last.
    pub(super) loaded: Mutex<Option<Arc<Loaded>>>,
    /// Held while study.toml is read, changed and written.
    pub(super) editing: Mutex<()>,
}

/// Nobody panics while holding a lock here; if someone did, what it holds is still whole.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    pub(super) fn new(folder: PathBuf, stepper: Stepper) -> Self {
        let files = Mutex::new(state_of(&folder));
        Self {
            folder,
            files,
            stepper,
            news: watch::Sender::new(News::default()),
            is_ended: watch::Sender::new(false),
            jobs: AtomicU64::new(0),
            running: Mutex::new(None),
            is_cancelled: AtomicBool::new(false),
            data: Mutex::new(None),
            case: Mutex::new(None),
            loaded: Mutex::new(None),
            editing: Mutex::new(()),
        }
    }

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Follows what changes.
    pub(super) fn news(&self) -> watch::Receiver<News> {
        self.news.subscribe()
    }

    /// Says when the server ends.
    pub(super) fn ended(&self) -> watch::Receiver<bool> {
        self.is_ended.subscribe()
    }

    pub(super) fn end(&self) {
        self.is_ended.send_replace(true);
    }

    /// The page's data as JSON, with its version; the same text until a file changes.
    pub(super) fn data(&self) -> Result<Arc<String>, StoryError> {
        // Before the files are read: what changes meanwhile is another version.
        let version = self.news.borrow().version;
        let mut data = lock(&self.data);
        if let Some((known, text)) = data.as_ref()
            && *known == version
        {
            return Ok(Arc::clone(text));
        }
        #[derive(Serialize)]
        struct Versioned {
            version: u64,
            #[serde(flatten)]
            data: PageData,
        }
        let study = Study::load(&self.folder)?;
        let versioned = Versioned { version, data: PageData::of(&study) };
        let text = Arc::new(serde_json::to_string(&versioned).unwrap_or_default());
        *data = Some((version, Arc::clone(&text)));
        Ok(text)
    }

    /// The model and the measured modes; the same until a file changes.
    pub(super) fn case(&self) -> Result<Arc<Case>, StoryError> {
        let version = self.news.borrow().version;
        let mut case = lock(&self.case);
        if let Some((known, case)) = case.as_ref()
            && *known == version
        {
            return Ok(Arc::clone(case));
        }
        let loaded = Arc::new(Project::open(&self.folder)?.case()?.clone());
        *case = Some((version, Arc::clone(&loaded)));
        Ok(loaded)
    }

    /// Starts a command; its status, or why it does not start.
    pub(super) fn run(self: &Arc<Self>, words: &[String]) -> Result<JobStatus, RunError> {
        let order = Order::of(words, &self.stepper, &self.folder).map_err(RunError::Refused)?;
        let mut running = lock(&self.running);
        if running.is_some() {
            let command = self.news.borrow().job.as_ref().map(|job| job.command.clone()).unwrap_or_default();
            return Err(RunError::Busy(command));
        }
        let child = order.start().map_err(RunError::Start)?;
        *running = child.id();
        self.is_cancelled.store(false, Ordering::Relaxed);
        let status = JobStatus {
            id: self.jobs.fetch_add(1, Ordering::Relaxed) + 1,
            command: order.typed(),
            state: JobState::Running,
            stage: None,
            done: 0,
            total: 0,
            elapsed_s: 0.0,
            output: String::new(),
        };
        self.tell(&status);
        let (shared, first) = (Arc::clone(self), status.clone());
        tokio::spawn(async move {
            let mut ended = follow(child, first, |status| shared.tell(status)).await;
            if ended.state == JobState::Failed && shared.is_cancelled.load(Ordering::Relaxed) {
                ended.state = JobState::Cancelled;
            }
            // What it has written is there before anyone hears that it is done.
            look(&shared).await;
            // Nobody starts another before all know that this one has ended.
            let mut running = lock(&shared.running);
            *running = None;
            shared.tell(&ended);
        });
        Ok(status)
    }

    fn tell(&self, status: &JobStatus) {
        self.news.send_modify(|news| news.job = Some(status.clone()));
    }

    /// Asks the command that runs to end; it removes what it has not finished.
    pub(super) fn cancel(&self) {
        if let Some(id) = *lock(&self.running) {
            self.is_cancelled.store(true, Ordering::Relaxed);
            end_process(id);
        }
    }

    /// Whether a command runs.
    pub(super) fn is_busy(&self) -> bool {
        lock(&self.running).is_some()
    }

    /// Waits until no command runs, for a while.
    pub(super) async fn job_ended(&self) {
        let mut news = self.news();
        let idle = news.wait_for(|news| news.job.as_ref().is_none_or(|job| job.state != JobState::Running));
        // What has not ended by then ends with this program.
        let _ = tokio::time::timeout(GRACE, idle).await;
    }
}

/// Why a command does not start.
#[derive(Debug)]
pub(super) enum RunError {
    /// The page may not ask for it.
    Refused(String),
    /// Another runs.
    Busy(String),
    /// The program does not start.
    Start(std::io::Error),
}

/// Ends a process of this program. Windows has no signal that it could answer, so that it ends at once there; what it has written stands.
#[cfg(not(unix))]
fn end_process(id: u32) {
    let _ = std::process::Command::new("taskkill").args(["/F", "/T", "/PID", &id.to_string()]).output();
}

/// Asks a process of this program to end.
#[cfg(unix)]
fn end_process(id: u32) {
    if let Some(process) = i32::try_from(id).ok().and_then(rustix::process::Pid::from_raw) {
        // One that has ended meanwhile needs no signal.
        let _ = rustix::process::kill_process(process, rustix::process::Signal::TERM);
    }
}

/// Looks at the study's files now and then, whoever changes them: a command in a terminal, an editor, or a collection.
pub(super) async fn watch_files(shared: Arc<Shared>) {
    loop {
        tokio::time::sleep(LOOK_EVERY).await;
        look(&shared).await;
    }
}

/// Makes another version where a file has changed since the last look; each change makes one.
pub(super) async fn look(shared: &Arc<Shared>) {
    let this = Arc::clone(shared);
    let looked = tokio::task::spawn_blocking(move || {
        let mut known = lock(&this.files);
        let now = state_of(this.folder());
        if *known != now {
            *known = now;
            this.news.send_modify(|news| news.version += 1);
        }
    });
    // It does not panic; where the runtime ends there is nobody to tell.
    let _ = looked.await;
}

/// A file with its time, of those of which it tells something, and its size.
type FileState = (PathBuf, Option<SystemTime>, u64);

/// Names, times and sizes of the files of a study and of its results.
fn state_of(folder: &Path) -> Vec<FileState> {
    let files = |folder: PathBuf| std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut state: Vec<_> = files(folder.to_owned())
        .chain(files(folder.join("results")))
        .filter_map(|file| {
            let about = file.metadata().ok().filter(std::fs::Metadata::is_file)?;
            let name = file.file_name().to_string_lossy().into_owned();
            // Reading a database touches these, too: of its log only the length tells that something was written.
            if name.ends_with("-wal") {
                return (about.len() > 0).then(|| (file.path(), None, about.len()));
            }
            let is_passing = name.ends_with(UNFINISHED_SUFFIX) || name.ends_with("-shm") || name == LOCK_FILE;
            (!is_passing).then(|| (file.path(), about.modified().ok(), about.len()))
        })
        .collect();
    state.sort();
    state
}
