//! The heading of the real image against the truth: in flight, with faults of the compass, and
//! without a compass.

mod common;

use std::collections::BTreeMap;

use aplomb::attitude::Vector3;
use aplomb::calibration::CompassCorrection;
use aplomb::estimator::heading::{Heading, HeadingEstimate};
use aplomb::health::Flags;
use aplomb::mpu6050::{Burst, PARTS};
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::serialize::StateReader;
use aplomb::settings::Record;
use aplomb::telemetry::heading;
use aplomb::telemetry::log::HeadingState;
use aplomb_models::compass::CompassConfig;
use aplomb_models::motion::Mount;
use aplomb_models::motion::geometry::Vector;
use aplomb_models::motion::rest::Rest;
use aplomb_recordings::flight_log::{self, Step};
use common::{firmware, pooled_run};
use virtual_board::flight::{Outcome, Run};
use virtual_board::kit::Kit;
use virtual_board::recorder::Sample;
use virtual_board::schedule::Schedule;
use virtual_board::slots::Slots;
use virtual_board::summary::valid_heading_deg;

/// Both boards with a compass.
const KITS: [Kit; 2] = [Kit::Gy87, Kit::Mpu9250];

/// The inverse of a matrix, by Cramer's rule.
fn inverse([a, b, c]: [Vector; 3]) -> [Vector; 3] {
    let cross = |u: Vector, v: Vector| {
        [
            u[1] * v[2] - u[2] * v[1],
            u[2] * v[0] - u[0] * v[2],
            u[0] * v[1] - u[1] * v[0],
        ]
    };
    let columns = [cross(b, c), cross(c, a), cross(a, b)];
    let determinant: f64 = a.iter().zip(columns[0]).map(|(a, b)| a * b).sum();
    [0, 1, 2].map(|row| columns.map(|column| column[row] / determinant))
}

/// The record of a module whose compass was calibrated exactly.
fn calibrated_record(config: &CompassConfig) -> Record {
    let vector = |[x, y, z]: Vector| Vector3::new(x as f32, y as f32, z as f32);
    let matrix = inverse(config.magnetism.soft_iron).map(vector);
    let iron = vector(config.magnetism.hard_iron_ut);
    let [x, y, z] = matrix.map(|row| row.dot(iron));
    let mut record = Record::default();
    record.compass.correction = Some(CompassCorrection {
        matrix,
        hard_iron_ut: Vector3::new(x, y, z),
    });
    record
}

/// The slots of a module with that record.
fn calibrated(config: &CompassConfig) -> Vec<u8> {
    Slots::with_record(&calibrated_record(config)).0
}

/// A flight with this kit, whose compass was calibrated.
fn calibrated_flight(kit: Kit, seed: u64) -> Run {
    with_calibrated_compass(pooled_run(), kit, seed)
}

fn with_calibrated_compass(run: Run, kit: Kit, seed: u64) -> Run {
    let config = kit.compass(seed, Mount::default()).unwrap();
    run.kit(kit)
        .seed(seed)
        .flash(calibrated(&config))
        .without_probe()
}

/// The share of samples with a valid heading from this time on. No valid heading is wrong by more
/// than the larger of 15° and six σ.
fn valid_share(outcome: &Outcome, from_s: f64) -> f64 {
    let (mut all, mut valid) = (0, 0);
    for sample in outcome.samples() {
        let is_late = sample.published_ns as f64 * 1e-9 > from_s;
        all += u32::from(is_late);
        let Some(heading) = sample.valid_heading() else {
            continue;
        };
        valid += u32::from(is_late);
        let error_deg = valid_heading_deg(sample).unwrap();
        let sigma_deg = f64::from(heading.sigma_rad).to_degrees();
        assert!(
            error_deg <= (6.0 * sigma_deg).max(15.0),
            "{error_deg} with {sigma_deg} at {} us",
            sample.snapshot.t_us
        );
    }
    f64::from(valid) / f64::from(all)
}

