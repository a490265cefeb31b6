//! Requests of a MAVLink ground station to the real image, beside a job, a change of the baud rate
//! or lines of text.

mod common;

use aplomb_models::motion::rest::Rest;
use common::pooled_run;
use virtual_board::flight::Outcome;
use virtual_board::schedule::Schedule;

/// Message COMMAND_LONG, and the seed of its checksum.
const COMMAND_LONG: (u8, u8) = (76, 152);
/// Message HEARTBEAT, and the seed of its checksum.
const HEARTBEAT: (u8, u8) = (0, 50);
/// Message PARAM_SET, and the seed of its checksum.
const PARAM_SET: (u8, u8) = (23, 168);
/// Message COMMAND_ACK.
const COMMAND_ACK: u8 = 77;
/// MAV_CMD_PREFLIGHT_CALIBRATION.
const CALIBRATION: u16 = 241;
/// MAV_CMD_PREFLIGHT_STORAGE.
const STORAGE: u16 = 245;
/// MAV_CMD_COMPONENT_ARM_DISARM.
const ARM: u16 = 400;
/// MAV_CMD_REQUEST_MESSAGE.
const REQUEST: u16 = 512;
/// MAV_RESULT_ACCEPTED.
const ACCEPTED: u8 = 0;
/// MAV_RESULT_TEMPORARILY_REJECTED.
const REJECTED: u8 = 1;
/// MAV_RESULT_IN_PROGRESS.
const IN_PROGRESS: u8 = 5;
/// MAV_RESULT_CANCELLED.
const CANCELLED: u8 = 6;

/// Adds a byte to the checksum of MAVLink, CRC-16/MCRF4XX.
fn checksum(sum: u16, byte: u8) -> u16 {
    (0..8).fold(sum ^ u16::from(byte), |sum, _| {
        (sum >> 1) ^ (0x8408 * (sum & 1))
    })
}

/// Returns a frame of MAVLink 2.
fn frame((message, seed): (u8, u8), payload: &[u8]) -> Vec<u8> {
    let length = payload.len() as u8;
    let mut frame = vec![0xFD, length, 0, 0, 0, 255, 190, message, 0, 0];
    frame.extend(payload);
    let checked = frame[1..].iter().chain([&seed]);
    let sum = checked.fold(0xFFFF, |sum, &byte| checksum(sum, byte));
    frame.extend(sum.to_le_bytes());
    frame
}

/// Returns a command with the first parameter 1, to the module.
fn command(number: u16) -> Vec<u8> {
    command_with(number, 1.0)
}

/// Returns a command with this first parameter, to the module.
fn command_with(number: u16, parameter: f32) -> Vec<u8> {
    let mut payload = [0; 33];
    payload[..4].copy_from_slice(&parameter.to_le_bytes());
    payload[28..30].copy_from_slice(&number.to_le_bytes());
    payload[30] = 1;
    frame(COMMAND_LONG, &payload)
}

/// Returns the commands and results of the acknowledgements that the module sends.
fn results(outcome: &Outcome) -> Vec<(u16, u8)> {
    let received = outcome.record.received.iter();
    let bytes: Vec<u8> = received.map(|received| received.byte).collect();
    let frames = bytes
        .windows(13)
        .filter(|bytes| bytes[0] == 0xFD && bytes[1] <= 10 && bytes[7..10] == [COMMAND_ACK, 0, 0]);
    frames
        .map(|bytes| {
            // A sender leaves zeros at the end out.
            let result = if bytes[1] > 2 { bytes[12] } else { 0 };
            (u16::from_le_bytes([bytes[10], bytes[11]]), result)
        })
        .collect()
}

/// Returns the console's answers, as the debug probe shows them.
fn answers(outcome: &Outcome) -> Vec<&str> {
    let lines = outcome.log().iter().map(|line| line.text.as_str());
    let starts = ["ok ", "error ", "progress ", "done ", "failed "];
    lines
        .filter_map(|line| {
            let at = starts.iter().filter_map(|start| line.find(start)).min()?;
            Some(&line[at..])
        })
        .collect()
}

