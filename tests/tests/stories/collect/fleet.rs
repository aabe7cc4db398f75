//! Gateways and workers over a real NATS server, all of which are killed in the middle of it: every window is in the stream once, and every interval
//! has one result, which is what `belfry watch` makes of the archive.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use assert_cmd::prelude::*;
use belfry_tests::nats::{NatsServer, StoredMessage};
use belfry_tests::{belfry_command, fleet};
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::RowAccessor;
use predicates::str::contains;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use super::live::{self, LiveBench, interrupt, kill};
use super::mast::{MODES, archive};

/// Length of an interval in s.
const EVERY_S: i64 = 10;
/// The part of the fleet that "Mast" is in: the FNV-1a hash of its name, modulo 128.
const PART: &str = "004";

/// The names of a bench's windows (node, boot, number), in the order in which they were stored, each with the middle of its time in µs.
fn stored(bench: &LiveBench) -> Vec<([u32; 3], i64)> {
    let archive = archive(bench.folder.path());
    let mut statement = archive.prepare("SELECT node, boot, number, start_us FROM window ORDER BY id").unwrap();
    let rows =
        statement.query_map([], |row| Ok(([row.get(0)?, row.get(1)?, row.get(2)?], row.get::<_, i64>(3)?))).unwrap();
    // Half a segment of 256 samples, at 500 a second.
    rows.map(Result::unwrap).map(|(name, start_us)| (name, start_us + 256_000)).collect()
}

/// The names of windows in the stream, in its order.
fn published(server: &NatsServer) -> Vec<[u32; 3]> {
    let messages = server.data().unwrap();
    let windows = messages.iter().filter(|message| message.subject.contains(".windows."));
    let name = |id: &str| -> [u32; 3] {
        let parts: Vec<u32> = id.strip_prefix("Mast-").unwrap().split('-').map(|part| part.parse().unwrap()).collect();
        parts.try_into().unwrap()
    };
    windows
        .map(|message| {
            let name = name(&message.id);
            assert_eq!(message.subject, format!("belfry.{PART}.Mast.windows.{}", name[0]));
            name
        })
        .collect()
}

fn results(server: &NatsServer) -> Vec<Value> {
    let messages = server.results().unwrap();
    let results = messages.iter().filter(|message| message.subject == format!("belfry.{PART}.Mast.results"));
    results.map(|message| serde_json::from_slice(&message.payload).unwrap()).collect()
}

fn work(server: &NatsServer, more: &[&str]) -> Command {
    let mut command = belfry_command();
    command.args(["work", "--from", &server.url()]).args(more);
    command
}

fn worker(bench: &LiveBench, server: &NatsServer, more: &[&str]) -> Child {
    bench.spawn(work(server, more))
}

fn frequencies_hz(modes: &Value) -> Vec<f64> {
    modes.as_array().unwrap().iter().map(|mode| mode["frequency_hz"].as_f64().unwrap()).collect()
}

fn is_near(hz: f64, true_hz: f64) -> bool {
    (hz / true_hz - 1.0).abs() < 0.02
}

/// Whether both modes of the mast are among these.
fn have_both(found_hz: &[f64]) -> bool {
    MODES.iter().all(|(true_hz, ..)| found_hz.iter().any(|hz| is_near(*hz, *true_hz)))
}

/// Identifies the modes of what has come and has them followed.
fn follow(bench: &LiveBench, server: &NatsServer, more: &[&str]) {
    // The drift is known from 20 s on.
    bench.wait_for(200);
    belfry_command().args(["identify", bench.study()]).assert().success();
    let said = fs::read_to_string(bench.folder.path().join("results/modes.json")).unwrap();
    let found: Value = serde_json::from_str(&said).unwrap();
    let found_hz = frequencies_hz(&found["modes"]);
    // While other tests run, the nodes' clocks are known only within half a millisecond in the first minute, 16° at 90 Hz: which splits that mode
    // now and then.
    assert!(have_both(&found_hz) && found_hz.len() <= 3, "{found_hz:?}");
    assert!(found_hz.iter().all(|hz| MODES.iter().any(|(true_hz, ..)| is_near(*hz, *true_hz))), "{found_hz:?}");
    let followed = format!("Mast is followed from now on: {} modes", found_hz.len());
    let url = server.url();
    let add = ["work", "--from", &url, "--add", bench.study(), "--every", "10s"];
    belfry_command().args(add).args(more).assert().success().stdout(contains(followed));
}

