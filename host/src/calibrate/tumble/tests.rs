//! A tumble of the real firmware over a simulated line.

use belfry_firmware::{Identity, Memory, Node};
use belfry_shared::frame::MAX_FRAME_BYTES;
use belfry_shared::message::SensorState;
use belfry_shared::time::NodeTime;

use super::*;
use crate::calibrate::simulated::{Tilts, Tumbled};
use crate::calibrate::{Gravity, fit, to_node};
use crate::link::memory::{Faults, Line};

const GRAVITY_M_S2: f64 = 9.8128;
const BAUD: u32 = 115_200;
/// Time of a simulation's step in µs: ten rows.
const STEP_US: i64 = 10_000;

fn node(channels: u8) -> Node<Box<Memory>> {
    let identity = Identity { node: 7, boot: 77, channels, full_scale_m_s2: 20.0, highest_rate_mhz: 4_000_000 };
    Node::new(identity, Box::new(Memory::new()))
}

/// A node that somebody turns over.
struct Bench {
    node: Node<Box<Memory>>,
    line: Line,
    sensor: Tumbled,
    now_us: i64,
}

impl Bench {
    fn new(seed: u64, faults: Faults) -> Self {
        let sensor = Tumbled::new(seed, GRAVITY_M_S2, 0.2, Tilts::OfEachFace);
        Self { node: node(3), line: Line::new(BAUD, faults, seed), sensor, now_us: 0 }
    }

    /// Lets the node sample what its face reads, or what hands make of it, and talk.
    fn step(&mut self, face: Option<usize>) {
        for row in 0..10 {
            let now = NodeTime((self.now_us + 1000 * row) as u64);
            let hand = (1e-6 * now.0 as f64 * 9.0).sin();
            let readings = match face {
                Some(face) => self.sensor.reading(face),
                None => [9.0 * hand, 4.0, 9.0 * (1.0 - hand * hand)].map(|value| value as f32),
            };
            self.node.sample(now, &readings);
        }
        self.now_us += STEP_US;
        self.line.advance(self.now_us * 1000);
        let now = NodeTime(self.now_us as u64);
        let mut end = self.line.node_end();
        let mut buffer = [0; 64];
        while let count @ 1.. = end.read(&mut buffer).unwrap() {
            buffer[..count].iter().for_each(|&byte| self.node.receive(now, byte));
        }
        while self.node.poll(now) {}
        while self.line.node_free_at() <= self.now_us * 1000 && self.node.has_bytes() {
            let mut frame = [0; MAX_FRAME_BYTES];
            let count = self.node.transmit(now, &mut frame);
            if count == 0 {
                break;
            }
            end.write(&frame[..count]).unwrap();
        }
    }

    fn clock(&self) -> impl Fn() -> HostTime + use<> {
        let now_us = self.now_us;
        move || HostTime(1_800_000_000_000_000 + now_us)
    }
}

fn hello() -> Hello {
    let mut bench = Bench::new(0, Faults::default());
    let mut greeting = crate::link::Greeting::new();
    loop {
        let elapsed = Duration::from_micros(bench.now_us as u64);
        if let Some(hello) = greeting.service(elapsed, &mut bench.line.host_end()).unwrap() {
            return hello;
        }
        bench.step(None);
    }
}

/// Tumbles: in the hand, then seventeen seconds on each face, as heartbeats may be lost.
fn tumbled(bench: &mut Bench, tumble: &mut Tumble) -> Result<Vec<Still>, TumbleError> {
    for second in 0..6 * 20 {
        let face = (second % 20 >= 3).then_some(second / 20);
        for _ in 0..100 {
            bench.step(face);
            if let Step::Done(found) = tumble.step(&bench.clock(), &mut bench.line.host_end())? {
                return Ok(found);
            }
        }
    }
    panic!("not done: {:?}", faces_of(&tumble.found()));
}

