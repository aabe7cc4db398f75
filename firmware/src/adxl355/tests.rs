//! The driver and the node on a simulated sensor: what it starts, what it finds out, and how true lines are after all corrections.

use super::simulated::{Simulated, Tone, Traits};
use super::*;
use crate::listening::listen;
use crate::sampling::{Fetcher, Row};
use crate::{Identity, Memory, Node};
use belfry_shared::adxl355::{correction_per_hz2, odr_hz};
use belfry_shared::frame::MAX_FRAME_BYTES;
use belfry_shared::message::{
    self, Band, Configuration, Conversation, Greeting, Heartbeat, HostMessage, InConversation, NodeMessage,
    SensorState, Summary, WindowHead,
};
use belfry_shared::quantise::decode_lines;
use belfry_shared::time::{ClockModel, HostTime, NodeTime, WindowGrid};
use core::f64::consts::TAU;
use embedded_hal_mock::eh1::delay::NoopDelay;
use embedded_hal_mock::eh1::spi::{Mock, Transaction};
use num_complex::{Complex32, Complex64};
use std::boxed::Box;
use std::{vec, vec::Vec};

fn reads(register: u8, answer: &[u8]) -> Vec<Transaction<u8>> {
    vec![
        Transaction::transaction_start(),
        Transaction::write_vec(vec![register << 1 | 1]),
        Transaction::read_vec(answer.to_vec()),
        Transaction::transaction_end(),
    ]
}

/// Starts the driver on a simulated sensor.
fn start(sensor: &Simulated, rate_mhz: u32) -> Result<Adxl355<Simulated>, Error<core::convert::Infallible>> {
    let mut now_us = || (1e6 * sensor.now_s()) as u64;
    Adxl355::start(sensor.clone(), &mut sensor.clone(), &mut now_us, rate_mhz).map_err(|(error, _)| error)
}

#[test]
fn digits_become_metres_per_second_squared_and_degrees() {
    // -1 digit, 1 g, -2.048 g; 1885 - 905 digits: 100 K above 25 °C.
    let digits = [0x01, 0x00, 0x03, 0xD4, 0xFF, 0xFF, 0xF0, 0x3E, 0x80, 0x00, 0x80, 0x00, 0x00];
    let stale = [0x00, 0x00, 0x03, 0xD4, 0xFF, 0xFF, 0xF0, 0x3E, 0x80, 0x00, 0x80, 0x00, 0x00];
    let steps = [reads(0x04, &digits), reads(0x04, &stale), reads(0x04, &[0; BURST]), reads(0x04, &[0xFF; BURST])];
    let mut mock = Mock::new(&steps.concat());
    let mut sensor = Adxl355 { bus: mock.clone(), oscillator_ppm: 0, delay_us: 0 };
    let reading = sensor.read().unwrap();
    let [x, y, z] = reading.acceleration_m_s2.unwrap();
    assert_eq!(x, -SCALE_M_S2);
    assert!((y - 9.806_65).abs() < 1e-5 && (z + 2.048 * 9.806_65).abs() < 1e-5, "{y} {z}");
    assert!(z.abs() > FULL_SCALE_M_S2);
    assert_eq!(reading.temperature_centi_c, 12_500);
    assert_eq!(sensor.read().unwrap().acceleration_m_s2, None);
    assert_eq!(sensor.read(), Err(Error::Silent));
    assert_eq!(sensor.read(), Err(Error::Silent));
    mock.done();
}

#[test]
fn what_is_not_there_or_never_ready_is_said_and_the_bus_comes_back() {
    let mut mock = Mock::new(&reads(0x00, &[0, 0, 0]));
    let (error, _) = Adxl355::start(mock.clone(), &mut NoopDelay, &mut || 0, 50_000).unwrap_err();
    assert_eq!(error, Error::NotThere([0; 3]));
    mock.done();
    let mut busy = [reads(0x00, &IDENTITY), reads(0x50, &[1; 5])].concat();
    busy.extend([
        Transaction::transaction_start(),
        Transaction::write_vec(vec![0x2F << 1, 0x52]),
        Transaction::transaction_end(),
    ]);
    busy.extend((0..START_MS).flat_map(|_| reads(0x04, &[0x10])));
    let mut mock = Mock::new(&busy);
    assert_eq!(Adxl355::start(mock.clone(), &mut NoopDelay, &mut || 0, 50_000).unwrap_err().0, Error::Busy);
    mock.done();
}

