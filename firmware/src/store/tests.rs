//! The store on a simulated chip whose supply fails at every byte that it writes.

use super::*;
use belfry_shared::message::{AxisCalibration, MAX_CHANNELS};
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::{vec, vec::Vec};

const FIRST_BOOT: u32 = u32::MAX - 1;
/// Parts of a window, in the order in which they are made: the head last.
const PARTS: [(u16, usize); 4] = [(1, 500), (2, 500), (3, 211), (0, 40)];
const TECHNOLOGIES: [Technology; 2] = [Technology::Fram, Technology::Nor];
const NOISE: [u8; 3] = [0x00, 0xFF, 0x5A];

type TestStore = Store<SimulatedChip<Vec<u8>>>;

fn blank(sectors: u32) -> Vec<u8> {
    vec![0xFF; (sectors * SECTOR_BYTES) as usize]
}

fn open(memory: Vec<u8>, technology: Technology) -> TestStore {
    let store = Store::open(SimulatedChip::new(memory, technology), FIRST_BOOT);
    assert!(store.has_chip());
    store
}

fn part_of(boot: u32, window: u32, part: u16, length: usize) -> Vec<u8> {
    let name = [&boot.to_le_bytes()[..], &window.to_le_bytes(), &part.to_le_bytes()].concat();
    (0..length).map(|n| name.get(n).copied().unwrap_or((7 * window + 3 * u32::from(part) + n as u32) as u8)).collect()
}

/// The longest there is.
fn calibration() -> Calibration {
    let axis = AxisCalibration { gain_ppm: i32::MIN, gain_std_ppm: u32::MAX, offset_um_s2: i32::MIN };
    Calibration { time: HostTime(i64::MIN), axes: heapless::Vec::from_slice(&[axis; MAX_CHANNELS]).unwrap() }
}

fn everything() -> Again {
    Again { first_window: 0, last_window: u32::MAX, first_part: 0, last_part: u16::MAX }
}

/// Puts windows up to `end`; how many are kept whole, up to where the supply fails.
fn put_windows(store: &mut TestStore, windows: core::ops::Range<u32>) -> u32 {
    let mut whole = windows.start;
    for window in windows {
        for (part, length) in PARTS {
            let message = part_of(store.boot(), window, part, length);
            while !store.put(window, part, &message) {
                store.step();
                if store.chip().has_failed() {
                    return whole;
                }
            }
            while store.step() {}
            if store.take_written() != Some((window, part)) {
                assert!(store.chip().has_failed());
                return whole;
            }
        }
        whole = window + 1;
    }
    whole
}

/// All parts that the store gives of a boot, and how often.
fn read_all(store: &mut TestStore, boot: u32, wanted: Again) -> BTreeMap<(u32, u16), Vec<Vec<u8>>> {
    let lengths: BTreeMap<u16, usize> = PARTS.into();
    let mut parts: BTreeMap<(u32, u16), Vec<Vec<u8>>> = BTreeMap::new();
    store.want(boot, &wanted);
    while store.step() {
        while let Some(bytes) = store.take_loaded().map(<[u8]>::to_vec) {
            // The content says which part it is.
            let window = u32::from_le_bytes(bytes[4..8].try_into().unwrap());
            let part = u16::from_le_bytes(bytes[8..10].try_into().unwrap());
            assert_eq!(bytes, part_of(boot, window, part, lengths[&part]));
            parts.entry((window, part)).or_default().push(bytes);
        }
    }
    parts
}

/// Every part of these windows, once, and nothing else.
fn assert_holds(store: &mut TestStore, boot: u32, windows: core::ops::Range<u32>) {
    let wanted = Again { first_window: windows.start, last_window: windows.end.saturating_sub(1), ..everything() };
    let parts = if windows.is_empty() { BTreeMap::new() } else { read_all(store, boot, wanted) };
    let expected: Vec<(u32, u16)> = windows
        .flat_map(|window| {
            let mut parts = PARTS.map(|(part, _)| (window, part));
            parts.sort_unstable();
            parts
        })
        .collect();
    assert_eq!(parts.keys().copied().collect::<Vec<_>>(), expected);
    assert!(parts.values().all(|copies| copies.len() == 1));
}

