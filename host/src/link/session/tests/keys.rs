//! Conversations with a node that has a key, and with others who do not have it.

use super::*;
use belfry_shared::frame::encode_as;
use belfry_shared::seal::{Key, Sender};

fn key() -> Key {
    Key::new([0x4B; 32])
}

fn keyed_node(boot: u32) -> Node<Box<Memory>> {
    let mut node = node(boot);
    node.set_key(Some(key()));
    node
}

fn session(key: Option<Key>) -> Session {
    new_session().with_key(key)
}

fn bench(faults: Faults) -> Bench {
    Bench { node: keyed_node(77), session: session(Some(key())), ..Bench::new(faults) }
}

#[test]
fn a_node_with_a_key_is_collected_from_over_a_line_that_damages_frames() {
    let mut bench = bench(Faults::damaging(0.05));
    let mut windows: Vec<NodeWindow> = Vec::new();
    // Long enough for some hundred frames of the host, of which the node cannot read one in thirty.
    bench.run(50 * 1600, &mut windows).unwrap();
    // 1600 s less the first seconds, a hop of 12.8 s; the last one may be on its way.
    assert!((121..=124).contains(&windows.len()), "{}", windows.len());
    assert!(windows.iter().zip(&windows[1..]).all(|(a, b)| b.grid_index == a.grid_index + 1));
    assert_eq!(bench.session.statistics().lost_windows, 0);
    let heartbeat = bench.session.heartbeat().unwrap();
    assert!(heartbeat.damaged_frames > 0, "{heartbeat:?}");
}

#[test]
fn windows_kept_through_an_outage_go_to_the_next_host_with_the_key() {
    let mut bench = bench(Faults::default());
    bench.run(50 * 20, &mut Vec::<NodeWindow>::new()).unwrap();
    // Frames of four windows go nowhere.
    bench.to_host = Some(versions::silence());
    bench.run(50 * 51, &mut Vec::<NodeWindow>::new()).unwrap();
    bench.to_host = None;
    bench.session = session(Some(key()));
    let mut windows: Vec<NodeWindow> = Vec::new();
    bench.run(50 * 20, &mut windows).unwrap();
    assert!(windows.len() >= 4 && windows[0].name.number == 0, "{windows:?}");
    assert_eq!(bench.session.statistics().unsealed_frames, 0);
}

#[test]
fn a_node_that_restarts_is_asked_and_set_up_again() {
    let mut bench = bench(Faults::default());
    let mut windows: Vec<NodeWindow> = Vec::new();
    bench.run(50 * 60, &mut windows).unwrap();
    let before = windows.len();
    (bench.node, bench.node_start) = (keyed_node(78), bench.step);
    bench.run(50 * 60, &mut windows).unwrap();
    assert!(before >= 2 && windows.len() >= before + 2, "{before}, then {}", windows.len());
    assert!(windows[before..].iter().all(|window| window.name.boot == 78));
}

#[test]
fn nobody_without_the_key_makes_the_node_forget_a_window_or_the_host_store_one() {
    let mut bench = bench(Faults::default());
    let mut windows: Vec<NodeWindow> = Vec::new();
    let forged = Acknowledgement { boot: 77, below: 2, again: Default::default() };
    // Until the node has shown its key.
    bench.run(50 * 2, &mut windows).unwrap();
    for second in 0..120 {
        // With the host's own number, which stands on the line for everyone to read.
        for message in [
            HostMessage::Greet(Greeting::OF_HOSTS),
            HostMessage::Acknowledge(forged.clone()),
            HostMessage::Configure(Configuration { segment: 512, ..configuration() }),
        ] {
            say_as(&bench.line, CONVERSATION, message);
        }
        // A fake node.
        let impostor = Hello {
            boot: 99,
            configuration_hash: Some(configuration().hash()),
            answers: Some(CONVERSATION),
            versions: Versions { lowest: 5, highest: 5 },
            ..hello()
        };
        let invented = [NodeMessage::Hello(impostor), unsound(77, second), unsound(99, second), heartbeat(77, 9, 90)];
        for message in invented {
            bench.line.node_end().write(&frame(&message)).unwrap();
        }
        // And one of an age that had no keys.
        let mut old = [0; MAX_FRAME_BYTES];
        let length = encode_as(3, &[0, 3], &mut old).unwrap();
        bench.line.node_end().write(&old[..length]).unwrap();
        bench.run(50, &mut windows).unwrap();
    }
    assert!(windows.len() >= 7, "{}", windows.len());
    let is_true = |window: &NodeWindow| matches!(&window.channels[..], [crate::window::ChannelData::Lines(_)]);
    assert!(windows.iter().all(|window| window.name.boot == 77 && is_true(window)));
    assert!(windows.iter().zip(&windows[1..]).all(|(a, b)| b.name.number == a.name.number + 1));
    let statistics = bench.session.statistics();
    assert_eq!((statistics.lost_windows, statistics.contradictions, statistics.unsealed_frames), (0, 0, 5 * 120));
    let refused = bench.session.heartbeat().unwrap().unsealed_messages;
    // The first heartbeat comes after ten seconds, of which the first two were quiet; the next two minutes later.
    assert!(refused >= 3 * 8, "{refused}");
}

