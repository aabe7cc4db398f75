//! Windows go from one archive to another as messages.

use super::*;

#[test]
fn an_archive_made_of_another_s_messages_has_the_same_windows() {
    let (mut bench, two, one) = Bench::of_both();
    for number in 0..4 {
        let mut of_two = sent(&two, 1, number, 100 + u64::from(number));
        if number == 2 {
            of_two.channels[1] = ChannelData::Unsound(ChannelState::Clipped);
        }
        bench.store(&two, &of_two);
        bench.store(&one, &sent(&one, 2, number, 100 + u64::from(number)));
    }
    let mut other = Bench::new();
    let mut after = 0;
    let mut names = Vec::new();
    loop {
        let following = bench.archive.following(after, 3).unwrap();
        let Some((last, _)) = following.last() else { break };
        after = *last;
        for (row, packed) in following {
            let packed = packed.unwrap();
            assert_eq!(bench.archive.row_of(&packed.name).unwrap(), Some(row));
            let message = packed.encode().unwrap();
            let back = PackedWindow::decode(&message).unwrap();
            assert_eq!(back, packed);
            // A hop of 128 samples at 25 Hz from the start.
            assert_eq!(back.middle_us(), (packed.grid_index as i64 + 1) * 5_120_000);
            names.push((packed.name.node, packed.name.number));
            // What comes twice is there once.
            for _ in 0..2 {
                other.archive.unpack(&back, HostTime(9)).unwrap().unwrap();
            }
            // Half a message is none, and neither is one with more behind it, or of another version.
            for length in 0..message.len() {
                assert!(PackedWindow::decode(&message[..length]).is_err(), "{length}");
            }
            assert!(PackedWindow::decode(&[message.as_slice(), &[0]].concat()).is_err());
            let newer = [&[2], &message[1..]].concat();
            assert!(PackedWindow::decode(&newer).is_err_and(|error| error.to_string().contains("version 2")));
        }
    }
    assert_eq!(names, [(1, 0), (2, 0), (1, 1), (2, 1), (1, 2), (2, 2), (1, 3), (2, 3)]);
    assert_eq!(other.read().unwrap(), bench.read().unwrap());
}

#[test]
fn a_damaged_window_is_named_and_the_next_follows() {
    let (bench, _) = Bench::of_one(3);
    bench.archive.connection.execute("UPDATE channel SET lines = zeroblob(9) WHERE window = 2", []).unwrap();
    let following = bench.archive.following(0, 9).unwrap();
    let sound: Vec<bool> = following.iter().map(|(_, window)| window.is_ok()).collect();
    assert_eq!(sound, [true, false, true]);
    let damage = following[1].1.as_ref().unwrap_err().to_string();
    assert!(damage.contains("window 1 of node 1") && damage.contains("checksum"), "{damage}");
}
