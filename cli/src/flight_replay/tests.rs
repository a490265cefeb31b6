//! Tests: flights that are logged, read, and replayed.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use aplomb::attitude::Vector3;
use aplomb::estimator::heading::{CompassKnowledge, HeadingEstimate};
use aplomb::health::BoardFlags;
use aplomb::mpu6050::{Burst, Part, RawSample, TemperatureCounts};
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::telemetry::log::encode;
use aplomb::telemetry::log::{Configuration, Decoder, FRAME_CAPACITY, Frame};
use aplomb::units::MagneticField;
use aplomb_recordings::flight_log::{Recorder, decode};
use aplomb_recordings::simulated::samples;
use proptest::prelude::*;

use super::*;
use crate::simulate::Kind;

fn settings() -> Settings {
    Settings::new(&Part::MPU_6050)
}

/// Seconds of a simulated quadrotor at 1 kHz, one flight a minute.
fn bursts(seconds: usize) -> Vec<Burst> {
    (0..seconds.div_ceil(60) as u64)
        .flat_map(|seed| samples(Kind::Flight.motion(seed), seed, 60))
        .take(seconds * 1_000)
        .enumerate()
        .map(|(index, sample)| Burst {
            bytes: RawSample {
                temperature: TemperatureCounts(-4000),
                ..sample.raw
            }
            .encode(),
            captured_at_us: 1_234_567 + 1_000 * index as u64,
            missed_before: 0,
        })
        .collect()
}

/// Returns the log of these bursts from an index on, and all snapshots of the flight.
fn fly(bursts: &[Burst], first: usize) -> (Vec<u8>, Vec<Snapshot>) {
    let mut pipeline = Pipeline::new(&settings());
    let mut snapshots: Vec<_> = bursts[..first]
        .iter()
        .map(|burst| pipeline.update(burst, BoardFlags::empty()))
        .collect();
    let mut recorder = Recorder::new(Vec::new(), pipeline, first as u32);
    snapshots.extend(bursts[first..].iter().map(|burst| {
        recorder
            .add(burst, BoardFlags::empty())
            .expect("memory takes everything")
    }));
    (recorder.into_inner(), snapshots)
}

fn replayed(log: &FlightLog, flight: &Flight) -> (Vec<Snapshot>, Agreement) {
    let mut replay =
        Replay::new(log, flight, FilterName::Kalman).expect("there is a configuration");
    let snapshots = std::iter::from_fn(|| replay.next()).collect();
    (snapshots, replay.agreement().clone())
}

#[test]
fn ten_minutes_fit_the_line_and_replay_to_the_bit() {
    let bursts = bursts(600);
    assert_eq!(bursts.len(), 600_000);
    let (bytes, flown) = fly(&bursts, 0);
    let per_second = bytes.len() / 600;
    assert!(10 * per_second < 921_600 / 2, "{per_second} bytes a second");
    let log = decode(&bytes).expect("few flights");
    let [flight] = &log.flights[..] else {
        panic!("{} flights", log.flights.len())
    };
    assert_eq!((flight.lost(), log.counts.damaged), (0, 0));
    let steps = log.steps(flight).expect("it is in memory");
    let read: Vec<_> = steps.map(|step| step.numbered.burst).collect();
    assert!(read == bursts, "every burst comes back");
    let (snapshots, agreement) = replayed(&log, flight);
    assert!(snapshots == flown, "every attitude comes back to the bit");
    assert_eq!(
        agreement,
        Agreement {
            bursts: 600_000,
            exact: 600_000,
            compared: 30_000,
            ..Agreement::default()
        }
    );
}

/// Returns the log of these bursts from an index on, with 50 readings a second, and the headings of
/// the flight by their times.
fn fly_with_compass(
    bursts: &[Burst],
    first: usize,
) -> (Vec<u8>, BTreeMap<u64, Option<HeadingEstimate>>) {
    let mut pipeline = Pipeline::new(&settings());
    for burst in &bursts[..first] {
        pipeline.update(burst, BoardFlags::empty());
    }
    let mut recorder = Recorder::new(Vec::new(), pipeline, first as u32);
    let headings = bursts[first..].iter().enumerate().map(|(index, burst)| {
        let snapshot = recorder
            .add(burst, BoardFlags::empty())
            .expect("memory takes everything");
        let heading = recorder.heading();
        if index % 20 == 7 {
            let earth = Vector3::new(20.0, 5.0, 44.0);
            let Vector3 { x, y, z } = snapshot.attitude.conjugate().rotate(earth);
            let field = MagneticField {
                ut: [x + 3.0, y, z],
            };
            let measured_us = snapshot.t_us as u32 - 10_300 - index as u32 % 7;
            recorder
                .add_reading(field, measured_us, CompassKnowledge::Factory)
                .expect("memory takes everything");
        }
        (snapshot.t_us, heading)
    });
    let headings = headings.collect();
    (recorder.into_inner(), headings)
}