/// What a line has carried to the host, with its end marks.
fn recorded(boot: u32, session: Session) -> Vec<u8> {
    let mut bench = Bench { node: keyed_node(boot), session, ..bench(Faults::default()) };
    let mut bytes = Vec::new();
    for _ in 0..50 * 40 {
        bench.run(1, &mut Vec::<NodeWindow>::new()).unwrap();
        bytes.append(&mut bench.carried);
    }
    bytes
}

fn messages(bytes: &[u8]) -> Vec<Vec<u8>> {
    let mut decoder = FrameDecoder::new();
    bytes.iter().filter_map(|&byte| decoder.push(byte).map(|frame| frame.unwrap().message.to_vec())).collect()
}

#[test]
fn what_the_node_has_said_before_counts_neither_again_nor_in_another_boot() {
    // In an earlier boot, to another session: each has a number of its own, also in one run of the program.
    let earlier = Session::new(3, Configurations::only(configuration()), BAUD).with_key(Some(key()));
    let old = recorded(76, earlier);
    let mut bench = bench(Faults::default());
    let mut windows: Vec<NodeWindow> = Vec::new();
    let mut present = Vec::new();
    for _ in 0..50 * 60 {
        bench.run(1, &mut windows).unwrap();
        present.append(&mut bench.carried);
    }
    let (stored, counts) = (windows.len(), bench.session.statistics());
    for bytes in [&old, &present] {
        bench.session.receive(HostTime(bench.step * 20_000), bytes, &mut windows).unwrap();
    }
    let after = bench.session.statistics();
    assert_eq!((windows.len(), after.duplicate_parts), (stored, counts.duplicate_parts));
    // Greetings of another boot are answered with a question.
    let is_greeting = |frame: &&Vec<u8>| frame.first() == Some(&0);
    let refused = messages(&present).len() + messages(&old).len() - messages(&old).iter().filter(is_greeting).count();
    assert!(refused > 20, "{refused}");
    assert_eq!(after.unsealed_frames, counts.unsealed_frames + refused as u64);
    assert!(bench.session.is_measuring());
    bench.run(50 * 30, &mut windows).unwrap();
    assert!(windows.len() >= stored + 2 && windows.iter().all(|window| window.name.boot == 77));
}

#[test]
fn what_the_node_has_said_in_a_boot_that_it_has_left_counts_no_more_in_the_same_run() {
    let mut bench = bench(Faults::default());
    let mut windows: Vec<NodeWindow> = Vec::new();
    let mut lives = [Vec::new(), Vec::new()];
    for (boot, carried) in [77, 78].into_iter().zip(&mut lives) {
        (bench.node, bench.node_start) = (keyed_node(boot), bench.step);
        for _ in 0..50 * 60 {
            bench.run(1, &mut windows).unwrap();
            carried.append(&mut bench.carried);
        }
    }
    let (stored, counts) = (windows.len(), bench.session.statistics());
    assert_eq!(bench.session.hello().unwrap().boot, 78);
    // Both lives have greetings that answer this run.
    for bytes in [&lives[0], &lives[1]] {
        bench.session.receive(HostTime(bench.step * 20_000), bytes, &mut windows).unwrap();
    }
    assert_eq!(windows.len(), stored);
    assert_eq!(bench.session.statistics().duplicate_parts, counts.duplicate_parts);
    assert!(bench.session.is_measuring() && bench.session.hello().unwrap().boot == 78);
    bench.run(50 * 30, &mut windows).unwrap();
    assert!(windows.len() >= stored + 2 && windows[stored..].iter().all(|window| window.name.boot == 78));
}

#[test]
fn a_key_on_one_end_alone_or_another_one_is_told_with_what_to_do() {
    let error = |node: Node<Box<Memory>>, key: Option<Key>| {
        let mut bench = Bench { node, session: session(key), ..Bench::new(Faults::default()) };
        bench.run(50 * 5, &mut Vec::<NodeWindow>::new()).unwrap_err()
    };
    let without = error(node(77), Some(key()));
    assert!(matches!(without, SessionError::Unsealed { node: 3 }), "{without}");
    assert!(without.to_string().contains("belfry key image 3"), "{without}");
    let missing = error(keyed_node(77), None);
    assert!(matches!(missing, SessionError::KeyMissing { node: 3 }), "{missing}");
    let other = error(keyed_node(77), Some(Key::new([1; 32])));
    assert!(matches!(other, SessionError::OtherKey { node: 3 }), "{other}");
}

