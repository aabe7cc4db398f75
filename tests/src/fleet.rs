//! What a fleet costs: many structures of twenty channels whose windows go through a NATS server to one worker.

use std::error::Error;
use std::fmt;
use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::thread;
use std::time::{Duration, Instant};

use belfry_host::archive::{ARCHIVE_FILE, Archive};
use belfry_host::jetstream::{Address, Gateway, ToAdd, add};
use belfry_host::measure::Route;
use belfry_host::story::{IdentifyRequest, Project};
use belfry_host::study::{Study, template};
use belfry_host::watch::Settings;
use belfry_host::window::channels_by_node;
use belfry_shared::time::HostTime;

use super::archive::{simulated, told};
use super::live::cpu_s;
use super::nats::NatsServer;

/// Seconds of an hour, which is an interval.
const HOUR_S: f64 = 3600.0;
/// Begin of what is simulated, in s of Unix time: a full hour, and past.
const BEGIN_S: f64 = 1_699_999_200.0;
/// Segments of four minutes: an hour averages 29.
const ANALYSIS: &str = "band_hz = [0.05, 1.5]\ndecimated_rate_hz = 4.1666666666667\nsegment = 1024";

/// What it has cost.
#[derive(Debug, Clone)]
pub struct FleetCost {
    /// Structures.
    pub structures: usize,
    /// Intervals of each that have a result.
    pub hours: usize,
    /// Modes that an interval shows, on average.
    pub modes: f64,
    /// Processor time of the gateways for a structure and hour, in s.
    pub gateway_s: f64,
    /// That of the worker.
    pub worker_s: f64,
    /// That of the server.
    pub server_s: f64,
    /// Bytes of windows of a structure and hour in the server's store.
    pub window_bytes: f64,
    /// Bytes of its result.
    pub result_bytes: f64,
    /// From when the worker was started until all results were there.
    pub time: Duration,
}

impl fmt::Display for FleetCost {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let year_hours = 8766.0;
        writeln!(
            formatter,
            "{} structures of 20 channels, {} hours each, {:.1} modes an hour, in {:.1} s",
            self.structures,
            self.hours,
            self.modes,
            self.time.as_secs_f64()
        )?;
        writeln!(
            formatter,
            "processor time of a structure and hour: gateway {:.3} s, worker {:.3} s, server {:.3} s",
            self.gateway_s, self.worker_s, self.server_s
        )?;
        writeln!(
            formatter,
            "structures a core carries at one set of modes an hour: {:.0} by the worker, {:.0} by the server",
            HOUR_S / self.worker_s,
            HOUR_S / self.server_s
        )?;
        write!(
            formatter,
            "bytes of a structure and year: {:.2} GB of windows (kept for 30 days: {:.2} GB), {:.1} MB of results",
            self.window_bytes * year_hours * 1e-9,
            self.window_bytes * 720.0 * 1e-9,
            self.result_bytes * year_hours * 1e-6
        )
    }
}

/// Has so many structures followed, and publishes so many hours of each; processor time of the gateways in s. `about` is put into `[structure]` of
/// each, by its number.
///
/// # Errors
/// When the simulation, or the server, fails.
pub fn publish(
    server: &NatsServer,
    structures: usize,
    hours: usize,
    seed: u64,
    about: impl Fn(usize) -> String,
) -> Result<f64, Box<dyn Error>> {
    let folder = super::folder_in_memory()?;
    let first = folder.path().join("first");
    fs::create_dir(&first)?;
    write(&first, hours, seed)?;
    let mut project = Project::open(&first)?;
    project.identify(&IdentifyRequest::by(Route::Direct), &mut |_| {})?;
    let address = Address::parse(&server.url())?;
    let mut gateway_s = 0.0;
    let text = fs::read_to_string(first.join("study.toml"))?;
    for number in 0..structures {
        let study = folder.path().join("next");
        fs::create_dir_all(study.join("results"))?;
        let name = format!("name = \"Tower {number}\"\n{}", about(number));
        fs::write(study.join("study.toml"), text.replacen("name = \"Tower\"", &name, 1))?;
        for file in ["beam.csv", ARCHIVE_FILE, "results/modes.json"] {
            fs::copy(first.join(file), study.join(file))?;
        }
        let study = Study::load(&study)?;
        let settings = Settings::default();
        add(&address, &ToAdd { study: &study, every: Duration::from_secs_f64(HOUR_S), settings })?;
        let before = cpu_s(std::process::id())?;
        Gateway::start(&study, address.clone())?.finish();
        gateway_s += cpu_s(std::process::id())? - before;
        fs::remove_dir_all(&study.folder)?;
    }
    Ok(gateway_s)
}