fn configuration() -> Configuration {
    use belfry_shared::message::{Band, Summary};
    Configuration {
        channels: 3,
        sampling_rate_uhz: 50_000_000,
        decimation: 10,
        segment: 1024,
        summary: Summary::Lines { bits: 10 },
        bands: [Band { first_line: 4, lines: 300 }].into_iter().collect(),
    }
}

#[test]
fn windows_configuration_and_time_outlast_a_cut_and_boots_count_up() {
    for technology in TECHNOLOGIES {
        let mut store = open(blank(8), technology);
        assert_eq!((store.boot(), store.configuration()), (FIRST_BOOT, None));
        assert_eq!(store.kept(), Some(Kept { last_time: None, boot: FIRST_BOOT, oldest_window: 0, next_window: 0 }));
        store.set_configuration(&configuration());
        store.set_calibration(&calibration());
        store.set_time(HostTime(1_000_000));
        assert_eq!(put_windows(&mut store, 0..4), 4);
        assert_eq!(store.oldest_window(), Some(0));
        assert!(store.acknowledge(FIRST_BOOT, 1));
        while store.step() {}

        let mut store = open(store.release().release(), technology);
        let boot = FIRST_BOOT + 1;
        assert_eq!((store.boot(), store.configuration()), (boot, Some(configuration())));
        assert_eq!(store.calibration(), Some(calibration()));
        let kept = Kept { last_time: Some(HostTime(1_000_000)), boot: FIRST_BOOT, oldest_window: 1, next_window: 4 };
        assert_eq!((store.kept(), store.oldest_window()), (Some(kept), None));
        assert_holds(&mut store, FIRST_BOOT, 1..4);
        // A boot without windows in between, and one whose number has run over.
        let store = open(store.release().release(), technology);
        assert_eq!((store.boot(), store.kept()), (0, Some(kept)));
        let mut store = open(store.release().release(), technology);
        assert_eq!(put_windows(&mut store, 0..2), 2);
        let mut store = open(store.release().release(), technology);
        assert_eq!((store.boot(), store.kept()), (2, Some(kept)));
        assert!(!store.acknowledge(FIRST_BOOT, 5), "there is no such window");
        assert!(store.acknowledge(FIRST_BOOT, 4) && store.take_news());
        let next = Kept { boot: 1, oldest_window: 0, next_window: 2, ..kept };
        assert_eq!(store.kept(), Some(next));
        assert_holds(&mut store, 1, 0..2);
        assert!(store.acknowledge(1, 2) && store.take_news() && !store.take_news());
        assert!(!store.kept().unwrap().has_windows());
        while store.step() {}
        let store = open(store.release().release(), technology);
        assert!(!store.kept().unwrap().has_windows());
        assert_eq!(store.chip.overwritten_bytes(), 0);
    }
}

#[test]
fn a_full_chip_overwrites_its_oldest_windows_and_counts_them() {
    for technology in TECHNOLOGIES {
        let mut store = open(blank(8), technology);
        assert_eq!(put_windows(&mut store, 0..100), 100);
        let oldest = store.oldest_window().unwrap();
        assert_eq!(store.lost_windows(), oldest);
        // A window takes 1.3 KB of 32 KB, of which the sector that is being filled and the ends of the others have nothing.
        assert!((76..=81).contains(&oldest), "{oldest}");
        assert_holds(&mut store, FIRST_BOOT, oldest..100);
        assert_eq!(store.chip.overwritten_bytes(), 0);
        // What is overwritten of an earlier boot is counted as well, and told.
        let mut store = open(store.release().release(), technology);
        let kept = store.kept().unwrap();
        assert_eq!((kept.boot, kept.oldest_window, kept.next_window), (FIRST_BOOT, oldest, 100));
        assert_eq!(put_windows(&mut store, 0..10), 10);
        let later = store.kept().unwrap();
        assert!(store.take_news() && later.oldest_window > oldest && later.next_window == 100);
        assert_eq!(store.lost_windows(), later.oldest_window - oldest);
        assert_eq!(put_windows(&mut store, 10..30), 20 + 10);
        assert!(store.take_news() && !store.kept().unwrap().has_windows());
        assert_eq!(store.lost_windows(), 100 - oldest + store.oldest_window().unwrap());
    }
}

