//! Emulated boards: QEMU with a program, its serial port, and a debugger's end.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Condvar, Mutex};
use std::time::{Duration, Instant};

use belfry_host::link::Transport;
use belfry_host::link::port::Port;
use belfry_host::link::who_is_there;
use belfry_shared::frame::FrameDecoder;
use belfry_shared::message::{self, Hello, NodeMessage};
use belfry_tests::{belfry_command, repository};
use serde_json::Value;

pub(crate) const PATIENCE: Duration = Duration::from_secs(20);
/// Of the ports; sockets have none.
pub(crate) const BAUD: u32 = 115_200;

/// The stack pointer and the program counter, as debuggers number them.
pub(crate) const STACK_POINTER: u8 = 13;
pub(crate) const PROGRAM_COUNTER: u8 = 15;

/// A program for the board: in the folder that BELFRY_PROGRAMS names, or built by `firmware/build.sh`, once.
pub(crate) fn program(name: &'static str) -> PathBuf {
    static PROGRAMS: Mutex<BTreeMap<&str, PathBuf>> = Mutex::new(BTreeMap::new());
    PROGRAMS.lock().unwrap().entry(name).or_insert_with(|| ready(name).unwrap_or_else(|| built(name))).clone()
}

fn ready(name: &str) -> Option<PathBuf> {
    let program = repository().join(std::env::var_os("BELFRY_PROGRAMS")?).join(name);
    assert!(program.is_file(), "BELFRY_PROGRAMS names a folder without {name}");
    Some(program)
}

fn built(name: &str) -> PathBuf {
    built_by(Command::new(repository().join("firmware/build.sh")).arg(name))
}

fn built_by(build: &mut Command) -> PathBuf {
    let built = build.stderr(Stdio::inherit()).output().unwrap();
    assert!(built.status.success(), "{build:?} fails");
    repository().join(String::from_utf8(built.stdout).unwrap().trim())
}

/// The node's program for a board with a memory chip, from beside those that BELFRY_PROGRAMS names, or built.
pub(crate) fn program_with_store() -> PathBuf {
    match std::env::var_os("BELFRY_PROGRAMS") {
        Some(folder) => {
            let program = repository().join(folder).join("../firmware-store/belfry-node");
            assert!(program.is_file(), "there is no {}", program.display());
            program
        }
        None => built_by(Command::new(repository().join("firmware/build.sh")).env("BELFRY_STORE", "yes")),
    }
}

/// The address of a symbol of a program.
pub(crate) fn symbol(program: &Path, name: &str) -> u32 {
    use object::{Object, ObjectSymbol};
    let bytes = std::fs::read(program).unwrap();
    let file = object::File::parse(&*bytes).unwrap();
    let symbol = file.symbols().find(|symbol| symbol.name() == Ok(name));
    let symbol = symbol.unwrap_or_else(|| panic!("{} has no {name}", program.display()));
    u32::try_from(symbol.address()).unwrap()
}

/// Permission to run emulators. Two at a time: more only slow each other down.
pub(crate) struct Seats(usize);

const SEATS: usize = 2;
static TAKEN: (Mutex<usize>, Condvar) = (Mutex::new(0), Condvar::new());

impl Seats {
    /// Waits until so many emulators may start, and takes them all at once.
    pub(crate) fn take(wanted: usize) -> Self {
        let taken = TAKEN.0.lock().unwrap();
        *TAKEN.1.wait_while(taken, |taken| *taken + wanted > SEATS).unwrap() += wanted;
        Self(wanted)
    }
}

impl Drop for Seats {
    fn drop(&mut self) {
        *TAKEN.0.lock().unwrap() -= self.0;
        TAKEN.1.notify_all();
    }
}

/// An emulated board; it stops with the test.
pub(crate) struct Board {
    emulator: Child,
    folder: tempfile::TempDir,
    // Given back when the emulator has ended.
    _seats: Option<Seats>,
}

impl Board {
    /// The node, which listens.
    pub(crate) fn start() -> Self {
        Self::run(&program("belfry-node"), &[]).0
    }

    /// Two of them.
    pub(crate) fn start_two() -> [Self; 2] {
        let program = program("belfry-node");
        let seats = Seats::take(2);
        let (first, ..) = Self::run_seated(&program, &[], None);
        // The seats are the second's, which stops last.
        let (second, ..) = Self::run_seated(&program, &[], Some(seats));
        [first, second]
    }

    /// A program, with arguments for the emulator besides; its line, and the greeting with which it has started.
    pub(crate) fn run(program: &Path, arguments: &[&str]) -> (Self, Port, Hello) {
        Self::run_seated(program, arguments, Some(Seats::take(1)))
    }

    fn run_seated(program: &Path, arguments: &[&str], seats: Option<Seats>) -> (Self, Port, Hello) {
        let folder = tempfile::tempdir().unwrap();
        let socket = |name: &str| format!("unix:{},server=on,wait=off", folder.path().join(name).display());
        let emulator = Command::new("qemu-system-arm")
            .args(["-M", "netduinoplus2", "-display", "none", "-monitor", "none", "-serial", "null"])
            // The processor waits until somebody listens.
            .args(["-serial", &socket("line"), "-gdb", &socket("debugger"), "-S"])
            .args(arguments)
            .arg("-kernel")
            .arg(program)
            .stdout(Stdio::null())
            .spawn()
            .expect("qemu-system-arm runs (Debian's package of that name)");
        let mut board = Self { emulator, folder, _seats: seats };
        let mut port = board.port_of_its_start();
        board.go_on_with(&[]);
        // What is said to a program that does not listen yet is lost, and may be lost in part: so nothing is said before it has
        // greeted.
        let hello = first_hello(&mut port);
        (board, port, hello)
    }

