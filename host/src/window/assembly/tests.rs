//! Parts in any order, and parts that contradict each other.

use super::*;
use crate::window::node_window::ChannelData;
use belfry_shared::message::{
    Band, ChannelState, Configuration, DensityPart, LinesPart, Peak, PeaksPart, Summary, WindowName,
};
use belfry_shared::quantise::{encode_densities, encode_lines, encoded_bytes};
use num_complex::Complex32;
use proptest::prelude::*;

const BOOT: u32 = 5;

fn configuration(summary: Summary) -> Configuration {
    let bands = [Band { first_line: 3, lines: 40 }, Band { first_line: 60, lines: 17 }];
    Configuration {
        channels: 3,
        sampling_rate_uhz: 50_000_000,
        decimation: 10,
        segment: 256,
        summary,
        bands: bands.into_iter().collect(),
    }
}

fn encode(message: &NodeMessage<'_>) -> Vec<u8> {
    let mut frame = [0; belfry_shared::frame::MAX_FRAME_BYTES];
    let length = belfry_shared::message::encode(message, &mut frame).unwrap();
    let mut decoder = belfry_shared::frame::FrameDecoder::new();
    frame[..length].iter().find_map(|&byte| decoder.push(byte).map(|frame| frame.unwrap().message.to_vec())).unwrap()
}

fn name(number: u32) -> WindowName {
    WindowName { node: 1, boot: BOOT, number }
}

/// A window's head, as of a node that runs [`lines_configuration`].
fn head(number: u32, data_parts: u16, channels: [ChannelState; 3]) -> NodeMessage<'static> {
    head_of(&lines_configuration(), number, data_parts, channels)
}

fn head_of(
    configuration: &Configuration,
    number: u32,
    data_parts: u16,
    channels: [ChannelState; 3],
) -> NodeMessage<'static> {
    NodeMessage::Head(WindowHead {
        name: name(number),
        configuration_hash: configuration.hash(),
        grid_index: u64::from(number) + 100,
        middle_offset_us: -7,
        drift_ppb: 3,
        data_parts,
        channels: channels.into_iter().collect(),
    })
}

/// All parts of a window of lines whose values tell window, channel and line; channel 1 is unsound.
fn lines_window(number: u32) -> Vec<Vec<u8>> {
    let sound = ChannelState::Sound { segments: 1 };
    let mut parts = Vec::new();
    let mut part = 0;
    for channel in [0_u8, 2] {
        for (first_line, lines) in [(3_u16, 32_usize), (35, 8), (60, 17)] {
            part += 1;
            let values: Vec<Complex32> = (0..lines)
                .map(|line| {
                    Complex32::new(
                        number as f32 + 1.0,
                        f32::from(channel) + (line as f32 + f32::from(first_line)) / 100.0,
                    )
                })
                .collect();
            let mut code = vec![0; encoded_bytes(lines, 16)];
            encode_lines(&values, 16, &mut code).unwrap();
            let message =
                LinesPart { name: name(number), part, channel, first_line, lines: lines as u16, bits: 16, code: &code };
            parts.push(encode(&NodeMessage::Lines(message)));
        }
    }
    parts.push(encode(&head(number, part, [sound, ChannelState::Clipped, sound])));
    parts
}

fn take(assembler: &mut Assembler, configuration: &Configuration, encoded: &[u8]) -> Outcome {
    let message = belfry_shared::message::decode::<NodeMessage<'_>>(encoded).unwrap();
    assembler.take(&Configurations::only(configuration.clone()), &message, encoded)
}

fn lines_configuration() -> Configuration {
    configuration(Summary::Lines { bits: 16 })
}

