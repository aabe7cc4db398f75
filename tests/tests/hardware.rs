//! The node's program on an emulated board: the same ELF that is flashed, in QEMU, at the other end of a socket.
//!
//! These tests need the program built for the board and `qemu-system-arm`; `./test` provides both and runs them.

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use belfry_firmware::{SUPPORTED_SEGMENTS, welch_segment};
use belfry_host::link::Transport;
use belfry_host::link::port::Port;
use belfry_host::link::replay::who_is_there;
use belfry_shared::frame::crc32;
use belfry_shared::message::{FaultKind, Hello};
use belfry_tests::belfry_command;
use serde_json::Value;

const PATIENCE: Duration = Duration::from_secs(20);

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_owned()
}

/// The program for the board, which `firmware/build.sh` names.
fn program() -> PathBuf {
    let built = Command::new(repository().join("firmware/build.sh")).stderr(Stdio::inherit()).output().unwrap();
    assert!(built.status.success(), "the node's program cannot be built");
    repository().join(String::from_utf8(built.stdout).unwrap().trim())
}

/// An emulated board; it stops with the test.
struct Board {
    emulator: Child,
    folder: tempfile::TempDir,
}

impl Board {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let socket = |name: &str| format!("unix:{},server=on,wait=off", folder.path().join(name).display());
        let emulator = Command::new("qemu-system-arm")
            .args(["-M", "netduinoplus2", "-display", "none", "-monitor", "none", "-serial", "null"])
            .args(["-serial", &socket("line"), "-gdb", &socket("debugger"), "-kernel"])
            .arg(program())
            .stdout(Stdio::null())
            .spawn()
            .expect("qemu-system-arm runs (Debian's package of that name)");
        let board = Self { emulator, folder };
        let start = Instant::now();
        // Not by connecting: a debugger that connects halts the processor.
        while !["line", "debugger"].iter().all(|name| board.folder.path().join(name).exists()) {
            assert!(start.elapsed() < PATIENCE, "the emulator did not start");
            std::thread::sleep(Duration::from_millis(50));
        }
        board
    }

    /// The line's name for `belfry`.
    fn line(&self) -> String {
        format!("unix:{}", self.folder.path().join("line").display())
    }

    fn hello(&self) -> Hello {
        let mut port = Port::open(&self.line(), 115_200).unwrap();
        who_is_there(&mut port, PATIENCE).unwrap()
    }

    /// Lets the processor go on elsewhere, by the debugger's protocol.
    fn jump(&self, address: u32) {
        let mut stream = UnixStream::connect(self.folder.path().join("debugger")).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let bytes: String = address.to_le_bytes().iter().map(|byte| format!("{byte:02x}")).collect();
        // The emulator takes registers by their numbers only from a debugger that has asked which there are.
        let registers = "qXfer:features:read:target.xml:0,ffb";
        for (command, answers) in [("?", true), (registers, true), (&format!("Pf={bytes}"), true), ("c", false)] {
            let sum = command.bytes().fold(0_u8, u8::wrapping_add);
            stream.write_all(format!("+${command}#{sum:02x}").as_bytes()).unwrap();
            let mut answer = Vec::new();
            while answers && !(answer.contains(&b'#') && answer.iter().rev().position(|&byte| byte == b'#') == Some(2))
            {
                let mut byte = [0];
                stream.read_exact(&mut byte).unwrap();
                answer.push(byte[0]);
            }
        }
        // The emulator halts the processor when the debugger leaves before it has gone on.
        std::thread::sleep(Duration::from_millis(500));
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        let _ = self.emulator.kill();
        let _ = self.emulator.wait();
    }
}

/// `belfry ... --json`, its exit status and its object.
fn belfry(arguments: &[&str]) -> (bool, Value, String) {
    let output = belfry_command().args(arguments).arg("--json").output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    (output.status.success(), serde_json::from_slice(&output.stdout).unwrap_or(Value::Null), said)
}

/// Every window of every node is that of the same firmware on this computer, to the bit.
fn assert_same_bits(report: &Value, nodes: usize) {
    let played = report["nodes"].as_array().unwrap();
    assert_eq!(played.len(), nodes, "{report}");
    for node in played {
        assert!(node["windows"].as_u64().unwrap() > 0 && node["windows"] == node["identical"], "{node}");
        // 10 bits: half a step of 1/511 of a block's full scale, which is up to 19 % above its largest component.
        assert!(node["largest_difference"].as_f64().unwrap() < 2e-3, "{node}");
    }
}

#[test]
#[ignore = "needs the node's program and qemu-system-arm; ./test runs it"]
fn a_real_recording_gives_the_same_bits_on_the_board() {
    let board = Board::start();
    let study = repository().join("studies/heritage-court");
    let (done, report, said) = belfry(&["replay", study.to_str().unwrap(), "--nodes", "1", "--port", &board.line()]);
    assert!(done, "{said}");
    assert_same_bits(&report, 4);
}

