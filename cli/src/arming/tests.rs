//! Tests: the armed state of flight logs whose states come late, are missing, or are of others.

use std::ops::Range;

use aplomb::health::BoardFlags;
use aplomb::mpu6050::{Burst, RawSample, TemperatureCounts};
use aplomb::telemetry::Output;
use aplomb::telemetry::log::{Decoder, FRAME_CAPACITY, Frame, NumberedBurst, Sender, encode};
use aplomb_recordings::flight_log::decode;
use aplomb_recordings::simulated::samples;

use super::*;
use crate::simulate::Kind;

/// Bursts of the test's flight, 1 ms each.
const BURSTS: u32 = 4_000;
/// First burst of the log.
const FIRST: u32 = 500;
/// Bursts at which the module is armed.
const ARMED: [Range<u32>; 2] = [1_203..2_001, 2_900..3_100];

fn is_armed(number: u32) -> bool {
    ARMED.iter().any(|range| range.contains(&number))
}

/// Returns the log of a flight. As on the module, the state is copied `lag` bursts after the
/// command that arms or disarms.
fn logged(lag: u32) -> Vec<u8> {
    let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    let mut sender = Sender::new(FIRST);
    let mut bytes = Vec::new();
    let mut copy_at = FIRST;
    let samples = samples(Kind::Flight.motion(1), 1, 60);
    for (number, sample) in (0..BURSTS).zip(samples) {
        if is_armed(number) != is_armed(number.saturating_sub(1)) {
            pipeline.set_armed(is_armed(number));
            sender.restart(number);
            copy_at = number + lag;
        }
        let now_us = 1_000 * u64::from(number);
        if number >= copy_at && sender.wants_state(now_us) {
            sender.copy_state(&pipeline, number);
            sender.measure_state(now_us);
        }
        let raw = RawSample {
            temperature: TemperatureCounts(-4_000),
            ..sample.raw
        };
        let burst = Burst {
            bytes: raw.encode(),
            captured_at_us: now_us,
            missed_before: 0,
        };
        pipeline.update(&burst, BoardFlags::empty());
        if number >= FIRST {
            let flags = BoardFlags::empty();
            let mut numbered = Some(NumberedBurst {
                number,
                flags,
                burst,
            });
            let mut buffer = [0; 8 * FRAME_CAPACITY];
            let mut output = Output::new(&mut buffer);
            sender.fill(now_us, &mut output, || numbered.take(), || None);
            let length = output.length();
            bytes.extend_from_slice(&buffer[..length]);
        }
    }
    bytes
}

/// Returns the bursts of a log whose armed state is not that of the flight; `None` if the log does
/// not show it.
fn wrong(bytes: &[u8]) -> Option<Vec<u32>> {
    let log = decode(bytes).expect("one flight");
    let flight = log.flight(None).expect("one flight");
    let first = flight.configuration.as_ref().expect("a configuration");
    let steps = || log.steps(flight).expect("it is in memory");
    let mut arming = LoggedArming::read(steps(), first)?;
    assert!(arming.arms());
    let numbers = steps().map(|step| step.numbered.number);
    Some(
        numbers
            .filter(|number| arming.at(*number) != is_armed(*number))
            .collect(),
    )
}

/// Returns the log with these frames alone, changed.
fn edited(bytes: &[u8], mut edit: impl FnMut(&mut Frame) -> bool) -> Vec<u8> {
    let mut decoder = Decoder::new();
    let mut edited = Vec::new();
    let mut buffer = [0; FRAME_CAPACITY];
    for byte in bytes.iter().copied().chain([0]) {
        if let Some(mut frame) = decoder.push(byte)
            && edit(&mut frame)
        {
            edited.extend_from_slice(encode(&frame, &mut buffer));
        }
    }
    edited
}

#[test]
fn the_state_holds_from_the_command_on_however_late_it_is_copied() {
    for lag in [0, 1, 60] {
        assert_eq!(wrong(&logged(lag)), Some(vec![]), "{lag}");
    }
}

#[test]
fn a_state_after_lost_ones_holds_from_its_settings_on() {
    let bytes = logged(30);
    // No state between the first arming and the disarming is whole: the log cannot show them.
    let lost = edited(&bytes, |frame| match frame {
        Frame::StatePiece(piece) => !ARMED[0].contains(&piece.number),
        _ => true,
    });
    assert_eq!(wrong(&lost), Some(ARMED[0].clone().collect()));
    // The bursts of the first command are lost, and the settings still begin there.
    let hole = edited(&bytes, |frame| match frame {
        Frame::Burst(burst) => !(1_190..1_220).contains(&burst.number),
        _ => true,
    });
    assert_eq!(wrong(&hole), Some(vec![]));
}

#[test]
fn states_that_cannot_be_read_show_nothing() {
    let bytes = logged(0);
    let without = edited(&bytes, |frame| !matches!(frame, Frame::StatePiece(_)));
    assert_eq!(wrong(&without), None);
    let other = edited(&bytes, |frame| {
        if let Frame::Configuration(configuration) = frame {
            configuration.revision += 1;
        }
        true
    });
    assert_eq!(wrong(&other), None);
    assert_eq!(armed_in(&[]), None);
    assert_eq!(armed_in(&[1; 40]), None);
}