fn check_lines_window(window: &NodeWindow) {
    let number = window.name.number;
    assert_eq!((window.grid_index, window.middle_offset_us, window.drift_ppb), (u64::from(number) + 100, -7, 3));
    assert_eq!(window.channels[1], ChannelData::Unsound(ChannelState::Clipped));
    for channel in [0, 2] {
        let ChannelData::Lines(lines) = &window.channels[channel] else { panic!("channel {channel} has no lines") };
        let positions: Vec<f32> = (3..43).chain(60..77).map(|line| line as f32 / 100.0).collect();
        assert_eq!(lines.len(), positions.len());
        for (line, position) in lines.iter().zip(positions) {
            // 16 bits of at most some hundreds.
            assert!((line.re - (number as f32 + 1.0)).abs() < 2e-2, "{line}");
            assert!((line.im - (channel as f32 + position)).abs() < 2e-2, "{line}");
        }
    }
}

proptest! {
    #[test]
    fn every_window_comes_out_once_and_unchanged_whatever_the_order_and_however_often(
        order in prop::collection::vec(any::<prop::sample::Index>(), 0..200),
    ) {
        let configuration = lines_configuration();
        let parts: Vec<Vec<u8>> = (0..5).flat_map(lines_window).collect();
        // A random sequence with repetitions, then every part once more, so that all have come.
        let sequence = order.iter().map(|index| index.index(parts.len())).chain(0..parts.len());
        let mut assembler = Assembler::new(1, BOOT);
        let mut whole = Vec::new();
        for part in sequence {
            if let Outcome::Whole(window) = take(&mut assembler, &configuration, &parts[part]) {
                check_lines_window(&window);
                whole.push(window.name.number);
                assembler.stored(window.name.number);
            }
        }
        whole.sort_unstable();
        prop_assert_eq!(whole, [0, 1, 2, 3, 4]);
        prop_assert_eq!((assembler.below(), assembler.lost(), assembler.is_complete()), (5, 0, true));
    }

    #[test]
    fn any_parts_are_taken_without_panic_and_in_bounded_memory(
        numbers in prop::collection::vec((any::<u32>(), any::<u16>(), 0_u8..6, any::<u16>(), any::<u16>(), any::<u8>()), 0..200),
    ) {
        let configuration = lines_configuration();
        let mut assembler = Assembler::new(1, BOOT);
        for (number, part, channel, first_line, lines, bits) in numbers {
            let message = LinesPart { name: name(number), part, channel, first_line, lines, bits, code: &[1, 2, 3] };
            let encoded = encode(&NodeMessage::Lines(message));
            let _ = take(&mut assembler, &configuration, &encoded);
            let sound = ChannelState::Sound { segments: lines };
            let encoded = encode(&head(number, part, [sound; 3]));
            let _ = take(&mut assembler, &configuration, &encoded);
            assembler.heartbeat(first_line.into(), number);
            let _ = assembler.overdue(HostTime(i64::from(number)), HostTime(0), HostTime(i64::from(part)), part % 2 == 0);
        }
    }
}

/// A peer that begins windows and never ends one, the newest first.
#[test]
fn unfinished_windows_take_bounded_memory_and_the_oldest_ones_still_come() {
    let configuration = lines_configuration();
    let mut assembler = Assembler::new(1, BOOT);
    let mut most = 0;
    for number in (0..20_000).rev() {
        // All but the head.
        for part in &lines_window(number)[..6] {
            take(&mut assembler, &configuration, part);
        }
        if number % 100 == 0 {
            most = most.max(assembler.partials().map(|(_, partial)| partial.bytes()).sum::<usize>());
        }
    }
    assert!((MOST_BYTES / 2..=MOST_BYTES).contains(&most), "{most} bytes");
    for number in 0..100 {
        let whole = lines_window(number).iter().any(|part| {
            let outcome = take(&mut assembler, &configuration, part);
            matches!(outcome, Outcome::Whole(_))
        });
        assert!(whole, "window {number}");
        assembler.stored(number);
    }
    assert_eq!(assembler.below(), 100);
}

