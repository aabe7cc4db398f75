//! What ends the program is recorded, and told after the restart.
//!
//! One end cannot be brought about here: the machine that QEMU emulates has no independent watchdog (its registers take what
//! is written and nothing follows), so that a program that hangs hangs for good.

use std::path::Path;

use belfry_shared::message::{Fault, FaultKind};
use belfry_tests::repository;

use super::emulator::{Board, PROGRAM_COUNTER, STACK_POINTER, belfry, program, symbol};

/// Ends the program by giving registers other values; the fault that it tells afterwards, and what `belfry ports` says of it.
fn fault_after(program: &Path, registers: &[(u8, u32)]) -> (Fault, String) {
    let (board, line, before) = Board::run(program, &[]);
    drop(line);
    assert_eq!(before.fault, None);
    board.go_on_with(registers);
    let after = board.hello();
    assert_ne!(after.boot, before.boot, "it has started anew");
    assert_eq!((after.node, after.configuration_hash, after.clock_set), (before.node, None, false));
    let (done, report, said) = belfry(&["ports", &board.line()]);
    assert!(done, "{said}");
    let ports = report["ports"].as_array().unwrap();
    let port = ports.iter().find(|port| port["port"] == board.line()).unwrap();
    (after.fault.expect("the node says what ended its life"), port["last_fault"].as_str().unwrap().to_owned())
}

#[test]
#[cfg_attr(not(emulator), ignore = "needs qemu-system-arm and a compiler for the board")]
fn a_hard_fault_is_recorded_and_told_after_the_restart() {
    let (fault, words) = fault_after(&program("belfry-node"), &[(PROGRAM_COUNTER, 0xF000_0000)]);
    assert_eq!((fault.kind, fault.address), (FaultKind::HardFault, 0xF000_0000));
    // The processor could not fetch the instruction: bits 0 (not permitted) or 8 (bus error) of the status.
    assert!(fault.status & 0x101 != 0 && fault.link != 0, "{fault:?}");
    let Fault { link, status, .. } = fault;
    assert_eq!(
        words,
        format!("the processor stopped (a hard fault) at 0xf0000000, to return to {link:#010x}, status {status:#010x}")
    );
}

/// The handler of interrupts that nothing should call panics; the processor is sent there.
#[test]
#[cfg_attr(not(emulator), ignore = "needs qemu-system-arm and a compiler for the board")]
fn a_panic_is_recorded_with_its_place_and_told_after_the_restart() {
    let program = program("belfry-node");
    let source = std::fs::read_to_string(repository().join("firmware/src/bin/belfry-node/board/mod.rs")).unwrap();
    let line = 1 + source.lines().position(|line| line.contains("panic!(\"interrupt {number}\")")).unwrap();
    let (fault, words) = fault_after(&program, &[(PROGRAM_COUNTER, symbol(&program, "DefaultHandler") & !1)]);
    assert_eq!(fault.kind, FaultKind::Panic);
    // Of long names the end is kept.
    assert!(fault.place.ends_with(&format!("belfry-node/board/mod.rs:{line}")), "{fault:?}");
    assert_eq!(words, format!("the program stopped itself (a panic) at {}", fault.place));
}

/// The program starts over with a stack that has next to nothing left, so that the functions it calls run over its end.
#[test]
#[cfg_attr(not(emulator), ignore = "needs qemu-system-arm and a compiler for the board")]
fn a_stack_that_runs_over_is_recorded_and_told_after_the_restart() {
    let program = program("belfry-node");
    let (start, stack_end) = (symbol(&program, "main") & !1, symbol(&program, "_stack_end"));
    let registers = [(STACK_POINTER, stack_end + 8), (PROGRAM_COUNTER, start)];
    let (fault, words) = fault_after(&program, &registers);
    assert_eq!(fault.kind, FaultKind::StackOverflow);
    assert_eq!(words, "the stack overflowed");
}

/// An interrupt can be what the stack has no room for: the processor itself runs over its end then.
#[test]
#[cfg_attr(not(emulator), ignore = "needs qemu-system-arm and a compiler for the board")]
fn a_stack_without_room_for_an_interrupt_is_recorded_too() {
    let program = program("belfry-node");
    let (fault, _) = fault_after(&program, &[(STACK_POINTER, symbol(&program, "_stack_end"))]);
    assert_eq!(fault.kind, FaultKind::StackOverflow);
}
