//! A serial line in memory: two byte pipes with a baud rate, in simulated time, with seeded faults.
//!
//! The host's end is a [`Transport`] like any other. Time is advanced by whoever runs the simulation; bytes arrive when a
//! line of that baud rate (10 bits a byte) would have carried them.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::io;
use std::rc::Rc;

use belfry_shared::frame::END_OF_FRAME;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::transport::Transport;

/// Simulated time in ns on the host's clock.
pub type Nanoseconds = i64;

/// How often a frame suffers which fault, each a probability; a frame suffers one at most.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Faults {
    /// The frame does not arrive.
    pub drop: f64,
    /// One of its bits is flipped.
    pub flip: f64,
    /// One of its bytes is lost.
    pub lose_byte: f64,
    /// A byte of noise comes into it.
    pub insert: f64,
    /// It arrives twice.
    pub duplicate: f64,
    /// It arrives after the frame behind it.
    pub reorder: f64,
    /// Its end arrives up to half a second later than its beginning.
    pub split: f64,
    /// It, and all behind it, arrive up to two seconds late.
    pub stall: f64,
    /// Every frame arrives up to this much late, in µs; no probability.
    pub jitter_us: u32,
}

impl Faults {
    /// A line on which `share` of all frames are damaged (dropped, changed or cut) in equal parts, and as many are
    /// duplicated, reordered or late.
    pub fn damaging(share: f64) -> Self {
        let third = share / 3.0;
        Self {
            drop: third,
            flip: third,
            lose_byte: third,
            duplicate: third,
            reorder: third,
            stall: third,
            ..Self::default()
        }
    }
}

/// What the line did.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LineStatistics {
    /// Bytes handed to the line.
    pub bytes: u64,
    /// Frames handed to the line.
    pub frames: u64,
    /// What befell them.
    pub befell: Befallen,
}

/// How many frames suffered which fault.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[expect(missing_docs, reason = "they are those of `Faults`")]
pub struct Befallen {
    pub drop: u64,
    pub flip: u64,
    pub lose_byte: u64,
    pub insert: u64,
    pub duplicate: u64,
    pub reorder: u64,
    pub split: u64,
    pub stall: u64,
}

impl LineStatistics {
    /// Frames dropped, changed, cut or lengthened.
    pub fn damaged(&self) -> u64 {
        let Befallen { drop, flip, lose_byte, insert, .. } = self.befell;
        drop + flip + lose_byte + insert
    }

    /// Frames duplicated, reordered or late, as a whole or in part.
    pub fn disturbed(&self) -> u64 {
        let Befallen { duplicate, reorder, split, stall, .. } = self.befell;
        duplicate + reorder + split + stall
    }
}

#[derive(Debug)]
struct Pipe {
    byte_time: Nanoseconds,
    free_at: Nanoseconds,
    last_arrival: Nanoseconds,
    frame: Vec<(Nanoseconds, u8)>,
    held_back: Option<Vec<u8>>,
    in_flight: VecDeque<(Nanoseconds, u8)>,
    faults: Faults,
    random: ChaCha8Rng,
    statistics: LineStatistics,
}

impl Pipe {
    fn new(baud: u32, faults: Faults, seed: u64) -> Self {
        Self {
            byte_time: 10_000_000_000 / Nanoseconds::from(baud.max(1)),
            free_at: Nanoseconds::MIN,
            last_arrival: Nanoseconds::MIN,
            frame: Vec::new(),
            held_back: None,
            in_flight: VecDeque::new(),
            faults,
            random: ChaCha8Rng::seed_from_u64(seed),
            statistics: LineStatistics::default(),
        }
    }

    fn write(&mut self, now: Nanoseconds, bytes: &[u8]) {
        self.statistics.bytes += bytes.len() as u64;
        for &byte in bytes {
            self.free_at = self.free_at.max(now) + self.byte_time;
            self.frame.push((self.free_at, byte));
            if byte == END_OF_FRAME {
                let frame = std::mem::take(&mut self.frame);
                // An empty frame carries nothing that faults could befall.
                match frame.as_slice() {
                    &[(arrival, end)] => self.arrive(arrival, end),
                    _ => self.carry(frame),
                }
            }
        }
    }

