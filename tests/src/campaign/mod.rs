//! The fault campaign: eight nodes and a host over days of simulated time, with faults of lines, nodes, host, disk and sensors.
//!
//! Half of the nodes have keys, and an attacker on their lines; half have memory chips, ample or small, whose writes power cuts tear.
//! The node's own code talks over simulated lines to the collector's own code, which writes into a real archive. After each run every
//! window that a node has made is held against the archive: it is there once, as it was sent, or it is listed as lost with a reason, and
//! then the node's own count says that it could not be helped.

mod attacker;
mod audit;
mod host;
mod node;
mod report;
mod schedule;
mod study;
mod world;

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

pub use report::Report;
use schedule::Schedule;
use world::World;

use crate::folder_in_memory;

/// Nodes of a run.
const NODES: usize = 8;
/// What is left over is delivered within this time once faults have ended.
const PATIENCE: Duration = Duration::from_secs(2 * 3600);
/// Longer than two heartbeats: a window whose frames were all lost is missed.
const AFTERMATH: Duration = Duration::from_secs(300);

/// What is tried.
#[derive(Debug, Clone, Copy)]
pub struct Campaign {
    /// Days times nodes, in whole runs.
    pub node_days: f64,
    /// Simulated days of a run.
    pub days_a_run: f64,
    /// How often things fail, as a multiple of the usual; 0 for nothing but the lines' faults.
    pub intensity: f64,
    /// Share of frames that every line damages; drawn line by line where nothing is said.
    pub damaged: Option<f64>,
    /// Draws everything.
    pub seed: u64,
}

/// Runs a campaign, on as many threads as there are processors.
///
/// # Errors
/// Where the simulation itself fails. What goes wrong in a run stands in the report.
pub fn run(campaign: &Campaign, on_run: &(dyn Fn(&Report) + Sync)) -> Result<Report, String> {
    let runs = (campaign.node_days / (NODES as f64 * campaign.days_a_run)).round().max(1.0) as usize;
    let next = AtomicUsize::new(0);
    let total = Mutex::new(Ok(Report::new(campaign.seed)));
    let work = || {
        loop {
            let run = next.fetch_add(1, Ordering::Relaxed);
            if run >= runs {
                return;
            }
            let outcome = one(campaign, run as u64);
            let mut total = total.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
            match (&mut *total, outcome) {
                (Ok(total), Ok(report)) => {
                    total.add(report);
                    on_run(total);
                }
                (Ok(_), Err(error)) => {
                    *total = Err(error);
                    return;
                }
                (Err(_), _) => return,
            }
        }
    };
    let threads = thread::available_parallelism().map_or(1, usize::from).min(runs);
    thread::scope(|scope| (0..threads).for_each(|_| drop(scope.spawn(work))));
    total.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// A run: faults for so long, then none until all is delivered, then the audit.
fn one(campaign: &Campaign, run: u64) -> Result<Report, String> {
    let seed = campaign.seed.wrapping_add(run.wrapping_mul(0x9E37_79B9_7F4A_7C15));
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let folder = folder_in_memory().map_err(|error| error.to_string())?;
    let study = study::Drawn::new(&mut random);
    study.write(folder.path()).map_err(|error| error.to_string())?;
    let length = Duration::from_secs_f64(campaign.days_a_run * 86_400.0);
    let schedule = Schedule::draw(&mut random, length, campaign.intensity);
    let mut report = Report::new(campaign.seed);
    let world = World::new(&study, folder.path(), schedule, campaign.damaged, random.random());
    host::live_through(&world, length, &mut report)?;
    world.end_faults();
    host::deliver_the_rest(&world, AFTERMATH, PATIENCE, &mut report)?;
    let lives = world.take_lives(&mut report);
    let dates = audit::Dates { earliest_us: world.earliest_us(), hop_us: study.hop_us() };
    audit::audit(folder.path(), &lives, dates, &mut report).map_err(|error| format!("run {run}: {error}"))?;
    report.runs = 1;
    report.node_days = NODES as f64 * campaign.days_a_run;
    for violation in &mut report.violations {
        *violation = format!("run {run}: {violation}");
    }
    Ok(report)
}