    /// Its line, once it listens.
    fn port_of_its_start(&mut self) -> Port {
        let line = self.line();
        when_listening(|| {
            let ended = self.emulator.try_wait().unwrap();
            assert!(ended.is_none(), "the emulator ended at its start: {ended:?}");
            Port::open(&line, BAUD)
        })
    }

    /// The line's name for `belfry`.
    pub(crate) fn line(&self) -> String {
        format!("unix:{}", self.folder.path().join("line").display())
    }

    pub(crate) fn port(&self) -> Port {
        Port::open(&self.line(), BAUD).unwrap()
    }

    pub(crate) fn hello(&self) -> Hello {
        who_is_there(&mut self.port(), PATIENCE).unwrap()
    }

    /// Gives registers of the processor other values and lets it go on.
    pub(crate) fn go_on_with(&self, registers: &[(u8, u32)]) {
        let mut debugger = Debugger::attach(&self.folder.path().join("debugger"));
        for &(number, value) in registers {
            let bytes: String = value.to_le_bytes().iter().map(|byte| format!("{byte:02x}")).collect();
            assert_eq!(debugger.ask(&format!("P{number:x}={bytes}")), "OK");
        }
        // Its answer comes once the processor goes on.
        assert_eq!(debugger.ask("D"), "OK");
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        let _ = self.emulator.kill();
        let _ = self.emulator.wait();
    }
}

/// The greeting with which a program starts.
fn first_hello(port: &mut Port) -> Hello {
    let (mut decoder, mut buffer) = (FrameDecoder::new(), [0; 64]);
    let start = Instant::now();
    while start.elapsed() < PATIENCE {
        let count = port.read(&mut buffer).unwrap();
        for &byte in &buffer[..count] {
            if let Some(frame) = decoder.push(byte) {
                let NodeMessage::Hello(hello) = message::decode(frame.unwrap().message).unwrap() else {
                    panic!("no greeting")
                };
                return hello;
            }
        }
    }
    panic!("the program does not greet");
}

/// Opens a socket of the emulator, which makes the file some time before it listens.
fn when_listening<T, E: Display>(mut open: impl FnMut() -> Result<T, E>) -> T {
    let start = Instant::now();
    loop {
        match open() {
            Ok(opened) => return opened,
            Err(error) => assert!(start.elapsed() < PATIENCE, "the emulator does not listen: {error}"),
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// The debugger's end of the emulator's remote protocol; the processor stands while it is there.
struct Debugger {
    stream: UnixStream,
    answers: BufReader<UnixStream>,
}

impl Debugger {
    fn attach(socket: &Path) -> Self {
        let stream = when_listening(|| UnixStream::connect(socket));
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let answers = BufReader::new(stream.try_clone().unwrap());
        let mut debugger = Self { stream, answers };
        debugger.ask("?");
        // The emulator takes registers by their numbers only from a debugger that has asked which there are.
        debugger.ask("qXfer:features:read:target.xml:0,ffb");
        debugger
    }

    /// The answer to a command.
    fn ask(&mut self, command: &str) -> String {
        let sum = command.bytes().fold(0_u8, u8::wrapping_add);
        // The plus takes note of the answer before.
        self.stream.write_all(format!("+${command}#{sum:02x}").as_bytes()).unwrap();
        loop {
            let answer = self.packet();
            // That the processor stands is told unasked as well.
            if command == "?" || !answer.starts_with('T') {
                return answer;
            }
        }
    }

    /// The next packet: `$`, what it says, `#`, two digits of its sum.
    fn packet(&mut self) -> String {
        let mut packet = Vec::new();
        self.answers.read_until(b'$', &mut packet).unwrap();
        packet.clear();
        self.answers.read_until(b'#', &mut packet).unwrap();
        self.answers.read_exact(&mut [0; 2]).expect("the emulator answers its debugger");
        packet.pop();
        String::from_utf8_lossy(&packet).into_owned()
    }
}

/// `belfry ... --json`, its exit status and its object.
pub(crate) fn belfry(arguments: &[&str]) -> (bool, Value, String) {
    let output = belfry_command().args(arguments).arg("--json").output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    (output.status.success(), serde_json::from_slice(&output.stdout).unwrap_or(Value::Null), said)
}

/// Every window of every node is that of the same firmware on this computer, to the bit.
pub(crate) fn assert_same_bits(report: &Value, nodes: usize) {
    let played = report["nodes"].as_array().unwrap();
    assert_eq!(played.len(), nodes, "{report}");
    for node in played {
        assert!(node["windows"].as_u64().unwrap() > 0 && node["windows"] == node["identical"], "{node}");
        // 10 bits: half a step of 1/511 of a block's full scale, which is up to 19 % above its largest component.
        assert!(node["largest_difference"].as_f64().unwrap() < 2e-3, "{node}");
    }
}
