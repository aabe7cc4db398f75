//! Where the time goes from a recording to modes: twenty minutes of 20 channels at 50 Hz through 8 nodes.
//!
//! `cargo bench -p belfry-benches --bench chain`; times are for the twenty minutes, so 1200 s over the time is the factor to real time.

use std::hint::black_box;

use belfry_host::fleet::{Fleet, FleetOptions};
use belfry_host::identify::MeasuredSetup;
use belfry_host::link::memory::Faults;
use belfry_host::spectra::direct::Welch;
use belfry_host::spectra::{CrossSpectrumAccumulator, LineGrid, WindowLines};
use belfry_host::study::{ModeChoice, Sensor, Setup, Unit};
use criterion::{Criterion, criterion_group, criterion_main};

const CHANNELS: usize = 20;
const ROWS: usize = 20 * 60 * 50;
const DECIMATION: u32 = 8;

fn grid() -> LineGrid {
    LineGrid { sampling_rate_hz: 6.25, segment: 512, first_line: 5, lines: 118 }
}

fn setup() -> Setup {
    let sensors = (0..CHANNELS).map(|channel| Sensor::new(channel.to_string(), (channel * 8 / CHANNELS) as u16 + 1));
    Setup {
        name: "bench".to_owned(),
        files: Vec::new(),
        live: false,
        block_s: None,
        utc_offset_h: None,
        variable: None,
        sampling_rate_hz: 50.0,
        unit: Unit::MetrePerSecondSquared,
        temperature: None,
        sensors: sensors.collect(),
    }
}

fn rows() -> Vec<f64> {
    let mut state = 1_u64;
    (0..ROWS * CHANNELS)
        .map(|_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 * 1e-12
        })
        .collect()
}

fn direct(rows: &[f64]) -> Vec<WindowLines> {
    let mut windows = Vec::new();
    let mut welch = Welch::new(grid(), DECIMATION, CHANNELS).expect("8 is a decimation");
    for row in rows.chunks_exact(CHANNELS) {
        welch.push(row, &mut |window| windows.push(window));
    }
    windows
}

fn nodes(rows: &[f64], options: &FleetOptions) -> usize {
    let mut windows = 0;
    let mut fleet = Fleet::start(&setup(), DECIMATION, &grid(), options).expect("the settings are a node's");
    for block in rows.chunks(4096 * CHANNELS) {
        fleet.push(block, &mut |_| windows += 1).expect("nodes run");
    }
    fleet.finish(&mut |_| windows += 1).expect("nodes end");
    windows
}

fn chain(criterion: &mut Criterion) {
    let rows = rows();
    let mut group = criterion.benchmark_group("twenty minutes, 20 channels");
    group.sample_size(10);
    group.bench_function("spectra directly", |bencher| bencher.iter(|| black_box(direct(&rows))));
    let sound = FleetOptions::default();
    group.bench_function("8 nodes and sound lines", |bencher| bencher.iter(|| black_box(nodes(&rows, &sound))));
    let bad = FleetOptions { faults: Faults::damaging(0.02), ..sound };
    group.bench_function("8 nodes and lines that damage 2 %", |bencher| bencher.iter(|| black_box(nodes(&rows, &bad))));
    let windows = direct(&rows);
    let average = || {
        let mut accumulator = CrossSpectrumAccumulator::new(grid(), CHANNELS).expect("20 channels");
        windows.iter().for_each(|window| accumulator.add(window.clone()).expect("windows of one grid"));
        accumulator.finish().expect("windows").0
    };
    group.bench_function("averaging", |bencher| bencher.iter(|| black_box(average())));
    let setup = setup();
    let measured = [MeasuredSetup { setup: &setup, spectrum: average() }];
    group.bench_function("modes", |bencher| {
        bencher.iter(|| black_box(belfry_host::identify::identify(&measured, &ModeChoice::default()).is_ok()))
    });
    group.finish();
}

criterion_group!(benches, chain);
criterion_main!(benches);
