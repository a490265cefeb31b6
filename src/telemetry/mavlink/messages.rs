//! Messages that the module sends.

use ::mavlink::dialects::common::{
    ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, AUTOPILOT_VERSION_DATA, HEARTBEAT_DATA,
    HIGHRES_IMU_DATA, HighresImuUpdatedFlags, MavAutopilot, MavModeFlag, MavProtocolCapability,
    MavState, MavSysStatusSensor, MavType, VFR_HUD_DATA,
};

use crate::attitude::{Quaternion, Vector3};
use crate::compass::CompassStatus;
use crate::estimator::Sample;
use crate::estimator::heading::HeadingEstimate;
use crate::health::Flags;
use crate::pipeline::Snapshot;
use crate::settings::Record;
use crate::telemetry::heading::Line as HeadingLine;

/// Fields of HIGHRES_IMU that a sample updates.
const UPDATED_SAMPLE: HighresImuUpdatedFlags = HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_XACC
    .union(HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_YACC)
    .union(HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_ZACC)
    .union(HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_XGYRO)
    .union(HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_YGYRO)
    .union(HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_ZGYRO)
    .union(HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_TEMPERATURE);
/// Fields of HIGHRES_IMU that a reading of the compass updates.
const UPDATED_FIELD: HighresImuUpdatedFlags = HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_XMAG
    .union(HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_YMAG)
    .union(HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_ZMAG);
/// Gauss per microtesla.
const GAUSS_PER_UT: f32 = 0.01;

/// Data for the messages.
#[derive(Debug, Clone, Copy)]
pub struct Vehicle<'a> {
    /// Latest attitude; `None` before the first.
    pub snapshot: Option<&'a Snapshot>,
    /// True if the attitude is due, and the messages that hold it.
    pub is_due: bool,
    /// Sample of that attitude, in body axes.
    pub sample: &'a Sample,
    /// Die temperature, °C.
    pub temperature_celsius: f32,
    /// Heading, if it is known. The snapshot's flag says whether it is valid.
    pub heading: Option<HeadingEstimate>,
    /// Compass.
    pub compass: CompassStatus,
    /// Record in use.
    pub record: &'a Record,
    /// Baud rate in use, or the requested one: the record has a new one once it is confirmed.
    pub baud: u32,
    /// True if the module is armed.
    pub is_armed: bool,
    /// Bursts that failed since start.
    pub bursts_failed: u16,
}

impl Vehicle<'_> {
    /// Returns the latest attitude: absolute while the heading is valid, relative otherwise.
    pub(super) fn attitude(&self) -> Option<Snapshot> {
        let mut snapshot = *self.snapshot?;
        if let Some(heading) = self.valid_heading() {
            let turn = Vector3::new(0.0, 0.0, heading.yaw_offset_rad);
            let turn = Quaternion::from_rotation_vector(turn);
            snapshot.attitude = turn.multiply(snapshot.attitude);
        }
        Some(snapshot)
    }

    /// Returns the heading, if it is valid.
    pub(super) fn valid_heading(&self) -> Option<HeadingEstimate> {
        let flags = self.snapshot?.flags;
        let is_valid = flags.contains(Flags::HEADING_VALID);
        self.heading.filter(|_| is_valid)
    }

    /// Returns the sensors that are there.
    pub(super) fn sensors(&self) -> MavSysStatusSensor {
        let imu = MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_GYRO
            | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_ACCEL
            | MavSysStatusSensor::MAV_SYS_STATUS_AHRS;
        if self.compass.part.is_some() || self.compass.fault.is_some() {
            imu | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_MAG
        } else {
            imu
        }
    }
}

/// Builds HEARTBEAT. `is_lost` is true if there has been no measurement for some time.
#[inline(never)]
pub(super) fn heartbeat(vehicle: &Vehicle<'_>, is_lost: bool) -> HEARTBEAT_DATA {
    HEARTBEAT_DATA {
        custom_mode: 0,
        mavtype: MavType::MAV_TYPE_GENERIC,
        // Ground stations ignore what claims to be no autopilot.
        autopilot: MavAutopilot::MAV_AUTOPILOT_GENERIC,
        base_mode: if vehicle.is_armed {
            MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED
        } else {
            MavModeFlag::empty()
        },
        system_status: match vehicle.snapshot {
            _ if is_lost => MavState::MAV_STATE_CRITICAL,
            None => MavState::MAV_STATE_BOOT,
            Some(_) if vehicle.is_armed => MavState::MAV_STATE_ACTIVE,
            Some(latest) if is_calibrating(latest.flags) => MavState::MAV_STATE_CALIBRATING,
            Some(_) => MavState::MAV_STATE_STANDBY,
        },
        // Version of the protocol's definitions, the same for MAVLink 2.
        mavlink_version: 3,
    }
}

/// Returns whether the gyroscope's offset is not known, and the attitude is not valid for that
/// reason.
fn is_calibrating(flags: Flags) -> bool {
    flags.contains(Flags::CALIBRATING) && !flags.contains(Flags::VALID)
}