/// Requests that come during a save wait for its end.
#[test]
fn requests_wait_for_the_end_of_a_save() {
    let requests = [command(STORAGE), command(STORAGE), command(ARM)].concat();
    let outcome = pooled_run()
        .seconds(4.0)
        .motion(Rest::level())
        .command(1.0, "format mavlink")
        .command(1.2, "mount z-down")
        .send(1.5, &requests)
        .run()
        .unwrap();
    assert_eq!(outcome.issues, Vec::<String>::new());
    assert_eq!(
        answers(&outcome)[2..],
        [
            "ok save: the sensor stops for a second",
            "done save: stored",
            "ok save: nothing has changed, nothing is written",
            "ok arm",
        ]
    );
    let expected = [
        (STORAGE, IN_PROGRESS),
        (STORAGE, ACCEPTED),
        (STORAGE, ACCEPTED),
        (ARM, ACCEPTED),
    ];
    assert_eq!(results(&outcome), expected);
}

/// A calibration that a line of text gives up is answered.
#[test]
fn a_calibration_that_a_line_gives_up_is_cancelled() {
    let run = |line| {
        pooled_run()
            .seconds(4.0)
            .motion(Rest::level())
            .command(1.0, "format mavlink")
            .send(1.5, &command(CALIBRATION))
            .command(3.0, line)
            .run()
            .unwrap()
    };
    for line in ["arm", "calibrate stop"] {
        let expected = [(CALIBRATION, IN_PROGRESS), (CALIBRATION, CANCELLED)];
        assert_eq!(results(&run(line)), expected, "{line}");
    }
    let goes_on = [(CALIBRATION, IN_PROGRESS)];
    assert_eq!(results(&run("status")), goes_on);
}

/// A calibration that another command ends is answered before that command.
#[test]
fn a_calibration_that_a_command_cancels_is_answered_first() {
    for (number, parameter) in [(CALIBRATION, 0.0), (ARM, 1.0)] {
        let outcome = pooled_run()
            .seconds(2.5)
            .motion(Rest::level())
            .command(1.0, "format mavlink")
            .send(1.5, &command(CALIBRATION))
            .send(2.0, &command_with(number, parameter))
            .run()
            .unwrap();
        let expected = [
            (CALIBRATION, IN_PROGRESS),
            (CALIBRATION, CANCELLED),
            (number, ACCEPTED),
        ];
        assert_eq!(results(&outcome), expected);
    }
}

/// While the output of an attitude takes 166 ms, requests wait in part. None is lost.
#[test]
fn no_request_is_lost_at_9600_baud() {
    let requests = 20_u32;
    let run = pooled_run()
        .seconds(2.0 + 1.03 * f64::from(requests))
        .motion(Rest::level())
        .command(0.5, "rate 4")
        .command(0.7, "baud 9600")
        .command(1.0, "format mavlink");
    let request = command_with(REQUEST, 148.0);
    let run = (0..requests).fold(run, |run, nth| {
        run.send(1.5 + 1.03 * f64::from(nth), &request)
    });
    let answered = results(&run.run().unwrap());
    assert_eq!(answered, vec![(REQUEST, ACCEPTED); requests as usize]);
}

/// Text in a damaged frame that follows a change of the format is dropped, and does not run when
/// the format is MAVLink again.
#[test]
fn text_behind_a_change_of_the_format_never_runs() {
    let mut damaged = frame(COMMAND_LONG, b"\nformat text\nrate 20\narm\nrate 30\n");
    if let Some(last) = damaged.last_mut() {
        *last ^= 0xFF;
    }
    let outcome = pooled_run()
        .seconds(3.5)
        .motion(Rest::level())
        .command(1.0, "format mavlink")
        .send(1.5, &damaged)
        .command(2.5, "format mavlink")
        .run()
        .unwrap();
    let all = answers(&outcome);
    let obeyed: Vec<_> = all.iter().filter(|line| line.starts_with("ok ")).collect();
    assert_eq!(
        obeyed,
        [
            &"ok mavlink, 50 a second; \"save\" keeps it",
            &"ok text, 50 a second; \"save\" keeps it",
            &"ok mavlink, 50 a second; \"save\" keeps it",
        ]
    );
}