/// Ends a gateway in good order, when it has published what has come, and waits for the last result.
fn end(bench: &LiveBench, server: &NatsServer, mut gateway: Child) {
    interrupt(&gateway);
    assert!(gateway.wait().unwrap().success());
    let wanted = intervals(&stored(bench));
    wait_until("the last result", || results(server).len() >= wanted.len());
}

fn wait_until(what: &str, is_so: impl Fn() -> bool) {
    live::wait_until(what, Duration::from_secs(90), is_so);
}

/// Whole intervals that the archive has, with the windows of each: those that both nodes have gone past.
fn intervals(windows: &[([u32; 3], i64)]) -> BTreeMap<i64, usize> {
    let number = |middle_us: &i64| middle_us.div_euclid(1_000_000 * EVERY_S);
    let newest =
        |node| windows.iter().filter(|(name, _)| name[0] == node).map(|(_, middle)| number(middle)).max().unwrap();
    let over = newest(3).min(newest(8));
    let mut counts = BTreeMap::new();
    for interval in windows.iter().map(|(_, middle)| number(middle)).filter(|&interval| interval < over) {
        *counts.entry(interval).or_default() += 1;
    }
    counts
}

/// Holds what workers have published against the archive, and against what a watch makes of it.
fn holds(bench: &LiveBench, server: &NatsServer) {
    let windows = stored(bench);
    let names: Vec<[u32; 3]> = windows.iter().map(|(name, _)| *name).collect();
    assert_eq!(published(server), names, "each window once, in the order of the archive");
    let expected = intervals(&windows);
    let results = results(server);
    let counts: Vec<(i64, usize)> = results
        .iter()
        .map(|result| (result["interval"].as_i64().unwrap(), result["windows"].as_u64().unwrap() as usize))
        .collect();
    assert_eq!(counts, expected.into_iter().collect::<Vec<_>>(), "each interval once, with all of its windows");
    // The archive alone, by the other way to the modes.
    let every = format!("{EVERY_S}s");
    let watch = ["watch", bench.study(), "--once", "--every", &every];
    belfry_command().args(watch).assert().success();
    let lines = fs::read_to_string(bench.folder.path().join("results/watch.jsonl")).unwrap();
    let watched: BTreeMap<i64, Value> = lines
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .map(|interval: Value| ((interval["start_s"].as_f64().unwrap() / EVERY_S as f64).round() as i64, interval))
        .collect();
    let seen: BTreeMap<i64, &Value> = results
        .iter()
        .filter(|result| !result["seen"].is_null())
        .map(|result| (result["interval"].as_i64().unwrap(), &result["seen"]))
        .collect();
    assert!(seen.len() >= 3, "{seen:?}");
    let same: BTreeSet<i64> = seen.keys().copied().filter(|interval| watched.contains_key(interval)).collect();
    assert_eq!(same.len(), seen.len(), "a watch has seen {:?}", watched.keys());
    for interval in &same {
        let (worker, watch) = (seen[interval], &watched[interval]);
        assert_eq!(worker["modes"], watch["modes"], "{interval}");
    }
    // Ten seconds show both modes as a rule, and one of them now and then.
    let both = same.iter().filter(|interval| have_both(&frequencies_hz(&seen[interval]["modes"]))).count();
    assert!(2 * both > same.len(), "{both} of {} intervals show both modes", same.len());
}

