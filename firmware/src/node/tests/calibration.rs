//! Heartbeats that come often, and a calibration that the node keeps and does not apply.

use belfry_shared::message::AxisCalibration;

use super::*;

impl Bench {
    /// Heartbeats since the last look.
    fn heartbeats(&mut self) -> Vec<Heartbeat> {
        let heartbeats = self.messages().into_iter().filter_map(|message| match message {
            NodeMessage::Heartbeat(heartbeat) => Some(heartbeat),
            _ => None,
        });
        let heartbeats = heartbeats.collect();
        self.frames.clear();
        heartbeats
    }
}

fn calibration() -> Calibration {
    let axis = |gain_ppm| AxisCalibration { gain_ppm, gain_std_ppm: 150, offset_um_s2: -200_000 };
    let axes = [30_000, -20_000].map(axis);
    Calibration { time: HostTime(1_700_000_000_000_000), axes: HeaplessVec::from_slice(&axes).unwrap() }
}

#[test]
fn heartbeats_come_as_often_as_is_asked_for_with_means_and_then_as_before() {
    for summary in [Summary::Lines { bits: 8 }, Summary::Psd { segments: 1000 }] {
        let mut bench = Bench::new(summary);
        bench.run(50 * 20, |_| [9.0, -1.0]);
        bench.heartbeats();
        bench.say(&HostMessage::Pace(Pace { period_ms: 1000, heartbeats: 5 }));
        // Each second stands still at another value.
        bench.run(50 * 60, |row| [(row / 50) as f32, -1.0]);
        let heard = bench.heartbeats();
        assert_eq!(heard.len(), 5);
        for (second, heartbeat) in (20_u32..).zip(&heard).skip(1) {
            // A row falls into the second before it where the heartbeat is due at its own moment.
            let mean = heartbeat.mean_m_s2();
            assert!((mean[0] - second as f32).abs() < 0.03 && mean[1] == -1.0, "{second}: {mean:?}");
            assert!(heartbeat.variance[0] < 0.03, "{heartbeat:?}");
        }
        // The next one is due two minutes after the last of them, or two and a half.
        bench.run(50 * 150, |_| [9.0, -1.0]);
        assert_eq!(bench.heartbeats().len(), 1);
    }
}

#[test]
fn a_pace_of_nothing_ends_another_and_one_of_no_time_is_bounded() {
    let mut bench = Bench::new(Summary::Lines { bits: 8 });
    bench.say(&HostMessage::Pace(Pace { period_ms: 0, heartbeats: u16::MAX }));
    bench.run(50, |_| [9.0, -1.0]);
    let heard = bench.heartbeats().len();
    assert!((8..=10).contains(&heard), "{heard} in a second");
    bench.say(&HostMessage::Pace(Pace { period_ms: 0, heartbeats: 0 }));
    bench.run(50 * 60, |_| [9.0, -1.0]);
    assert_eq!(bench.heartbeats().len(), 0);
}

#[test]
fn a_calibration_is_told_in_every_greeting_and_changes_no_window() {
    let (mut plain, mut calibrated) = (Bench::new(Summary::Lines { bits: 8 }), Bench::new(Summary::Lines { bits: 8 }));
    assert_eq!(calibrated.next_hello().unwrap().calibration, None);
    plain.next_hello();
    calibrated.say(&HostMessage::Calibrate(calibration()));
    assert_eq!(calibrated.next_hello().unwrap().calibration, Some(calibration()));
    calibrated.frames.clear();
    plain.frames.clear();
    for bench in [&mut plain, &mut calibrated] {
        bench.run(256 * 5 * 3, |row| [tone(row), 2.0 * tone(row)]);
    }
    assert!(plain.frames.len() > 6, "{}", plain.frames.len());
    assert_eq!(plain.frames, calibrated.frames, "windows hold what the sensor says");
    // Nobody but the host that it listens to can tell it anything.
    let other = Calibration { axes: HeaplessVec::new(), ..calibration() };
    calibrated.say_in(OTHER, &HostMessage::Calibrate(other));
    assert_eq!(calibrated.next_hello().unwrap().calibration, Some(calibration()));
}
