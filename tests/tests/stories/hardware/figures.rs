//! The program's size and instructions against the record.

use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::OnceLock;

use belfry_firmware::{SUPPORTED_SEGMENTS, welch_segment};
use belfry_shared::frame::crc32;
use belfry_tests::repository;

use super::emulator::{Seats, program, program_with_store};

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

/// A TOML file of the repository.
fn table(file: &str) -> toml::Table {
    std::fs::read_to_string(repository().join(file)).unwrap().parse().unwrap()
}

/// What `firmware/count.sh` prints: of which kind a number is, of what size, and the number.
fn counts() -> &'static [(String, u32, u64)] {
    static COUNTS: OnceLock<Vec<(String, u32, u64)>> = OnceLock::new();
    COUNTS.get_or_init(|| {
        let program = program("belfry-count");
        let _seat = Seats::take(1);
        let mut count = Command::new(repository().join("firmware/count.sh"));
        let counted = count.arg(program).stderr(Stdio::inherit()).output().unwrap();
        assert!(counted.status.success(), "instructions cannot be counted");
        let text = String::from_utf8(counted.stdout).unwrap();
        let of_line = |line: &str| {
            let mut words = line.split(' ');
            let (kind, size, number) = (words.next()?, words.next()?.parse().ok()?, words.next()?.parse().ok()?);
            ["segment", "checksum", "second", "fetch", "seal", "sealed"]
                .contains(&kind)
                .then(|| (kind.to_owned(), size, number))
        };
        text.lines().filter_map(of_line).collect()
    })
}

#[test]
#[cfg_attr(not(emulator), ignore = "needs qemu-system-arm and a compiler for the board")]
fn spectra_of_every_length_have_the_same_bits_on_the_board() {
    let on_board: Vec<(u32, u64)> =
        counts().iter().filter(|(kind, ..)| kind == "checksum").map(|&(_, size, sum)| (size, sum)).collect();
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
#[cfg_attr(not(emulator), ignore = "needs qemu-system-arm and a compiler for the board")]
fn the_program_is_no_larger_and_no_slower_than_recorded() {
    let record = table("firmware/figures.toml");
    let recorded = |name: &str| {
        let mut words = name.split('.');
        let first = record.get(words.next().unwrap());
        words.fold(first, |table, word| table?.get(word)).and_then(toml::Value::as_integer).unwrap_or(0) as u64
    };
    let mut measured = Vec::new();
    for (program, of) in [(program("belfry-node"), ""), (program_with_store(), "_with_store")] {
        let (flash, ram) = flash_and_ram(&program);
        println!("{}: {flash} bytes of flash, {ram} of RAM", program.display());
        assert!(flash <= 96 * 1024 && ram <= 112 * 1024, "{}: {flash}, {ram}", program.display());
        measured.extend([(format!("bytes.flash{of}"), flash), (format!("bytes.ram{of}"), ram)]);
    }
    let counted = counts().iter().filter(|(kind, ..)| kind != "checksum");
    measured.extend(counted.map(|(kind, size, count)| (format!("instructions.{kind}.{size}"), *count)));
    assert_eq!(measured.len(), 17, "{measured:?}");
    let grown: Vec<String> = measured
        .iter()
        .filter(|(name, now)| 100 * now > 105 * recorded(name))
        .map(|(name, now)| format!("{name}: {now}, recorded {}", recorded(name)))
        .collect();
    assert!(grown.is_empty(), "more than 5 % over firmware/figures.toml: {}", grown.join("; "));
    // The whole node on a core of 168 MHz: 0.5 % at 50 Hz, 10 % at 1000 Hz. Sampling is in it: the interrupt waits for the bytes on the sensor's bus,
    // 1.6 µs each; entry and exit of two interrupts, the timer and the select are less than 300 instructions.
    let of = |name: &str| measured.iter().find(|(known, _)| known == name).unwrap().1 as f64 / 168e6;
    let sample = of("instructions.fetch.14") + 300.0 / 168e6 + 14.0 * 1.6e-6;
    let load = |rate_hz: u32| of(&format!("instructions.second.{rate_hz}")) + f64::from(rate_hz) * sample;
    println!("load: {:.3} % at 50 Hz, {:.3} % at 1000 Hz", 100.0 * load(50), 100.0 * load(1000));
    assert!(load(50) < 0.005 && load(1000) < 0.1, "{measured:?}");
    // Seals take at most 5 % of what the node does.
    for rate_hz in [50, 1000] {
        let (plain, sealed) =
            (of(&format!("instructions.second.{rate_hz}")), of(&format!("instructions.sealed.{rate_hz}")));
        assert!(sealed < 1.05 * plain, "{measured:?}");
    }
    // CMSIS-DSP's window, FFT, power and sum.
    for (length, cmsis) in [(256, 14_449), (1024, 57_595), (2048, 134_087)] {
        let name = format!("instructions.segment.{length}");
        assert!(measured.iter().any(|(known, count)| *known == name && *count <= cmsis), "{name}: {measured:?}");
    }
}

/// `cargo run` in firmware/ takes its development profile, which has to be the one that all of this is measured with.
#[test]
fn what_cargo_run_flashes_is_built_as_what_is_tested() {
    let profile = |table: &toml::Table, name: &str| table["profile"][name].as_table().unwrap().clone();
    let (workspace, flashed) = (table("Cargo.toml"), table("firmware/.cargo/config.toml"));
    let mut tested = profile(&workspace, "firmware");
    assert_eq!(tested.remove("inherits"), Some("release".into()));
    // What cargo's own release profile has and its development profile does not.
    for name in ["debug", "debug-assertions", "overflow-checks", "incremental"] {
        tested.entry(name).or_insert(false.into());
    }
    assert_eq!(profile(&flashed, "dev"), tested);
}
