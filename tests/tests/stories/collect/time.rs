//! A host that stays away for long, and a computer whose clock is set.

use std::fs;
use std::time::Duration;

use belfry_host::collect::CollectOptions;
use belfry_host::heartbeats;
use belfry_shared::time::HostTime;
use belfry_tests::belfry_command;

use super::bench::{Bench, at, options};
use super::mast::{archive, folder_in_memory, is_without_gaps, numbers};

#[test]
fn a_host_that_stays_away_for_long_gets_what_the_node_still_has_and_is_told_what_is_lost() {
    let bench = Bench::new();
    let of = |node| numbers(bench.folder(), node);
    bench.collect_for(3).unwrap();
    let (before, before_eight) = (of(3), of(8).len());
    // A node keeps 112 parts at most: some fifty windows here, seven seconds.
    bench.pass(Duration::from_secs(14));
    let report = bench.collect_for(5).unwrap();
    let numbers = of(3);
    let (last_before, first_after) = (before.len() as u32 - 1, numbers[before.len()]);
    assert!(is_without_gaps(&before) && first_after > last_before + 10, "{numbers:?}");
    // What was still there comes, as does what was measured meanwhile.
    bench.collect_rest(before.len().max(before_eight));
    let numbers = of(3);
    let after: Vec<u32> = numbers[before.len()..].to_vec();
    assert!(after.len() > 30 && after.iter().copied().eq(first_after..first_after + after.len() as u32), "{numbers:?}");
    let lost = report.ports.iter().find(|port| port.node == Some(3)).unwrap().lost_windows;
    assert_eq!(lost, u64::from(first_after - last_before - 1));
    let checked = belfry_command().args(["archive", "check"]).arg(bench.folder()).output().unwrap();
    let said = String::from_utf8(checked.stderr).unwrap() + &String::from_utf8(checked.stdout).unwrap();
    let listed = format!("node 3: {lost} windows are lost: the node had no room for them any longer");
    assert!(checked.status.success() && said.contains(&listed), "{said}");
    // Another study, of the very same settings: nothing of what the node measured before is taken for its own.
    bench.collect_for(3).unwrap();
    bench.pass(Duration::from_secs(2));
    let other = folder_in_memory();
    fs::copy(bench.folder().join("study.toml"), other.path().join("study.toml")).unwrap();
    bench.hide("node8", true);
    let collect_there = |drop_foreign| {
        let options = CollectOptions { drop_foreign, ..options() };
        bench.collect(other.path(), &options, |host| host.run(Duration::from_secs(4)))
    };
    let said = collect_there(false).unwrap_err();
    assert!(
        said.contains("still holds windows that another study asked for") && said.contains("--drop-foreign"),
        "{said}"
    );
    let dropped = collect_there(true).unwrap();
    let foreign = dropped.ports[0].foreign_windows as u32;
    assert!(foreign > 5, "{dropped:?}");
    let first: u32 = archive(other.path()).query_row("SELECT min(number) FROM window", [], |row| row.get(0)).unwrap();
    assert_eq!(first, of(3).last().unwrap() + 1 + foreign, "{dropped:?}");
}

#[test]
fn a_computers_clock_that_is_set_moves_the_nodes_time_with_it() {
    let bench = Bench::with_crystals(200.0);
    bench.hide("node8", true);
    let began_after = |seconds: f64| -> usize {
        let query = "SELECT count(*) FROM window WHERE start_us > ?1";
        archive(bench.folder()).query_row(query, [(seconds * 1e6) as i64], |row| row.get(0)).unwrap()
    };
    let mut tomorrow_s = 0.0;
    let report = bench.collect(bench.folder(), &options(), |host| {
        // From 20 s on; both ends look at the line every quarter of a millisecond, which is 12 ppm of that.
        host.wait_until("the drift of -200 ppm is not found", |statuses| {
            let drift_ppm = at(statuses, "node3").and_then(|status| status.drift_ppm);
            drift_ppm.is_some_and(|drift_ppm| (drift_ppm + 200.0).abs() < 30.0)
        });
        tomorrow_s = bench.unix_s() + 80_000.0;
        assert_eq!(began_after(tomorrow_s), 0);
        bench.set_ahead(86_400);
        host.wait_until("no window of tomorrow comes", |_| began_after(tomorrow_s) >= 8);
        host.wait_for_all(3);
    });
    report.unwrap();
    let numbers = numbers(bench.folder(), 3);
    assert!(is_without_gaps(&numbers), "{numbers:?}");
    // Today's came before.
    assert!(began_after(0.0) > began_after(tomorrow_s) + 8);
}

#[test]
fn what_nodes_say_of_themselves_is_kept_whenever_it_comes() {
    let bench = Bench::new();
    // The first comes ten seconds after the configuration, the others every two minutes.
    bench.collect_for(15).unwrap();
    bench.collect_for(130).unwrap();
    let mut kept = Vec::new();
    assert_eq!(heartbeats::read(bench.folder(), |heartbeat| kept.push(heartbeat)).unwrap(), 0);
    for node in [3, 8] {
        let of_node: Vec<_> = kept.iter().filter(|heartbeat| heartbeat.node == node).collect();
        let times: Vec<f64> = of_node.iter().map(|heartbeat| heartbeat.time_s).collect();
        assert!(times.len() == 2 && (times[1] - times[0] - 120.0).abs() < 1.0, "node {node}: {times:?}");
        // Motion of some mm/s² about nothing.
        assert!(
            of_node.iter().all(|one| one.variance.len() == 2 && one.variance.iter().all(|v| *v > 0.0)),
            "{of_node:?}"
        );
        assert!(of_node.iter().all(|one| one.mean_m_s2.iter().all(|mean| mean.abs() < 0.01)), "{of_node:?}");
    }
    // Those of the first ten seconds are from before the others.
    let middle = HostTime((1e6 * (kept[0].time_s + 60.0)) as i64);
    assert_eq!(heartbeats::prune(bench.folder(), middle, false).unwrap(), 2);
}
