//! Records of a SeedLink server that others wrote (seedlink-rs), in miniSEED that others wrote (miniseed-rs): the client is killed, the server goes away and
//! comes back, and the files have each record once.

use std::fs;
use std::path::Path;
use std::time::Duration;

use assert_cmd::prelude::*;
use belfry_tests::belfry_command;
use belfry_tests::nats::free_port;
use miniseed_rs::{EncodingFormat, MseedRecord, NanoTime, Samples, encode};
use predicates::str::contains;
use seedlink_rs_server::{SeedLinkServer, ServerConfig, ShutdownHandle};

use super::live::{interrupt, kill, wait_until};
use super::mast::folder_in_memory;

const STATIONS: [&str; 2] = ["DAMA", "DAMB"];
const RATE_HZ: f64 = 50.0;
/// Rows of a record: two seconds.
const ROWS: usize = 100;
const PATIENCE: Duration = Duration::from_secs(60);

/// A record by its number: two seconds of two whole-number tones, compressed, from a minute before midnight on.
fn record(station: &str, number: usize) -> Vec<u8> {
    let second = 86_400 - 60 + 2 * number;
    let start = NanoTime {
        year: 2027,
        day: 15 + (second / 86_400) as u16,
        hour: (second / 3600 % 24) as u8,
        minute: (second / 60 % 60) as u8,
        second: (second % 60) as u8,
        nanosecond: 0,
    };
    let row = |row: usize| {
        let time_s = (number * ROWS + row) as f64 / RATE_HZ;
        let gain = if station == STATIONS[0] { 3000.0 } else { 2000.0 };
        (gain * (std::f64::consts::TAU * 1.3 * time_s).sin() + 500.0 * (std::f64::consts::TAU * 4.1 * time_s).cos())
            as i32
    };
    let record = MseedRecord::new()
        .with_nslc("CH", station, "00", "HNZ")
        .with_start_time(start)
        .with_sample_rate(RATE_HZ)
        .with_encoding(EncodingFormat::Steim2)
        .with_samples(Samples::Int((0..ROWS).map(row).collect()))
        .with_record_length(512);
    encode(&record).unwrap()
}

/// A server that keeps its records on the disk; it ends with this.
struct Network {
    runtime: Option<tokio::runtime::Runtime>,
    store: seedlink_rs_server::DataStore,
    shutdown: ShutdownHandle,
}

impl Network {
    fn start(folder: &Path, port: u16) -> Self {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        let config = ServerConfig { persist_dir: Some(folder.join("journal")), ..ServerConfig::default() };
        let server = runtime.block_on(SeedLinkServer::bind_with_config(&format!("127.0.0.1:{port}"), config)).unwrap();
        let (store, shutdown) = (server.store().clone(), server.shutdown_handle());
        runtime.spawn(server.run());
        Self { runtime: Some(runtime), store, shutdown }
    }

    fn send(&self, numbers: std::ops::Range<usize>) {
        for number in numbers {
            for station in STATIONS {
                self.store.push("CH", station, &record(station, number)).unwrap();
            }
        }
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        self.shutdown.shutdown();
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(Duration::from_secs(10));
        }
    }
}

#[test]
fn records_of_another_makers_server_come_once_each_whoever_goes_away() {
    let folder = folder_in_memory();
    let folder = folder.path();
    let sensors = STATIONS.map(|station| format!("[[setup.sensor]]\nchannel = \"CH.{station}.00.HNZ\"\nnode = 1\n"));
    let text = format!(
        "[structure]\nname = \"Dam\"\n[[setup]]\nname = \"now\"\nfiles = [\"seis/*.mseed\"]\nsampling_rate_hz = {RATE_HZ:.1}\nunit = \"V\"\n{}",
        sensors.map(|sensor| sensor + "sensitivity_v_per_m_s2 = 1000.0\n").concat()
    );
    fs::write(folder.join("study.toml"), text).unwrap();
    let port = free_port().unwrap();
    let network = Network::start(folder, port);
    let client = || {
        let mut command = belfry_command();
        command.arg("collect").arg(folder).args(["--seedlink", &format!("127.0.0.1:{port}")]);
        command.spawn().unwrap()
    };
    let file = |station: &str, day: u8| {
        fs::read(folder.join(format!("seis/CH.{station}.00.HNZ.2027-01-{day}.mseed"))).unwrap_or_default()
    };
    let whole = |station: &str, numbers: std::ops::Range<usize>| {
        numbers.flat_map(|number| record(station, number)).collect::<Vec<u8>>()
    };
    let until = |last: usize| {
        let there = |station| file(station, 15).len() + file(station, 16).len() >= 512 * last;
        wait_until(&format!("{last} records of each station"), PATIENCE, || STATIONS.into_iter().all(there));
    };
    network.send(0..10);
    let first = client();
    until(10);
    kill(first);
    network.send(10..20);
    let second = client();
    until(20);
    // The server goes away, and comes back with what it had.
    drop(network);
    let network = Network::start(folder, port);
    network.send(20..45);
    until(45);
    interrupt(&second);
    assert!({ second }.wait().unwrap().success());
    for station in STATIONS {
        // Thirty records are of the minute before midnight.
        assert!(file(station, 15) == whole(station, 0..30), "{station}: the day before");
        assert!(file(station, 16) == whole(station, 30..45), "{station}: the day after");
    }
    // Ninety seconds without a gap across midnight.
    let look = belfry_command().arg("look").arg(folder).assert().success();
    let said = String::from_utf8(look.get_output().stdout.clone()).unwrap();
    assert!(said.contains("CH.DAMA.00.HNZ"), "{said}");
    look.stdout(contains("0:01:30 long, from 2027-01-15T23:59:00"));
}
