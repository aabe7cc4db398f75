//! What collecting from many nodes costs: processor, memory, and how often the program wakes up.

use std::error::Error;
use std::fmt;
use std::fs;
use std::process::{Child, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use super::nodes::{LiveNodes, Measured};

/// How often the kernel counts a process's time (`USER_HZ`).
const TICKS_PER_SECOND: f64 = 100.0;
/// Nodes are greeted and their clocks measured first in this time.
const START: Duration = Duration::from_secs(30);

/// What it has cost.
#[derive(Debug, Clone)]
pub struct LoadReport {
    /// Nodes, of four channels each.
    pub nodes: u16,
    /// Time over which it was measured, after the start.
    pub time: Duration,
    /// Windows that came in this time.
    pub windows: u64,
    /// Share of one core.
    pub core_share: f64,
    /// The same while the nodes were greeted, and their clocks measured first.
    pub core_share_at_start: f64,
    /// The most memory that it had at once, in bytes.
    pub most_bytes: u64,
    /// Times a second that one of its threads woke up.
    pub wakeups_per_second: f64,
}

impl fmt::Display for LoadReport {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "{} nodes of 4 channels, {:.0} s: {} windows, {:.2} % of one core ({:.1} % in the first {:.0} s), {:.1} MB, {:.0} wake-ups/s",
            self.nodes,
            self.time.as_secs_f64(),
            self.windows,
            100.0 * self.core_share,
            100.0 * self.core_share_at_start,
            START.as_secs_f64(),
            self.most_bytes as f64 * 1e-6,
            self.wakeups_per_second
        )
    }
}

/// What a process has used so far: time in s, and times that its threads woke up.
struct Used {
    cpu_s: f64,
    wakeups: u64,
}

fn used(child: &Child) -> Result<Used, Box<dyn Error>> {
    let folder = format!("/proc/{}", child.id());
    let mut wakeups = 0;
    for task in fs::read_dir(format!("{folder}/task"))? {
        let status = fs::read_to_string(task?.path().join("status"))?;
        wakeups += number(&status, "voluntary_ctxt_switches:")?;
    }
    Ok(Used { cpu_s: cpu_s(child.id())?, wakeups })
}

/// Processor time of a process, in s.
pub(crate) fn cpu_s(process: u32) -> Result<f64, Box<dyn Error>> {
    let stat = fs::read_to_string(format!("/proc/{process}/stat"))?;
    // Behind the name, which may contain anything: fields 14 and 15 of the line (proc(5)).
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |index: usize| fields.get(index).and_then(|field| field.parse::<f64>().ok()).ok_or("no times");
    Ok((ticks(11)? + ticks(12)?) / TICKS_PER_SECOND)
}

/// The number behind a word at the start of a line.
fn number(text: &str, word: &str) -> Result<u64, Box<dyn Error>> {
    let line = text.lines().find_map(|line| line.strip_prefix(word)).ok_or_else(|| format!("no {word}"))?;
    Ok(line.split_whitespace().next().unwrap_or_default().parse()?)
}

/// Collects from so many nodes for so long.
///
/// # Errors
/// Where the nodes or the command cannot be started, or the system does not say what it uses.
pub fn load(nodes: u16, time: Duration) -> Result<LoadReport, Box<dyn Error>> {
    let analysis = "band_hz = [0.3, 1.5]\ndecimated_rate_hz = 5.0\nsegment = 256";
    let live = LiveNodes::start(&Measured { nodes, channels: 4, rate_hz: 50.0, analysis })?;
    let mut child = live.collect().stdout(Stdio::null()).stderr(Stdio::null()).spawn()?;
    let measure = |child: &Child| -> Result<LoadReport, Box<dyn Error>> {
        thread::sleep(START);
        let (start, first, before) = (Instant::now(), used(child)?, windows(&live)?);
        thread::sleep(time);
        let (last, after) = (used(child)?, windows(&live)?);
        let elapsed = start.elapsed();
        let status = fs::read_to_string(format!("/proc/{}/status", child.id()))?;
        Ok(LoadReport {
            nodes,
            time: elapsed,
            windows: after - before,
            core_share: (last.cpu_s - first.cpu_s) / elapsed.as_secs_f64(),
            core_share_at_start: first.cpu_s / START.as_secs_f64(),
            most_bytes: 1024 * number(&status, "VmHWM:")?,
            wakeups_per_second: (last.wakeups - first.wakeups) as f64 / elapsed.as_secs_f64(),
        })
    };
    let report = measure(&child);
    child.kill()?;
    child.wait()?;
    report
}

fn windows(live: &LiveNodes) -> rusqlite::Result<u64> {
    let archive = rusqlite::Connection::open(live.folder.path().join("archive.sqlite"))?;
    archive.query_row("SELECT count(*) FROM window", [], |row| row.get(0))
}