#[test]
#[cfg_attr(not(nats), ignore = "nats-server is not installed; ./test installs it")]
fn windows_and_results_come_once_whoever_is_killed() {
    let mut server = NatsServer::start().unwrap();
    let bench = LiveBench::new();
    let url = server.url();
    let gateway = || bench.spawn(bench.collect(&["--to", &url]));
    let first = gateway();
    follow(&bench, &server, &[]);
    let workers = [worker(&bench, &server, &[]), worker(&bench, &server, &[])];
    wait_until("the first result", || !results(&server).is_empty());
    kill(first);
    let second = gateway();
    // Whichever of them has the structure.
    let [one, other] = workers;
    kill(one);
    thread::sleep(Duration::from_secs(6));
    let third = worker(&bench, &server, &[]);
    thread::sleep(Duration::from_secs(5));
    server.kill(0).unwrap();
    // The archive grows meanwhile.
    let before = stored(&bench).len();
    thread::sleep(Duration::from_secs(4));
    assert!(stored(&bench).len() > before + 20, "collecting waits for the server");
    server.restart(0).unwrap();
    kill(other);
    thread::sleep(Duration::from_secs(12));
    end(&bench, &server, second);
    kill(third);
    holds(&bench, &server);
    // Whoever begins anew finds nothing to do.
    fs::remove_file(bench.folder.path().join("gateway.json")).unwrap();
    let (windows, found) = (published(&server), results(&server));
    let again = gateway();
    let late = worker(&bench, &server, &[]);
    thread::sleep(Duration::from_secs(3));
    interrupt(&again);
    assert!({ again }.wait_with_output().unwrap().status.success());
    interrupt(&late);
    assert!({ late }.wait_with_output().unwrap().status.success());
    assert_eq!(published(&server)[..windows.len()], windows);
    assert_eq!(results(&server)[..found.len()], found);
    let after: BTreeSet<[u32; 3]> = published(&server).into_iter().collect();
    assert_eq!(after.len(), published(&server).len(), "a window has come twice");
}

#[test]
#[cfg_attr(not(nats), ignore = "nats-server is not installed; ./test installs it")]
fn each_server_of_a_cluster_may_die_and_everything_goes_on() {
    const REPLICAS: [&str; 2] = ["--replicas", "3"];
    let mut server = NatsServer::start_cluster(3).unwrap();
    let bench = LiveBench::new();
    let url = server.url();
    let gateway = bench.spawn(bench.collect(&["--to", &url, REPLICAS[0], REPLICAS[1]]));
    follow(&bench, &server, &REPLICAS);
    let workers = [worker(&bench, &server, &REPLICAS), worker(&bench, &server, &REPLICAS)];
    wait_until("the first result", || !results(&server).is_empty());
    for dead in 0..3 {
        let before = results(&server).len();
        server.kill(dead).unwrap();
        let on = Instant::now();
        wait_until("results after a server's death", || results(&server).len() >= before + 2);
        println!("server {dead} is dead: two more results after {:.1} s", on.elapsed().as_secs_f64());
        server.restart(dead).unwrap();
        server.wait_until_ready().unwrap();
    }
    end(&bench, &server, gateway);
    workers.into_iter().for_each(kill);
    holds(&bench, &server);
    // Another structure, whose streams are made by a command that does not say how many copies there are to be.
    let other = tempfile::tempdir().unwrap();
    fs::create_dir(other.path().join("results")).unwrap();
    fs::copy(bench.folder.path().join("results/modes.json"), other.path().join("results/modes.json")).unwrap();
    let text = fs::read_to_string(bench.folder.path().join("study.toml")).unwrap();
    fs::write(other.path().join("study.toml"), text.replace("\"Mast\"", "\"Other mast\"")).unwrap();
    let before = server.replicas().unwrap().len();
    let add = ["work", "--from", &url, "--add", other.path().to_str().unwrap(), "--every", "10s"];
    belfry_command().args(add).assert().success();
    let replicas = server.replicas().unwrap();
    assert_eq!(replicas.len(), before + 2, "{replicas:?}");
    assert!(replicas.values().all(|&count| count == 3), "{replicas:?}");
}

/// Gateway, worker and server are killed in turn, a hundred times.
#[test]
#[cfg_attr(not(all(nats, long_tests)), ignore = "long: ./test --all runs it")]
fn nothing_is_lost_or_doubled_in_a_hundred_kills() {
    const KILLS: usize = 100;
    let mut random = ChaCha8Rng::seed_from_u64(22);
    let mut server = NatsServer::start().unwrap();
    let bench = LiveBench::new();
    let url = server.url();
    let start_gateway = || bench.spawn(bench.collect(&["--to", &url]));
    let mut gateway = start_gateway();
    follow(&bench, &server, &[]);
    let mut workers = vec![worker(&bench, &server, &[]), worker(&bench, &server, &[])];
    wait_until("the first result", || !results(&server).is_empty());
    for number in 0..KILLS {
        thread::sleep(Duration::from_secs_f64(random.random_range(0.2..4.0)));
        match number % 3 {
            0 => {
                kill(gateway);
                gateway = start_gateway();
            }
            1 => {
                kill(workers.remove(0));
                workers.push(worker(&bench, &server, &[]));
            }
            _ => {
                server.kill(0).unwrap();
                thread::sleep(Duration::from_secs_f64(random.random_range(0.0..2.0)));
                server.restart(0).unwrap();
            }
        }
    }
    // The last gateway has to have begun before it can end in good order.
    let before = stored(&bench).len();
    wait_until("windows", || stored(&bench).len() > before + 20);
    end(&bench, &server, gateway);
    workers.into_iter().for_each(kill);
    holds(&bench, &server);
    let (windows, results) = (published(&server).len(), results(&server));
    println!(
        "{KILLS} kills: {windows} windows in the stream, {} results, each once and with all of its windows",
        results.len()
    );
}

