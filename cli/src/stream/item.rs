//! Attitudes and messages that are decoded from a stream.

use aplomb::attitude::Quaternion;
use aplomb::health::Flags;
use aplomb::pipeline::Snapshot;
use aplomb::settings::OutputFormat;
use aplomb::telemetry::heading;
use aplomb::telemetry::text::Line;
use aplomb::units::degrees;
use aplomb_recordings::attitude_table::Row;

/// Format of a stream of attitudes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// A format of the module.
    Module(OutputFormat),
    /// An attitude CSV, as `replay` and `fly` write it.
    Table,
}

impl Format {
    /// Returns the name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Module(format) => format.name(),
            Self::Table => "attitude CSV",
        }
    }

    /// Returns whether the format consists of lines of text.
    pub const fn has_lines(self) -> bool {
        matches!(
            self,
            Self::Table
                | Self::Module(OutputFormat::Text | OutputFormat::Classic | OutputFormat::Teleplot)
        )
    }
}

/// Attitude, as far as the format has it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Attitude {
    /// Time since the module's start, µs.
    pub t_us: Option<u64>,
    /// Roll, right wing down positive, degrees.
    pub roll_deg: f32,
    /// Pitch, nose up positive, degrees.
    pub pitch_deg: f32,
    /// Yaw, clockwise from above positive, degrees.
    pub yaw_deg: Option<f32>,
    /// Body rates, °/s. In `classic`: rates of roll and pitch.
    pub rates_deg_s: [Option<f32>; 3],
    /// Flags of the module.
    pub flags: Option<Flags>,
}

/// Sensors that the module reports as healthy in SYS_STATUS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sensors {
    /// The gyroscope is healthy.
    pub gyroscope: bool,
    /// The accelerometer is healthy.
    pub accelerometer: bool,
    /// The attitude is healthy.
    pub attitude: bool,
    /// The compass is healthy, or there is none.
    pub compass: bool,
}

impl Sensors {
    /// Returns the names of those that are not healthy.
    pub fn unhealthy(&self) -> Vec<&'static str> {
        let names = [
            (self.gyroscope, "GYROSCOPE"),
            (self.accelerometer, "ACCELEROMETER"),
            (self.attitude, "ATTITUDE"),
            (self.compass, "COMPASS"),
        ];
        let unhealthy = names.iter().filter(|(is_healthy, _)| !is_healthy);
        unhealthy.map(|(_, name)| *name).collect()
    }
}

/// Decoded piece of a stream.
#[derive(Debug, Clone, PartialEq)]
pub enum Item {
    /// An attitude.
    Attitude(Attitude),
    /// σ of the tilt, degrees.
    TiltSigma(f32),
    /// Heading from a compass.
    Heading(heading::Line),
    /// Temperature of the die, °C.
    Temperature(f32),
    /// Health of the sensors.
    Sensors(Sensors),
    /// Message of the module.
    Message(String),
}

/// Counts of a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Attitudes.
    pub attitudes: u64,
    /// Bursts of the flight log.
    pub bursts: u64,
    /// Bursts, packets and messages that are missing by their numbers.
    pub lost: u64,
    /// Pieces that cannot be read in the present format.
    pub damaged: u64,
}

impl Attitude {
    /// Returns the angles of an attitude.
    pub fn of_quaternion(attitude: Quaternion) -> Self {
        let angles = attitude.to_euler();
        Self {
            roll_deg: degrees(angles.roll_rad),
            pitch_deg: degrees(angles.pitch_rad),
            yaw_deg: Some(degrees(angles.yaw_rad)),
            ..Self::default()
        }
    }

    /// Returns the attitude of a snapshot.
    pub fn of_snapshot(snapshot: &Snapshot) -> Self {
        let rates = snapshot.body_rates_rad_s;
        Self {
            t_us: Some(snapshot.t_us),
            rates_deg_s: [rates.x, rates.y, rates.z].map(|rate| Some(degrees(rate))),
            flags: Some(snapshot.flags),
            ..Self::of_quaternion(snapshot.attitude)
        }
    }

    /// Returns the attitude of a row of an attitude table.
    pub fn of_row(row: &Row) -> Self {
        let [roll_deg, pitch_deg, yaw_deg] = row.attitude.angles_deg();
        Self {
            t_us: u64::try_from(row.t_us).ok(),
            roll_deg,
            pitch_deg,
            yaw_deg: Some(yaw_deg),
            rates_deg_s: row.rates_deg_s.map_or([None; 3], |rates| rates.map(Some)),
            flags: row.flags,
        }
    }

    /// Returns the attitude of a line. `named` are the flags that the module named last; `VALID` is
    /// in each line.
    pub fn of_line(line: &Line, named: Flags) -> Self {
        let mut flags = named;
        flags.set(Flags::VALID, line.is_valid);
        Self {
            roll_deg: line.roll_deg,
            pitch_deg: line.pitch_deg,
            yaw_deg: Some(line.yaw_deg),
            rates_deg_s: [
                line.roll_rate_deg_s,
                line.pitch_rate_deg_s,
                line.yaw_rate_deg_s,
            ]
            .map(Some),
            flags: Some(flags),
            ..Self::default()
        }
    }
}