/// Returns the healthy sensors of those that are there. `flags` are those of the latest attitude.
/// The attitude is healthy only while it is valid.
#[inline(never)]
pub(super) fn health(flags: Option<Flags>, present: MavSysStatusSensor) -> MavSysStatusSensor {
    let Some(flags) = flags else {
        return MavSysStatusSensor::empty();
    };
    let when = |is_healthy: bool, sensor: MavSysStatusSensor| {
        if is_healthy {
            sensor
        } else {
            MavSysStatusSensor::empty()
        }
    };
    let healthy = when(
        !flags.intersects(Flags::NO_MEASUREMENT | Flags::GYROSCOPE_SATURATED),
        MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_GYRO,
    ) | when(
        !flags.intersects(Flags::NO_MEASUREMENT | Flags::ACCELEROMETER_SATURATED),
        MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_ACCEL,
    ) | when(
        flags.contains(Flags::VALID) && !flags.contains(Flags::GAP),
        MavSysStatusSensor::MAV_SYS_STATUS_AHRS,
    ) | when(
        !flags.contains(Flags::COMPASS_FAULT),
        MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_MAG,
    );
    healthy & present
}

/// Builds ATTITUDE.
#[inline(never)]
pub(super) fn attitude(snapshot: &Snapshot) -> ATTITUDE_DATA {
    let angles = snapshot.euler();
    let rates = snapshot.body_rates_rad_s;
    ATTITUDE_DATA {
        time_boot_ms: milliseconds(snapshot.t_us),
        roll: angles.roll_rad,
        pitch: angles.pitch_rad,
        yaw: angles.yaw_rad,
        rollspeed: rates.x,
        pitchspeed: rates.y,
        yawspeed: rates.z,
    }
}

/// Builds ATTITUDE_QUATERNION.
#[inline(never)]
pub(super) fn quaternion(snapshot: &Snapshot) -> ATTITUDE_QUATERNION_DATA {
    let attitude = snapshot.attitude;
    let rates = snapshot.body_rates_rad_s;
    ATTITUDE_QUATERNION_DATA {
        time_boot_ms: milliseconds(snapshot.t_us),
        q1: attitude.w,
        q2: attitude.x,
        q3: attitude.y,
        q4: attitude.z,
        rollspeed: rates.x,
        pitchspeed: rates.y,
        yawspeed: rates.z,
    }
}

/// Builds HIGHRES_IMU. It marks the sample as updated if that `is_measured`, and the field if there
/// is one and it is new.
#[inline(never)]
pub(super) fn imu(
    snapshot: &Snapshot,
    vehicle: &Vehicle<'_>,
    is_measured: bool,
    has_new_field: bool,
) -> HIGHRES_IMU_DATA {
    let force = vehicle.sample.specific_force_m_s2;
    let rates = snapshot.body_rates_rad_s;
    let field = vehicle.compass.field;
    let mut updated = HighresImuUpdatedFlags::empty();
    if is_measured {
        updated |= UPDATED_SAMPLE;
    }
    if has_new_field && field.is_some() {
        updated |= UPDATED_FIELD;
    }
    let [xmag, ymag, zmag] = field.unwrap_or_default().ut.map(|part| part * GAUSS_PER_UT);
    HIGHRES_IMU_DATA {
        time_usec: snapshot.t_us,
        xacc: force.x,
        yacc: force.y,
        zacc: force.z,
        xgyro: rates.x,
        ygyro: rates.y,
        zgyro: rates.z,
        xmag,
        ymag,
        zmag,
        temperature: vehicle.temperature_celsius,
        fields_updated: updated,
        ..HIGHRES_IMU_DATA::DEFAULT
    }
}

/// Builds VFR_HUD with the heading. Speeds and height are unknown: 0.
#[inline(never)]
pub(super) fn hud(snapshot: &Snapshot, heading: &HeadingEstimate) -> VFR_HUD_DATA {
    let degrees = HeadingLine::new(snapshot, heading).heading_deg;
    // In [0, 360) before it is rounded.
    let rounded = (degrees + 0.5) as i16;
    VFR_HUD_DATA {
        heading: if rounded < 360 { rounded } else { 0 },
        ..VFR_HUD_DATA::DEFAULT
    }
}

/// Builds AUTOPILOT_VERSION.
pub(super) fn version() -> AUTOPILOT_VERSION_DATA {
    AUTOPILOT_VERSION_DATA {
        capabilities: MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_COMMAND_INT,
        // One byte each, and 255 for a release.
        flight_sw_version: const {
            u32::from_be_bytes([
                number(env!("CARGO_PKG_VERSION_MAJOR")),
                number(env!("CARGO_PKG_VERSION_MINOR")),
                number(env!("CARGO_PKG_VERSION_PATCH")),
                255,
            ])
        },
        ..AUTOPILOT_VERSION_DATA::DEFAULT
    }
}

/// Converts µs to ms in 32 bits, which wrap after 49 days.
///
/// Divides by hand, 16 bits at a time: a division of 64 bits takes a kilobyte of flash.
pub(super) const fn milliseconds(t_us: u64) -> u32 {
    let [high, middle, low] = [t_us >> 32, (t_us >> 16) & 0xFFFF, t_us & 0xFFFF];
    let middle = ((high as u32 % 1000) << 16) | middle as u32;
    let low = ((middle % 1000) << 16) | low as u32;
    ((middle / 1000) << 16) | (low / 1000)
}

/// Parses a part of the version.
const fn number(text: &str) -> u8 {
    match u8::from_str_radix(text, 10) {
        Ok(number) => number,
        Err(_) => u8::MAX,
    }
}