#[test]
fn it_starts_synchronised_and_knows_how_fast_the_oscillator_is() {
    for oscillator in [-0.02, -0.003, 0.0, 0.011, 0.02] {
        let simulated = Simulated::new(Traits { oscillator, ..Traits::IDEAL }, &[]);
        let sensor = start(&simulated, 1_000_000).unwrap();
        // Looks are 22 µs apart: 170 ppm of eight periods of 16 ms.
        assert!((f64::from(sensor.oscillator_ppm()) - 1e6 * oscillator).abs() < 200.0, "{}", sensor.oscillator_ppm());
        let registers = [0x28, 0x2B, 0x2C, 0x2D].map(|register| simulated.register(register));
        assert_eq!(registers, [2, EXTERNAL_SYNC, RANGE_2_G, MEASURE]);
        assert!(simulated.now_s() < 0.2, "{} s", simulated.now_s());
    }
    let wild = Simulated::new(Traits { oscillator: 0.15, ..Traits::IDEAL }, &[]);
    assert_eq!(start(&wild, 1_000_000).unwrap_err(), Error::Oscillator);
    // A new rate is set in standby; its filters have another delay.
    let simulated = Simulated::new(Traits::IDEAL, &[]);
    let mut sensor = start(&simulated, 1_000_000).unwrap();
    assert!((sensor.delay_us() - 2744).abs() <= 1, "{}", sensor.delay_us());
    sensor.set_rate(500_000).unwrap();
    assert!((sensor.delay_us() - 5254).abs() <= 2 && simulated.register(0x28) == 3, "{}", sensor.delay_us());
}

#[test]
fn a_reset_that_loads_the_fuses_wrongly_is_repeated_and_given_up_in_the_end() {
    for bad_resets in 0..MOST_RESETS {
        let simulated = Simulated::new(Traits { bad_resets, ..Traits::IDEAL }, &[]);
        start(&simulated, 1_000_000).unwrap();
    }
    let simulated = Simulated::new(Traits { bad_resets: MOST_RESETS, ..Traits::IDEAL }, &[]);
    assert_eq!(start(&simulated, 1_000_000).unwrap_err(), Error::Fuses);
}

/// A node with its sensor, in simulated time: pulses at a rate, each fetched half a period later.
struct Rig {
    sensor: Simulated,
    fetcher: Fetcher<Simulated>,
    node: Box<Node<Box<Memory>>>,
    rate_hz: u32,
    /// By how much the node's crystal is slow.
    crystal: f64,
    /// Part of a period by which the interrupt may be late, beyond half a period.
    lateness: f64,
    row: u64,
    /// Pulses given: one more than rows where one came before the last row was fetched.
    pulses: u64,
    frames: Vec<Vec<u8>>,
}

/// The first pulse, in s.
const BEGIN_S: f64 = 1.0;

impl Rig {
    fn new(traits: Traits, tones: &[Tone], configuration: &Configuration) -> Self {
        let sensor = Simulated::new(traits, tones);
        let rate_hz = (configuration.sampling_rate_uhz / 1_000_000) as u32;
        let mut fetcher = Fetcher::NONE;
        fetcher.set_sensor(start(&sensor, 1000 * rate_hz).unwrap());
        let identity = Identity {
            node: 3,
            boot: 77,
            channels: 3,
            full_scale_m_s2: FULL_SCALE_M_S2,
            highest_rate_mhz: HIGHEST_RATE_MHZ,
        };
        let mut node = Box::new(Node::new(identity, Box::new(Memory::new())));
        node.set_correction(correction_per_hz2);
        let mut rig =
            Self { sensor, fetcher, node, rate_hz, crystal: 0.0, lateness: 0.0, row: 0, pulses: 0, frames: Vec::new() };
        rig.say(&HostMessage::Greet(Greeting::OF_HOSTS));
        rig.say(&HostMessage::Configure(configuration.clone()));
        rig.say(&HostMessage::SetClock(ClockModel { node: NodeTime(0), host: HostTime(0), drift_ppb: 0 }));
        rig
    }