/// Replays a flight, and returns its headings where they are exact.
fn replayed_headings(bytes: &[u8]) -> (Vec<(u64, Option<HeadingEstimate>)>, Agreement) {
    let log = decode(bytes).expect("few flights");
    let mut replay = Replay::new(&log, &log.flights[0], FilterName::Kalman).expect("settings");
    let mut headings = Vec::new();
    let mut exact = 0;
    while let Some(snapshot) = replay.next() {
        if replay.agreement().heading_exact > exact {
            headings.push((snapshot.t_us, replay.pipeline().heading()));
        }
        exact = replay.agreement().heading_exact;
    }
    (headings, replay.agreement().clone())
}

#[test]
fn headings_replay_to_the_bit_from_the_first_reading_on_and_from_a_state_in_flight() {
    let bursts = bursts(30);
    for (first, fewest) in [(0, 29_980), (12_000, 17_980)] {
        let (bytes, flown) = fly_with_compass(&bursts, first);
        let (headings, agreement) = replayed_headings(&bytes);
        assert!(headings.len() > fewest, "{} of {fewest}", headings.len());
        assert!(headings.iter().filter(|it| it.1.is_some()).count() > 10_000);
        for (t_us, heading) in headings {
            assert_eq!(Some(&heading), flown.get(&t_us), "{t_us}");
        }
        assert!(agreement.heading_compared > 40, "{agreement:?}");
        assert_eq!(agreement.heading_different, 0);
        assert_eq!(agreement.different, 0);
    }
    // A log whose beginning is lost continues with the next state, ten seconds after the first.
    let (bytes, flown) = fly_with_compass(&bursts, 0);
    let (headings, agreement) = replayed_headings(&bytes[bytes.len() / 30..]);
    assert!(
        (19_000..20_000).contains(&headings.len()),
        "{}",
        headings.len()
    );
    for (t_us, heading) in headings {
        assert_eq!(Some(&heading), flown.get(&t_us), "{t_us}");
    }
    assert_eq!(agreement.heading_different, 0);
}

/// Removes the frame of the reading with this number.
fn without_reading(bytes: &[u8], number: u32) -> Vec<u8> {
    let mut kept = Vec::new();
    let mut start = 0;
    while start < bytes.len() {
        let length = bytes[start + 1..].iter().position(|byte| *byte == 0);
        let frame = &bytes[start..start + 2 + length.expect("a whole frame")];
        let mut decoder = Decoder::new();
        let decoded = frame.iter().filter_map(|byte| decoder.push(*byte)).last();
        let is_it = matches!(decoded, Some(Frame::Reading(it)) if it.number == number);
        if !is_it {
            kept.extend_from_slice(frame);
        }
        start += frame.len();
    }
    kept
}

#[test]
fn a_missing_reading_is_counted_and_its_headings_are_not_called_exact() {
    let (bytes, flown) = fly_with_compass(&bursts(25), 0);
    let damaged = without_reading(&bytes, 300);
    let log = decode(&damaged).expect("few flights");
    assert_eq!(
        (log.flights[0].readings, log.flights[0].readings_lost),
        (1_249, 1)
    );
    assert_eq!(log.flights[0].lost(), 0);
    let (headings, agreement) = replayed_headings(&damaged);
    assert_eq!((agreement.exact, agreement.different), (25_000, 0));
    assert_eq!(agreement.heading_different, 0);
    // Reading 300 comes at 6 s, the next state at 10 s.
    let inexact = 25_000 - agreement.heading_exact;
    assert!((3_900..4_200).contains(&inexact), "{inexact}");
    for (t_us, heading) in headings {
        assert_eq!(Some(&heading), flown.get(&t_us), "{t_us}");
    }
    // The reading just after a state is missing: the state tells that it should be there.
    let log = decode(&bytes).expect("few flights");
    let steps = log.steps(&log.flights[0]).expect("it is in memory");
    let state = steps
        .filter_map(|step| step.heading_state)
        .nth(1)
        .expect("a second state");
    let (number, _) = state.split_first_chunk().expect("four bytes");
    let (_, agreement) = replayed_headings(&without_reading(&bytes, u32::from_le_bytes(*number)));
    assert_eq!(agreement.heading_different, 0);
    assert!(agreement.heading_exact < 20_100, "{agreement:?}");
}