/// Follows so many structures for so many hours.
///
/// # Errors
/// When the simulation, the server or a command fails.
pub fn run(structures: usize, hours: usize, seed: u64) -> Result<FleetCost, Box<dyn Error>> {
    let server = NatsServer::start()?;
    let gateway_s = publish(&server, structures, hours, seed, |_| String::new())?;
    let stored = |stream: &str| bytes_below(&server.folder().join("store0/jetstream/$G/streams").join(stream));
    let window_bytes = stored("BELFRY")?;
    let server_before = server.cpu_s()?;
    let start = Instant::now();
    let mut command = super::belfry_command();
    command.args(["work", "--from", &server.url()]).stdout(Stdio::null()).stderr(Stdio::null());
    let mut worker = command.spawn()?;
    let wanted = structures * hours;
    let mut count = 0;
    while count < wanted {
        if start.elapsed() > Duration::from_secs(60 + 5 * wanted as u64) || worker.try_wait()?.is_some() {
            let _ = worker.kill();
            return Err(format!("{count} of {wanted} results have come").into());
        }
        thread::sleep(Duration::from_millis(500));
        count = server.count("BELFRY_RESULTS")?;
    }
    let time = start.elapsed();
    let worker_s = cpu_s(worker.id())?;
    let server_s = server.cpu_s()? - server_before;
    worker.kill()?;
    worker.wait()?;
    let results = server.messages("BELFRY_RESULTS")?;
    let mut modes = 0;
    for result in &results {
        let result: serde_json::Value = serde_json::from_slice(&result.payload)?;
        modes += result["seen"]["modes"].as_array().map_or(0, Vec::len);
    }
    let each = (structures * hours) as f64;
    Ok(FleetCost {
        structures,
        hours,
        modes: modes as f64 / each,
        gateway_s: gateway_s / each,
        worker_s: worker_s / each,
        server_s: server_s / each,
        window_bytes: window_bytes as f64 / each,
        result_bytes: stored("BELFRY_RESULTS")? as f64 / each,
        time,
    })
}

/// Writes a study of the stand-in tower whose nodes have sent so many hours and some minutes.
fn write(folder: &Path, hours: usize, seed: u64) -> Result<(), String> {
    let text = template::CANTON_STUDY;
    let line = |start: &str| text.lines().find(|line| line.trim_start().starts_with(start)).ok_or("a line is gone");
    let text = text.replace(line("files")?, "live = true").replace(line("band_hz")?, ANALYSIS).replacen(
        line("name")?,
        "name = \"Tower\"",
        1,
    );
    fs::write(folder.join("study.toml"), text).map_err(told)?;
    fs::write(folder.join("beam.csv"), template::CANTON_BEAM).map_err(told)?;
    let study = Study::load(folder).map_err(told)?;
    let setup = study.setups.first().ok_or("the built-in study has no setup")?.clone();
    let while_s = (hours as f64 + 0.3) * HOUR_S;
    let simulated = simulated(&study, &setup, seed, while_s)?;
    let mut archive = Archive::create(folder).map_err(told)?;
    let first = simulated.windows.iter().map(|window| window.grid_index).min().ok_or("no window")?;
    for (node, channels) in channels_by_node(&setup) {
        let names: Vec<&str> = channels.iter().map(|&channel| setup.sensors[channel].channel.as_str()).collect();
        let configuration = simulated.configuration(&setup, channels.len())?;
        archive.ask(&setup.name, node, &configuration, &names, HostTime(0)).map_err(told)?;
    }
    let mut windows = simulated.windows.clone();
    windows.sort_by_key(|window| (window.grid_index, window.name.node));
    for mut window in windows {
        let configuration = simulated.configuration(&setup, window.channels.len())?;
        let hop_s = f64::from(configuration.hop_samples() as u32) / setup.sampling_rate_hz;
        window.grid_index = (BEGIN_S / hop_s).ceil() as u64 + window.grid_index - first;
        archive.store(&setup.name, &configuration, &window, HostTime(0)).map_err(told)?;
    }
    Ok(())
}

/// Bytes of all files below a folder.
fn bytes_below(folder: &Path) -> std::io::Result<u64> {
    let mut bytes = 0;
    for entry in fs::read_dir(folder)? {
        let (path, kind) = (entry.as_ref().map(fs::DirEntry::path), entry.as_ref().map(fs::DirEntry::metadata));
        let (Ok(path), Ok(kind)) = (path, kind) else { continue };
        let kind = kind?;
        bytes += if kind.is_dir() { bytes_below(&path)? } else { kind.len() };
    }
    Ok(bytes)
}
