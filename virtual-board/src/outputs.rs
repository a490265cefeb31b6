//! The files that a flight leaves in its output folder.
//!
//! | file | contents |
//! |---|---|
//! | `attitude.csv` | a row per published sample: the snapshot, and the heading of a compass |
//! | `bursts.csv` | a row per published sample: its bytes from the bus, and its conditions |
//! | `truth.csv` | a row per published sample: the true motion at its edge, where it is known |
//! | `uart.log` | the UART's bytes |
//! | `firmware.log` | the lines of the debug probe, each with its time |
//! | `attitude.png` | estimate against truth, and the error |
//! | `summary.json` | the figures |
//!
//! The rows of the three tables belong together by their times, which are the firmware's. Numbers
//! are in their shortest form that reads back as the same number. Flags are names joined by `|`.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;

use aplomb::health::{BoardFlags, Flags};
use aplomb::mpu6050::Burst;
use aplomb::telemetry::bursts;
use aplomb::units::degrees;

use aplomb_recordings::output::check_writable;

use crate::Error;
use crate::flight::Outcome;
use crate::plot::{self, Labels};
use crate::recorder::Sample;

/// The name of the picture.
pub const PICTURE: &str = "attitude.png";

/// Writes all files into a folder, which is made if need be.
///
/// # Errors
///
/// When a file cannot be written.
pub fn write(folder: &Path, outcome: &Outcome, labels: &Labels) -> Result<(), Error> {
    fs::create_dir_all(folder).map_err(|cause| Error::Output(folder.into(), cause.to_string()))?;
    let samples = outcome.samples();
    in_file(folder, "attitude.csv", |file| write_attitude(file, samples))?;
    in_file(folder, "bursts.csv", |file| write_bursts(file, samples))?;
    in_file(folder, "truth.csv", |file| write_truth(file, samples))?;
    in_file(folder, "uart.log", |file| {
        let bytes: Vec<u8> = outcome
            .record
            .received
            .iter()
            .map(|received| received.byte)
            .collect();
        file.write_all(&bytes)
    })?;
    in_file(folder, "firmware.log", |file| {
        outcome.log().iter().try_for_each(|line| {
            writeln!(file, "{:10.3} s  {}", line.at_ns as f64 * 1e-9, line.text)
        })
    })?;
    in_file(folder, PICTURE, |file| {
        file.write_all(&plot::png(outcome, labels))
    })?;
    in_file(folder, "summary.json", |file| {
        serde_json::to_writer_pretty(&mut *file, &outcome.summary)?;
        writeln!(file)
    })
}

fn in_file(
    folder: &Path,
    name: &str,
    content: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<(), Error> {
    let path = folder.join(name);
    let written = check_writable(&path)
        .and_then(|()| File::create(&path))
        .and_then(|file| {
            let mut file = BufWriter::new(file);
            content(&mut file)?;
            file.flush()
        });
    written.map_err(|cause| Error::Output(path, cause.to_string()))
}

/// `attitude.csv`.
///
/// # Errors
///
/// When the writer refuses.
pub fn write_attitude(to: &mut impl Write, samples: &[Sample]) -> io::Result<()> {
    let has_compass = samples.iter().any(|sample| sample.heading.is_some());
    let heading_columns = if has_compass {
        ",heading_deg,heading_sigma_deg,yaw_offset_deg"
    } else {
        ""
    };
    writeln!(
        to,
        "t_us,qw,qx,qy,qz,roll_deg,pitch_deg,yaw_deg,\
         roll_rate_dps,pitch_rate_dps,yaw_rate_dps,flags{heading_columns}"
    )?;
    for sample in samples {
        let snapshot = &sample.snapshot;
        let (attitude, euler, rates) = (
            snapshot.attitude,
            snapshot.euler(),
            snapshot.body_rates_rad_s,
        );
        write!(
            to,
            "{},{},{},{},{},{},{},{},{},{},{},{}",
            snapshot.t_us,
            attitude.w,
            attitude.x,
            attitude.y,
            attitude.z,
            degrees(euler.roll_rad),
            degrees(euler.pitch_rad),
            degrees(euler.yaw_rad),
            degrees(rates.x),
            degrees(rates.y),
            degrees(rates.z),
            snapshot.flags,
        )?;
        match &sample.heading {
            Some(heading) => write!(
                to,
                ",{},{},{}",
                degrees(heading.heading_rad(euler.yaw_rad)),
                degrees(heading.sigma_rad),
                degrees(heading.yaw_offset_rad),
            )?,
            None if has_compass => write!(to, ",,,")?,
            None => {}
        }
        writeln!(to)?;
    }
    Ok(())
}

/// `bursts.csv`: what went into the pipeline, the board's flags and the armed state included.
///
/// # Errors
///
/// When the writer refuses.
pub fn write_bursts(to: &mut impl Write, samples: &[Sample]) -> io::Result<()> {
    writeln!(to, "{}", bursts::HEADER)?;
    for sample in samples {
        let flags = sample.snapshot.flags;
        let burst = Burst {
            bytes: sample.burst.bytes,
            captured_at_us: sample.snapshot.t_us,
            missed_before: u8::from(flags.contains(Flags::MISSED)),
        };
        let row = bursts::Row {
            burst,
            board: BoardFlags::from_bits_truncate(flags.bits()),
            is_armed: sample.is_armed,
        };
        writeln!(to, "{row}")?;
    }
    Ok(())
}

/// `truth.csv`: the same quantities as in `attitude.csv`, and whether the sample counts for scores.
///
/// # Errors
///
/// When the writer refuses.
pub fn write_truth(to: &mut impl Write, samples: &[Sample]) -> io::Result<()> {
    writeln!(
        to,
        "t_us,qw,qx,qy,qz,roll_deg,pitch_deg,yaw_deg,\
         roll_rate_dps,pitch_rate_dps,yaw_rate_dps,scored"
    )?;
    for sample in samples {
        let Some(truth) = sample.edge.map(|edge| edge.truth) else {
            continue;
        };
        let Some(attitude) = truth.attitude else {
            continue;
        };
        let [roll, pitch, yaw] = attitude.to_euler_degrees();
        let [p, q, r] = truth.body_rates_rad_s.map(f64::to_degrees);
        writeln!(
            to,
            "{},{},{},{},{},{roll},{pitch},{yaw},{p},{q},{r},{}",
            sample.snapshot.t_us,
            attitude.w,
            attitude.x,
            attitude.y,
            attitude.z,
            u8::from(truth.scored),
        )?;
    }
    Ok(())
}
