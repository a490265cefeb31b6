//! The session from the other end of the line: a ground station made of the crate's own dialect.

use ::mavlink::dialects::common::{
    self, HEARTBEAT_DATA, MISSION_REQUEST_LIST_DATA, MavAutopilot, MavCmd, MavMessage, MavModeFlag,
    MavResult, MavState, MavSysStatusSensor, PARAM_REQUEST_LIST_DATA, PARAM_REQUEST_READ_DATA,
    PARAM_SET_DATA,
};
use ::mavlink::{MAVLinkV1MessageRaw, MavlinkVersion, Message};
use proptest::prelude::*;

use super::super::action::Calibrate;
use super::super::messages::milliseconds;
use super::super::wire::CommandAck;
use super::*;
use crate::attitude::{EulerAngles, Quaternion, Vector3};
use crate::compass::{self, CompassStatus};
use crate::estimator::Sample;
use crate::estimator::heading::HeadingEstimate;
use crate::health::Flags;
use crate::pipeline::Snapshot;
use crate::settings::Record;
use crate::units::{MagneticField, radians};

const STATION: MavHeader = MavHeader {
    system_id: 255,
    component_id: 190,
    sequence: 9,
};

#[test]
fn milliseconds_are_those_of_a_division() {
    let mut t_us = 1_u64;
    while t_us < u64::MAX / 3000 {
        for t_us in [t_us - 1, t_us, 1000 * t_us - 1, 1000 * t_us] {
            assert_eq!(milliseconds(t_us), (t_us / 1000) as u32, "{t_us}");
        }
        t_us = t_us * 3 / 2 + 1;
    }
}

/// A module with a session.
struct Bench {
    session: Session,
    record: Record,
    snapshot: Snapshot,
    /// False before the first attitude.
    has_attitude: bool,
    sample: Sample,
    field: Option<MagneticField>,
    is_armed: bool,
    baud: u32,
    text: Vec<u8>,
    now_us: u64,
}

impl Bench {
    fn new() -> Self {
        let mut bench = Self {
            session: Session::new(),
            record: Record::default(),
            snapshot: Snapshot {
                t_us: 5_000_000,
                attitude: Quaternion::from_euler(EulerAngles {
                    roll_rad: radians(10.0),
                    pitch_rad: radians(-20.0),
                    yaw_rad: radians(30.0),
                }),
                body_rates_rad_s: Vector3::new(0.1, -0.2, 0.3),
                flags: Flags::VALID,
                tilt_variance_rad2: 0.0,
            },
            sample: Sample {
                specific_force_m_s2: Vector3::new(0.0, 0.5, -9.8),
                ..Sample::default()
            },
            has_attitude: true,
            field: None,
            is_armed: false,
            baud: 115_200,
            text: Vec::new(),
            now_us: 5_000_000,
        };
        // Discards the first heartbeat and status.
        bench.receive_all(2048);
        bench
    }

    fn send_bytes(&mut self, bytes: &[u8]) {
        for byte in bytes {
            let text = &mut self.text;
            self.session
                .receive(*byte, self.now_us, &mut |byte| text.push(byte));
        }
    }

    /// Finds no received byte.
    fn poll(&mut self) {
        let text = &mut self.text;
        self.session.poll(self.now_us, &mut |byte| text.push(byte));
    }

    fn send(&mut self, message: &MavMessage) {
        self.send_bytes(frame(message).raw_bytes());
    }

    /// Output of the session without attitudes, in a buffer of this size.
    fn receive_all(&mut self, size: usize) -> Vec<(u8, MavMessage)> {
        self.receive_with(size, false)
    }

    /// Output of the session, in a buffer of this size.
    fn receive_with(&mut self, size: usize, is_due: bool) -> Vec<(u8, MavMessage)> {
        let mut buffer = vec![0; size];
        let mut output = Output::new(&mut buffer);
        let vehicle = Vehicle {
            snapshot: self.has_attitude.then_some(&self.snapshot),
            is_due,
            sample: &self.sample,
            temperature_celsius: 25.5,
            heading: None,
            compass: CompassStatus {
                field: self.field,
                ..CompassStatus::default()
            },
            record: &self.record,
            baud: self.baud,
            is_armed: self.is_armed,
            bursts_failed: 3,
        };
        self.session.fill(self.now_us, &vehicle, &mut output);
        let length = output.length();
        messages(&buffer[..length])
    }

    fn answers(&mut self, message: &MavMessage) -> Vec<MavMessage> {
        self.send(message);
        self.receive_all(2048)
            .into_iter()
            .map(|(_, message)| message)
            .collect()
    }
}

fn frame(message: &MavMessage) -> MAVLinkV2MessageRaw {
    let mut raw = MAVLinkV2MessageRaw::new();
    raw.serialize_message(STATION, message);
    raw
}

/// A frame with this payload, which the crate need not know. `extra` is the seed of its checksum.
fn frame_of(message: u8, extra: u8, payload: &[u8]) -> Vec<u8> {
    let length = payload.len() as u8;
    let mut bytes = vec![0xFD, length, 0, 0, 9, 255, 190, message, 0, 0];
    bytes.extend(payload);
    let checksum = ::mavlink::calculate_crc(&bytes[1..], extra);
    bytes.extend(checksum.to_le_bytes());
    bytes
}

/// Frames of a stream without other bytes, with their sequence numbers. The crate's own table
/// checks the checksums.
fn messages(mut bytes: &[u8]) -> Vec<(u8, MavMessage)> {
    let mut found = Vec::new();
    while !bytes.is_empty() {
        let mut whole = [0; 283];
        let length = 12 + usize::from(bytes[1]);
        whole[..length].copy_from_slice(&bytes[..length]);
        bytes = &bytes[length..];
        let raw = MAVLinkV2MessageRaw::from_bytes_unparsed(whole);
        assert!(raw.has_valid_crc::<MavMessage>());
        assert_eq!((raw.system_id(), raw.component_id()), (1, 1));
        let message = MavMessage::parse(MavlinkVersion::V2, raw.message_id(), raw.payload());
        found.push((raw.sequence(), message.expect("a message of the dialect")));
    }
    found
}

