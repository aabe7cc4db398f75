//! Nodes that fall silent while a watch goes on: it says so, on its own account and to whoever is to hear of it, and says when they speak again.

use std::fs;
use std::process::Stdio;
use std::time::Duration;

use assert_cmd::prelude::*;
use belfry_tests::belfry_command;
use belfry_tests::post::{Begins, Post};
use serde_json::Value;

use super::live::{self, LiveBench, interrupt, kill};

#[test]
fn nodes_that_fall_silent_are_an_alarm_until_they_speak_again() {
    let bench = LiveBench::new();
    let broker = Post::broker(Begins::Plain).unwrap();
    let file = bench.folder.path().join("study.toml");
    let text = fs::read_to_string(&file).unwrap();
    let alarms = format!("\n[alarms.mqtt]\nserver = \"mqtt://127.0.0.1:{}\"\ntopic = \"mast\"\n", broker.port);
    fs::write(&file, text + &alarms).unwrap();
    let collecting = bench.collect(&[]).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    bench.wait_for(200);
    belfry_command().args(["identify", bench.study()]).assert().success();
    // Nothing can be told at first.
    broker.refuse(2);
    let mut watch = belfry_command();
    watch.args(["watch", bench.study(), "--every", "8s", "--silent-after", "6s"]);
    let watch = watch.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let watched = bench.folder.path().join("results/watch_nodes.json");
    let nodes = || -> Vec<Value> {
        let text = fs::read_to_string(&watched).unwrap_or_default();
        let watched: Value = serde_json::from_str(&text).unwrap_or_default();
        watched["nodes"].as_array().cloned().unwrap_or_default()
    };
    wait_until("the watch knows the nodes", || nodes().len() == 2);
    for node in nodes() {
        assert_eq!(node["problems"], Value::Array(Vec::new()), "{node}");
        // The crystals are 20 ppm off, and windows are on the grid to a sample (2 ms).
        let [offset_s, drift_ppm] = ["clock_offset_s", "clock_drift_ppm"].map(|key| node[key].as_f64().unwrap());
        assert!(offset_s.abs() < 2e-3 && (5.0..60.0).contains(&drift_ppm.abs()), "{node}");
    }
    kill(collecting);
    let is_silent = |node: &Value| node["problems"][0]["problem"] == "silent";
    wait_until("silence", || nodes().iter().all(is_silent));
    wait_until("the broker hears of it", || broker.given().len() == 2);
    assert_eq!(broker.still_refuses(), 0);
    let again = bench.collect(&[]).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    wait_until("they speak again", || broker.given().len() == 4);
    interrupt(&watch);
    let ended = watch.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert!(ended.status.success() && said.contains("MQTT by 127.0.0.1"), "{said}");
    kill(again);
    let told: Vec<Value> = broker.given().iter().map(|one| serde_json::from_str(&one.content).unwrap()).collect();
    let turns: Vec<(&str, u64)> =
        told.iter().map(|event| (event["event"].as_str().unwrap(), event["node"].as_u64().unwrap())).collect();
    let mut sorted = turns.clone();
    sorted.sort_unstable();
    assert_eq!(sorted, [("begun", 3), ("begun", 8), ("ended", 3), ("ended", 8)], "{turns:?}");
    assert!(turns[..2].iter().all(|(event, _)| *event == "begun"), "{turns:?}");
    // The file has the same lines.
    let lines = fs::read_to_string(bench.folder.path().join("results/alarms.jsonl")).unwrap();
    assert_eq!(lines.lines().count(), 4, "{lines}");
}

fn wait_until(what: &str, is_so: impl Fn() -> bool) {
    live::wait_until(what, Duration::from_secs(60), is_so);
}