/// The samples from this time on, s.
fn after(outcome: &Outcome, from_s: f64) -> impl Iterator<Item = &Sample> {
    let samples = outcome.samples().iter();
    samples.filter(move |sample| sample.published_ns as f64 * 1e-9 > from_s)
}

#[test]
fn a_calibrated_compass_gives_a_valid_heading_within_seconds_of_motion() {
    for kit in KITS {
        let run = calibrated_flight(kit, 4).command(19.0, "status");
        let outcome = run.seconds(20.0).run().unwrap();
        assert_eq!(outcome.issues, Vec::<String>::new());
        let share = valid_share(&outcome, 10.0);
        assert!(share > 0.98, "{kit:?}: {share}");
        let summary = &outcome.summary;
        assert!(
            summary.heading_rms_deg.is_some_and(|it| it < 4.0),
            "{kit:?} {summary:?}"
        );
        // The text has it.
        let lines = outcome.uart_lines.iter();
        let lines: Vec<heading::Line> = lines.filter_map(|it| heading::decode(&it.text)).collect();
        assert!(lines.len() > 400, "{}", lines.len());
        let last = lines.last().unwrap();
        assert!(last.is_valid, "{last:?}");
        let (sample, heading) = (outcome.samples().last().unwrap(), last_heading(&outcome));
        let expected = heading::Line::new(&sample.snapshot, &heading);
        let error_deg = (last.heading_deg - expected.heading_deg + 540.0) % 360.0 - 180.0;
        assert!(error_deg.abs() < 3.0, "{last:?} {expected:?}");
        assert!(outcome.uart_reports("attitude: VALID|HEADING_VALID"));
        assert!(outcome.uart_reports(" heading_valid=yes north=magnetic mount="));
    }
}

fn last_heading(outcome: &Outcome) -> HeadingEstimate {
    outcome.samples().last().unwrap().heading.unwrap()
}

/// A declination turns the heading, in memory and as text. The attitude stays that without one, to
/// the bit.
#[test]
fn a_declination_turns_the_heading_and_nothing_else() {
    let config = Kit::Gy87.compass(4, Mount::default()).unwrap();
    // The second `compass` restarts the filter.
    let restart = [(1.0, "compass off"), (1.5, "compass auto")];
    for (stored_deg, set, others, expected_deg) in [
        (4.5, None, &[][..], 4.5),
        (4.5, Some((6.0, "declination -22.5")), &[], -22.5),
        (0.0, Some((0.7, "declination 90")), &restart, 90.0),
    ] {
        let run = |declination_deg: f32, set: Option<(f64, &str)>| {
            let mut record = calibrated_record(&config);
            record.compass.declination_rad = declination_deg.to_radians();
            let run = calibrated_flight(Kit::Gy87, 4).flash(Slots::with_record(&record).0);
            let commands = others.iter().copied().chain(set);
            let run = commands.fold(run, |run, (at_s, line)| run.command(at_s, line));
            run.seconds(14.0).run().unwrap()
        };
        let (magnetic, turned) = (run(0.0, None), run(stored_deg, set));
        let attitude = |sample: &Sample| sample.snapshot.attitude;
        let attitudes =
            |outcome: &Outcome| -> Vec<_> { outcome.samples().iter().map(attitude).collect() };
        assert!(attitudes(&magnetic) == attitudes(&turned));
        let memory_deg = |outcome: &Outcome| {
            let yaw_rad = outcome.samples().last().unwrap().snapshot.euler().yaw_rad;
            last_heading(outcome).heading_rad(yaw_rad).to_degrees()
        };
        let text_deg = |outcome: &Outcome| {
            let mut lines = outcome.uart_lines.iter().rev();
            let line = lines.find_map(|it| heading::decode(&it.text));
            line.unwrap().heading_deg
        };
        for turn_deg in [
            memory_deg(&turned) - memory_deg(&magnetic),
            text_deg(&turned) - text_deg(&magnetic),
        ] {
            let error_deg = (turn_deg - expected_deg + 540.0) % 360.0 - 180.0;
            assert!(error_deg.abs() < 0.3, "{expected_deg}: {turn_deg}");
        }
    }
}