    fn say(&mut self, message: &HostMessage) {
        let message = InConversation { conversation: Conversation([1; 4]), message: message.clone() };
        let mut frame = [0; MAX_FRAME_BYTES];
        let length = message::encode(&message, &mut frame).unwrap();
        for &byte in &frame[..length] {
            self.node.receive(NodeTime(0), byte);
        }
    }

    /// The next row, as the sensor's pulse and the interrupt after it make it.
    fn next_row(&mut self) -> Row {
        let node_s = self.pulse_s(self.row);
        // Delays that come in no order.
        let late = self.lateness * (self.row.wrapping_mul(2_654_435_761) % 1009) as f64 / 1009.0;
        let fetch_s = node_s * (1.0 + self.crystal) + (0.5 + late) / f64::from(self.rate_hz);
        // The timer waits for nobody.
        self.pulses = self.pulses.max(self.row);
        loop {
            let pulse_s = self.pulse_s(self.pulses) * (1.0 + self.crystal);
            if pulse_s > fetch_s {
                break;
            }
            self.sensor.advance_to(pulse_s);
            self.sensor.pulse();
            self.pulses += 1;
        }
        self.sensor.advance_to(fetch_s);
        self.row += 1;
        self.fetcher.fetch(NodeTime((1e6 * node_s).round() as u64))
    }

    /// When the node gives a pulse, by its clock in s.
    fn pulse_s(&self, number: u64) -> f64 {
        BEGIN_S + number as f64 / f64::from(self.rate_hz)
    }

    fn run(&mut self, rows: u64) {
        for _ in 0..rows {
            let row = self.next_row();
            if row.is_stale {
                self.node.stale(row.time)
            } else {
                self.node.sample(row.time, &row.readings)
            }
            if self.row.is_multiple_of(16) {
                self.listen();
            }
        }
    }

    fn listen(&mut self) {
        let now = NodeTime((1e6 * self.sensor.now_s()) as u64);
        listen(&mut self.node, now, &mut self.frames);
    }

    fn heartbeats(&self) -> Vec<Heartbeat> {
        let heartbeats = self.frames.iter().filter_map(|frame| match message::decode(frame).unwrap() {
            NodeMessage::Heartbeat(heartbeat) => Some(heartbeat),
            _ => None,
        });
        heartbeats.collect()
    }

    /// The first window's head, and its lines of a channel.
    fn window(&self, channel: u8) -> Option<(WindowHead, Vec<Complex32>)> {
        let messages: Vec<NodeMessage<'_>> = self.frames.iter().map(|frame| message::decode(frame).unwrap()).collect();
        let head = messages.iter().find_map(|message| match message {
            NodeMessage::Head(head) => Some(head.clone()),
            _ => None,
        })?;
        let mut lines = Vec::new();
        for message in &messages {
            if let NodeMessage::Lines(part) = message
                && part.name == head.name
                && part.channel == channel
            {
                let mut decoded = vec![Complex32::default(); usize::from(part.lines)];
                decode_lines(part.code, part.bits, &mut decoded).unwrap();
                lines.extend(decoded);
            }
        }
        Some((head, lines))
    }
}

const SEGMENT: usize = 256;
const FIRST_LINE: usize = 13;
const LINES: usize = 90;

/// Lines from 0.05 to 0.4 of the decimated rate.
fn configuration(rate_hz: u32, decimation: u32) -> Configuration {
    Configuration {
        channels: 3,
        sampling_rate_uhz: u64::from(rate_hz) * 1_000_000,
        decimation,
        segment: SEGMENT as u16,
        summary: Summary::Lines { bits: 16 },
        bands: [Band { first_line: FIRST_LINE as u16, lines: LINES as u16 }].into_iter().collect(),
    }
}