#[test]
fn densities_and_peaks_make_a_window_too() {
    let configuration = configuration(Summary::Psd { segments: 4 });
    let densities: Vec<f32> = (1..=57).map(|k| 1e-6 * k as f32).collect();
    let mut parts = Vec::new();
    for (part, (first_line, range)) in [(1_u16, (3_u16, 0..40)), (2, (60, 40..57))] {
        let mut code = vec![0; range.len()];
        let base = encode_densities(&densities[range], &mut code).unwrap();
        let message = DensityPart { name: name(0), part, channel: 0, first_line, base, code: &code };
        parts.push(encode(&NodeMessage::Density(message)));
    }
    let peak = Peak { frequency_hz: 1.5, density: 3.0 };
    let peaks = PeaksPart { name: name(0), part: 3, channel: 0, peaks: [peak].into_iter().collect() };
    parts.push(encode(&NodeMessage::Peaks(peaks)));
    let states = [ChannelState::Sound { segments: 4 }, ChannelState::Missing, ChannelState::Constant];
    parts.push(encode(&head_of(&configuration, 0, 3, states)));
    let mut assembler = Assembler::new(1, BOOT);
    let outcomes: Vec<Outcome> = parts.iter().map(|part| take(&mut assembler, &configuration, part)).collect();
    let Outcome::Whole(window) = &outcomes[3] else { panic!("{outcomes:?}") };
    let ChannelData::Psd { segments, densities: found, peaks } = &window.channels[0] else { panic!("{window:?}") };
    assert_eq!((*segments, peaks.as_slice()), (4, &[peak][..]));
    for (found, expected) in found.iter().zip(&densities) {
        assert!((found / expected - 1.0).abs() < 0.045, "{found} for {expected}");
    }
    assert_eq!(window.channels[2], ChannelData::Unsound(ChannelState::Constant));
}

#[test]
fn what_contradicts_itself_is_refused_and_given_up_not_stored() {
    let configuration = lines_configuration();
    let sound = ChannelState::Sound { segments: 1 };
    let refused = |message: NodeMessage<'_>| take(&mut Assembler::new(1, BOOT), &configuration, &encode(&message));
    let part =
        |number, part| LinesPart { name: name(number), part, channel: 0, first_line: 3, lines: 0, bits: 8, code: &[] };
    assert_eq!(refused(NodeMessage::Lines(part(0, 0))), Outcome::Contradiction, "part 0 is the head's");
    assert_eq!(refused(NodeMessage::Lines(part(1 << 20, 1))), Outcome::Contradiction, "a million windows ahead");
    assert_eq!(refused(head(0, u16::MAX, [sound; 3])), Outcome::Contradiction, "65 535 parts");
    let mut other_boot = part(0, 1);
    other_boot.name.boot = 6;
    assert_eq!(refused(NodeMessage::Lines(other_boot)), Outcome::Contradiction);
    // A window whose head says fewer parts than make all lines.
    let mut assembler = Assembler::new(1, BOOT);
    assert_eq!(take(&mut assembler, &configuration, &lines_window(0)[0]), Outcome::Taken);
    let too_few = encode(&head(0, 1, [sound, ChannelState::Missing, ChannelState::Missing]));
    assert_eq!(take(&mut assembler, &configuration, &too_few), Outcome::Contradiction);
    assert_eq!((assembler.below(), assembler.lost()), (1, 1));
}

