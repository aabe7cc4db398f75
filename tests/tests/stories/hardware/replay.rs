//! Recordings through boards, and lines that are not as they should be.

use belfry_host::link::Transport;
use belfry_tests::repository;

use super::emulator::{Board, assert_same_bits, belfry};

#[test]
#[cfg_attr(
    not(all(emulator, heritage_court_data)),
    ignore = "needs ../shared/heritage-court, qemu-system-arm and a compiler for the board"
)]
fn a_real_recording_gives_the_same_bits_on_the_board() {
    let board = Board::start();
    let study = repository().join("studies/heritage-court");
    let (done, report, said) = belfry(&["replay", study.to_str().unwrap(), "--nodes", "1", "--port", &board.line()]);
    assert!(done, "{said}");
    assert_same_bits(&report, 4);
}

/// Half an hour is three windows: the ring of samples comes round twice, and heartbeats come.
#[test]
#[cfg_attr(not(all(long_tests, emulator)), ignore = "long: ./test --all runs it where qemu-system-arm is")]
fn half_an_hour_of_the_tower_gives_the_same_bits_on_two_boards_at_once() {
    let boards = Board::start_two();
    let folder = tempfile::tempdir().unwrap();
    let study = folder.path().join("tower");
    let study = study.to_str().unwrap();
    assert!(belfry(&["init", study, "--template", "canton"]).0);
    assert!(belfry(&["simulate", study, "--hours", "0.5", "--seed", "3", "--adopt"]).0);
    let (first, second) = (boards[0].line(), boards[1].line());
    let (done, report, said) = belfry(&["replay", study, "--nodes", "1,2", "--port", &first, "--port", &second]);
    assert!(done, "{said}");
    assert_same_bits(&report, 2);
    // The heartbeats came, and the stack has room: 16 KB are set aside.
    for node in report["nodes"].as_array().unwrap() {
        assert!(node["stack_free_bytes"].as_u64().unwrap() > 2048, "{node}");
    }
}

#[test]
#[cfg_attr(not(emulator), ignore = "needs qemu-system-arm and a compiler for the board")]
fn garbage_and_a_vanished_host_leave_the_node_listening() {
    let board = Board::start();
    let before = board.hello();
    assert_eq!((before.node, before.fault.clone(), before.replaying), (1, None, false));
    {
        let mut port = board.port();
        for n in 0..200_u32 {
            let noise: Vec<u8> =
                (0..64).map(|k| (n.wrapping_mul(2_654_435_761).wrapping_add(k * 97) >> 11) as u8).collect();
            port.write(&noise).unwrap();
        }
        // The host vanishes in the middle of a frame.
        port.write(&[7, 1, 2]).unwrap();
    }
    let after = board.hello();
    assert_eq!(after.boot, before.boot, "it has not started anew");
    let (done, report, _) = belfry(&["ports", &board.line()]);
    assert!(done);
    let ports = report["ports"].as_array().unwrap();
    assert!(ports.iter().any(|port| port["port"] == board.line() && port["node"] == 1), "{report}");
}