/// A node's first window of tones: the lines of a channel as the host has them after its corrections, and when the segment began by the grid, in s.
fn measured(traits: Traits, tones: &[Tone], configuration: &Configuration) -> (Vec<Complex64>, f64) {
    let mut rig = Rig::new(traits, tones, configuration);
    // The first whole segment on the grid, a filter's length later.
    rig.run(u64::from(configuration.decimation) * (SEGMENT as u64 * 3 / 2 + 60));
    let (head, lines) = rig.window(0).unwrap();
    assert_eq!(lines.len(), LINES, "{head:?}");
    let grid =
        WindowGrid { sampling_rate_uhz: configuration.sampling_rate_uhz, hop_samples: configuration.hop_samples() };
    let spacing_hz = spacing_hz(configuration);
    let corrected = lines.iter().enumerate().map(|(index, line)| {
        let frequency_hz = (FIRST_LINE + index) as f64 * spacing_hz;
        let turn = Complex64::cis(-TAU * frequency_hz * 1e-6 * f64::from(head.middle_offset_us));
        Complex64::new(line.re.into(), line.im.into()) * turn
    });
    (corrected.collect(), 1e-6 * grid.start(head.grid_index).0 as f64)
}

fn spacing_hz(configuration: &Configuration) -> f64 {
    decimated_hz(configuration) / SEGMENT as f64
}

fn decimated_hz(configuration: &Configuration) -> f64 {
    1e-6 * configuration.sampling_rate_uhz as f64 / f64::from(configuration.decimation)
}

/// The line of tones in exact samples from `begin_s` on: straight line out, Hann window, scaled to a density.
fn expected(tones: &[Tone], begin_s: f64, line: usize, configuration: &Configuration) -> Complex64 {
    let (n, rate_hz) = (SEGMENT as f64, decimated_hz(configuration));
    let samples: Vec<f64> = (0..SEGMENT)
        .map(|index| {
            let t = begin_s + index as f64 / rate_hz;
            tones.iter().map(|tone| tone.amplitude_m_s2 * (TAU * tone.frequency_hz * t + tone.phase).cos()).sum()
        })
        .collect();
    let middle = 0.5 * (n - 1.0);
    let mean = samples.iter().sum::<f64>() / n;
    let about: f64 = samples.iter().enumerate().map(|(index, x)| (index as f64 - middle) * x).sum();
    let slope = about / (n * (n * n - 1.0) / 12.0);
    let sum: Complex64 = samples
        .iter()
        .enumerate()
        .map(|(index, x)| {
            let index = index as f64;
            let window = 0.5 - 0.5 * (TAU * index / n).cos();
            Complex64::cis(-TAU * line as f64 * index / n) * window * (x - mean - slope * (index - middle))
        })
        .sum();
    sum * (2.0 / (rate_hz * 0.375 * n)).sqrt()
}

/// An oscillator of RC kind: it wanders by 50 ns in a millisecond. And noise of a digit, a tenth of a sensor's own: without any, motion that the
/// filters keep out would leave nothing but equal readings.
fn with_oscillator(oscillator: f64) -> Traits {
    Traits { oscillator, oscillator_jitter_s: 50e-9, noise_m_s2: 2e-6, ..Traits::IDEAL }
}

/// What nodes are asked for: rate and decimation.
const TASKS: [(u32, u32); 5] = [(1000, 200), (1000, 80), (1000, 40), (500, 100), (500, 40)];

#[test]
fn phases_are_within_0_05_degrees_and_gains_within_0_1_db_whatever_the_oscillator() {
    for (rate_hz, decimation) in TASKS {
        for oscillator in [-0.02, 0.007, 0.02] {
            let configuration = configuration(rate_hz, decimation);
            let spacing_hz = spacing_hz(&configuration);
            let numbers: Vec<usize> = (FIRST_LINE..FIRST_LINE + LINES).step_by(4).collect();
            let tones: Vec<Tone> = numbers
                .iter()
                .enumerate()
                .map(|(index, &line)| Tone {
                    frequency_hz: line as f64 * spacing_hz,
                    amplitude_m_s2: 0.2,
                    phase: 2.4 * (index * index) as f64,
                })
                .collect();
            let (lines, begin_s) = measured(with_oscillator(oscillator), &tones, &configuration);
            let (mut worst_deg, mut worst_db) = (0.0_f64, 0.0_f64);
            for line in numbers {
                let ratio = lines[line - FIRST_LINE] / expected(&tones, begin_s, line, &configuration);
                worst_deg = worst_deg.max(ratio.arg().to_degrees().abs());
                worst_db = worst_db.max(20.0 * ratio.norm().log10().abs());
            }
            assert!(worst_deg < 0.05 && worst_db < 0.1, "{rate_hz}/{decimation} {oscillator}: {worst_deg} {worst_db}");
        }
    }
}

