//! What a fleet costs: many structures of twenty channels whose windows go through a NATS server to one worker.

use std::error::Error;
use std::fmt;
use std::fs;
use std::path::Path;
use std::process::{Child, Stdio};
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
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use serde_json::json;
use tempfile::TempDir;

use super::archive::{simulated, told};
use super::live::cpu_s;
use super::nats::{NatsServer, StoredMessage};

/// Seconds of an hour, which is an interval.
const HOUR_S: f64 = 3600.0;
/// Begin of what is simulated, in s of Unix time: a full hour, and past.
const BEGIN_S: f64 = 1_699_999_200.0;
/// Segments of four minutes: an hour averages 29.
const ANALYSIS: &str = "band_hz = [0.05, 1.5]\ndecimated_rate_hz = 4.1666666666667\nsegment = 1024";

/// What is followed.
#[derive(Debug, Clone, Copy)]
pub struct FleetCase {
    /// Structures.
    pub structures: usize,
    /// Hours of windows of each.
    pub hours: usize,
    /// Days before them of which there are results.
    pub history_days: usize,
    /// Seed.
    pub seed: u64,
}

/// What it has cost.
#[derive(Debug, Clone)]
pub struct FleetCost {
    /// Structures.
    pub structures: usize,
    /// Intervals of each that have a result.
    pub hours: usize,
    /// Days of results before them; the last of them is judged at midnight, within these hours.
    pub history_days: usize,
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
            "{} structures of 20 channels, {} hours each behind {} days of results, {:.1} modes an hour, in {:.1} s",
            self.structures,
            self.hours,
            self.history_days,
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
    let towers = Towers::simulate(server, hours, seed)?;
    let mut gateway_s = 0.0;
    for number in 0..structures {
        towers.add(number, &about(number))?;
        gateway_s += towers.send(number)?;
    }
    Ok(gateway_s)
}

/// Towers that move alike.
struct Towers {
    folder: TempDir,
    address: Address,
    /// The study of each but for its name.
    text: String,
    /// Number and frequency in Hz of the modes that are followed.
    modes: Vec<(usize, f64)>,
}

impl Towers {
    /// What nodes of each send in so many hours and some minutes.
    fn simulate(server: &NatsServer, hours: usize, seed: u64) -> Result<Self, Box<dyn Error>> {
        let folder = super::folder_in_memory()?;
        let first = folder.path().join("first");
        fs::create_dir(&first)?;
        write(&first, hours, seed)?;
        let mut project = Project::open(&first)?;
        let found = project.identify(&IdentifyRequest::by(Route::Direct), &mut |_| {})?.identification;
        let text = fs::read_to_string(first.join("study.toml"))?;
        let modes = found.modes.iter().map(|mode| (mode.number, mode.frequency_hz)).collect();
        Ok(Self { address: Address::parse(&server.url())?, folder, text, modes })
    }

    /// The study of a tower, with these files of the first.
    fn study(&self, number: usize, about: &str, files: &[&str]) -> Result<Study, Box<dyn Error>> {
        let (first, next) = (self.folder.path().join("first"), self.folder.path().join("next"));
        if next.exists() {
            fs::remove_dir_all(&next)?;
        }
        fs::create_dir_all(next.join("results"))?;
        let name = format!("name = \"Tower {number}\"\n{about}");
        fs::write(next.join("study.toml"), self.text.replacen("name = \"Tower\"", &name, 1))?;
        for file in files {
            fs::copy(first.join(file), next.join(file))?;
        }
        Ok(Study::load(&next)?)
    }

    /// Has a tower followed.
    fn add(&self, number: usize, about: &str) -> Result<(), Box<dyn Error>> {
        let study = self.study(number, about, &["beam.csv", "results/modes.json"])?;
        let (every, settings) = (Duration::from_secs_f64(HOUR_S), Settings::default());
        add(&self.address, &ToAdd { study: &study, every, settings })?;
        Ok(())
    }

    /// Publishes what its nodes have sent; processor time of the gateway in s.
    fn send(&self, number: usize) -> Result<f64, Box<dyn Error>> {
        let study = self.study(number, "", &["beam.csv", ARCHIVE_FILE])?;
        let before = cpu_s(std::process::id())?;
        Gateway::start(&study, self.address.clone())?.finish();
        Ok(cpu_s(std::process::id())? - before)
    }
}