/// The hard iron is found in flight.
#[test]
fn a_compass_that_nobody_calibrated_gives_a_heading_in_flight() {
    for kit in KITS {
        let run = pooled_run().kit(kit).seed(2).without_probe();
        let outcome = run.seconds(30.0).run().unwrap();
        let share = valid_share(&outcome, 20.0);
        assert!(share > 0.9, "{kit:?}: {share}");
    }
}

/// The attitude comes first, and is that without a compass.
#[test]
fn budgets_hold_with_a_heading() {
    for kit in KITS {
        // With an account of instructions.
        let run = with_calibrated_compass(Run::new(firmware()), kit, 3);
        let outcome = run.seconds(10.0).run().unwrap();
        let summary = &outcome.summary;
        assert_eq!(summary.missed, 0);
        assert!(
            summary
                .edge_to_attitude_us_max
                .is_some_and(|it| it <= 395.0),
            "{kit:?} {summary:?}"
        );
        assert!(
            summary
                .instructions_per_sample_mean
                .is_some_and(|it| it <= 1_400.0),
            "{kit:?} {summary:?}"
        );
        assert!(
            summary
                .instructions_per_sample_max
                .is_some_and(|it| it <= 6_000),
            "{kit:?} {summary:?}"
        );
        let steady = after(&outcome, 2.0).filter_map(|sample| sample.instructions);
        let worst = steady.max().unwrap();
        assert!(worst <= 3_000, "{kit:?} {worst}");
        let who_am_i = kit.who_am_i();
        let part = PARTS.iter().find(|part| part.who_am_i == who_am_i).unwrap();
        let mut pipeline = Pipeline::new(&Settings::new(part));
        for sample in outcome.samples() {
            let flags = sample.snapshot.flags;
            let burst = Burst {
                bytes: sample.burst.bytes,
                captured_at_us: sample.snapshot.t_us,
                missed_before: u8::from(flags.contains(Flags::MISSED)),
            };
            let board = aplomb::health::BoardFlags::from_bits_truncate(flags.bits());
            assert_eq!(pipeline.update(&burst, board), sample.snapshot, "{kit:?}");
        }
    }
}

#[test]
fn without_a_compass_there_is_no_heading() {
    let run = pooled_run().seconds(6.0).seed(3).without_probe();
    let outcome = run.command(3.0, "status").run().unwrap();
    assert!(outcome.samples().len() > 5_000);
    assert!(
        outcome
            .samples()
            .iter()
            .all(|sample| sample.heading.is_none())
    );
    assert!(!outcome.uart_reports("heading"));
    assert!(!outcome.uart_reports("HEADING"));
}

/// A heading without readings is valid for a second and a little more. It comes back by itself.
#[test]
fn no_fault_of_the_compass_gives_a_wrong_valid_heading() {
    for (name, lasts_s) in [
        ("compass-silent", 3.0),
        ("compass-frozen", 3.0),
        ("compass-overflow", 3.0),
        ("compass-garbled", 3.0),
        ("compass-stall", 0.02),
    ] {
        let text = format!("6.0 {lasts_s} {name}");
        let outcome = calibrated_flight(Kit::Gy87, 5)
            .schedule(&Schedule::parse("test", &text).unwrap())
            .seconds(13.0)
            .run()
            .unwrap();
        let share = valid_share(&outcome, 11.5);
        assert!(share > 0.98, "{name}: {share}");
        if lasts_s > 1.0 {
            let during = after(&outcome, 8.3);
            let during = during.take_while(|sample| sample.published_ns < 8_900_000_000);
            let valid = during.filter(|sample| sample.valid_heading().is_some());
            assert_eq!(valid.count(), 0, "{name}");
            assert!(
                outcome.uart_reports("attitude: VALID|COMPASS_FAULT"),
                "{name}"
            );
        }
    }
}