/// Motion above the band: in the transition beyond 0.6 of the decimated rate, far above it, and where it folds down at the sensor's rate and its
/// double, and at the sampling rate. At the sensor's rate most is left at the band's upper edge, which lies farthest from the filters' zero.
#[test]
fn motion_above_the_band_is_80_db_down_in_every_line_of_it() {
    for (rate_hz, decimation) in TASKS {
        for oscillator in [-0.02, 0.007, 0.02] {
            let configuration = configuration(rate_hz, decimation);
            let (decimated_hz, rate) = (decimated_hz(&configuration), f64::from(rate_hz));
            let odr = odr_hz(setting_for(1000 * rate_hz)) * (1.0 + oscillator);
            for frequency_hz in [
                0.613 * decimated_hz,
                0.93 * decimated_hz,
                3.3 * decimated_hz,
                0.3 * rate,
                odr - 0.21 * decimated_hz,
                odr - 0.4 * decimated_hz,
                rate + 0.33 * decimated_hz,
                2.0 * odr + 0.11 * decimated_hz,
            ] {
                let tone = Tone { frequency_hz, amplitude_m_s2: 9.0, phase: 0.3 };
                let (lines, _) = measured(with_oscillator(oscillator), &[tone], &configuration);
                // A tone on a line of the band would have this magnitude there.
                let whole = 0.5 * 9.0 * (2.0 * SEGMENT as f64 / 4.0 / (decimated_hz * 0.375)).sqrt();
                let most = lines.iter().map(|line| line.norm()).fold(0.0, f64::max);
                let db = 20.0 * (most / whole).log10();
                assert!(db < -80.0, "{rate_hz}/{decimation} {oscillator} {frequency_hz} Hz: {db} dB");
            }
        }
    }
}

/// A sensor with all that a real one has, and a node whose crystal is 50 ppm slow and whose interrupts are up to 0.4 of a period late, for so many
/// minutes in which it warms up by 20 K.
fn warmed_up(minutes: u32) -> Rig {
    let traits = Traits {
        noise_m_s2: 22.5e-6 * 9.806_65,
        offset_m_s2: [0.1, -0.2, 9.9],
        offset_per_k_m_s2: [0.001, 0.001, -0.001],
        oscillator: -0.02,
        oscillator_per_k: 2e-4,
        oscillator_jitter_s: 50e-9,
        ..Traits::IDEAL
    };
    let mut rig = Rig::new(traits, &[], &configuration(1000, 200));
    (rig.crystal, rig.lateness) = (50e-6, 0.4);
    for minute in 0..minutes {
        rig.sensor.change(|traits| traits.temperature_c = 25.0 + 20.0 * f64::from(minute) / f64::from(minutes - 1));
        rig.run(60_000);
        // What it has said is looked at when it ends.
        let kept = rig.frames.len().saturating_sub(1000);
        rig.frames.drain(..kept);
    }
    rig
}

#[test]
fn samples_are_fresh_with_noise_drift_and_an_oscillator_that_warms_up() {
    let rig = warmed_up(10);
    let heartbeat = rig.heartbeats().pop().unwrap();
    assert_eq!((heartbeat.stale_rows, heartbeat.lost_rows), (0, 0));
    assert_eq!(heartbeat.sensors, [SensorState::Sound; 3]);
    // The noise of the band of the filters, whatever the offset and its drift: 22.5 µg over some 250 Hz, in the sensor's bandwidth.
    for (channel, variance) in heartbeat.variance.iter().enumerate() {
        let rms = variance.sqrt();
        assert!((2e-3..6e-3).contains(&rms), "channel {channel}: {rms}");
    }
    // The offset, less 1 mm/s² for each kelvin: it has warmed up by more than 10 K when the last two minutes that are told of begin.
    let mean_m_s2 = heartbeat.mean_m_s2()[2];
    assert!((9.88..9.89).contains(&mean_m_s2), "{mean_m_s2}");
    assert_eq!(rig.fetcher.temperature_centi_c(), Some(4500));
}

mod long {
    use super::*;

