//! `belfry collect`, killed at random instants and started again: what is lost, what is stored twice, and how soon windows come again.

use std::error::Error;
use std::fmt;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use belfry_host::archive::Archive;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rusqlite::{Connection, OpenFlags};
use tempfile::NamedTempFile;

use super::nodes::{LiveNodes, Measured};

const NODES: u16 = 4;
/// A window comes after this time at the latest.
const PATIENCE: Duration = Duration::from_secs(30);
/// How often the archive is looked at.
const LOOK: Duration = Duration::from_millis(5);
/// Nodes are without a host for so long at most between two lives of it.
const AWAY_S: f64 = 0.3;

/// What came of it.
#[derive(Debug, Clone)]
pub struct KillReport {
    /// Draws the instants.
    pub seed: u64,
    /// Kills.
    pub kills: usize,
    /// Windows in the archive in the end.
    pub windows: u64,
    /// Numbers that are missing among them.
    pub lost: u64,
    /// Windows that are there more than once.
    pub doubled: u64,
    /// From the start of the program to the first window that it stored, where it was left alone until then; shortest first.
    pub recoveries: Vec<Duration>,
    /// Whether every row matches its checksum.
    pub is_sound: bool,
}

impl fmt::Display for KillReport {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let at = |share: f64| {
            let index = ((self.recoveries.len().max(1) - 1) as f64 * share).round() as usize;
            self.recoveries.get(index).map_or(f64::NAN, Duration::as_secs_f64)
        };
        write!(
            formatter,
            "seed {}: {} kills, {} windows, {} lost, {} doubled; archive {}; windows again after {:.3} s (median), {:.3} s (95 %), {:.3} s (longest of {})",
            self.seed,
            self.kills,
            self.windows,
            self.lost,
            self.doubled,
            if self.is_sound { "sound" } else { "DAMAGED" },
            at(0.5),
            at(0.95),
            at(1.0),
            self.recoveries.len()
        )
    }
}

/// Kills the command so many times: every other time at any instant after its start, else after it has stored a window.
///
/// # Errors
/// Where the nodes or the command cannot be started, or windows stay away.
pub fn kills(kills: usize, seed: u64) -> Result<KillReport, Box<dyn Error>> {
    let analysis = "band_hz = [15.0, 150.0]\nsegment = 256";
    let live = LiveNodes::start(&Measured { nodes: NODES, channels: 2, rate_hz: 1000.0, analysis })?;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut recoveries = Vec::new();
    // Once in peace, so that there is an archive.
    let first = start(&live)?;
    wait_for(&live, 0)?;
    drop(first);
    for number in 0..kills {
        let before = windows(&live)?;
        let begin = Instant::now();
        let child = start(&live)?;
        if number % 2 == 0 {
            thread::sleep(Duration::from_secs_f64(random.random_range(0.0..1.0)));
        } else {
            wait_for(&live, before)?;
            recoveries.push(begin.elapsed());
            thread::sleep(Duration::from_secs_f64(random.random_range(0.0..0.6)));
        }
        drop(child);
        thread::sleep(Duration::from_secs_f64(random.random_range(0.0..AWAY_S)));
    }
    // Then until all is there, and an end as it should be.
    let mut child = start(&live)?;
    thread::sleep(Duration::from_secs(5));
    Command::new("kill").args(["-INT", &child.0.id().to_string()]).status()?;
    let status = child.0.wait()?;
    if !status.success() {
        return Err(format!("the command failed in the end: {status}; {}", child.said()?).into());
    }
    recoveries.sort_unstable();
    let archive = archive(&live)?;
    let count = |query: &str| archive.query_row(query, [], |row| row.get::<_, u64>(0));
    let lost = count(
        "SELECT sum(lives.made - lives.windows) FROM
             (SELECT max(number) + 1 AS made, count(DISTINCT number) AS windows FROM window GROUP BY node, boot) AS lives",
    )?;
    // A node has one window at a place of the grid; that a number comes once the archive itself sees to.
    let doubled = count("SELECT count(*) - count(DISTINCT node || ' ' || boot || ' ' || grid_index) FROM window")?;
    let is_sound = Archive::check(live.folder.path())?.is_sound;
    Ok(KillReport { seed, kills, windows: windows(&live)?, lost, doubled, recoveries, is_sound })
}

/// The command. It is killed when it goes out of scope, however that comes about, so that none is left behind.
struct Running(Child, NamedTempFile);

impl Running {
    /// What it has said of errors.
    fn said(&self) -> std::io::Result<String> {
        std::fs::read_to_string(self.1.path())
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // One that has ended cannot be killed, and need not be.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn start(live: &LiveNodes) -> std::io::Result<Running> {
    let errors = NamedTempFile::new()?;
    let child = live.collect().stdout(Stdio::null()).stderr(errors.reopen()?).spawn()?;
    Ok(Running(child, errors))
}

fn archive(live: &LiveNodes) -> rusqlite::Result<Connection> {
    Connection::open_with_flags(live.folder.path().join("archive.sqlite"), OpenFlags::SQLITE_OPEN_READ_ONLY)
}

/// Windows that the archive has; none before it is there.
fn windows(live: &LiveNodes) -> rusqlite::Result<u64> {
    archive(live)?.query_row("SELECT count(*) FROM window", [], |row| row.get(0))
}

/// Waits until the archive has more windows than this.
fn wait_for(live: &LiveNodes, count: u64) -> Result<(), Box<dyn Error>> {
    let start = Instant::now();
    while windows(live).unwrap_or(0) <= count {
        if start.elapsed() > PATIENCE {
            return Err("no window comes".into());
        }
        thread::sleep(LOOK);
    }
    Ok(())
}
