//! Writers of a conversion: a flight log, a table of bursts, and a log in SI units.

use std::io::Write;

use aplomb::attitude::{BodyVector, Vector3};
use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb::mpu6050::{Config, RawSample};
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::telemetry::bursts;
use aplomb_recordings::flight_log::Recorder;
use aplomb_recordings::log::Statements;
use aplomb_recordings::number;
use aplomb_recordings::output::OutputFile;

use super::Recorded;

/// Properties of the recording that is written.
pub(super) struct Target {
    pub(super) settings: Settings,
    /// Readings of a compass are written too.
    pub(super) has_compass: bool,
    /// The armed state is written too.
    pub(super) has_armed: bool,
    /// Knowledge of accelerometer and gyroscope, if it is known.
    pub(super) knowledge: Option<AccelerometerKnowledge>,
}

impl Target {
    /// Returns the knowledge, if it is not that of counts without a statement.
    fn uncommon_knowledge(&self) -> Option<AccelerometerKnowledge> {
        self.knowledge
            .filter(|knowledge| *knowledge != AccelerometerKnowledge::Factory)
    }

    /// Returns what a table of bursts has to state: all that is not the default.
    fn statements(&self) -> Statements {
        let Config {
            accelerometer_range: force,
            gyroscope_range: rate,
            ..
        } = self.settings.sensor;
        let default = Config::DEFAULT;
        Statements {
            accelerometer: self.uncommon_knowledge(),
            accelerometer_range: (force != default.accelerometer_range).then_some(force),
            gyroscope_range: (rate != default.gyroscope_range).then_some(rate),
        }
    }
}

/// Latest time in a flight log, µs: its bursts have 48 bits, which are almost nine years.
const LATEST_LOGGED_US: u64 = (1 << 48) - 1;

pub(super) fn write_log(
    file: &mut OutputFile,
    target: &Target,
    bursts: &mut dyn Iterator<Item = Recorded>,
) -> std::io::Result<()> {
    let mut pipeline = Pipeline::new(&target.settings);
    // The log's states of the filter hold it.
    if let Some(knowledge) = target.uncommon_knowledge() {
        pipeline.set_accelerometer_knowledge(knowledge);
    }
    let mut recorder = Recorder::new(file, pipeline, 0);
    for Recorded { row, .. } in bursts {
        let t_us = row.burst.captured_at_us;
        if t_us > LATEST_LOGGED_US {
            return Err(std::io::Error::other(format!(
                "a flight log holds times of up to {LATEST_LOGGED_US} us, and one is {t_us}: \
                 subtract the first time from all"
            )));
        }
        recorder.set_armed(row.is_armed);
        recorder.add(&row.burst, row.board)?;
    }
    Ok(())
}

pub(super) fn write_bursts(
    file: &mut OutputFile,
    target: &Target,
    bursts: &mut dyn Iterator<Item = Recorded>,
) -> std::io::Result<()> {
    let comments = target.statements().comments();
    writeln!(file, "{comments}{}", bursts::HEADER)?;
    for Recorded { row, .. } in bursts {
        writeln!(file, "{row}")?;
    }
    Ok(())
}

pub(super) fn write_csv(
    file: &mut OutputFile,
    target: &Target,
    bursts: &mut dyn Iterator<Item = Recorded>,
) -> std::io::Result<()> {
    let (settings, has_compass) = (&target.settings, target.has_compass);
    let field_columns = if has_compass { ",mx,my,mz" } else { "" };
    let armed_column = if target.has_armed { ",armed" } else { "" };
    let stated = Statements {
        accelerometer: target.knowledge,
        ..Statements::default()
    };
    let comments = stated.comments();
    writeln!(
        file,
        "{comments}t_us,ax,ay,az,gx,gy,gz{field_columns}{armed_column}"
    )?;
    let mut line = Vec::new();
    for Recorded { row, reading, .. } in bursts {
        let raw = RawSample::decode(&row.burst.bytes);
        let force = raw
            .accelerometer
            .to_m_s2(settings.sensor.accelerometer_range);
        let rates = raw.gyroscope.to_rad_s(settings.sensor.gyroscope_range);
        line.clear();
        write!(line, "{}", row.burst.captured_at_us)?;
        for value in [force.x, force.y, force.z, rates.x, rates.y, rates.z] {
            line.push(b',');
            number::append(&mut line, value);
        }
        match reading {
            Some(reading) => {
                let [x, y, z] = reading.field.ut;
                let field = BodyVector::new(x, y, z);
                let Vector3 { x, y, z } = settings.mount.to_sensor(field);
                for value in [x, y, z] {
                    line.push(b',');
                    number::append(&mut line, value);
                }
            }
            None if has_compass => line.extend_from_slice(b",,,"),
            None => {}
        }
        if target.has_armed {
            write!(line, ",{}", u8::from(row.is_armed))?;
        }
        line.push(b'\n');
        file.write_all(&line)?;
    }
    Ok(())
}