    #[test]
    #[ignore = "long: ./test --all runs it"]
    fn no_sample_is_lost_or_stale_in_a_day() {
        let heartbeat = warmed_up(24 * 60).heartbeats().pop().unwrap();
        assert_eq!((heartbeat.stale_rows, heartbeat.lost_rows), (0, 0));
    }
}

#[test]
fn a_sample_that_the_next_pulse_replaces_before_it_is_fetched_is_counted() {
    let mut rig = Rig::new(Traits::IDEAL, &[], &configuration(1000, 200));
    // A sixth of the interrupts come after the next pulse, and read that pulse's sample. The row after such a one finds it read, unless it is as late.
    rig.lateness = 0.6;
    let stale = (0..10_000).filter(|_| rig.next_row().is_stale).count();
    assert!((500..1667).contains(&stale), "{stale}");
    rig.run(70_000);
    let heartbeat = rig.heartbeats().pop().unwrap();
    assert!(heartbeat.stale_rows > 500, "{}", heartbeat.stale_rows);
}

/// Noise of a damaged sensor passes its own filters, as all noise does that it has.
#[test]
fn a_noisy_sensor_is_told_at_every_rate() {
    for (rate_hz, decimation) in [(4000, 800), (2000, 400), (1000, 200), (500, 100), (100, 20), (50, 10)] {
        // 0.5 m/s² in the filters' band.
        let noise_m_s2 = 0.5 / (0.25 * odr_hz(setting_for(1000 * rate_hz))).sqrt();
        for (noise_m_s2, expected) in [(noise_m_s2, SensorState::Noisy), (0.02 * noise_m_s2, SensorState::Sound)] {
            let traits = Traits { offset_m_s2: [0.0, 0.0, 9.8], noise_m_s2, ..Traits::IDEAL };
            let mut rig = Rig::new(traits, &[], &configuration(rate_hz, decimation));
            rig.run(130 * u64::from(rate_hz));
            let heartbeat = rig.heartbeats().pop().unwrap();
            assert_eq!(heartbeat.sensors, [expected; 3], "{rate_hz} Hz: {:?}", heartbeat.rms());
        }
    }
}

#[test]
fn a_broken_wire_of_the_pulses_is_found_out_and_told() {
    let mut rig = Rig::new(Traits { offset_m_s2: [0.0, 0.0, 9.8], ..Traits::IDEAL }, &[], &configuration(1000, 200));
    rig.run(15_000);
    rig.sensor.change(|traits| traits.has_pulses = false);
    assert!(rig.fetcher.take_lost().is_none());
    rig.run(16);
    assert!(rig.fetcher.take_lost().is_some(), "sixteen stale rows are no chance");
    // A start does not mend a wire.
    for _ in 0..70 {
        rig.sensor.lose_supply();
        let started = start(&rig.sensor, 1_000_000).unwrap();
        rig.row = 1 + ((rig.sensor.now_s() - BEGIN_S) * 1000.0).ceil() as u64;
        rig.fetcher.set_sensor(started);
        rig.run(1800);
    }
    rig.run(130_000);
    let heartbeat = rig.heartbeats().pop().unwrap();
    assert_eq!(heartbeat.sensors, [SensorState::Unsynchronised; 3]);
    assert!(heartbeat.stale_rows > 200_000, "{}", heartbeat.stale_rows);
    rig.sensor.change(|traits| traits.has_pulses = true);
    rig.run(130_000);
    let heartbeat = rig.heartbeats().pop().unwrap();
    assert_eq!(rig.fetcher.temperature_centi_c(), Some(2500));
    assert_ne!(heartbeat.sensors, [SensorState::Unsynchronised; 3]);
}

#[test]
fn a_sensor_that_lost_its_supply_for_a_moment_is_started_anew() {
    let mut rig = Rig::new(Traits::IDEAL, &[], &configuration(1000, 200));
    assert!((0..100).all(|_| !rig.next_row().is_stale));
    // Its registers are at their defaults: it is in standby.
    rig.sensor.lose_supply();
    assert!((0..16).all(|_| rig.next_row().is_stale));
    assert!(rig.fetcher.take_lost().is_some());
    let started = start(&rig.sensor, 1_000_000).unwrap();
    rig.fetcher.set_sensor(started);
    rig.row += 300;
    assert!((0..100).map(|_| rig.next_row()).skip(3).all(|row| !row.is_stale));
}