    /// Puts a frame on its way, with whatever befalls it.
    fn carry(&mut self, mut frame: Vec<(Nanoseconds, u8)>) {
        self.statistics.frames += 1;
        let Faults { drop, flip, lose_byte, insert, duplicate, reorder, split, stall, jitter_us } = self.faults;
        let mut lot: f64 = self.random.random();
        let mut befalls = |probability: f64, count: &mut u64| {
            let hit = (0.0..probability).contains(&lot);
            lot -= probability;
            *count += u64::from(hit);
            hit
        };
        let befell = &mut self.statistics.befell;
        if befalls(drop, &mut befell.drop) {
            return;
        }
        let (flip, lose_byte) = (befalls(flip, &mut befell.flip), befalls(lose_byte, &mut befell.lose_byte));
        let insert = befalls(insert, &mut befell.insert);
        let duplicate = befalls(duplicate, &mut befell.duplicate);
        let mut reordered = 0;
        // One at a time can be held back.
        let reorder = befalls(reorder, &mut reordered) && self.held_back.is_none();
        let (split, stall) = (befalls(split, &mut befell.split), befalls(stall, &mut befell.stall));
        befell.reorder += u64::from(reorder);
        if flip {
            let bit = self.random.random_range(0..frame.len() * 8);
            frame[bit / 8].1 ^= 1 << (bit % 8);
        }
        if lose_byte {
            let lost = self.random.random_range(0..frame.len());
            frame.remove(lost);
        }
        if insert {
            let place = self.random.random_range(0..frame.len());
            let noise = (frame[place].0, self.random.random());
            frame.insert(place, noise);
        }
        if split {
            let (place, late_by) = (self.random.random_range(0..frame.len()), self.random.random_range(0..500_000_000));
            frame.iter_mut().skip(place).for_each(|(arrival, _)| *arrival += late_by);
        }
        if reorder {
            self.held_back = Some(frame.into_iter().map(|(_, byte)| byte).collect());
            return;
        }
        if stall && let Some((arrival, _)) = frame.first() {
            self.last_arrival = self.last_arrival.max(arrival + self.random.random_range(0..2_000_000_000));
        }
        let late_by = if jitter_us > 0 { self.random.random_range(0..=i64::from(jitter_us) * 1000) } else { 0 };
        for &(arrival, byte) in &frame {
            self.arrive(arrival + late_by, byte);
        }
        let late = if duplicate { Some(frame.iter().map(|&(_, byte)| byte).collect()) } else { None };
        for bytes in [late, self.held_back.take()].into_iter().flatten() {
            for byte in bytes {
                self.arrive(self.last_arrival + self.byte_time, byte);
            }
        }
    }

    fn arrive(&mut self, arrival: Nanoseconds, byte: u8) {
        self.last_arrival = self.last_arrival.max(arrival);
        self.in_flight.push_back((self.last_arrival, byte));
    }

    fn read(&mut self, now: Nanoseconds, buffer: &mut [u8]) -> usize {
        let mut count = 0;
        while count < buffer.len()
            && let Some(&(arrival, byte)) = self.in_flight.front()
            && arrival <= now
        {
            buffer[count] = byte;
            count += 1;
            self.in_flight.pop_front();
        }
        count
    }

    fn next_arrival(&self) -> Option<Nanoseconds> {
        self.in_flight.front().map(|&(arrival, _)| arrival)
    }
}

#[derive(Debug)]
struct Wires {
    now: Nanoseconds,
    to_host: Pipe,
    to_node: Pipe,
}

/// A simulated serial line with its two ends.
#[derive(Debug, Clone)]
pub struct Line(Rc<RefCell<Wires>>);

impl Line {
    /// A line of a baud rate, with the same kind of faults in both directions.
    pub fn new(baud: u32, faults: Faults, seed: u64) -> Self {
        let to_host = Pipe::new(baud, faults, seed);
        let to_node = Pipe::new(baud, faults, seed ^ 0x9E37_79B9_7F4A_7C15);
        Self(Rc::new(RefCell::new(Wires { now: Nanoseconds::MIN, to_host, to_node })))
    }