fn command(command: MavCmd, parameters: [f32; 7]) -> MavMessage {
    let [param1, param2, param3, param4, param5, param6, param7] = parameters;
    MavMessage::COMMAND_LONG(common::COMMAND_LONG_DATA {
        param1,
        param2,
        param3,
        param4,
        param5,
        param6,
        param7,
        command,
        target_system: 1,
        target_component: 1,
        confirmation: 0,
    })
}

fn acknowledgement(command: MavCmd, result: MavResult) -> MavMessage {
    MavMessage::COMMAND_ACK(common::COMMAND_ACK_DATA { command, result })
}

fn set(name: &str, value: f32) -> MavMessage {
    MavMessage::PARAM_SET(PARAM_SET_DATA {
        param_value: value,
        target_system: 1,
        target_component: 1,
        param_id: name.into(),
        param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
    })
}

#[test]
fn heartbeats_come_once_a_second_beside_attitudes() {
    let mut bench = Bench::new();
    let mut heartbeats = 0;
    let mut statuses = 0;
    let mut last = None;
    for step in 0..100_u64 {
        let mut buffer = [0; 512];
        let mut output = Output::new(&mut buffer);
        bench.snapshot.t_us = 6_000_000 + step * 20_000;
        let vehicle = Vehicle {
            snapshot: Some(&bench.snapshot),
            is_due: true,
            sample: &bench.sample,
            temperature_celsius: 25.5,
            heading: None,
            compass: CompassStatus::default(),
            record: &bench.record,
            baud: bench.baud,
            is_armed: true,
            bursts_failed: 3,
        };
        bench
            .session
            .fill(bench.snapshot.t_us, &vehicle, &mut output);
        let length = output.length();
        let mut kinds = [false; 3];
        for (sequence, message) in messages(&buffer[..length]) {
            if let Some(last) = last.replace(sequence) {
                assert_eq!(sequence, u8::wrapping_add(last, 1));
            }
            match message {
                MavMessage::HEARTBEAT(beat) => {
                    heartbeats += 1;
                    assert_eq!(beat.autopilot, MavAutopilot::MAV_AUTOPILOT_GENERIC);
                    assert_eq!(beat.base_mode, MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED);
                    assert_eq!(beat.system_status, MavState::MAV_STATE_ACTIVE);
                }
                MavMessage::SYS_STATUS(status) => {
                    statuses += 1;
                    assert_eq!(status.onboard_control_sensors_health.bits(), 0x0020_0003);
                    assert_eq!(status.errors_count1, 3);
                }
                MavMessage::ATTITUDE(attitude) => {
                    kinds[0] = true;
                    assert_eq!(u64::from(attitude.time_boot_ms), bench.snapshot.t_us / 1000);
                    assert!((attitude.roll.to_degrees() - 10.0).abs() < 1e-4);
                    assert!((attitude.pitch.to_degrees() + 20.0).abs() < 1e-4);
                    assert!((attitude.yaw.to_degrees() - 30.0).abs() < 1e-4);
                    assert_eq!(attitude.pitchspeed, -0.2);
                }
                MavMessage::ATTITUDE_QUATERNION(attitude) => {
                    kinds[1] = true;
                    assert_eq!(attitude.q1, bench.snapshot.attitude.w);
                    assert_eq!(attitude.q4, bench.snapshot.attitude.z);
                }
                MavMessage::HIGHRES_IMU(imu) => {
                    kinds[2] = true;
                    assert_eq!((imu.time_usec, imu.zacc), (bench.snapshot.t_us, -9.8));
                    assert_eq!((imu.temperature, imu.ygyro), (25.5, -0.2));
                    assert_eq!(imu.fields_updated.bits(), 0x103F);
                }
                other => panic!("{other:?}"),
            }
        }
        assert_eq!(kinds, [true; 3]);
    }
    assert_eq!((heartbeats, statuses), (2, 2));
}

/// State in the heartbeat that is due.
fn state(bench: &mut Bench) -> MavState {
    let received = bench.receive_all(512);
    let Some((_, MavMessage::HEARTBEAT(beat))) = received.first() else {
        panic!("{received:?}");
    };
    beat.system_status
}

/// Half a second without a measurement is critical, whether the module is armed or not.
#[test]
fn a_sensor_that_falls_silent_makes_the_heartbeat_critical() {
    for (is_armed, healthy) in [
        (false, MavState::MAV_STATE_STANDBY),
        (true, MavState::MAV_STATE_ACTIVE),
    ] {
        let mut bench = Bench::new();
        bench.is_armed = is_armed;
        for (flags, expected) in [
            (Flags::VALID, healthy),
            (Flags::DEGRADED | Flags::STALE, MavState::MAV_STATE_CRITICAL),
            (Flags::FROZEN, MavState::MAV_STATE_CRITICAL),
            (Flags::VALID, healthy),
        ] {
            bench.now_us += 1_000_000;
            bench.snapshot.flags = flags;
            assert_eq!(state(&mut bench), expected, "{flags}");
        }
        // One sample that is no measurement is nothing to worry about.
        bench.now_us += 900_000;
        bench.receive_all(512);
        bench.now_us += 100_000;
        bench.snapshot.flags = Flags::REJECTED;
        assert_eq!(state(&mut bench), healthy);
    }
}

