//! One flipped bit anywhere in an archive is told, or changes no number that is read.

use std::time::Duration;

use super::*;

/// Of the bits of the file, so many are flipped, one at a time.
const FLIPS: usize = 1500;

/// Eight hours of two nodes, as a file.
fn archive() -> Vec<u8> {
    let (mut bench, two, one) = Bench::of_both();
    bench.archive.meet("now", 1, 7, 0, HostTime(0)).unwrap();
    bench.archive.meet("now", 2, 7, 0, HostTime(0)).unwrap();
    for number in 0..60 {
        // A hop is 5.12 s.
        let grid_index = 20_000_000 + 90 * u64::from(number);
        bench.store(&two, &sent(&two, 1, number, grid_index));
        bench.store(&one, &sent(&one, 2, number, grid_index));
    }
    let Bench { folder, archive } = bench;
    drop(archive);
    std::fs::read(folder.path().join(ARCHIVE_FILE)).unwrap()
}

#[test]
fn a_flipped_bit_is_told_or_changes_no_number() {
    let sound = archive();
    let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
    let file = folder.path().join(ARCHIVE_FILE);
    std::fs::write(&file, &sound).unwrap();
    let ranges = [TimeRange::ALL, TimeRange { last: Some(Duration::from_secs(3 * 3600)), ..TimeRange::ALL }];
    let sound_reads = ranges.map(|range| read(folder.path(), &range).unwrap().unwrap());
    let counts = sound_reads.each_ref().map(|(_, windows, damages)| (windows.len(), damages.len()));
    assert_eq!(counts, [(60, 0), (24, 0)]);
    let mut random = ChaCha8Rng::seed_from_u64(19);
    let used: Vec<usize> = (0..sound.len()).filter(|&at| sound[at] != 0).collect();
    let (mut told, mut same, mut refused) = (0, 0, 0);
    for flip in 0..FLIPS {
        // Most of a small archive is empty; half of the flips hit what is not.
        let at =
            if flip % 2 == 0 { random.random_range(0..sound.len()) } else { used[random.random_range(0..used.len())] };
        let bit = random.random_range(0..8);
        let mut bytes = sound.clone();
        bytes[at] ^= 1 << bit;
        std::fs::write(&file, &bytes).unwrap();
        // Half of them with a range of time.
        let (range, (setup, windows, _)) = (&ranges[flip / 2 % 2], &sound_reads[flip / 2 % 2]);
        match read(folder.path(), range) {
            Err(_) => refused += 1,
            Ok(Some((_, _, damages))) if !damages.is_empty() => told += 1,
            Ok(Some((found, read, _))) if found == *setup && read == *windows => same += 1,
            Ok(other) => {
                panic!("bit {bit} of byte {at} is not told, and changes what is read: {:?}", other.map(|read| read.0))
            }
        }
    }
    // The sample is one that shows something.
    println!("{FLIPS} flipped bits: {told} told, {refused} refused, {same} without effect");
    assert!(told > FLIPS / 5 && refused > 0 && same > 0, "{told} told, {refused} refused, {same} without effect");
}