#[test]
fn commands_that_change_the_compass_restart_the_heading() {
    let config = Kit::Gy87.compass(1, Mount::default()).unwrap();
    let outcome = pooled_run()
        .kit(Kit::Gy87)
        .motion(Rest::level())
        .flash(calibrated(&config))
        .command(4.0, "status")
        .command(4.5, "compass off")
        .command(5.0, "status")
        .command(5.5, "compass auto")
        .without_probe()
        .seconds(9.0)
        .run()
        .unwrap();
    let statuses: Vec<&str> = outcome
        .uart_lines
        .iter()
        .map(|line| line.text.as_str())
        .filter(|line| line.contains("ok status: flags="))
        .collect();
    // The texts are those of the compass alone: the status without one has none of them.
    assert!(
        statuses[0].contains(" compass=QMC5883L@0x0d field_ut="),
        "{statuses:?}"
    );
    assert!(statuses[0].contains(" strength_ut=49."), "{statuses:?}");
    let heading = " heading_valid=no north=magnetic mount=";
    assert!(statuses[0].contains(heading), "{statuses:?}");
    assert!(!statuses[1].contains("heading"), "{statuses:?}");
    // At rest the heading is known, but nothing tells it from that of a magnet.
    assert!(!statuses[0].contains("HEADING"), "{statuses:?}");
    let known = after(&outcome, 3.5).take_while(|sample| sample.published_ns < 4_400_000_000);
    let known: Vec<bool> = known.map(|sample| sample.heading.is_some()).collect();
    assert!(known.len() > 500 && known.iter().all(|is_known| *is_known));
    assert!(!statuses[1].contains("HEADING"), "{statuses:?}");
    let off = after(&outcome, 4.7).take_while(|sample| sample.published_ns < 5_600_000_000);
    assert_eq!(off.filter(|sample| sample.heading.is_some()).count(), 0);
    // The correction is lost with the command. At rest nothing tells hard iron from the field.
    assert_eq!(
        after(&outcome, 3.5)
            .filter(|it| it.valid_heading().is_some())
            .count(),
        0
    );
}

/// Bits of a heading, to compare.
fn bits(heading: Option<HeadingEstimate>) -> Option<(u32, u32, bool)> {
    heading.map(|it| {
        let (offset_rad, sigma_rad) = (it.yaw_offset_rad, it.sigma_rad);
        (offset_rad.to_bits(), sigma_rad.to_bits(), it.is_valid)
    })
}

/// Replay of a log with the library alone.
#[derive(Default)]
struct Replayed {
    pipeline: Option<Pipeline>,
    heading: Option<Heading>,
    is_exact: bool,
    /// Exact headings by the times of their samples.
    headings: BTreeMap<u64, Option<HeadingEstimate>>,
    starts: u32,
}