    /// Moves time forward.
    pub fn advance(&self, now: Nanoseconds) {
        self.0.borrow_mut().now = now;
    }

    /// When the next byte arrives at either end.
    pub fn next_arrival(&self) -> Option<Nanoseconds> {
        let wires = self.0.borrow();
        [wires.to_host.next_arrival(), wires.to_node.next_arrival()].into_iter().flatten().min()
    }

    /// When the node may send again.
    pub fn node_free_at(&self) -> Nanoseconds {
        self.0.borrow().to_host.free_at
    }

    /// The host's end.
    pub fn host_end(&self) -> HostEnd {
        HostEnd(self.clone())
    }

    /// The node's end.
    pub fn node_end(&self) -> NodeEnd {
        NodeEnd(self.clone())
    }

    /// What the line did towards the host and towards the node.
    pub fn statistics(&self) -> (LineStatistics, LineStatistics) {
        let wires = self.0.borrow();
        (wires.to_host.statistics, wires.to_node.statistics)
    }
}

/// The host's end of a [`Line`].
#[derive(Debug)]
pub struct HostEnd(Line);

impl Transport for HostEnd {
    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut wires = self.0.0.borrow_mut();
        let now = wires.now;
        wires.to_node.write(now, bytes);
        Ok(())
    }

    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let mut wires = self.0.0.borrow_mut();
        let now = wires.now;
        Ok(wires.to_host.read(now, buffer))
    }
}

/// The node's end of a [`Line`].
#[derive(Debug)]
pub struct NodeEnd(Line);

impl Transport for NodeEnd {
    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut wires = self.0.0.borrow_mut();
        let now = wires.now;
        wires.to_host.write(now, bytes);
        Ok(())
    }

    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let mut wires = self.0.0.borrow_mut();
        let now = wires.now;
        Ok(wires.to_node.read(now, buffer))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_all(end: &mut impl Transport) -> Vec<u8> {
        let mut buffer = [0; 4096];
        let count = end.read(&mut buffer).unwrap();
        buffer[..count].to_vec()
    }

    #[test]
    fn bytes_arrive_when_the_baud_rate_allows() {
        let line = Line::new(10_000, Faults::default(), 1);
        line.advance(0);
        line.host_end().write(&[1, 2, 0]).unwrap();
        line.advance(1_999_999);
        assert_eq!(read_all(&mut line.node_end()), [1]);
        assert_eq!(line.next_arrival(), Some(2_000_000));
        line.advance(3_000_000);
        assert_eq!(read_all(&mut line.node_end()), [2, 0]);
    }

    #[test]
    fn every_fault_happens_as_often_as_asked_and_is_counted() {
        let share = 0.3;
        let line = Line::new(1_000_000, Faults::damaging(share), 7);
        let frames = 10_000;
        line.advance(0);
        for n in 0..frames {
            line.host_end().write(&[1 + (n % 200) as u8, 7, 9, 0]).unwrap();
        }
        let (_, statistics) = line.statistics();
        assert_eq!(statistics.frames, frames);
        // A binomial count of 10 000 draws at 0.3 has the standard deviation 46.
        for count in [statistics.damaged(), statistics.disturbed()] {
            assert!((count as f64 - share * frames as f64).abs() < 5.0 * 46.0, "{statistics:?}");
        }
    }

    #[test]
    fn a_line_without_faults_changes_nothing_and_the_same_seed_gives_the_same_faults() {
        let carried = |faults, seed| {
            let line = Line::new(1_000_000, faults, seed);
            line.advance(0);
            let mut bytes = Vec::new();
            for n in 0..200_u32 {
                line.host_end().write(&[1 + n as u8 % 100, 5, 0]).unwrap();
                line.advance(Nanoseconds::from(n) * 10_000_000_000);
                bytes.extend(read_all(&mut line.node_end()));
            }
            bytes
        };
        assert_eq!(carried(Faults::default(), 1).len(), 600);
        assert_eq!(carried(Faults::damaging(0.2), 1), carried(Faults::damaging(0.2), 1));
        assert_ne!(carried(Faults::damaging(0.2), 1), carried(Faults::damaging(0.2), 2));
    }
}