/// Interval, windows, mode and frequency in Hz.
type Row = (i64, i64, i64, Option<f64>);

/// Parquet files of a structure, the oldest day first; none before there is a folder.
fn tables_of(folder: &Path, structure: &str) -> Vec<PathBuf> {
    let files = fs::read_dir(folder.join(structure)).into_iter().flatten().map(|entry| entry.unwrap().path());
    let mut files: Vec<PathBuf> =
        files.filter(|file| file.extension().is_some_and(|ending| ending == "parquet")).collect();
    files.sort();
    files
}

/// Rows of all Parquet files of a structure.
fn rows(folder: &Path, structure: &str) -> Vec<Row> {
    let mut rows = Vec::new();
    for file in tables_of(folder, structure) {
        let reader = SerializedFileReader::new(fs::File::open(file).unwrap()).unwrap();
        for row in reader.get_row_iter(None).unwrap() {
            let row = row.unwrap();
            assert_eq!(row.get_string(0).unwrap(), structure);
            let [interval, windows, mode] = [1, 4, 6].map(|column| row.get_long(column).unwrap());
            rows.push((interval, windows, mode, row.get_double(7).ok()));
        }
    }
    rows
}

/// Whether DuckDB sees of each mode what the results have.
fn duckdb_reads(tables: &Path, expected: &[Row]) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("duck.py");
    let output = Command::new("python3").arg(script).arg(tables).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let mut modes: BTreeMap<i64, Vec<f64>> = BTreeMap::new();
    for (_, _, mode, frequency_hz) in expected {
        modes.entry(*mode).or_default().extend(frequency_hz);
    }
    modes.remove(&0);
    let said = String::from_utf8(output.stdout).unwrap();
    assert_eq!(said.lines().count(), modes.len(), "{said}");
    for (line, (mode, hz)) in said.lines().zip(modes) {
        let (what, mean_hz) = line.rsplit_once(',').unwrap();
        assert_eq!(what, format!("Mast,{mode},{}", hz.len()));
        let mean = hz.iter().sum::<f64>() / hz.len() as f64;
        assert!((mean_hz.parse::<f64>().unwrap() - mean).abs() < 1e-9 * mean, "{line}");
    }
}

#[test]
#[cfg_attr(not(nats), ignore = "nats-server is not installed; ./test installs it")]
fn a_server_lets_in_who_has_its_credentials_encrypts_and_results_come_as_parquet_once_each() {
    let server = NatsServer::start_secured().unwrap();
    let bench = LiveBench::new();
    let (url, secrets) = (server.url(), server.arguments());
    assert!(url.starts_with("tls://"));
    let secrets: Vec<&str> = secrets.iter().map(String::as_str).collect();
    let gateway = bench.spawn(bench.collect(&[&["--to", &url], &secrets[..]].concat()));
    follow(&bench, &server, &secrets);
    // Neither without the certificate nor without the credentials.
    for some in [&secrets[..2], &secrets[2..]] {
        let add = ["work", "--from", &url, "--add", bench.study(), "--every", "10s"];
        belfry_command().args(add).args(some).assert().failure().stderr(contains("no connection to tls://"));
    }
    let tables = bench.folder.path().join("tables");
    let work = || worker(&bench, &server, &[&["--parquet", tables.to_str().unwrap()], &secrets[..]].concat());
    let first = work();
    wait_until("two results", || results(&server).len() >= 2);
    kill(first);
    let second = work();
    wait_until("two more", || results(&server).len() >= 4);
    end(&bench, &server, gateway);
    let results = results(&server);
    let expected: Vec<_> = results
        .iter()
        .flat_map(|result| {
            let whole = |name: &str| result[name].as_i64().unwrap();
            let modes = result["seen"]["modes"].as_array().cloned().unwrap_or_default();
            let row = move |mode: &Value| {
                (whole("interval"), whole("windows"), mode["number"].as_i64().unwrap(), mode["frequency_hz"].as_f64())
            };
            let rows: Vec<_> = modes.iter().map(row).collect();
            if rows.is_empty() { vec![(whole("interval"), whole("windows"), 0, None)] } else { rows }
        })
        .collect();
    wait_until("the files", || rows(&tables, "Mast").len() >= expected.len());
    assert_eq!(rows(&tables, "Mast"), expected);
    if cfg!(long_tests) {
        duckdb_reads(&tables, &expected);
    }
    kill(second);
    holds(&bench, &server);
}

