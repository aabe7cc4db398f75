//! Ports and nodes that do not serve, and nodes that answer elsewhere than before.

use std::fs;
use std::process::Command;
use std::time::Duration;

use assert_cmd::prelude::*;
use belfry_host::collect::{Event, Happening, PortState};
use belfry_tests::belfry_command;

use super::bench::{Bench, at, measures, options, windows};
use super::mast::{is_without_gaps, lives, numbers};

#[test]
fn ports_and_studies_that_do_not_serve_are_told_in_words() {
    let bench = Bench::new();
    let says = |said: &str, parts: &[&str]| {
        for part in parts {
            assert!(said.contains(part), "no {part:?} in: {said}");
        }
    };
    let fails = |command: &mut Command, parts: &[&str]| {
        let output = command.assert().failure().get_output().clone();
        says(&String::from_utf8_lossy(&output.stderr), parts);
    };
    let command = |name: &str, more: &[&str]| {
        let mut command = belfry_command();
        command.arg(name).arg(bench.folder()).args(more);
        command
    };
    fails(&mut command("identify", &[]), &["setup \"now\"", "no window has come yet", "belfry collect"]);
    // Only nodes of another study answer.
    let study = bench.folder().join("study.toml");
    let text = fs::read_to_string(&study).unwrap();
    fs::write(&study, text.replace("node = 3", "node = 4").replace("node = 8", "node = 5")).unwrap();
    says(
        &bench.collect_for(60).unwrap_err(),
        &["no sensor of this setup has `node = 3`", "no port has a node that can be used"],
    );
    // More channels than the node has.
    fs::write(&study, text.replace("node = 8", "node = 3")).unwrap();
    bench.hide("node8", true);
    says(&bench.collect_for(60).unwrap_err(), &["node 3 cannot measure", "the node has 2 channels"]);
    bench.hide("node8", false);
    // No band, and no live setup.
    let for_a_minute = ["--port", "unix:nowhere", "--for", "60s"];
    fs::write(&study, text.replace("band_hz = [15.0, 150.0]\n", "")).unwrap();
    fails(&mut command("collect", &for_a_minute), &["band_hz", "before there are data"]);
    fs::write(&study, text.replace("live = true", "files = [\"a.csv\"]\nunit = \"g\"")).unwrap();
    fails(&mut command("collect", &for_a_minute), &["no live setup", "live = true"]);
    fs::write(&study, &text).unwrap();
    fails(
        &mut command("collect", &["--port", "unix:nowhere", "--setup", "then"]),
        &["\"then\" is no live setup", "\"now\""],
    );
    // The nodes still measure for who asks rightly.
    bench.collect_for(4).unwrap();
    assert!(!numbers(bench.folder(), 3).is_empty());
}

#[test]
fn a_node_goes_on_at_another_port_and_after_a_restart() {
    let bench = Bench::new();
    bench.hide("node8", true);
    let mut boot = 0;
    let report = bench.collect(bench.folder(), &options(), |host| {
        host.wait_until("no window comes", |statuses| measures(statuses, "node3", 3) && windows(statuses) >= 4);
        bench.replug(3, "elsewhere");
        host.wait_until("the other port is not found", |statuses| measures(statuses, "elsewhere", 3));
        let before = windows(&host.statuses());
        host.wait_until("no window comes there", |statuses| windows(statuses) >= before + 4);
        // What went into the pulled cable is asked for again.
        host.wait_for_all(3);
        boot = bench.restart(3);
        host.wait_until("the restart is not seen", |statuses| {
            statuses.iter().any(|status| status.hello.as_ref().is_some_and(|hello| hello.boot == boot))
        });
        host.wait_until("no window of its new life comes", |_| {
            lives(bench.folder(), 3).get(&boot).is_some_and(|numbers| numbers.len() >= 4)
        });
        let statuses = host.statuses();
        let old = at(&statuses, "node3").unwrap();
        assert!(matches!(old.state, PortState::Gone(_)) && old.node.is_none(), "{old:?}");
    });
    // Each window once, of both lives.
    let lives = lives(bench.folder(), 3);
    assert_eq!(lives.keys().copied().collect::<Vec<u32>>(), [boot - 1, boot]);
    for (boot, numbers) in &lives {
        assert!(is_without_gaps(numbers), "life {boot}: {numbers:?}");
    }
    // Its count has moved with it: the port where it was has none.
    let stored: usize = lives.values().map(Vec::len).sum();
    assert_eq!(report.unwrap().windows(), stored as u64);
}

#[test]
fn another_node_in_its_place_is_left_alone_and_does_not_end_collecting() {
    let bench = Bench::new();
    // Node 8 belongs to no sensor of this study.
    let study = bench.folder().join("study.toml");
    let text = fs::read_to_string(&study).unwrap();
    let start = text.find("[[setup.sensor]]\nchannel = \"c\"").unwrap();
    fs::write(&study, text[..start].to_owned() + &text[text.find("[analysis]").unwrap()..]).unwrap();
    bench.hide("node8", true);
    bench.hide("elsewhere", true);
    let report = bench.collect(bench.folder(), &options(), |host| {
        host.wait_until("no window comes", |statuses| measures(statuses, "node3", 3) && windows(statuses) >= 4);
        bench.replug(3, "elsewhere");
        bench.replug(8, "node3");
        host.wait_until("the other node is not seen", |statuses| {
            at(statuses, "node3").is_some_and(|status| status.state == PortState::Foreign && status.node == Some(8))
        });
        // What node 3 did there is not the other's.
        let status = at(&host.statuses(), "node3").unwrap().clone();
        assert!(status.statistics.windows == 0 && status.heartbeat.is_none(), "{status:?}");
        host.run(Duration::from_secs(1));
        bench.hide("elsewhere", false);
        host.wait_until("its new port is not found", |statuses| measures(statuses, "elsewhere", 3));
        host.wait_until("no window comes there", |statuses| windows(statuses) >= 8);
        host.wait_for_all(3);
        // One after the other: where it was, that this port was pulled and another node came, and where it is.
        let events = host.take_events();
        let state = |event: &Event| match &event.what {
            Happening::State(state) => Some((event.port.clone(), event.node, state.name())),
            _ => None,
        };
        let states: Vec<_> = events.iter().filter_map(state).collect();
        let expected = [
            ("node3", Some(3), "preparing"),
            ("node3", Some(3), "measuring"),
            ("node3", Some(3), "gone"),
            ("node3", Some(8), "foreign"),
            ("elsewhere", Some(3), "preparing"),
            ("elsewhere", Some(3), "measuring"),
        ];
        assert_eq!(states, expected.map(|(port, node, state)| (port.to_owned(), node, state)));
    });
    report.unwrap();
    assert!(numbers(bench.folder(), 8).is_empty());
    let numbers = numbers(bench.folder(), 3);
    assert!(is_without_gaps(&numbers), "{numbers:?}");
}