#[test]
fn a_log_that_begins_in_flight_and_has_a_hole_is_exact_but_for_the_hole() {
    let bursts = bursts(45);
    let (mut bytes, flown) = fly(&bursts, 5_000);
    // A second of the line is lost, ten seconds after the log's start.
    let per_second = bytes.len() / 40;
    bytes.drain(12 * per_second..13 * per_second);
    let log = decode(&bytes).expect("few flights");
    let flight = &log.flights[0];
    assert!((950..1_050).contains(&flight.lost()), "{}", flight.lost());
    let (snapshots, agreement) = replayed(&log, flight);
    assert_eq!(agreement.different, 0);
    assert!(agreement.compared > 1_000);
    // From the hole to the next state nothing is promised.
    let inexact = agreement.bursts - agreement.exact;
    assert!((6_000..9_000).contains(&inexact), "{agreement:?}");
    let at = |t_us| flown.iter().find(|snapshot| snapshot.t_us == t_us).copied();
    for snapshot in [&snapshots[0], &snapshots[10_000], snapshots.last().unwrap()] {
        assert_eq!(Some(*snapshot), at(snapshot.t_us));
    }
}

#[test]
fn of_a_line_with_every_hundredth_byte_wrong_all_that_is_whole_is_recovered() {
    let bursts = bursts(60);
    let (bytes, _) = fly(&bursts, 0);
    let mut random = 1_u64;
    let mut random = || {
        // Marsaglia's xorshift.
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        random
    };
    // The frames of the clean stream, each with its two zeros, and which of them are hit.
    let mut damaged = bytes.clone();
    for byte in &mut damaged {
        if random() % 100 == 0 {
            *byte ^= 1 + (random() % 255) as u8;
        }
    }
    let mut whole = Vec::new();
    let mut total = 0;
    let mut start = 0;
    while start < bytes.len() {
        let end = start
            + 2
            + bytes[start + 1..]
                .iter()
                .position(|&byte| byte == 0)
                .unwrap();
        total += 1;
        if bytes[start..end] == damaged[start..end] {
            let mut decoder = Decoder::new();
            whole.extend(
                bytes[start..end]
                    .iter()
                    .filter_map(|&byte| decoder.push(byte)),
            );
        }
        start = end;
    }
    let mut decoder = Decoder::new();
    let found: Vec<_> = damaged
        .iter()
        .filter_map(|&byte| decoder.push(byte))
        .collect();
    assert!(found == whole, "{} of {}", found.len(), whole.len());
    assert!(
        (total / 2..total * 4 / 5).contains(&whole.len()),
        "{total} {}",
        whole.len()
    );
    let log = decode(&damaged).expect("few flights");
    let lost = log.flights[0].lost();
    assert!(lost > 10_000 && lost + log.flights[0].bursts > 59_990);
}

#[test]
fn a_restart_of_the_module_is_another_flight() {
    let bursts = bursts(3);
    let (mut bytes, flown) = fly(&bursts, 0);
    bytes.extend(b"# aplomb on a board\n");
    bytes.extend(fly(&bursts, 0).0);
    let log = decode(&bytes).expect("few flights");
    assert_eq!(log.flights.len(), 2);
    for flight in &log.flights {
        assert!(replayed(&log, flight).0 == flown);
    }
}

#[test]
fn a_time_that_goes_back_is_another_flight_whatever_the_numbers() {
    let bursts = bursts(3);
    let (mut bytes, flown) = fly(&bursts, 0);
    let mut recorder = Recorder::new(Vec::new(), Pipeline::new(&settings()), 5_512);
    for burst in &bursts {
        recorder
            .add(burst, BoardFlags::empty())
            .expect("memory takes everything");
    }
    bytes.extend(recorder.into_inner());
    let log = decode(&bytes).expect("few flights");
    assert_eq!(log.flights.len(), 2);
    for flight in &log.flights {
        assert_eq!(flight.lost(), 0);
        assert!(replayed(&log, flight).0 == flown);
    }
}