#[test]
#[cfg_attr(not(nats), ignore = "nats-server is not installed; ./test installs it")]
fn what_a_clock_ahead_sends_is_told_and_left_out_and_days_that_were_left_unfinished_are_made_whole() {
    const DAY_S: i64 = 86_400;
    let server = NatsServer::start().unwrap();
    let add = |hours| fleet::publish(&server, 1, hours, 22, |_| String::new()).unwrap();
    add(2);
    // Results of three days before, as another worker left them, and a window of a gateway whose clock is two hours ahead.
    let windows = server.data().unwrap();
    let first = windows.iter().find(|message| message.subject.contains(".windows.")).unwrap().clone();
    let part = first.subject.split('.').nth(1).unwrap();
    let results = || {
        let messages = server.results().unwrap();
        messages.iter().map(|message| serde_json::from_slice(&message.payload).unwrap()).collect::<Vec<Value>>()
    };
    for day in 19_671..19_674 {
        let (interval, start_s) = (day * 24, (day * DAY_S) as f64);
        let result = json!({
            "structure": "Tower-0", "interval": interval, "start_s": start_s, "end_s": start_s + 3600.0, "windows": day, "seen": null,
            "last_hz": [], "next": 1, "warnings": [],
        });
        let id = format!("Tower-0-{interval}");
        let message =
            StoredMessage { subject: format!("belfry.{part}.Tower-0.results"), id, payload: result.to_string().into() };
        server.publish(message, 0).unwrap();
    }
    let now_us = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_micros() as i64;
    let ahead = StoredMessage { id: "Tower-0-1-7-4000000000".to_owned(), ..first };
    server.publish(ahead, now_us + 7_200_000_000).unwrap();
    add(4);
    let folder = tempfile::tempdir().unwrap();
    let tables = folder.path().join("tables");
    let days = || tables_of(&tables, "Tower-0");
    let work = || {
        let mut command = work(&server, &["--parquet", tables.to_str().unwrap()]);
        let worker = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        wait_until("the results", || results().len() >= 7);
        // Files are written after the stream has a result.
        let newest = || rows(&tables, "Tower-0").last().map(|row| row.0);
        wait_until("the files", || days().len() >= 5 && newest() == Some(472_225));
        kill(worker);
    };
    work();
    let counts: Vec<i64> = results().iter().map(|result| result["interval"].as_i64().unwrap()).collect();
    // 2023-11-14 from 22:00 on.
    assert_eq!(counts[3..], [472_222, 472_223, 472_224, 472_225]);
    let told = |result: &Value| {
        result["warnings"].to_string().contains("1 messages are left out, whose time was more than 15 min ahead")
    };
    assert_eq!(results().iter().filter(|result| told(result)).count(), 1, "{:?}", results());
    let (whole, files) = (rows(&tables, "Tower-0"), days());
    assert_eq!(
        files,
        ["2023-11-10", "2023-11-11", "2023-11-12", "2023-11-14", "2023-11-15"]
            .map(|day| tables.join("Tower-0").join(format!("{day}.parquet")))
    );
    // A worker that was killed on the second day and comes back on the sixth.
    for file in &files[2..] {
        fs::remove_file(file).unwrap();
    }
    fs::copy(&files[0], &files[1]).unwrap();
    work();
    assert_eq!(rows(&tables, "Tower-0"), whole);
}