/// At a low rate most calls have no attitude that is due.
#[test]
fn a_heartbeat_between_two_attitudes_has_the_state_of_the_last() {
    let mut bench = Bench::new();
    for _ in 0..5 {
        bench.now_us += 1_000_000;
        let received = bench.receive_all(512);
        let [
            (_, MavMessage::HEARTBEAT(beat)),
            (_, MavMessage::SYS_STATUS(status)),
        ] = &received[..]
        else {
            panic!("{received:?}");
        };
        assert_eq!(beat.system_status, MavState::MAV_STATE_STANDBY);
        let health = status.onboard_control_sensors_health.bits();
        assert_eq!(health, 0x0020_0003);
    }
}

#[test]
fn a_module_without_an_attitude_boots_and_is_then_critical() {
    let mut bench = Bench::new();
    bench.session = Session::new();
    bench.has_attitude = false;
    for (now_us, expected) in [
        (10_000, MavState::MAV_STATE_BOOT),
        (1_010_000, MavState::MAV_STATE_CRITICAL),
    ] {
        bench.now_us = now_us;
        assert_eq!(state(&mut bench), expected);
    }
}

/// Health bits in the messages of a call.
fn healths(bench: &mut Bench) -> Vec<u32> {
    let received = bench.receive_all(512);
    let status = |message: &(u8, MavMessage)| match &message.1 {
        MavMessage::SYS_STATUS(status) => Some(status.onboard_control_sensors_health.bits()),
        _ => None,
    };
    received.iter().filter_map(status).collect()
}

#[test]
fn one_invalid_attitude_shows_in_a_status_at_once() {
    let mut bench = Bench::new();
    bench.now_us += 300_000;
    assert!(healths(&mut bench).is_empty());
    bench.snapshot.flags = Flags::FROZEN | Flags::DEGRADED;
    assert_eq!(healths(&mut bench), [0]);
    // The status that follows is that of now.
    bench.snapshot.flags = Flags::VALID;
    bench.now_us += 99_000;
    assert!(healths(&mut bench).is_empty());
    bench.now_us += 1_000;
    assert_eq!(healths(&mut bench), [0x0020_0003]);
    // A fault that ends soon after its message is over in the next one.
    bench.snapshot.flags = Flags::FROZEN;
    bench.now_us += 100_000;
    assert_eq!(healths(&mut bench), [0]);
    bench.now_us += 50_000;
    assert!(healths(&mut bench).is_empty());
    bench.snapshot.flags = Flags::VALID;
    bench.now_us += 50_000;
    assert_eq!(healths(&mut bench), [0x0020_0003]);
    bench.now_us += 100_000;
    // Flags that come and go do not fill the line.
    let (mut statuses, mut unhealthy) = (0, 0);
    for step in 0..1_000 {
        bench.now_us += 1_000;
        bench.snapshot.flags = if step % 2 == 0 {
            Flags::empty()
        } else {
            Flags::VALID
        };
        let found = healths(&mut bench);
        statuses += found.len();
        unhealthy += found.iter().filter(|health| **health == 3).count();
    }
    assert!((1..=10).contains(&statuses), "{statuses}");
    assert!(2 * unhealthy >= statuses, "{unhealthy} of {statuses}");
}

#[test]
fn a_status_without_room_is_sent_later() {
    let mut bench = Bench::new();
    bench.now_us += 300_000;
    bench.snapshot.flags = Flags::FROZEN;
    assert_eq!(bench.receive_all(20), []);
    bench.snapshot.flags = Flags::VALID;
    bench.now_us += 100_000;
    assert_eq!(healths(&mut bench), [0]);
}

/// Fields that the next HIGHRES_IMU marks as updated.
fn updated(bench: &mut Bench) -> u16 {
    let received = bench.receive_with(512, true);
    let updated = |message: &(u8, MavMessage)| match &message.1 {
        MavMessage::HIGHRES_IMU(imu) => Some(imu.fields_updated.bits()),
        _ => None,
    };
    let found = received.iter().find_map(updated);
    found.expect("a HIGHRES_IMU")
}

#[test]
fn only_a_new_measurement_counts_as_updated() {
    const SAMPLE: u16 = 0x103F;
    const FIELD: u16 = 0x01C0;
    let mut bench = Bench::new();
    assert_eq!(updated(&mut bench), SAMPLE);
    bench.field = Some(MagneticField {
        ut: [20.0, 0.0, 44.0],
    });
    assert_eq!(updated(&mut bench), SAMPLE | FIELD);
    assert_eq!(updated(&mut bench), SAMPLE);
    bench.snapshot.flags = Flags::STALE | Flags::DEGRADED;
    assert_eq!(updated(&mut bench), 0);
    bench.field = Some(MagneticField {
        ut: [20.0, 0.1, 44.0],
    });
    assert_eq!(updated(&mut bench), FIELD);
    bench.field = None;
    bench.snapshot.flags = Flags::VALID;
    assert_eq!(updated(&mut bench), SAMPLE);
}

/// The record has the new rate only once a frame has arrived at it.
#[test]
fn a_baud_rate_is_answered_with_the_requested_one() {
    let mut bench = Bench::new();
    assert_eq!(bench.answers(&set("OUT_BAUD", 921_600.0)), []);
    let (ticket, action) = bench.session.take_action().expect("a change");
    assert_eq!(action, Action::SetBaud(921_600));
    bench.baud = 921_600;
    bench.session.answer(ticket, Outcome::Accepted);
    let answers = bench.receive_all(512);
    let [(_, MavMessage::PARAM_VALUE(value))] = &answers[..] else {
        panic!("{answers:?}");
    };
    assert_eq!(value.param_value, 921_600.0);
}