#[test]
fn parts_are_found_wherever_they_are_and_each_request_is_answered_once() {
    let mut store = open(blank(16), Technology::Nor);
    assert_eq!(put_windows(&mut store, 0..60), 60);
    let boot = store.boot();
    let oldest = store.oldest_window().unwrap();
    for window in oldest..60 {
        let wanted = Again { first_window: window, last_window: window, first_part: 2, last_part: 3 };
        // The second asks for nothing more.
        store.want(boot, &Again { first_part: 3, ..wanted });
        store.want(boot, &Again { first_part: 3, ..wanted });
        let parts = read_all(&mut store, boot, Again { last_part: 2, ..wanted });
        assert_eq!(parts.keys().copied().collect::<Vec<_>>(), [(window, 2), (window, 3)]);
        assert!(parts.values().all(|copies| copies.len() == 1));
    }
    // What the host has meanwhile is not read any more.
    store.want(boot, &everything());
    assert!(store.acknowledge(boot, 59));
    while store.step() {}
    let mut last = Vec::new();
    while let Some(part) = store.take_loaded().map(<[u8]>::to_vec) {
        last.push(part);
        while store.step() {}
    }
    assert_eq!(last, PARTS.map(|(part, length)| part_of(boot, 59, part, length)));
}

#[test]
fn without_a_chip_nothing_is_kept() {
    for memory in [Vec::new(), blank(LEAST_SECTORS - 1)] {
        let mut store = Store::open(SimulatedChip::new(memory, Technology::Fram), 7);
        assert!(!store.has_chip() && !store.keeps() && store.boot() == 7);
        assert!(!store.put(0, 0, &[1]) && !store.step());
        assert_eq!((store.kept(), store.oldest_window(), store.configuration()), (None, None, None));
    }
    let mut dead = SimulatedChip::new(blank(8), Technology::Fram);
    dead.fail_after(0, 0);
    assert!(!Store::open(dead, 7).has_chip());
}

#[test]
fn what_another_program_has_left_on_a_chip_is_no_store() {
    for (technology, fill) in
        TECHNOLOGIES.into_iter().flat_map(|technology| [0x00, 0x42].map(|fill| (technology, fill)))
    {
        let mut memory = blank(8);
        memory.fill(fill);
        let mut store = open(memory, technology);
        assert_eq!(store.boot(), FIRST_BOOT);
        assert_eq!(put_windows(&mut store, 0..5), 5);
        assert_holds(&mut store, FIRST_BOOT, 0..5);
    }
}

/// A chip on which windows have been put, and what is known of it.
struct Before {
    memory: Vec<u8>,
    boot: u32,
    oldest: u32,
    next: u32,
}

fn filled(technology: Technology, sectors: u32, windows: u32) -> Before {
    let mut store = open(blank(sectors), technology);
    store.set_configuration(&configuration());
    store.set_calibration(&calibration());
    assert_eq!(put_windows(&mut store, 0..windows), windows);
    let oldest = store.oldest_window().unwrap_or(0);
    Before { boot: store.boot(), oldest, next: windows, memory: store.release().release() }
}

/// Has the supply fail after so many steps of a start and of some windows, and looks at what is left. `false` where it did not fail.
fn cut_once(before: &Before, technology: Technology, windows: u32, steps: u64, noise: u8) -> bool {
    let mut chip = SimulatedChip::new(before.memory.clone(), technology);
    chip.fail_after(steps, noise);
    let mut store = Store::open(chip, FIRST_BOOT);
    let boot = before.boot.wrapping_add(1);
    let (mut whole, mut lost) = (0, 0);
    if store.has_chip() {
        assert_eq!(store.boot(), boot);
        whole = put_windows(&mut store, 0..windows);
        lost = store.lost_windows();
    }
    let has_failed = store.chip.has_failed();
    assert_eq!(store.chip.overwritten_bytes(), 0);
    let mut store = open(store.release().release(), technology);
    // Where the start was not stored whole, nobody has heard of its boot id.
    assert!(store.boot() == boot || store.boot() == boot.wrapping_add(1), "{}", store.boot());
    assert_eq!((store.configuration(), store.calibration()), (Some(configuration()), Some(calibration())));
    let mut held = BTreeMap::new();
    while let Some(kept) = store.kept().filter(Kept::has_windows) {
        assert_holds(&mut store, kept.boot, kept.oldest_window..kept.next_window);
        held.insert(kept.boot, (kept.oldest_window, kept.next_window));
        assert!(store.acknowledge(kept.boot, kept.next_window) && store.take_news());
    }
    // Windows from before: all but those that were overwritten. Of the sector that was next when the supply failed, they may be counted and still
    // be there, or not be counted and gone.
    let (oldest, next) = held.remove(&before.boot).unwrap_or((before.next, before.next));
    assert_eq!(next, before.next);
    let a_sector = 4;
    let counted = before.oldest + lost;
    assert!(oldest >= before.oldest && oldest.abs_diff(counted) <= a_sector, "{oldest}, {counted} by the count");
    // Windows of the start that was cut: all that were kept, and perhaps the one that was about to be.
    let (oldest, next) = held.remove(&boot).unwrap_or((0, 0));
    assert!(oldest == 0 && (whole..=whole + 1).contains(&next), "{oldest}..{next}, {whole} were kept");
    assert!(held.is_empty());
    assert_eq!(store.chip.overwritten_bytes(), 0);
    // It goes on.
    assert_eq!(put_windows(&mut store, 0..4), 4);
    let boot = store.boot();
    assert_holds(&mut store, boot, 0..4);
    assert_eq!(store.chip.overwritten_bytes(), 0);
    has_failed
}