#[test]
fn a_node_that_is_tumbled_learns_its_gains_and_offsets() {
    for (seed, faults) in [(1, Faults::default()), (2, Faults::damaging(0.05))] {
        let mut bench = Bench::new(seed, faults);
        let mut tumble = Tumble::new(&hello(), BAUD, None, false, GRAVITY_M_S2).unwrap();
        let found = tumbled(&mut bench, &mut tumble).unwrap();
        let calibrated = fit(&found, Gravity::measured(GRAVITY_M_S2), 0.2).unwrap();
        for (axis, of_axis) in calibrated.axes.iter().enumerate() {
            let error = of_axis.gain * bench.sensor.sensitivity[axis][axis] - 1.0;
            assert!(error.abs() < 5.0 * of_axis.gain_std.max(1e-5), "{seed}: gain off by {error}");
            let error = of_axis.offset_m_s2 - bench.sensor.offset[axis];
            assert!(error.abs() < 5.0 * of_axis.offset_std_m_s2.max(1e-4), "{seed}: offset off by {error}");
        }
        let calibration = to_node(&calibrated.axes, HostTime(5));
        // The clock goes on while the node is told.
        let bench = std::cell::RefCell::new(bench);
        let clock = || bench.borrow().clock()();
        let mut end = bench.borrow().line.host_end();
        tumble.tell(&calibration, &clock, &mut end, &mut |_, _| bench.borrow_mut().step(None)).unwrap();
        assert_eq!(tumble.session.hello().unwrap().calibration.as_ref(), Some(&calibration));
    }
}

#[test]
fn a_node_that_sends_no_means_is_told_to_be_too_old_and_one_with_two_axes_is_refused() {
    let two = Hello { channels: 2, ..hello() };
    let error = Tumble::new(&two, BAUD, None, false, GRAVITY_M_S2).err().unwrap().to_string();
    assert!(error.contains("2 channels"), "{error}");
    let mut bench = Bench::new(3, Faults::default());
    let mut tumble = Tumble::new(&hello(), BAUD, None, false, GRAVITY_M_S2).unwrap();
    // It is brought to measure, and then its heartbeats no longer come.
    while !tumble.session.is_measuring() {
        bench.step(None);
        tumble.step(&bench.clock(), &mut bench.line.host_end()).unwrap();
    }
    let begun = bench.clock()();
    for second in 0..60 {
        let later = HostTime(begun.0 + 1_000_000 * second);
        let stepped = tumble.step(&|| later, &mut Deaf);
        if let Err(error) = stepped {
            assert!(matches!(error, TumbleError::TooOld { node: 7 }) && second <= 20, "{error}");
            return;
        }
    }
    panic!("it waits for ever");
}

/// A line on which nothing comes.
struct Deaf;

impl Transport for Deaf {
    fn write(&mut self, _: &[u8]) -> std::io::Result<()> {
        Ok(())
    }

    fn read(&mut self, _: &mut [u8]) -> std::io::Result<usize> {
        Ok(0)
    }
}

#[test]
fn seconds_without_readings_lie_still_never() {
    let mut heard = Heard::default();
    let heartbeat = |state| Heartbeat {
        node: 7,
        boot: 77,
        next_window: 0,
        oldest_window: 0,
        lost_windows: 0,
        damaged_frames: 0,
        refused_messages: 0,
        level: [0.0; 3].into_iter().collect(),
        sensors: [state; 3].into_iter().collect(),
        lost_rows: 0,
        board: belfry_shared::message::BoardState::default(),
        unknown_messages: 0,
        unsealed_messages: 0,
        stale_rows: 0,
        variance: [1e-5; 3].into_iter().collect(),
        mean: Heartbeat::means_of(&[0.0, 0.0, 9.8]),
    };
    for second in 0..20 {
        let state = if second < 10 { SensorState::Sound } else { SensorState::Absent };
        heard.heartbeat(HostTime(second * 1_000_000), &heartbeat(state));
    }
    let times = faces_of(&still(&heard.cells, GRAVITY_M_S2));
    assert_eq!(times[4], 7.0, "nine cells, less the first and the last: {times:?}");
}