#[test]
fn two_hosts_with_the_key_count_on_from_each_other() {
    let mut bench = bench(Faults::default());
    bench.run(50 * 20, &mut Vec::<NodeWindow>::new()).unwrap();
    // On another computer, with another number; the node hears it on the same line.
    let hello = bench.session.hello().unwrap().clone();
    let heard = hello.counters.unwrap().heard + 1000;
    let greeting = InConversation {
        conversation: Conversation([9; 4]),
        message: HostMessage::Greet(Greeting { counter: heard, ..Greeting::OF_HOSTS }),
    };
    let bytes = postcard::to_slice(&greeting, &mut [0; 64]).unwrap().to_vec();
    let mut frame = [0; MAX_FRAME_BYTES];
    let length = key().encode(Sender::Host, 77, heard, &bytes, &mut frame).unwrap();
    bench.line.host_end().write(&frame[..length]).unwrap();
    let mut windows: Vec<NodeWindow> = Vec::new();
    bench.run(50 * 90, &mut windows).unwrap();
    assert!(bench.session.is_measuring() && windows.len() >= 5, "{}", windows.len());
    let counters = bench.session.hello().unwrap().counters.unwrap();
    assert!(counters.heard > heard, "{counters:?}");
}

#[test]
fn more_frames_lost_in_a_row_than_counters_tell_apart_end_nothing() {
    let mut bench = bench(Faults::default());
    let mut windows: Vec<NodeWindow> = Vec::new();
    bench.run(50 * 20, &mut windows).unwrap();
    // First nothing comes to the host, while the node is made to say much; then nothing to the node.
    bench.to_host = Some(versions::silence());
    for _ in 0..300 {
        say_as(&bench.line, CONVERSATION, HostMessage::Ask(Versions::OF_HOSTS));
        bench.run(2, &mut windows).unwrap();
    }
    bench.to_host = None;
    bench.run(50 * 60, &mut windows).unwrap();
    let stored = windows.len();
    assert!(bench.session.is_measuring() && stored >= 3, "{stored}");
    bench.to_node = Some(versions::silence());
    for _ in 0..300 {
        bench.session.wire.say(&HostMessage::EndReplay);
    }
    bench.run(50 * 20, &mut windows).unwrap();
    bench.to_node = None;
    bench.run(50 * 60, &mut windows).unwrap();
    assert!(bench.session.is_measuring() && windows.len() >= stored + 5, "{stored}, then {}", windows.len());
    assert!(windows.iter().zip(&windows[1..]).all(|(a, b)| b.name.number == a.name.number + 1));
    assert!(bench.session.hello().unwrap().counters.unwrap().heard > 300);
}

#[test]
fn what_the_node_does_not_hear_costs_no_window_whatever_else_is_on_the_line() {
    let mut bench = bench(Faults::default());
    let mut windows: Vec<NodeWindow> = Vec::new();
    bench.run(50 * 40, &mut windows).unwrap();
    // A window does not arrive; then nothing comes to the node, while somebody goes on to talk to the host.
    bench.to_host = Some(versions::silence());
    bench.run(50 * 14, &mut windows).unwrap();
    (bench.to_host, bench.to_node) = (None, Some(versions::silence()));
    let noise = frame(&unsound(77, 1));
    for _ in 0..2 * 240 {
        bench.line.node_end().write(&noise).unwrap();
        bench.run(25, &mut windows).unwrap();
    }
    assert_eq!(bench.session.statistics().lost_windows, 0);
    let mut numbers: Vec<u32> = windows.iter().map(|window| window.name.number).collect();
    assert!(numbers.windows(2).any(|pair| pair[1] > pair[0] + 1), "one is missing: {numbers:?}");
    bench.to_node = None;
    bench.run(50 * 30, &mut windows).unwrap();
    numbers = windows.iter().map(|window| window.name.number).collect();
    numbers.sort_unstable();
    assert!(
        numbers.len() > 15 && numbers.iter().enumerate().all(|(index, &number)| number == index as u32),
        "{numbers:?}"
    );
    assert_eq!(bench.session.statistics().lost_windows, 0);
}

#[test]
fn a_node_of_the_version_before_has_no_key() {
    // Its first frame tells the version, and its greeting that it is not sealed.
    let golden = "00 05 c2 c1 fc d3 f5 9a 8c cd 07 03 87 e0 02 04 00 00 00 00 00 01";
    let mut bytes: Vec<u8> = golden.split(' ').map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
    bytes.extend(CONVERSATION.0);
    bytes.push(0);
    let mut frame = [0; MAX_FRAME_BYTES];
    let length = encode_as(5, &bytes, &mut frame).unwrap();
    let heard = session(Some(key())).receive(HostTime(0), &frame[..length], &mut Vec::<NodeWindow>::new());
    assert!(matches!(heard, Err(SessionError::Unsealed { node: 3 })), "{heard:?}");
}