/// Several pieces end with a zero, so the last one is not full.
#[test]
fn a_text_of_whole_pieces_has_an_end() {
    for (letters, pieces) in [(0, 1), (50, 1), (51, 2), (100, 3), (149, 3), (150, 4)] {
        let mut bench = Bench::new();
        let mut buffer = [0; 512];
        let mut output = Output::new(&mut buffer);
        let text = "x".repeat(letters);
        let session = &mut bench.session;
        assert!(session.send_text(Severity::Information, &text, &mut output));
        let length = output.length();
        assert_eq!(messages(&buffer[..length]).len(), pieces, "{letters}");
    }
}

/// One change runs at a time. Each answer has the value after its own.
#[test]
fn a_parameter_is_answered_after_its_change() {
    let mut bench = Bench::new();
    assert_eq!(bench.answers(&set("OUT_RATE_HZ", 20.0)), []);
    let (ticket, action) = bench.session.take_action().expect("a change");
    assert_eq!(action, Action::SetRate(20));
    bench.record.preferences.rate_hz = 20;
    bench.session.answer(ticket, Outcome::Accepted);
    let answers = bench.receive_all(512);
    let [(_, MavMessage::PARAM_VALUE(value))] = &answers[..] else {
        panic!("{answers:?}");
    };
    assert_eq!(value.param_value, 20.0);
}

#[test]
fn faults_clear_the_health_bits() {
    let present = MavSysStatusSensor::from_bits_retain(0x0020_0003);
    let health_with = |flags, present| health(Some(flags), present).bits();
    let health_of = |flags| health_with(flags, present);
    assert_eq!(health_of(Flags::VALID), 0x0020_0003);
    assert_eq!(health_of(Flags::DEGRADED), 3, "σ above 30°");
    assert_eq!(health_of(Flags::DEGRADED | Flags::TEMPERATURE), 3);
    assert_eq!(health_of(Flags::VALID | Flags::GAP), 3);
    for no_measurement in [Flags::FROZEN, Flags::STALE, Flags::REJECTED] {
        assert_eq!(health_of(no_measurement | Flags::DEGRADED), 0);
    }
    let saturated = Flags::VALID | Flags::ACCELEROMETER_SATURATED;
    assert_eq!(health_of(saturated), 0x0020_0001);
    assert_eq!(health_of(Flags::CALIBRATING), 3);
    let started_in_motion = Flags::CALIBRATING | Flags::DEGRADED | Flags::VALID;
    assert_eq!(health_of(started_in_motion), health_of(Flags::VALID));
    assert_eq!(health(None, present).bits(), 0);
    let with_compass = present | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_MAG;
    assert_eq!(health_with(Flags::VALID, with_compass), 0x0020_0007);
    let without = Flags::VALID | Flags::COMPASS_FAULT;
    assert_eq!(health_with(without, with_compass), 0x0020_0003);
}

/// The messages of one second with this heading and compass, at 10 Hz.
fn with_compass(flags: Flags, compass: CompassStatus) -> Vec<MavMessage> {
    let mut bench = Bench::new();
    bench.snapshot.flags = flags;
    let mut received = Vec::new();
    for step in 0..10_u64 {
        let mut buffer = [0; 512];
        let mut output = Output::new(&mut buffer);
        let vehicle = Vehicle {
            snapshot: Some(&bench.snapshot),
            is_due: true,
            sample: &bench.sample,
            temperature_celsius: 25.5,
            heading: Some(HeadingEstimate {
                yaw_offset_rad: radians(-60.0),
                sigma_rad: radians(3.0),
                is_valid: true,
            }),
            compass,
            record: &bench.record,
            baud: bench.baud,
            is_armed: false,
            bursts_failed: 0,
        };
        let now_us = 6_000_000 + 100_000 * step;
        bench.session.fill(now_us, &vehicle, &mut output);
        let length = output.length();
        received.extend(messages(&buffer[..length]).into_iter().map(|(_, it)| it));
    }
    received
}

#[test]
fn a_valid_heading_is_the_yaw_and_others_are_not() {
    let compass = CompassStatus {
        part: Some(("QMC5883L", 0x0D)),
        fault: None,
        field: Some(MagneticField {
            ut: [20.0, -5.0, 45.0],
        }),
        hard_iron_ut: None,
    };
    for (flags, yaw_deg) in [
        (Flags::VALID | Flags::HEADING_VALID, -30.0),
        (Flags::VALID, 30.0),
    ] {
        let mut huds = 0;
        let mut updated = Vec::new();
        for message in with_compass(flags, compass) {
            match message {
                MavMessage::ATTITUDE(attitude) => {
                    assert!(
                        (attitude.yaw.to_degrees() - yaw_deg).abs() < 1e-3,
                        "{attitude:?}"
                    );
                    assert!((attitude.roll.to_degrees() - 10.0).abs() < 1e-3);
                    assert!((attitude.pitch.to_degrees() + 20.0).abs() < 1e-3);
                }
                MavMessage::ATTITUDE_QUATERNION(it) => {
                    let yaw_rad = Quaternion::new(it.q1, it.q2, it.q3, it.q4)
                        .to_euler()
                        .yaw_rad;
                    assert!((yaw_rad.to_degrees() - yaw_deg).abs() < 1e-3, "{it:?}");
                }
                MavMessage::HIGHRES_IMU(imu) => {
                    let field = Vector3::new(imu.xmag, imu.ymag, imu.zmag);
                    assert!((field - Vector3::new(0.2, -0.05, 0.45)).is_within(1e-6));
                    updated.push(imu.fields_updated.bits());
                }
                MavMessage::VFR_HUD(hud) => {
                    huds += 1;
                    assert_eq!((hud.heading, hud.airspeed), (330, 0.0));
                }
                MavMessage::SYS_STATUS(status) => {
                    assert_eq!(status.onboard_control_sensors_present.bits(), 0x0020_0007);
                    assert_eq!(status.onboard_control_sensors_health.bits(), 0x0020_0007);
                }
                _ => {}
            }
        }
        // The compass has given one reading.
        assert_eq!(updated[0], 0x11FF);
        assert!(updated[1..].iter().all(|bits| *bits == 0x103F));
        let is_valid = flags.contains(Flags::HEADING_VALID);
        assert_eq!(huds, if is_valid { 2 } else { 0 });
    }
}