/// Returns a frame that sets this baud rate.
fn set_baud(baud: f32) -> Vec<u8> {
    let mut set = [0; 23];
    set[..4].copy_from_slice(&baud.to_le_bytes());
    set[4] = 1;
    set[6..14].copy_from_slice(b"OUT_BAUD");
    set[22] = 9;
    frame(PARAM_SET, &set)
}

/// The heartbeats of a ground station confirm the baud rate that it has set.
#[test]
fn a_heartbeat_confirms_a_baud_rate() {
    let run = |second: &[u8]| {
        pooled_run()
            .seconds(13.0)
            .motion(Rest::level())
            .command(1.0, "format mavlink")
            .send(
                1.5,
                &[set_baud(921_600.0), frame(HEARTBEAT, &[6, 8])].concat(),
            )
            .send(3.0, second)
            .run()
            .unwrap()
    };
    let heartbeat = frame(HEARTBEAT, &[0, 0, 0, 0, 6, 8, 0, 4, 3]);
    let heard = run(&heartbeat);
    assert_eq!(answers(&heard)[2..], [""; 0]);
    // The one before the change does not count, nor does noise.
    let unheard = run(&heartbeat[1..]);
    let reverted = "failed baud: nothing was understood at 921600, it is 115200 again";
    assert_eq!(answers(&unheard)[2..], [reverted]);
}

/// After the crash the module still sends at the rate that a frame has confirmed.
#[test]
fn a_baud_rate_that_a_frame_has_confirmed_outlives_a_crash() {
    let schedule = Schedule::parse("crash", "4.0 0 crash").unwrap();
    let outcome = pooled_run()
        .seconds(5.0)
        .motion(Rest::level())
        .command(1.0, "format mavlink")
        .send(1.5, &set_baud(921_600.0))
        .send(2.5, &frame(HEARTBEAT, &[0, 0, 0, 0, 6, 8, 0, 4, 3]))
        .schedule(&schedule)
        .run()
        .unwrap();
    assert_eq!(outcome.record.resets_ns.len(), 1);
    // At 921,600 baud a byte takes 11 us, at 115,200 baud 87 us.
    let times_ns = outcome
        .record
        .received
        .iter()
        .map(|received| received.at_ns);
    let last: Vec<u64> = times_ns
        .skip_while(|&at_ns| at_ns < 4_500_000_000)
        .collect();
    let shortest = last.windows(2).map(|pair| pair[1] - pair[0]).min();
    assert!(shortest.is_some_and(|it| it < 12_000), "{shortest:?}");
}

/// A command confirms a new baud rate only if it was received at that rate.
#[test]
fn a_command_before_the_change_does_not_confirm_a_baud_rate() {
    let reverted = "failed baud: nothing was understood at 921600, it is 115200 again";
    let run = || pooled_run().seconds(13.0).motion(Rest::level());

    let text = run()
        .command(1.0, "baud 921600\nrate 20\nsave")
        .run()
        .unwrap();
    assert_eq!(answers(&text)[1..], [reverted], "{:#?}", answers(&text));

    // The console takes the line first.
    let requests = [&command(ARM)[..], b"baud 921600\n"].concat();
    let mavlink = run()
        .command(1.0, "format mavlink")
        .send(1.5, &requests)
        .run()
        .unwrap();
    assert_eq!(
        answers(&mavlink)[2..],
        [reverted],
        "{:#?}",
        answers(&mavlink)
    );
    assert_eq!(results(&mavlink), [(ARM, REJECTED)]);
}