#[test]
fn a_window_of_an_earlier_configuration_comes_and_one_of_another_study_is_told_and_left_to_be_given_up() {
    let sound = ChannelState::Sound { segments: 1 };
    let configurations =
        Configurations { current: configuration(Summary::Lines { bits: 8 }), earlier: vec![lines_configuration()] };
    let mut assembler = Assembler::new(1, BOOT);
    let mut take = |encoded: &[u8]| {
        let message = belfry_shared::message::decode::<NodeMessage<'_>>(encoded).unwrap();
        assembler.take(&configurations, &message, encoded)
    };
    let outcomes: Vec<Outcome> = lines_window(0).iter().map(|part| take(part)).collect();
    let Some(Outcome::Whole(window)) = outcomes.last() else { panic!("{outcomes:?}") };
    check_lines_window(window);
    let foreign = encode(&head_of(&configuration(Summary::Lines { bits: 4 }), 1, 6, [sound; 3]));
    assert_eq!(take(&foreign), Outcome::Foreign);
    // It stays wanted, so that nothing acknowledges it, until somebody gives it up.
    assert_eq!(take(&foreign), Outcome::Foreign);
    assembler.stored(0);
    assert_eq!((assembler.below(), assembler.is_complete()), (1, false));
    assembler.stored(1);
    assert_eq!((assembler.below(), assembler.lost()), (2, 0));
}

#[test]
fn what_is_kept_from_before_is_not_asked_again_and_what_is_missing_among_it_is() {
    let kept = KeptWindows { first: 10, numbers: vec![14, 10, 11, 3], last: Some((14, 114)), ..KeptWindows::default() };
    let mut assembler = Assembler::resuming(1, BOOT, &kept);
    assert_eq!((assembler.below(), assembler.lost(), assembler.missing()), (12, 0, 2));
    assert_eq!(asked(&mut assembler, 1000, false), [(12, 13, 0, u16::MAX)]);
    assert_eq!(take(&mut assembler, &lines_configuration(), &lines_window(14)[0]), Outcome::Duplicate);
    // Window 14 as it was (its grid index is 114), and another life's window of that name.
    let sound = ChannelState::Sound { segments: 1 };
    let of_last_life = encode(&head(14, 6, [sound; 3]));
    assert_eq!(take(&mut assembler, &lines_configuration(), &of_last_life), Outcome::Duplicate);
    let NodeMessage::Head(later) = head(14, 6, [sound; 3]) else { panic!("a head") };
    assert!(!assembler.is_out_of_order(&later), "it begins when it did");
    let later = WindowHead { grid_index: 115, ..later };
    let of_others = WindowName { boot: BOOT + 1, ..later.name };
    assert!(assembler.is_out_of_order(&later) && !assembler.is_out_of_order(&WindowHead { name: of_others, ..later }));
    assert!(assembler.was_wanted(10) && !assembler.was_wanted(9));
    // The node says that window 12 is gone.
    assembler.heartbeat(13, 15);
    assert_eq!((assembler.below(), assembler.lost()), (13, 1));
}

#[test]
fn a_late_frame_is_a_duplicate_not_four_billion_lost_ones() {
    let configuration = lines_configuration();
    let mut assembler = Assembler::new(1, BOOT);
    for number in 0..2 {
        for part in lines_window(number) {
            if let Outcome::Whole(window) = take(&mut assembler, &configuration, &part) {
                assembler.stored(window.name.number);
            }
        }
    }
    assert_eq!(take(&mut assembler, &configuration, &lines_window(0)[2]), Outcome::Duplicate);
    assert_eq!((assembler.below(), assembler.lost()), (2, 0));
    // A heartbeat that was overtaken says less than is known.
    assembler.heartbeat(0, 1);
    assert_eq!((assembler.below(), assembler.lost()), (2, 0));
}

fn asked(assembler: &mut Assembler, now: i64, busy: bool) -> Vec<(u32, u32, u16, u16)> {
    let again = assembler.overdue(HostTime(now), HostTime(now - 100), HostTime(now), busy);
    again.iter().map(|range| (range.first_window, range.last_window, range.first_part, range.last_part)).collect()
}