/// Returns a second's log, damaged, with whole frames of any numbers between.
fn nearly_a_log() -> impl Strategy<Value = Vec<u8>> {
    static LOG: LazyLock<Vec<u8>> = LazyLock::new(|| fly_with_compass(&bursts(2), 0).0);
    let change = (any::<prop::sample::Index>(), any::<u8>());
    let burst = (any::<u32>(), any::<u64>(), any::<[u8; 14]>()).prop_map(
        |(number, captured_at_us, bytes)| {
            let burst = Burst {
                bytes,
                captured_at_us,
                missed_before: 0,
            };
            let flags = BoardFlags::from_bits_retain(number);
            Frame::Burst(NumberedBurst {
                number,
                flags,
                burst,
            })
        },
    );
    let configuration = any::<u32>().prop_map(|from_number| {
        let mut settings = Settings::new(&Part::MPU_6050);
        settings.sensor_delay_us = Some(from_number);
        Frame::Configuration(Configuration {
            revision: REVISION,
            from_number,
            settings,
        })
    });
    let reading = any::<(u32, u32, [f32; 3], bool)>();
    let reading = reading.prop_map(|(number, late_us, ut, starts_filter)| {
        Frame::Reading(CompassReading {
            number,
            sample_t_us: 1_234_567 + u64::from(late_us % 4_000_000),
            measured_us: number,
            field: MagneticField { ut },
            knowledge: CompassKnowledge::Calibrated,
            declination_rad: 0.1,
            starts_filter,
        })
    });
    let frame = prop_oneof![3 => burst, 1 => configuration, 3 => reading];
    let insertion = (any::<prop::sample::Index>(), frame);
    (
        prop::collection::vec(change, 0..40),
        prop::collection::vec(insertion, 0..10),
        any::<prop::sample::Index>(),
    )
        .prop_map(|(changes, insertions, end)| {
            let mut bytes = LOG.clone();
            for (place, byte) in changes {
                let place = place.index(bytes.len());
                bytes[place] = byte;
            }
            for (place, frame) in insertions {
                let place = place.index(bytes.len());
                let frame = encode(&frame, &mut [0; FRAME_CAPACITY]).to_vec();
                bytes.splice(place..place, frame);
            }
            bytes.truncate(end.index(bytes.len()));
            bytes
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn any_log_is_read_and_replayed_to_its_end(bytes in nearly_a_log()) {
        let log = decode(&bytes).expect("few flights");
        let mut whole = 0;
        for flight in log.flown() {
            let steps = log.steps(flight).expect("it is in memory");
            let numbers: Vec<_> = steps.map(|step| step.numbered.number).collect();
            prop_assert!(numbers.is_sorted_by(|one, other| one < other));
            prop_assert_eq!(numbers.len() as u64, flight.bursts);
            prop_assert!(flight.lost() <= u64::from(u32::MAX));
            whole += flight.bursts;
            let Ok(mut replay) = Replay::new(&log, flight, FilterName::Kalman) else {
                prop_assert!(flight.configuration.is_none());
                continue;
            };
            while let Some(snapshot) = replay.next() {
                let q = snapshot.attitude;
                prop_assert!((q.dot(q) - 1.0).abs() < 1e-3, "{q:?}");
            }
            let agreement = replay.agreement();
            prop_assert_eq!(agreement.bursts, flight.bursts);
            prop_assert!(agreement.compared <= agreement.exact);
            prop_assert!(agreement.exact <= agreement.bursts);
            prop_assert!(agreement.heading_exact <= agreement.exact);
            if let Some(heading) = replay.pipeline().heading() {
                prop_assert!(heading.yaw_offset_rad.is_finite() && heading.sigma_rad.is_finite());
            }
        }
        prop_assert!(whole <= log.counts.frames);
    }
}

#[test]
fn another_filter_is_never_called_exact() {
    let bursts = bursts(3);
    let log = decode(&fly(&bursts, 0).0).expect("few flights");
    let mut replay =
        Replay::new(&log, &log.flights[0], FilterName::Classic).expect("there is a configuration");
    while replay.next().is_some() {}
    assert_eq!(
        (replay.agreement().bursts, replay.agreement().exact),
        (3_000, 0)
    );
}