#[test]
#[ignore = "needs the node's program and qemu-system-arm; ./test runs it"]
fn an_hour_of_the_tower_gives_the_same_bits_on_two_boards_at_once() {
    let boards = [Board::start(), Board::start()];
    let folder = tempfile::tempdir().unwrap();
    let study = folder.path().join("tower");
    let study = study.to_str().unwrap();
    assert!(belfry(&["init", study, "--template", "canton"]).0);
    assert!(belfry(&["simulate", study, "--hours", "1", "--seed", "3", "--adopt"]).0);
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
#[ignore = "needs the node's program and qemu-system-arm; ./test runs it"]
fn garbage_and_a_vanished_host_leave_the_node_listening() {
    let board = Board::start();
    let before = board.hello();
    assert_eq!((before.node, before.fault.clone(), before.replaying), (1, None, false));
    {
        let mut port = Port::open(&board.line(), 115_200).unwrap();
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

#[test]
#[ignore = "needs the node's program and qemu-system-arm; ./test runs it"]
fn a_hard_fault_is_recorded_and_told_after_the_restart() {
    let board = Board::start();
    let before = board.hello();
    board.jump(0xF000_0000);
    let after = board.hello();
    let fault = after.fault.expect("the node says what ended its life");
    assert_eq!((fault.kind, fault.address), (FaultKind::HardFault, 0xF000_0000));
    assert_ne!(after.boot, before.boot);
}

/// Bytes of a program's segments: those that lie in flash (with the first values of data), and those that data take in RAM.
fn flash_and_ram(program: &Path) -> (u64, u64) {
    use object::{Object, ObjectSection, SectionKind};
    let bytes = std::fs::read(program).unwrap();
    let file = object::File::parse(&*bytes).unwrap();
    let (mut flash, mut ram) = (0, 0);
    for section in file.sections().filter(|section| section.address() > 0) {
        match section.kind() {
            SectionKind::Data => (flash, ram) = (flash + section.size(), ram + section.size()),
            SectionKind::UninitializedData => ram += section.size(),
            _ => flash += section.size(),
        }
    }
    (flash, ram)
}

/// What `firmware/count.sh` prints: of which kind a number is, of what size, and the number.
fn counts() -> Vec<(String, u32, u64)> {
    let counted = Command::new(repository().join("firmware/count.sh")).stderr(Stdio::inherit()).output().unwrap();
    assert!(counted.status.success(), "instructions cannot be counted");
    let text = String::from_utf8(counted.stdout).unwrap();
    let of_line = |line: &str| {
        let mut words = line.split(' ');
        let (kind, size, number) = (words.next()?, words.next()?.parse().ok()?, words.next()?.parse().ok()?);
        ["segment", "checksum", "second"].contains(&kind).then(|| (kind.to_owned(), size, number))
    };
    text.lines().filter_map(of_line).collect()
}

#[test]
#[ignore = "needs the node's program and qemu-system-arm; ./test runs it"]
fn spectra_of_every_length_have_the_same_bits_on_the_board() {
    let on_board: Vec<(u32, u64)> =
        counts().into_iter().filter(|(kind, ..)| kind == "checksum").map(|(_, size, sum)| (size, sum)).collect();
    let here: Vec<(u32, u64)> = SUPPORTED_SEGMENTS
        .iter()
        .map(|&length| {
            // The signal that belfry-count makes.
            let noise = |n: u32| (n.wrapping_mul(2_654_435_761) >> 8) as f32 / (1 << 24) as f32 - 0.5;
            let mut samples: Vec<f32> = (0..u32::from(length)).map(noise).collect();
            let mut sums = vec![0.0; usize::from(length) / 2];
            welch_segment(&mut samples, 5.0, &mut sums);
            let bytes: Vec<u8> = sums.iter().flat_map(|sum: &f32| sum.to_le_bytes()).collect();
            (u32::from(length), u64::from(crc32(&bytes)))
        })
        .collect();
    assert_eq!(on_board, here);
}

#[test]
#[ignore = "needs the node's program and qemu-system-arm; ./test runs it"]
fn the_program_is_no_larger_and_no_slower_than_recorded() {
    let record: toml::Table =
        std::fs::read_to_string(repository().join("firmware/figures.toml")).unwrap().parse().unwrap();
    let recorded = |name: &str| {
        let mut words = name.split('.');
        let first = record.get(words.next().unwrap());
        words.fold(first, |table, word| table?.get(word)).and_then(toml::Value::as_integer).unwrap_or(0) as u64
    };
    let (flash, ram) = flash_and_ram(&program());
    assert!(flash <= 96 * 1024 && ram <= 112 * 1024, "{flash} bytes of flash, {ram} of RAM");
    let mut measured = vec![("bytes.flash".to_owned(), flash), ("bytes.ram".to_owned(), ram)];
    let counted = counts().into_iter().filter(|(kind, ..)| kind != "checksum");
    measured.extend(counted.map(|(kind, size, count)| (format!("instructions.{kind}.{size}"), count)));
    assert_eq!(measured.len(), 9, "{measured:?}");
    let grown: Vec<String> = measured
        .iter()
        .filter(|(name, now)| 100 * now > 105 * recorded(name))
        .map(|(name, now)| format!("{name}: {now}, recorded {}", recorded(name)))
        .collect();
    assert!(grown.is_empty(), "more than 5 % over firmware/figures.toml: {}", grown.join("; "));
    // The whole node on a core of 168 MHz: 0.5 % at 50 Hz, 10 % at 1000 Hz.
    let of = |name: &str| measured.iter().find(|(known, _)| known == name).unwrap().1 as f64 / 168e6;
    assert!(of("instructions.second.50") < 0.005 && of("instructions.second.1000") < 0.1, "{measured:?}");
}