#[test]
fn the_heading_of_the_hud_is_the_nearest_degree() {
    let mut bench = Bench::new();
    for (heading_deg, expected) in [
        (0.0, 0),
        (0.6, 1),
        (270.4, 270),
        (270.6, 271),
        (359.4, 359),
        (359.6, 0),
    ] {
        bench.snapshot.attitude = Quaternion::new(1.0, 0.0, 0.0, 0.0);
        let heading = HeadingEstimate {
            yaw_offset_rad: radians(heading_deg),
            sigma_rad: radians(3.0),
            is_valid: true,
        };
        assert_eq!(hud(&bench.snapshot, &heading).heading, expected);
    }
}

#[test]
fn a_compass_with_a_fault_is_present_and_not_healthy() {
    let compass = CompassStatus {
        fault: Some(compass::Fault::Absent(compass::PartId::Ak8963)),
        ..CompassStatus::default()
    };
    let received = with_compass(Flags::VALID | Flags::COMPASS_FAULT, compass);
    let statuses = received.iter().filter_map(|message| match message {
        MavMessage::SYS_STATUS(status) => Some(status),
        _ => None,
    });
    for status in statuses {
        assert_eq!(status.onboard_control_sensors_present.bits(), 0x0020_0007);
        assert_eq!(status.onboard_control_sensors_health.bits(), 0x0020_0003);
    }
    assert!(
        !received
            .iter()
            .any(|it| matches!(it, MavMessage::VFR_HUD(_)))
    );
}

#[test]
fn parameters_are_listed_read_and_set() {
    let mut bench = Bench::new();
    bench.send(&MavMessage::PARAM_REQUEST_LIST(PARAM_REQUEST_LIST_DATA {
        target_system: 1,
        target_component: 0,
    }));
    let mut listed = Vec::new();
    for _ in 0..40 {
        for (_, message) in bench.receive_all(60) {
            let MavMessage::PARAM_VALUE(value) = message else {
                panic!("{message:?}")
            };
            assert_eq!(usize::from(value.param_count), PARAMETERS.len());
            assert_eq!(usize::from(value.param_index), listed.len());
            listed.push((
                value.param_id.to_str().unwrap().to_owned(),
                value.param_value,
            ));
        }
    }
    assert_eq!(listed.len(), PARAMETERS.len());
    assert_eq!(listed[0], ("OUT_RATE_HZ".to_owned(), 50.0));
    assert_eq!(listed[1], ("OUT_BAUD".to_owned(), 115_200.0));
    assert_eq!(listed[3], ("MOUNT".to_owned(), -1.0));

    bench.send(&set("OUT_RATE_HZ", 20.0));
    let (ticket, action) = bench.session.take_action().expect("it is to be set");
    assert_eq!(action, Action::SetRate(20));
    bench.record.preferences.rate_hz = 20;
    bench.session.answer(ticket, Outcome::Accepted);
    let answers = bench.receive_all(2048);
    assert!(
        matches!(&answers[..], [(_, MavMessage::PARAM_VALUE(value))] if value.param_value == 20.0)
    );

    // A parameter that cannot be set is sent unchanged.
    for (name, value) in [
        ("OUT_RATE_HZ", 0.5),
        ("MOUNT", 24.0),
        ("ACC_SCALE_X", 2.0),
        ("OUT_BAUD", f32::NAN),
    ] {
        let answers = bench.answers(&set(name, value));
        assert_eq!(bench.session.take_action(), None, "{name}");
        assert!(
            matches!(&answers[..], [MavMessage::PARAM_VALUE(_)]),
            "{name}"
        );
    }
    let by_name = bench.answers(&MavMessage::PARAM_REQUEST_READ(PARAM_REQUEST_READ_DATA {
        param_index: -1,
        target_system: 1,
        target_component: 1,
        param_id: "MOUNT".into(),
    }));
    assert!(matches!(&by_name[..], [MavMessage::PARAM_VALUE(value)] if value.param_index == 3));
}

/// A station repeats a request without an answer. The old value would look like a refusal.
#[test]
fn parameters_beyond_the_queue_are_not_answered() {
    let mut bench = Bench::new();
    for rate_hz in 1..=10_u8 {
        bench.send(&set("OUT_RATE_HZ", rate_hz.into()));
    }
    assert_eq!(bench.receive_all(2048), []);
    assert_eq!(bench.session.dropped(), 6);
    for rate_hz in 1..=4 {
        let (_, action) = bench.session.take_action().expect("a change");
        assert_eq!(action, Action::SetRate(rate_hz));
    }
    assert_eq!(bench.session.take_action(), None);
}