/// Results of the days before the first hour, as a worker leaves them: of modes that follow the season and the time of day.
fn history(
    server: &NatsServer,
    structure: usize,
    case: &FleetCase,
    modes: &[(usize, f64)],
) -> Result<(), Box<dyn Error>> {
    let mut random = ChaCha8Rng::seed_from_u64(case.seed.wrapping_add(structure as u64));
    let key = format!("Tower-{structure}");
    let subject = results_subject(&key);
    let begin = (BEGIN_S / HOUR_S) as i64;
    let results = (begin - 24 * case.history_days as i64..begin).map(|interval| {
        let start_s = interval as f64 * HOUR_S;
        let turn = |period_s: f64| (std::f64::consts::TAU * start_s / period_s).sin();
        let temperature_degc = 10.0 + 12.0 * turn(365.25 * 24.0 * HOUR_S) + 4.0 * turn(24.0 * HOUR_S);
        let seen: Vec<_> = modes
            .iter()
            .map(|&(number, hz)| {
                let noise: f64 = StandardNormal.sample(&mut random);
                let hz = hz * (1.0 - 5e-5 * temperature_degc + 1e-3 * noise);
                json!({"number": number, "frequency_hz": hz, "frequency_std_hz": 1e-3 * hz, "response_rms": 1e-4})
            })
            .collect();
        let end_s = start_s + HOUR_S;
        let result = json!({
            "structure": key, "interval": interval, "start_s": start_s, "end_s": end_s, "windows": 240, "last_hz": modes, "next": 1, "warnings": [],
            "seen": {"start_s": start_s, "end_s": end_s, "temperature_degc": temperature_degc, "modes": seen},
        });
        let id = format!("{key}-{interval}");
        StoredMessage { subject: subject.clone(), id, payload: result.to_string().into_bytes() }
    });
    server.publish_all(results.collect(), 0)
}

/// Where results of a structure go: its part is the FNV-1a hash of its name, modulo 128.
fn results_subject(key: &str) -> String {
    let hash = |hash: u32, byte: u8| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193);
    format!("belfry.{:03}.{key}.results", key.bytes().fold(0x811c_9dc5, hash) % 128)
}

/// Follows so many structures for so many hours, with a worker that is there before their windows come.
///
/// # Errors
/// When the simulation, the server or a command fails.
pub fn run(case: &FleetCase) -> Result<FleetCost, Box<dyn Error>> {
    let FleetCase { structures, hours, history_days, seed } = *case;
    let server = NatsServer::start()?;
    let towers = Towers::simulate(&server, hours, seed)?;
    for structure in 0..structures {
        towers.add(structure, "")?;
        if history_days > 0 {
            history(&server, structure, case, &towers.modes)?;
        }
    }
    let [_, history_bytes] = server.stored_bytes()?;
    let mut command = super::belfry_command();
    command.args(["work", "--from", &server.url()]).stdout(Stdio::null()).stderr(Stdio::null());
    let mut worker = command.spawn()?;
    // What is judged once, when a worker finds days that none has judged.
    let judged = if history_days > 0 { structures } else { 0 };
    wait_for(judged, &mut worker, || server.count_judged())?;
    let (worker_before, server_before) = (cpu_s(worker.id())?, server.cpu_s()?);
    let (start, mut gateway_s) = (Instant::now(), 0.0);
    for structure in 0..structures {
        gateway_s += towers.send(structure)?;
    }
    wait_for(structures * (24 * history_days + hours), &mut worker, || server.count_results())?;
    let time = start.elapsed();
    let worker_s = cpu_s(worker.id())? - worker_before;
    let server_s = server.cpu_s()? - server_before;
    worker.kill()?;
    worker.wait()?;
    let results = server.results()?;
    let [window_bytes, result_bytes] = server.stored_bytes()?;
    let mut modes = 0;
    for result in &results {
        let result: serde_json::Value = serde_json::from_slice(&result.payload)?;
        if result["start_s"].as_f64().is_none_or(|start_s| start_s < BEGIN_S) {
            continue;
        }
        modes += result["seen"]["modes"].as_array().map_or(0, Vec::len);
    }
    let each = (structures * hours) as f64;
    Ok(FleetCost {
        structures,
        hours,
        history_days,
        modes: modes as f64 / each,
        gateway_s: gateway_s / each,
        worker_s: worker_s / each,
        server_s: server_s / each,
        window_bytes: window_bytes as f64 / each,
        result_bytes: (result_bytes - history_bytes) as f64 / each,
        time,
    })
}

/// Waits until there are so many of something, as long as the worker is there.
fn wait_for(
    wanted: usize,
    worker: &mut Child,
    count: impl Fn() -> Result<usize, Box<dyn Error>>,
) -> Result<(), Box<dyn Error>> {
    let start = Instant::now();
    loop {
        let there = count()?;
        if there >= wanted {
            return Ok(());
        }
        if start.elapsed() > Duration::from_secs(60 + 5 * wanted as u64) || worker.try_wait()?.is_some() {
            let _ = worker.kill();
            return Err(format!("{there} of {wanted} have come").into());
        }
        // Asking costs the server as well.
        thread::sleep(Duration::from_secs(2));
    }
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