impl Replayed {
    fn take(&mut self, step: &Step) {
        let burst = &step.numbered.burst;
        if step.configuration.is_some() {
            // The sample before the change has lost its heading before the next one came.
            self.headings.pop_last();
            self.is_exact = false;
        }
        if let Some(state) = &step.state {
            let part = PARTS.first().unwrap();
            let pipeline = self
                .pipeline
                .get_or_insert_with(|| Pipeline::new(&Settings::new(part)));
            let mut reader = StateReader::new(state);
            pipeline.visit_state(&mut reader);
            assert!(reader.is_complete());
        }
        let Some(pipeline) = &mut self.pipeline else {
            return;
        };
        if let Some(bytes) = &step.heading_state {
            let mut state = HeadingState {
                next_reading: 0,
                filter: None,
            };
            let mut reader = StateReader::new(bytes);
            state.visit_state(&mut reader);
            assert!(reader.is_complete());
            if self.is_exact {
                // The filter's state is the replay's, to the bit.
                assert_eq!(self.heading, state.filter);
            }
            self.heading = state.filter;
            self.is_exact = true;
        }
        pipeline.update(burst, step.numbered.flags);
        if let Some(heading) = &mut self.heading {
            pipeline.update_heading(heading);
        }
        if self.is_exact {
            let estimate = self.heading.as_ref().and_then(Heading::estimate);
            self.headings.insert(burst.captured_at_us, estimate);
        }
        if let Some(reading) = &step.reading {
            assert_eq!(reading.sample_t_us, burst.captured_at_us);
            if reading.starts_filter {
                let mut heading = Heading::new(reading.knowledge);
                heading.set_declination(reading.declination_rad);
                self.heading = Some(heading);
                self.is_exact = true;
                self.starts += 1;
            }
            let age_us = pipeline.reading_age_us(reading.measured_us);
            if let Some(heading) = &mut self.heading {
                heading.add_field(reading.field, age_us);
            }
        }
    }
}

/// Each heading of the flight is replayed, also after commands that change the compass.
#[test]
fn a_flight_log_replays_the_heading_to_the_bit() {
    for kit in KITS {
        let outcome = calibrated_flight(kit, 4)
            .command(1.0, "baud 921600")
            .command(1.2, "declination 3.5")
            .command(1.5, "format log")
            .command(12.0, "declination -2")
            .command(14.0, "compass +y-z")
            .command(15.5, "compass off")
            .command(16.5, "compass auto")
            .seconds(18.0)
            .run()
            .unwrap();
        assert_eq!(outcome.summary.missed, 0);
        let received = &outcome.record.received;
        let bytes: Vec<u8> = received.iter().map(|received| received.byte).collect();
        let log = flight_log::decode(&bytes).unwrap();
        let [flight] = &log.flights[..] else {
            panic!("{} flights", log.flights.len())
        };
        assert_eq!((flight.lost(), flight.readings_lost), (0, 0));
        assert!(flight.readings > 650, "{}", flight.readings);
        let mut replayed = Replayed::default();
        for step in log.steps(flight).unwrap() {
            replayed.take(&step);
        }
        assert_eq!(replayed.starts, 2, "after the change, and after the pause");
        let (mut compared, mut known) = (0, 0);
        for sample in outcome.samples() {
            let t_us = sample.snapshot.t_us;
            if let Some(heading) = replayed.headings.get(&t_us) {
                assert_eq!(bits(*heading), bits(sample.heading), "{kit:?} at {t_us} us");
                compared += 1;
                known += u32::from(heading.is_some());
            }
        }
        assert!(compared > 15_000 && known > 11_000, "{compared} {known}");
    }
}

/// The load of the log in flight, against the documented share of the line.
#[test]
fn a_flight_log_with_a_compass_leaves_half_of_the_line_free() {
    let outcome = calibrated_flight(Kit::Gy87, 4)
        .command(1.0, "baud 921600")
        .command(1.5, "format log")
        .seconds(12.5)
        .run()
        .unwrap();
    assert_eq!(outcome.issues, Vec::<String>::new());
    // The copies of both states delay no attitude.
    let summary = &outcome.summary;
    assert_eq!(summary.missed, 0);
    assert!(
        summary
            .edge_to_attitude_us_max
            .is_some_and(|it| it <= 395.0),
        "{summary:?}"
    );
    // Ten seconds, each byte with ten bits.
    let ten_seconds = 2_000_000_000..12_000_000_000;
    let received = outcome.record.received.iter();
    let bytes = received.filter(|byte| ten_seconds.contains(&byte.at_ns));
    let bytes = bytes.count();
    let share = bytes as f64 / 921_600.0;
    println!(
        "{bytes} bytes in ten seconds: {:.1} % of the line",
        100.0 * share
    );
    assert!((0.44..0.5).contains(&share), "{share}");
}