#[test]
fn a_parameter_that_does_not_exist_is_denied() {
    let mut bench = Bench::new();
    let request = MavCmd::MAV_CMD_REQUEST_MESSAGE;
    for index in [15.0, 99.0, 65_536.0, -1.0, 0.5, f32::NAN] {
        let answers = bench.answers(&command(request, [22.0, index, 0.0, 0.0, 0.0, 0.0, 0.0]));
        let denied = acknowledgement(request, MavResult::MAV_RESULT_DENIED);
        assert_eq!(answers, [denied], "{index}");
    }
    let answers = bench.answers(&command(request, [22.0, 14.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
    let [MavMessage::PARAM_VALUE(value), answer] = &answers[..] else {
        panic!("{answers:?}");
    };
    assert_eq!(value.param_index, 14);
    assert_eq!(
        *answer,
        acknowledgement(request, MavResult::MAV_RESULT_ACCEPTED)
    );
}

/// Progress in percent, or 255 if it is unknown (common.xml).
#[test]
fn progress_is_unknown_while_an_action_goes_on() {
    let mut bench = Bench::new();
    bench.send(&command(
        MavCmd::MAV_CMD_PREFLIGHT_STORAGE,
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ));
    let (ticket, _) = bench.session.take_action().expect("an action");
    for (outcome, progress) in [(Outcome::InProgress, 255), (Outcome::Accepted, 0)] {
        bench.session.answer(ticket, outcome);
        let Some(Reply::Acknowledge(answer)) = bench.session.inbox.replies.pop_front() else {
            panic!("no answer");
        };
        let mut payload = [0; 10];
        assert_eq!(answer.ser(MavlinkVersion::V2, &mut payload), 10);
        assert_eq!(payload[3], progress);
    }
}

/// Some ground stations leave the type out.
#[test]
fn a_parameter_of_any_type_is_set() {
    for kind in [0, 1, 9, 10, 255] {
        let mut bench = Bench::new();
        let raw = frame(&set("OUT_RATE_HZ", 20.0));
        let mut payload = raw.payload().to_vec();
        payload[22] = kind;
        bench.send_bytes(&frame_of(23, 168, &payload));
        let (_, action) = bench.session.take_action().expect("a change");
        assert_eq!(action, Action::SetRate(20), "type {kind}");
    }
}

#[test]
fn every_command_is_answered_known_or_not() {
    let mut bench = Bench::new();
    for known in 0..=u16::MAX {
        // The crate cannot build an unknown command, so the test writes its bytes.
        if known % 97 != 0 && ![241, 245, 400, 512, 520].contains(&known) {
            continue;
        }
        let mut raw = frame(&command(MavCmd::MAV_CMD_DO_SET_MODE, [9.0; 7]));
        let mut bytes = raw.raw_bytes().to_vec();
        let payload = 10 + 28;
        bytes[payload..payload + 2].copy_from_slice(&known.to_le_bytes());
        let end = bytes.len() - 2;
        let checksum = ::mavlink::calculate_crc(&bytes[1..end], 152);
        bytes[end..].copy_from_slice(&checksum.to_le_bytes());
        raw.as_mut_slice()[..bytes.len()].copy_from_slice(&bytes);
        bench.send_bytes(&bytes);
        let mut buffer = [0; 512];
        let mut output = Output::new(&mut buffer);
        let vehicle = Vehicle {
            snapshot: None,
            is_due: false,
            sample: &bench.sample,
            temperature_celsius: 0.0,
            heading: None,
            compass: CompassStatus::default(),
            record: &bench.record,
            baud: bench.baud,
            is_armed: false,
            bursts_failed: 0,
        };
        bench.session.fill(bench.now_us, &vehicle, &mut output);
        let length = output.length();
        assert_eq!(length, 12 + 10, "{known}");
        let answer = CommandAck::deser(MavlinkVersion::V2, &buffer[10..20]).unwrap();
        assert_eq!(answer.command, known);
        assert!(
            answer.result == 3 || (known == 400 && answer.result == 2),
            "{known}"
        );
    }
}

#[test]
fn calibration_is_requested_either_way_and_answered_by_the_owner() {
    let mut bench = Bench::new();
    let calibration = MavCmd::MAV_CMD_PREFLIGHT_CALIBRATION;
    let mut parameters = [0.0; 7];
    for (index, value, expected) in [
        (0, 1.0, Calibrate::Gyroscope),
        (1, 1.0, Calibrate::Compass),
        (4, 1.0, Calibrate::Accelerometer),
        (4, 2.0, Calibrate::Level),
        (0, 0.0, Calibrate::Cancel),
    ] {
        parameters = [0.0; 7];
        parameters[index] = value;
        assert_eq!(bench.answers(&command(calibration, parameters)), []);
        let (ticket, action) = bench.session.take_action().expect("an action");
        assert_eq!(action, Action::Calibrate(expected));
        bench.session.answer(ticket, Outcome::InProgress);
        bench.session.answer(ticket, Outcome::Accepted);
        let answers: Vec<_> = bench
            .receive_all(2048)
            .into_iter()
            .map(|(_, m)| m)
            .collect();
        assert_eq!(
            answers,
            [
                acknowledgement(calibration, MavResult::MAV_RESULT_IN_PROGRESS),
                acknowledgement(calibration, MavResult::MAV_RESULT_ACCEPTED),
            ]
        );
    }
    // A barometer: there is none.
    parameters[2] = 1.0;
    assert_eq!(
        bench.answers(&command(calibration, parameters)),
        [acknowledgement(
            calibration,
            MavResult::MAV_RESULT_UNSUPPORTED
        )]
    );
    bench.send(&MavMessage::COMMAND_INT(common::COMMAND_INT_DATA {
        x: 2,
        command: calibration,
        target_system: 1,
        target_component: 1,
        ..common::COMMAND_INT_DATA::default()
    }));
    let (_, action) = bench.session.take_action().expect("an action");
    assert_eq!(action, Action::Calibrate(Calibrate::Level));
    // The largest integer is an unused parameter, like NaN among the floats.
    bench.send(&MavMessage::COMMAND_INT(common::COMMAND_INT_DATA {
        param1: 1.0,
        param2: f32::NAN,
        x: i32::MAX,
        y: i32::MAX,
        command: calibration,
        target_system: 1,
        target_component: 1,
        ..common::COMMAND_INT_DATA::default()
    }));
    let (_, action) = bench.session.take_action().expect("an action");
    assert_eq!(action, Action::Calibrate(Calibrate::Gyroscope));
}

#[test]
fn actions_beyond_the_queue_are_refused_and_not_lost() {
    let mut bench = Bench::new();
    let save = MavCmd::MAV_CMD_PREFLIGHT_STORAGE;
    for _ in 0..5 {
        bench.send(&command(save, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
    }
    let answers: Vec<_> = bench
        .receive_all(2048)
        .into_iter()
        .map(|(_, m)| m)
        .collect();
    assert_eq!(
        answers,
        [acknowledgement(
            save,
            MavResult::MAV_RESULT_TEMPORARILY_REJECTED
        )]
    );
    for _ in 0..4 {
        assert!(matches!(
            bench.session.take_action(),
            Some((_, Action::Save))
        ));
    }
    assert_eq!(bench.session.take_action(), None);
}

#[test]
fn a_ground_station_finds_the_version_and_no_mission() {
    let mut bench = Bench::new();
    let request = MavCmd::MAV_CMD_REQUEST_MESSAGE;
    let answers = bench.answers(&command(request, [148.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
    let [MavMessage::AUTOPILOT_VERSION(version), ack] = &answers[..] else {
        panic!("{answers:?}")
    };
    assert_eq!(
        *ack,
        acknowledgement(request, MavResult::MAV_RESULT_ACCEPTED)
    );
    assert_eq!(version.capabilities.bits(), 8192 + 131_072 + 8);
    let text = env!("CARGO_PKG_VERSION");
    let [major, minor, patch, _] = version.flight_sw_version.to_be_bytes();
    assert_eq!(format!("{major}.{minor}.{patch}"), text);
    for kind in [0, 2] {
        let mut frame = MAVLinkV2MessageRaw::new();
        frame.serialize_message_data(
            STATION,
            &Extended {
                message: MISSION_REQUEST_LIST_DATA {
                    target_system: 1,
                    target_component: 1,
                },
                extension: [kind],
            },
        );
        bench.send_bytes(frame.raw_bytes());
        let mut buffer = [0; 100];
        let mut output = Output::new(&mut buffer);
        let reply = bench.session.inbox.replies.pop_front().expect("a reply");
        let vehicle = Vehicle {
            snapshot: None,
            is_due: false,
            sample: &bench.sample,
            temperature_celsius: 0.0,
            heading: None,
            compass: CompassStatus::default(),
            record: &bench.record,
            baud: bench.baud,
            is_armed: false,
            bursts_failed: 0,
        };
        assert!(bench.session.reply(reply, &vehicle, &mut output));
        let payload = [0, 0, 255, 190, kind];
        let length = if kind == 0 { 4 } else { 5 };
        assert_eq!(output.length(), 12 + length);
        assert_eq!(buffer[10..10 + length], payload[..length]);
    }
}

#[test]
fn requests_to_others_are_not_answered() {
    let mut bench = Bench::new();
    for (system, component) in [(2, 1), (1, 100)] {
        let mut message = command(MavCmd::MAV_CMD_DO_SET_MODE, [0.0; 7]);
        *message.target_system_id_mut().unwrap() = system;
        *message.target_component_id_mut().unwrap() = component;
        assert_eq!(bench.answers(&message), []);
    }
}

/// A line that echoes, or another module at the same address, starts nothing.
#[test]
fn frames_from_the_module_s_own_address_are_ignored() {
    let mut bench = Bench::new();
    let message = command(MavCmd::MAV_CMD_DO_SET_MODE, [0.0; 7]);
    for (system_id, component_id, answers) in [(1, 1, 0), (1, 190, 1), (255, 1, 1)] {
        let mut raw = MAVLinkV2MessageRaw::new();
        let header = MavHeader {
            system_id,
            component_id,
            sequence: 9,
        };
        raw.serialize_message(header, &message);
        bench.send_bytes(raw.raw_bytes());
        assert_eq!(bench.session.take_has_frame(), answers > 0);
        assert_eq!(bench.receive_all(2048).len(), answers);
        assert_eq!(bench.text, b"");
    }
}

#[test]
fn lines_of_text_pass_between_frames_and_after_noise() {
    let mut bench = Bench::new();
    let beat = frame(&MavMessage::HEARTBEAT(HEARTBEAT_DATA::default()));
    bench.send_bytes(b"rate 20\n");
    bench.send_bytes(beat.raw_bytes());
    bench.send_bytes(b"format text\r\n");
    assert_eq!(bench.text, b"rate 20\nformat text\r\n");
    bench.text.clear();
    // Text after a start byte is no frame: its flags are wrong.
    bench.send_bytes(b"\xFDformat text\n");
    assert_eq!(bench.text, b"\xFDformat text\n");
    bench.text.clear();
    // A frame that never ends, before a typed line.
    bench.send_bytes(b"\xFD\x20\x00\x00format text\n");
    assert_eq!(bench.text, b"");
    bench.now_us += FRAME_TIMEOUT_US_AND_MORE;
    bench.poll();
    assert_eq!(bench.text, b"\xFD\x20\x00\x00format text\n");
    bench.text.clear();
    // A frame inside an incomplete heartbeat is found.
    let request = frame(&command(MavCmd::MAV_CMD_DO_SET_MODE, [0.0; 7]));
    bench.send_bytes(b"\xFD\x01\x00\x00\x00\xFF\xBE\x00\x00\x00");
    bench.send_bytes(request.raw_bytes());
    bench.send_bytes(b"status\n");
    assert!(bench.text.ends_with(b"status\n"));
    assert_eq!(bench.receive_all(2048).len(), 1);
}

/// At 9600 baud the output of an attitude takes 166 ms. Received bytes are read after that.
#[test]
fn a_frame_whose_rest_waits_behind_the_output_is_whole() {
    let mut bench = Bench::new();
    let request = [148.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let request = frame(&command(MavCmd::MAV_CMD_REQUEST_MESSAGE, request));
    let bytes = request.raw_bytes();
    for at in 1..bytes.len() {
        let (start, rest) = bytes.split_at(at);
        bench.send_bytes(start);
        bench.poll();
        bench.now_us += 166_000;
        bench.send_bytes(rest);
        bench.poll();
        assert_eq!(
            bench.text, b"",
            "read in two parts, the first of {at} bytes"
        );
        assert_eq!(bench.session.inbox.replies.len(), 2, "version and result");
        bench.session.inbox.replies.clear();
    }
}

#[test]
fn frames_of_version_1_are_skipped_and_not_answered() {
    let mut bench = Bench::new();
    let mut sent = MAVLinkV1MessageRaw::new();
    for message in [
        MavMessage::HEARTBEAT(HEARTBEAT_DATA::default()),
        command(MavCmd::MAV_CMD_DO_SET_MODE, [0.0; 7]),
    ] {
        sent.serialize_message(STATION, &message);
        for _ in 0..12 {
            bench.send_bytes(sent.raw_bytes());
        }
        bench.send_bytes(b"format text\n");
        assert_eq!(bench.text, b"format text\n");
        bench.text.clear();
        // Version 2 is answered between them, and a frame that stops ends.
        let request = command(MavCmd::MAV_CMD_DO_SET_MODE, [0.0; 7]);
        assert_eq!(bench.answers(&request).len(), 1);
        let (start, _) = sent.raw_bytes().split_at(9);
        bench.send_bytes(start);
        bench.now_us += FRAME_TIMEOUT_US_AND_MORE;
        bench.poll();
        assert_eq!(bench.text, start);
        bench.text.clear();
    }
}

/// A byte of noise that begins a frame of version 1 costs no frame of version 2 behind it.
#[test]
fn noise_before_a_frame_is_no_frame_of_version_1() {
    let mut bench = Bench::new();
    let request = command(MavCmd::MAV_CMD_DO_SET_MODE, [0.0; 7]);
    bench.send_bytes(b"\xFE");
    assert_eq!(bench.answers(&request).len(), 1);
    assert_eq!(bench.text, b"\xFE");
}

const FRAME_TIMEOUT_US_AND_MORE: u64 = super::super::receiver::FRAME_TIMEOUT_US + 1;

#[test]
fn long_messages_go_in_chunks_or_not_at_all() {
    let mut bench = Bench::new();
    let text = "a".repeat(49) + &"b".repeat(52);
    let mut buffer = [0; 512];
    let mut output = Output::new(&mut buffer);
    assert!(bench.session.send_text(Severity::Error, &text, &mut output));
    assert!(
        bench
            .session
            .send_text(Severity::Information, "short", &mut output)
    );
    let length = output.length();
    let sent = messages(&buffer[..length]);
    let mut whole = String::new();
    for (index, (_, message)) in sent.iter().enumerate() {
        let MavMessage::STATUSTEXT(part) = message else {
            panic!("{message:?}")
        };
        if index < 3 {
            assert_eq!(part.severity, MavSeverity::MAV_SEVERITY_ERROR);
            whole += part.text.to_str().unwrap();
        } else {
            assert_eq!(part.text.to_str(), Ok("short"));
        }
    }
    assert_eq!(whole, text);
    // Number and piece follow the letters; zeros at the end are left out.
    assert_eq!(buffer[1], 52);
    assert_eq!(buffer[10 + 51..10 + 52], [1]);
    let second = 12 + 52;
    assert_eq!(buffer[second + 10 + 51..second + 10 + 54], [1, 0, 1]);
    let mut small = [0; 100];
    let mut output = Output::new(&mut small);
    assert!(!bench.session.send_text(Severity::Error, &text, &mut output));
    assert_eq!(output.length(), 0);
}

#[test]
fn a_dropped_message_is_counted_and_takes_no_number() {
    let mut bench = Bench::new();
    let mut sequences = Vec::new();
    for step in 0..50_u64 {
        let mut buffer = [0; 100];
        let mut output = Output::new(&mut buffer);
        let vehicle = Vehicle {
            snapshot: Some(&bench.snapshot),
            is_due: true,
            sample: &bench.sample,
            temperature_celsius: 0.0,
            heading: None,
            compass: CompassStatus::default(),
            record: &bench.record,
            baud: bench.baud,
            is_armed: false,
            bursts_failed: 0,
        };
        let now_us = bench.now_us + step * 20_000;
        bench.session.fill(now_us, &vehicle, &mut output);
        let length = output.length();
        sequences.extend(
            messages(&buffer[..length])
                .iter()
                .map(|(number, _)| *number),
        );
    }
    // Of three messages a time, the largest has no room.
    assert_eq!(bench.session.dropped(), 50);
    assert!(
        sequences
            .windows(2)
            .all(|pair| pair[1] == pair[0].wrapping_add(1))
    );
}

proptest! {
    #[test]
    fn any_bytes_leave_the_session_able_to_answer(noise: Vec<u8>) {
        let mut bench = Bench::new();
        bench.send_bytes(&noise);
        bench.now_us += FRAME_TIMEOUT_US_AND_MORE;
        bench.poll();
        let request = command(MavCmd::MAV_CMD_DO_SET_MODE, [0.0; 7]);
        let unsupported = MavResult::MAV_RESULT_UNSUPPORTED;
            let expected = acknowledgement(MavCmd::MAV_CMD_DO_SET_MODE, unsupported);
        let answers = bench.answers(&request);
        prop_assert!(answers.contains(&expected), "{:?}", answers);
    }

    #[test]
    fn bytes_that_are_no_frame_all_become_text(
        noise in proptest::collection::vec(0..0xFD_u8, 0..300),
    ) {
        let mut bench = Bench::new();
        bench.send_bytes(&noise);
        prop_assert_eq!(&bench.text, &noise);
    }
}