/// Cuts at every byte of a start and some windows, on a chip that is new, and on one that is full.
#[test]
fn a_cut_at_any_byte_costs_the_record_that_was_being_written_and_no_other() {
    let mut cases = 0;
    for technology in TECHNOLOGIES {
        for before in [filled(technology, 8, 1), filled(technology, 8, 40)] {
            for noise in NOISE {
                let cuts = (0..).take_while(|&steps| cut_once(&before, technology, 4, steps, noise)).count();
                // Four windows, at least.
                assert!(cuts > 5000, "{cuts}");
                cases += cuts;
            }
        }
    }
    std::println!("{cases} cuts");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    /// One cut after the other, also while a start recovers from the one before: boot ids only rise, and what was kept and not overwritten is
    /// there, until it is acknowledged.
    #[test]
    fn cut_after_cut_nothing_is_lost_but_what_is_counted(
        is_nor in any::<bool>(),
        lives in prop::collection::vec((0_u64..12_000, any::<u8>(), any::<bool>()), 1..12),
    ) {
        let technology = TECHNOLOGIES[usize::from(is_nor)];
        let mut memory = blank(12);
        let mut last_boot = None;
        // What is to be there, by boot: kept windows from the first on.
        let mut kept: BTreeMap<u32, u32> = BTreeMap::new();
        for (steps, noise, acknowledges) in lives {
            let mut chip = SimulatedChip::new(memory, technology);
            chip.fail_after(steps, noise);
            let mut store = Store::open(chip, 100);
            if store.has_chip() {
                prop_assert!(last_boot.is_none_or(|last| store.boot() > last), "{} after {last_boot:?}", store.boot());
                last_boot = Some(store.boot());
                if acknowledges && let Some(held) = store.kept().filter(Kept::has_windows) {
                    prop_assert!(store.acknowledge(held.boot, held.next_window));
                    kept.retain(|&boot, _| boot > held.boot);
                }
                let whole = put_windows(&mut store, 0..8);
                kept.insert(store.boot(), whole);
                // Whatever is overwritten is the oldest, and counted or of the sector that was next.
                let lost = store.lost_windows() > 0;
                if lost {
                    let first = store.kept().filter(Kept::has_windows).map(|held| held.boot);
                    kept.retain(|&boot, _| first.is_some_and(|first| boot > first));
                }
            }
            memory = store.release().release();
        }
        let mut store = open(memory, technology);
        prop_assert!(last_boot.is_none_or(|last| store.boot() > last));
        let mut found = BTreeMap::new();
        while let Some(held) = store.kept().filter(Kept::has_windows) {
            assert_holds(&mut store, held.boot, held.oldest_window..held.next_window);
            found.insert(held.boot, held);
            prop_assert!(store.acknowledge(held.boot, held.next_window));
        }
        // The newest boots with windows, as many as are held.
        let expected: Vec<_> = kept.into_iter().filter(|&(_, whole)| whole > 0).collect();
        for (boot, whole) in expected.into_iter().rev().take(MOST_BOOTS - 1) {
            let held = found.get(&boot);
            prop_assert!(held.is_some_and(|held| held.next_window >= whole), "boot {boot} had {whole}: {held:?}");
        }
        prop_assert_eq!(store.chip.overwritten_bytes(), 0);
    }
}