#[test]
fn exactly_what_is_missing_is_asked_again_and_not_before_its_time() {
    let configuration = lines_configuration();
    let mut assembler = Assembler::new(1, BOOT);
    let parts = lines_window(0);
    for index in [0, 3, 6] {
        take(&mut assembler, &configuration, &parts[index]);
    }
    assembler.heartbeat(0, 4);
    assert_eq!(
        asked(&mut assembler, 1000, true),
        [(0, 0, 2, 3), (0, 0, 5, 6), (1, 2, 0, u16::MAX)],
        "the newest may be on its way"
    );
    assert_eq!(asked(&mut assembler, 1050, false), [(3, 3, 0, u16::MAX)]);
    assert_eq!(asked(&mut assembler, 1080, false), [], "all asked a moment ago");
    assert_eq!(asked(&mut assembler, 1101, false), [(0, 0, 2, 3), (0, 0, 5, 6), (1, 2, 0, u16::MAX)]);
    // A window of which only data came: its head, and whatever may follow.
    take(&mut assembler, &configuration, &lines_window(1)[1]);
    assert!(asked(&mut assembler, 1300, false).starts_with(&[
        (0, 0, 2, 3),
        (0, 0, 5, 6),
        (1, 1, 0, 0),
        (1, 1, 1, 1),
        (1, 1, 3, u16::MAX)
    ]));
}

#[test]
fn what_the_node_no_longer_has_and_what_never_comes_is_given_up_and_counted() {
    let mut assembler = Assembler::new(1, BOOT);
    assembler.heartbeat(3, 5);
    assert_eq!((assembler.below(), assembler.lost(), assembler.is_complete()), (3, 3, false));
    for round in 0..=MAX_ASKS {
        let _ = asked(&mut assembler, i64::from(round) * 1000, false);
    }
    assert_eq!((assembler.below(), assembler.lost(), assembler.is_complete()), (5, 5, true));
}

#[test]
fn a_line_on_which_nothing_is_answered_gives_no_window_up() {
    let mut assembler = Assembler::new(1, BOOT);
    assembler.heartbeat(0, 1);
    for round in 0..i64::from(10 * MAX_ASKS) {
        let again = assembler.overdue(HostTime(round * 1000), HostTime(round * 1000 - 100), HostTime(-1), false);
        assert_eq!(again.len(), 1);
    }
    assert_eq!((assembler.below(), assembler.lost()), (0, 0));
}

#[test]
fn an_acknowledgement_has_no_more_ranges_than_a_message_holds() {
    let configuration = lines_configuration();
    let mut assembler = Assembler::new(1, BOOT);
    for number in 0..20 {
        take(&mut assembler, &configuration, &lines_window(number)[2]);
    }
    assert!(asked(&mut assembler, 1000, false).len() <= MAX_AGAIN);
}

/// Contradictory parts come before the window's own: they must not cost it.
#[test]
fn a_part_of_a_channel_band_or_size_that_cannot_be_is_refused_and_the_window_still_comes() {
    let configuration = lines_configuration();
    let valid = vec![0; encoded_bytes(32, 16)];
    let part = |part, channel, first_line, lines, bits, code| {
        encode(&NodeMessage::Lines(LinesPart { name: name(0), part, channel, first_line, lines, bits, code }))
    };
    for (what, wrong) in [
        ("channel 3 of 3", part(1, 3, 3, 32, 16, &valid)),
        ("a line outside the bands", part(1, 0, 50, 32, 16, &valid)),
        ("a code that is too short", part(1, 0, 3, 32, 16, &valid[1..])),
        ("other bits", part(1, 0, 3, 32, 8, &valid[..encoded_bytes(32, 8)])),
        (
            "densities among lines",
            encode(&NodeMessage::Density(DensityPart {
                name: name(0),
                part: 1,
                channel: 0,
                first_line: 3,
                base: 0,
                code: &[1],
            })),
        ),
    ] {
        let mut assembler = Assembler::new(1, BOOT);
        assert_eq!(take(&mut assembler, &configuration, &wrong), Outcome::Contradiction, "{what}");
        let whole =
            lines_window(0).iter().any(|part| matches!(take(&mut assembler, &configuration, part), Outcome::Whole(_)));
        assert!(whole, "{what} cost the window");
    }
}
