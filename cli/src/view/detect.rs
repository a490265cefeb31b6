//! What the module sends, whatever its format: bytes in, readings and messages out.
//!
//! Every byte is offered to the decoder of every format. Each accepts only what it can check (a checksum, or the exact form
//! of a line or packet), so the format is that of the last thing that was accepted, and a change of it needs no notice.

use std::collections::VecDeque;

use aplomb::attitude::Quaternion;
use aplomb::health::{BoardFlags, Flags};
use aplomb::mpu6050::{Part, RawSample};
use aplomb::pipeline::{Pipeline, Snapshot};
use aplomb::serialize::StateReader;
use aplomb::settings::OutputFormat;
use aplomb::telemetry::log::{self, Frame, NumberedBurst};
use aplomb::telemetry::text::Line;
use aplomb::telemetry::{classic, teapot, teleplot, text};
use aplomb::units::degrees;
use mavlink::dialects::common::{MavMessage, MavSysStatusSensor};
use mavlink::{MAVLinkV2MessageRaw, MavlinkVersion, Message};

use crate::attitude_table::{Columns, Row};
use crate::flight_log::Collector;

/// A line that is longer is none of the module's; a status has up to 610 letters.
const LONGEST_LINE: usize = 1024;

/// Room for the longest frame of MAVLink 2, as the `mavlink` crate has it.
const MAVLINK_CAPACITY: usize = 283;

/// Bursts that are kept until the pieces of a state have come: they take a second or two.
const BURSTS_KEPT: usize = 8192;

/// A form in which attitudes come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// One of the module's.
    Module(OutputFormat),
    /// An attitude CSV, as `replay` and `fly` write it.
    Table,
}

impl Format {
    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Module(format) => format.name(),
            Self::Table => "attitude CSV",
        }
    }

    const fn has_lines(self) -> bool {
        matches!(
            self,
            Self::Table
                | Self::Module(OutputFormat::Text | OutputFormat::Classic | OutputFormat::Teleplot)
        )
    }
}

/// An attitude, as far as the format has it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Reading {
    /// The module's time, µs since its start.
    pub t_us: Option<u64>,
    /// Right wing down positive, degrees.
    pub roll_deg: f32,
    /// Nose up positive, degrees.
    pub pitch_deg: f32,
    /// Clockwise from above positive, degrees.
    pub yaw_deg: Option<f32>,
    /// Rates of roll, pitch and yaw in °/s: the body's own, except for `classic`, whose angles change so fast.
    pub rates_deg_s: [Option<f32>; 3],
    /// The module's flags.
    pub flags: Option<Flags>,
}

/// Which sensors the module calls healthy in SYS_STATUS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sensors {
    pub gyroscope: bool,
    pub accelerometer: bool,
    pub attitude: bool,
}

/// Something that was decoded.
#[derive(Debug, Clone, PartialEq)]
pub enum Item {
    /// An attitude.
    Reading(Reading),
    /// σ of the tilt, degrees.
    TiltSigma(f32),
    /// The die's temperature, °C.
    Temperature(f32),
    /// The module's judgement of its sensors.
    Sensors(Sensors),
    /// A message of the module.
    Message(String),
}

/// What came, in numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Attitudes.
    pub readings: u64,
    /// Bursts of the flight log.
    pub bursts: u64,
    /// What is missing by the numbers that bursts, packets and messages have.
    pub lost: u64,
    /// Pieces that are nothing in the present format.
    pub damaged: u64,
}

/// Decodes a stream.
#[derive(Default)]
pub struct Decoder {
    format: Option<Format>,
    counts: Counts,
    lines: Lines,
    packets: Packets,
    mavlink: Mavlink,
    log: Log,
}

impl Decoder {
    /// The format of what was decoded last.
    pub fn format(&self) -> Option<Format> {
        self.format
    }

    /// What came so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// The stream is interrupted: what follows does not continue it.
    pub fn interrupt(&mut self) {
        let Self { format, counts, .. } = *self;
        *self = Self {
            format,
            counts,
            ..Self::default()
        };
    }

    /// Takes the next bytes, and appends what they complete.
    pub fn push(&mut self, bytes: &[u8], items: &mut Vec<Item>) {
        for byte in bytes {
            let start = items.len();
            let found = self.take(*byte, items);
            if let Some(format) = found {
                if self.format.replace(format) != Some(format) {
                    self.leave_others(format);
                }
                if !format.has_lines() {
                    self.lines.restart();
                }
            }
            let is_reading = |item: &&Item| matches!(item, Item::Reading(_));
            self.counts.readings += items[start..].iter().filter(is_reading).count() as u64;
        }
    }

    /// What another format's numbers count from now on is not lost.
    fn leave_others(&mut self, format: Format) {
        if format != Format::Module(OutputFormat::Log) {
            self.log = Log::default();
        }
        if format != Format::Module(OutputFormat::Mavlink) {
            self.mavlink.sequence = None;
        }
        if format != Format::Module(OutputFormat::Teapot) {
            self.packets.counter = None;
        }
    }

    /// The format of what this byte completes.
    fn take(&mut self, byte: u8, items: &mut Vec<Item>) -> Option<Format> {
        let has_lines = self.format.is_none_or(Format::has_lines);
        let format = self.format;
        let counts = &mut self.counts;
        let module = |format| Some(Format::Module(format));
        if self.log.push(byte, counts, items) {
            return module(OutputFormat::Log);
        }
        // What is damaged in another format's eyes is not.
        let damaged = self.log.take_damaged();
        if format == module(OutputFormat::Log) {
            counts.damaged += damaged;
        }
        if self.mavlink.push(byte, counts, items) {
            return module(OutputFormat::Mavlink);
        }
        let damaged = self.mavlink.take_damaged();
        if format == module(OutputFormat::Mavlink) {
            counts.damaged += damaged;
        }
        if let Some((attitude, counter)) = self.packets.push(byte) {
            if let Some(last) = self.packets.counter.replace(counter) {
                counts.lost += u64::from(counter.wrapping_sub(last).wrapping_sub(1));
            }
            items.push(Item::Reading(Reading::of_attitude(attitude)));
            return module(OutputFormat::Teapot);
        }
        match self.lines.push(byte, items) {
            Some(Content::Attitude(format)) => return Some(format),
            Some(Content::Unknown) if has_lines && format.is_some() => counts.damaged += 1,
            Some(_) | None => {}
        }
        None
    }
}

impl Reading {
    fn of_attitude(attitude: Quaternion) -> Self {
        let angles = attitude.to_euler();
        Self {
            roll_deg: degrees(angles.roll_rad),
            pitch_deg: degrees(angles.pitch_rad),
            yaw_deg: Some(degrees(angles.yaw_rad)),
            ..Self::default()
        }
    }

    fn of_snapshot(snapshot: &Snapshot) -> Self {
        let rates = snapshot.body_rates_rad_s;
        Self {
            t_us: Some(snapshot.t_us),
            rates_deg_s: [rates.x, rates.y, rates.z].map(|rate| Some(degrees(rate))),
            flags: Some(snapshot.flags),
            ..Self::of_attitude(snapshot.attitude)
        }
    }

    fn of_row(row: &Row) -> Self {
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

    /// `told` are the flags that the module named last; whether an attitude is valid each line says.
    fn of_line(line: &Line, told: Flags) -> Self {
        let mut flags = told;
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

/// What a line was.
enum Content {
    Attitude(Format),
    /// A message, a part of an attitude, or nothing.
    Other,
    Unknown,
}

/// The flags that a message names, if it names any, as far as they last: those that have changed, or those of a status.
fn flags_of(message: &str) -> Option<Flags> {
    let names = message.strip_prefix("attitude: ").or_else(|| {
        let status = message.strip_prefix("ok status: flags=")?;
        status.split(' ').next()
    })?;
    let flags: Flags = names.parse().ok()?;
    Some(flags & (Flags::LASTING | Flags::CALIBRATING))
}

/// The formats that are lines of text.
#[derive(Default)]
struct Lines {
    bytes: Vec<u8>,
    /// Whether a line's beginning has been seen.
    is_in_step: bool,
    columns: Option<Columns>,
    /// The variables of `teleplot` so far.
    variables: Line,
    /// The flags that the module named last.
    told: Flags,
}

impl Lines {
    /// What follows is the beginning of a line, if it is one.
    fn restart(&mut self) {
        self.bytes.clear();
        self.is_in_step = true;
    }

    fn push(&mut self, byte: u8, items: &mut Vec<Item>) -> Option<Content> {
        match byte {
            b'\n' => {
                let was_in_step = std::mem::replace(&mut self.is_in_step, true);
                let bytes = std::mem::take(&mut self.bytes);
                let content = match std::str::from_utf8(&bytes) {
                    Ok(line) => self.line(line.trim_end_matches('\r'), items),
                    Err(_) => Content::Unknown,
                };
                self.bytes = bytes;
                self.bytes.clear();
                let is_half_line = !was_in_step && matches!(content, Content::Unknown);
                (!is_half_line).then_some(content)
            }
            // No text has a zero in it; after one, a line may begin, or something else goes on.
            0 => {
                self.bytes.clear();
                self.is_in_step = false;
                None
            }
            _ => {
                if self.bytes.len() < LONGEST_LINE {
                    self.bytes.push(byte);
                }
                None
            }
        }
    }

    fn line(&mut self, line: &str, items: &mut Vec<Item>) -> Content {
        let module = |format| Content::Attitude(Format::Module(format));
        if let Some(message) = line.strip_prefix("# ") {
            self.told = flags_of(message).unwrap_or(self.told);
            items.push(Item::Message(message.to_owned()));
            return Content::Other;
        }
        if let Ok(line) = text::decode(line) {
            self.attitude(&line, items);
            return module(OutputFormat::Text);
        }
        if let Some(angles) = classic::decode(line) {
            items.push(Item::Reading(Reading {
                roll_deg: angles.roll_deg,
                pitch_deg: angles.pitch_deg,
                rates_deg_s: [
                    Some(angles.roll_rate_deg_s),
                    Some(angles.pitch_rate_deg_s),
                    None,
                ],
                ..Reading::default()
            }));
            return module(OutputFormat::Classic);
        }
        if let Some((label, value)) = teleplot::decode(line) {
            return self.variable(label, value, items);
        }
        if let Some(columns) = Columns::of(line) {
            self.columns = Some(columns);
            return Content::Other;
        }
        if let Some(columns) = &self.columns
            && let Ok(row) = columns.row(line)
        {
            items.push(Item::Reading(Reading::of_row(&row)));
            items.extend(row.tilt_sigma_deg.map(Item::TiltSigma));
            return Content::Attitude(Format::Table);
        }
        if line.is_empty() {
            Content::Other
        } else {
            Content::Unknown
        }
    }

    fn attitude(&mut self, line: &Line, items: &mut Vec<Item>) {
        if line.is_valid && self.told.intersects(Flags::INVALIDATING) {
            // What was named is over.
            self.told = Flags::empty();
        }
        items.push(Item::Reading(Reading::of_line(line, self.told)));
    }

    /// The last one of each attitude completes it.
    fn variable(&mut self, label: &str, value: f32, items: &mut Vec<Item>) -> Content {
        let variables = &mut self.variables;
        match label {
            "roll" => variables.roll_deg = value,
            "pitch" => variables.pitch_deg = value,
            "yaw" => variables.yaw_deg = value,
            "roll_rate" => variables.roll_rate_deg_s = value,
            "pitch_rate" => variables.pitch_rate_deg_s = value,
            "yaw_rate" => variables.yaw_rate_deg_s = value,
            _ => {
                variables.is_valid = value == 1.0;
                let line = *variables;
                self.attitude(&line, items);
                return Content::Attitude(Format::Module(OutputFormat::Teleplot));
            }
        }
        Content::Other
    }
}

/// The teapot demo's packets.
#[derive(Default)]
struct Packets {
    window: [u8; teapot::PACKET_LENGTH],
    counter: Option<u8>,
}

impl Packets {
    fn push(&mut self, byte: u8) -> Option<(Quaternion, u8)> {
        self.window.rotate_left(1);
        self.window[teapot::PACKET_LENGTH - 1] = byte;
        if byte != b'\n' {
            return None;
        }
        let found = teapot::decode(&self.window)?;
        // It has no checksum, but an attitude has the length of one.
        let length = found.0.dot(found.0);
        (0.99..1.01).contains(&length).then_some(found)
    }
}

/// MAVLink 2 from the module.
#[derive(Default)]
struct Mavlink {
    bytes: Vec<u8>,
    sequence: Option<u8>,
    text: Vec<u8>,
    text_id: u16,
    damaged: u64,
}

impl Mavlink {
    const START: u8 = 0xFD;
    const OVERHEAD: usize = 12;
    const SIGNED: u8 = 1;

    /// Whether a frame ends with this byte. One that is found late, behind what looked like the start of another, does not:
    /// the byte may be one of another format.
    fn push(&mut self, byte: u8, counts: &mut Counts, items: &mut Vec<Item>) -> bool {
        if self.bytes.is_empty() && byte != Self::START {
            return false;
        }
        self.bytes.push(byte);
        let mut is_frame = false;
        while let [Self::START, length, flags, ..] = self.bytes[..] {
            let signature = if flags & Self::SIGNED != 0 { 13 } else { 0 };
            let whole = Self::OVERHEAD + usize::from(length) + signature;
            if self.bytes.len() < whole {
                break;
            }
            let mut frame = [0; MAVLINK_CAPACITY];
            frame[..whole].copy_from_slice(&self.bytes[..whole]);
            let raw = MAVLinkV2MessageRaw::from_bytes_unparsed(frame);
            let used = if raw.has_valid_crc::<MavMessage>() {
                is_frame = self.bytes.len() == whole;
                self.frame(&raw, counts, items);
                whole
            } else {
                self.damaged += 1;
                1
            };
            self.bytes.drain(..used);
            // What may be a frame begins at the next start.
            let next = self.bytes.iter().position(|byte| *byte == Self::START);
            self.bytes.drain(..next.unwrap_or(self.bytes.len()));
        }
        is_frame
    }

    fn take_damaged(&mut self) -> u64 {
        std::mem::take(&mut self.damaged)
    }

    fn frame(&mut self, raw: &MAVLinkV2MessageRaw, counts: &mut Counts, items: &mut Vec<Item>) {
        if let Some(last) = self.sequence.replace(raw.sequence()) {
            counts.lost += u64::from(raw.sequence().wrapping_sub(last).wrapping_sub(1));
        }
        let payload = raw.payload();
        let Ok(message) = MavMessage::parse(MavlinkVersion::V2, raw.message_id(), payload) else {
            return;
        };
        match message {
            MavMessage::ATTITUDE(attitude) => items.push(Item::Reading(Reading {
                t_us: Some(u64::from(attitude.time_boot_ms) * 1000),
                roll_deg: degrees(attitude.roll),
                pitch_deg: degrees(attitude.pitch),
                yaw_deg: Some(degrees(attitude.yaw)),
                rates_deg_s: [attitude.rollspeed, attitude.pitchspeed, attitude.yawspeed]
                    .map(|rate| Some(degrees(rate))),
                flags: None,
            })),
            MavMessage::HIGHRES_IMU(imu) => items.push(Item::Temperature(imu.temperature)),
            MavMessage::SYS_STATUS(status) => {
                let is_healthy = |sensor| status.onboard_control_sensors_health.contains(sensor);
                items.push(Item::Sensors(Sensors {
                    gyroscope: is_healthy(MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_GYRO),
                    accelerometer: is_healthy(MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_ACCEL),
                    attitude: is_healthy(MavSysStatusSensor::MAV_SYS_STATUS_AHRS),
                }));
            }
            MavMessage::STATUSTEXT(_) => self.text(payload, items),
            _ => {}
        }
    }

    /// A piece of a message: severity, 50 letters, which message, which piece; zeros at the end may be missing.
    fn text(&mut self, payload: &[u8], items: &mut Vec<Item>) {
        const LETTERS: std::ops::Range<usize> = 1..51;
        let letters = payload
            .get(LETTERS.start..payload.len().min(LETTERS.end))
            .unwrap_or_default();
        let at = |place: usize| payload.get(place).copied().unwrap_or_default();
        let id = u16::from_le_bytes([at(LETTERS.end), at(LETTERS.end + 1)]);
        if id == 0 || id != self.text_id {
            self.text.clear();
        }
        self.text_id = id;
        let end = letters.iter().position(|letter| *letter == 0);
        self.text.extend(&letters[..end.unwrap_or(letters.len())]);
        let is_last = id == 0 || end.is_some() || letters.len() < LETTERS.len();
        if is_last {
            let text = String::from_utf8_lossy(&std::mem::take(&mut self.text)).into_owned();
            items.push(Item::Message(text));
        }
    }
}

/// The flight log, with the filter that flies along to know its σ.
#[derive(Default)]
struct Log {
    decoder: log::Decoder,
    damaged: u64,
    part: Option<&'static Part>,
    pipeline: Option<Pipeline>,
    recent: VecDeque<NumberedBurst>,
    collector: Collector,
    /// What there is of a message whose last piece was full, so that another may follow.
    text: String,
}

impl Log {
    /// A piece of a message that is cut has at least so many bytes: it ends with a whole character.
    const FULL_PIECE: usize = log::TEXT_CAPACITY - 3;

    /// Whether a frame is complete.
    fn push(&mut self, byte: u8, counts: &mut Counts, items: &mut Vec<Item>) -> bool {
        match self.decoder.push(byte) {
            Some(frame) => {
                self.frame(frame, counts, items);
                true
            }
            None => false,
        }
    }

    fn take_damaged(&mut self) -> u64 {
        let damaged = self.decoder.counts().damaged;
        damaged - std::mem::replace(&mut self.damaged, damaged)
    }

    fn frame(&mut self, frame: Frame, counts: &mut Counts, items: &mut Vec<Item>) {
        // The pieces of a message come one right after the other.
        let is_text = matches!(frame, Frame::Text(_));
        if !is_text && !self.text.is_empty() {
            items.push(Item::Message(std::mem::take(&mut self.text)));
        }
        match frame {
            Frame::Configuration(configuration) => {
                self.part = Some(configuration.settings.part);
                match &mut self.pipeline {
                    Some(pipeline) => {
                        pipeline.set_calibration(&configuration.settings.calibration);
                    }
                    None => self.pipeline = Some(Pipeline::new(&configuration.settings)),
                }
            }
            Frame::Burst(burst) => self.burst(burst, counts),
            Frame::Attitude(snapshot) => {
                items.push(Item::Reading(Reading::of_snapshot(&snapshot)));
                if let Some(pipeline) = &self.pipeline {
                    let held = pipeline.stale(snapshot.t_us, BoardFlags::empty());
                    items.push(Item::TiltSigma(degrees(held.tilt_sigma_rad())));
                }
                if let (Some(part), Some(last)) = (self.part, self.recent.back()) {
                    let raw = RawSample::decode(&last.burst.bytes);
                    items.push(Item::Temperature(raw.temperature.to_celsius(part)));
                }
            }
            Frame::StatePiece(piece) => {
                if let Some((number, state)) = self.collector.add(&piece) {
                    self.start_over(number, &state);
                }
            }
            Frame::Text(piece) => {
                self.text += piece.as_str();
                if piece.as_str().len() < Self::FULL_PIECE {
                    items.push(Item::Message(std::mem::take(&mut self.text)));
                }
            }
            _ => {}
        }
    }

    fn burst(&mut self, burst: NumberedBurst, counts: &mut Counts) {
        counts.bursts += 1;
        if let Some(last) = self.recent.back() {
            match burst.number.checked_sub(last.number) {
                Some(step @ 1..) => counts.lost += u64::from(step - 1),
                // The module has started again.
                _ => {
                    self.recent.clear();
                    self.pipeline = None;
                }
            }
        }
        if self.recent.len() == BURSTS_KEPT {
            self.recent.pop_front();
        }
        self.recent.push_back(burst);
        if let Some(pipeline) = &mut self.pipeline {
            update(pipeline, &burst);
        }
    }

    /// Goes on from the module's own state, with the bursts that came after it.
    fn start_over(&mut self, number: u32, state: &[u8]) {
        let Some(mut pipeline) = self.pipeline else {
            return;
        };
        let mut reader = StateReader::new(state);
        pipeline.visit_state(&mut reader);
        if reader.is_complete() {
            for burst in self.recent.iter().filter(|burst| burst.number >= number) {
                update(&mut pipeline, burst);
            }
            self.pipeline = Some(pipeline);
        }
    }
}

/// Updates with a burst. The log does not hold the module's checks of the full scales: they are taken for right.
fn update(pipeline: &mut Pipeline, burst: &NumberedBurst) -> Snapshot {
    pipeline.update(&burst.burst, burst.flags | BoardFlags::SCALES_VERIFIED)
}

#[cfg(test)]
mod tests {
    use aplomb::attitude::{EulerAngles, Vector3};
    use aplomb::estimator::Sample;
    use aplomb::mpu6050::Burst;
    use aplomb::pipeline::Settings;
    use aplomb::telemetry::mavlink::{Session, Vehicle};
    use aplomb::telemetry::message::Severity;
    use aplomb::telemetry::{FRAME_CAPACITY, Output, encode};
    use aplomb::units::radians;
    use proptest::prelude::*;

    use super::*;
    use crate::flight_log::Recorder;

    fn snapshot() -> Snapshot {
        Snapshot {
            t_us: 2_000_000,
            attitude: Quaternion::from_euler(EulerAngles {
                roll_rad: radians(12.0),
                pitch_rad: radians(-5.0),
                yaw_rad: radians(40.0),
            }),
            body_rates_rad_s: Vector3::new(0.1, -0.2, 0.3),
            flags: Flags::VALID,
            tilt_variance_rad2: 1e-4,
        }
    }

    fn frame(format: OutputFormat, counter: u8) -> Vec<u8> {
        let mut frame = [0; FRAME_CAPACITY];
        encode(format, &snapshot(), counter, &mut frame).to_vec()
    }

    fn decode(decoder: &mut Decoder, bytes: &[u8]) -> Vec<Item> {
        let mut items = Vec::new();
        decoder.push(bytes, &mut items);
        items
    }

    fn readings(items: &[Item]) -> Vec<Reading> {
        let reading = |item: &Item| match item {
            Item::Reading(reading) => Some(*reading),
            _ => None,
        };
        items.iter().filter_map(reading).collect()
    }

    /// Frames of every format, lines, and noise; some with a byte changed.
    fn nearly_a_stream() -> impl Strategy<Value = Vec<u8>> {
        let formats = [
            OutputFormat::Text,
            OutputFormat::Teapot,
            OutputFormat::Classic,
            OutputFormat::Teleplot,
        ];
        let of_format = (prop::sample::select(formats.to_vec()), any::<u8>())
            .prop_map(|(format, counter)| frame(format, counter));
        let said = prop::option::of("[ -~é°]{0,120}");
        let of_session = said.prop_map(|said| mavlink(&mut Session::new(), said.as_deref()));
        let of_log =
            (any::<u32>(), any::<[u8; 14]>(), any::<u32>()).prop_map(|(number, bytes, flags)| {
                let captured_at_us = u64::from(number) * 1_000;
                let burst = Burst {
                    bytes,
                    captured_at_us,
                    missed_before: 0,
                };
                let flags = BoardFlags::from_bits_retain(flags);
                let configuration = log::Configuration {
                    revision: aplomb::estimator::REVISION,
                    from_number: number,
                    settings: Settings::new(&Part::MPU_6050),
                };
                let frames = [
                    Frame::Burst(NumberedBurst {
                        number,
                        flags,
                        burst,
                    }),
                    Frame::Configuration(configuration),
                    Frame::Attitude(snapshot()),
                    Frame::Text(log::Text::new("said")),
                ];
                let mut place = [0; log::FRAME_CAPACITY];
                log::encode(&frames[number as usize % 4], &mut place).to_vec()
            });
        let line = "# (attitude: |ok status: flags=)?[A-Z|]{0,20}( x=1)?\n|t_us,(qw,qx,qy,qz|roll_deg,pitch_deg,yaw_deg)(,flags)?\n|\
                    -?[0-9]{1,4}(,(1|0|nan)){3,4}(,VALID)?\n|>[a-z_]{3,5}:[0-9.]{1,5}\n|.{0,9}";
        let piece = prop_oneof![
            4 => of_format,
            2 => of_session,
            4 => of_log,
            4 => line.prop_map(String::into_bytes),
            1 => prop::collection::vec(any::<u8>(), 0..40),
        ];
        let change = prop::option::weighted(0.2, (any::<prop::sample::Index>(), any::<u8>()));
        let piece = (piece, change).prop_map(|(mut piece, change)| {
            if let Some((place, byte)) = change
                && !piece.is_empty()
            {
                let place = place.index(piece.len());
                piece[place] = byte;
            }
            piece
        });
        prop::collection::vec(piece, 0..20).prop_map(|pieces| pieces.concat())
    }

    proptest! {
        #[test]
        fn any_stream_is_decoded_alike_in_any_pieces_and_a_whole_line_is_found_after_it(
            stream in nearly_a_stream(),
            size in 1_usize..50,
        ) {
            let mut whole = Decoder::default();
            let mut items = decode(&mut whole, &stream);
            let mut pieces = Decoder::default();
            let in_pieces: Vec<Item> = stream
                .chunks(size)
                .flat_map(|piece| decode(&mut pieces, piece))
                .collect();
            // Numbers that are none are not equal to themselves, but look alike.
            prop_assert_eq!(format!("{items:?}"), format!("{in_pieces:?}"));
            prop_assert_eq!(whole.counts(), pieces.counts());
            prop_assert_eq!(whole.format(), pieces.format());
            items.retain(|item| matches!(item, Item::Reading(_)));
            prop_assert_eq!(items.len() as u64, whole.counts().readings);
            let next = [b"\n", &frame(OutputFormat::Text, 0)[..]].concat();
            let found = readings(&decode(&mut whole, &next));
            prop_assert!(found.last().is_some_and(|found| (found.roll_deg - 12.0).abs() < 0.02));
            prop_assert_eq!(whole.format(), Some(Format::Module(OutputFormat::Text)));
        }
    }

    /// The last σ.
    fn sigma_of(items: &[Item]) -> Option<f32> {
        items.iter().rev().find_map(|item| match item {
            Item::TiltSigma(sigma) => Some(*sigma),
            _ => None,
        })
    }

    fn mavlink(session: &mut Session, says: Option<&str>) -> Vec<u8> {
        let mut buffer = [0; 2000];
        let mut output = Output::new(&mut buffer);
        let vehicle = Vehicle {
            snapshot: Some(&snapshot()),
            sample: &Sample::default(),
            temperature_celsius: 31.5,
            record: &aplomb::settings::Record::default(),
            is_armed: false,
            bursts_failed: 0,
        };
        session.fill(2_000_000, &vehicle, &mut output);
        if let Some(text) = says {
            assert!(session.send_text(Severity::Information, text, &mut output));
        }
        let length = output.length();
        buffer[..length].to_vec()
    }

    #[test]
    fn every_format_of_a_frame_is_found_by_itself_and_so_are_changes() {
        let mut decoder = Decoder::default();
        for format in [
            OutputFormat::Text,
            OutputFormat::Teapot,
            OutputFormat::Classic,
            OutputFormat::Teleplot,
            OutputFormat::Text,
        ] {
            let items = decode(&mut decoder, &frame(format, 0));
            let [reading] = readings(&items)[..] else {
                panic!("{format:?}: {items:?}");
            };
            assert_eq!(decoder.format(), Some(Format::Module(format)));
            assert!((reading.roll_deg - 12.0).abs() < 0.02, "{reading:?}");
            assert!((reading.pitch_deg + 5.0).abs() < 0.02, "{reading:?}");
            let yaw = reading.yaw_deg;
            assert_eq!(yaw.is_some(), format != OutputFormat::Classic);
            assert!(yaw.is_none_or(|yaw| (yaw - 40.0).abs() < 0.02));
            let has_health = matches!(format, OutputFormat::Text | OutputFormat::Teleplot);
            assert_eq!(reading.flags, has_health.then_some(Flags::VALID));
        }
        assert_eq!(decoder.counts().damaged, 0);
        let items = decode(&mut decoder, &mavlink(&mut Session::new(), None));
        assert_eq!(
            decoder.format(),
            Some(Format::Module(OutputFormat::Mavlink))
        );
        assert!((readings(&items)[0].roll_deg - 12.0).abs() < 1e-3);
        assert!(items.contains(&Item::Temperature(31.5)));
    }

    #[test]
    fn text_says_whether_it_is_valid_and_a_message_why_it_is_not() {
        let mut decoder = Decoder::default();
        let said = "# attitude: VALID|DEGRADED|POLLED\nroll:1.00\tpitch:-2.50\tyaw:90.00\troll_rate:0.00\t\
                    pitch_rate:0.12\tyaw_rate:-3.00\tvalid:0\n";
        let items = decode(&mut decoder, said.as_bytes());
        let [reading] = readings(&items)[..] else {
            panic!("{items:?}");
        };
        assert_eq!(reading.flags, Some(Flags::DEGRADED | Flags::POLLED));
        // A status names them before anything changes, what has just happened too.
        let said = "# ok status: flags=CALIBRATING|MISSED|DEGRADED sensor=none\nroll:1.00\tpitch:-2.50\tyaw:90.00\t\
                    roll_rate:0.00\tpitch_rate:0.12\tyaw_rate:-3.00\tvalid:0\n";
        let items = decode(&mut decoder, said.as_bytes());
        let flags = Flags::CALIBRATING | Flags::DEGRADED;
        assert_eq!(readings(&items)[0].flags, Some(flags));
        // It is over when an attitude is valid.
        let items = decode(&mut decoder, &frame(OutputFormat::Text, 0));
        assert_eq!(readings(&items)[0].flags, Some(Flags::VALID));
        let items = decode(&mut decoder, b"# attitude: VALID\n");
        assert_eq!(items, [Item::Message("attitude: VALID".into())]);
        let items = decode(&mut decoder, &frame(OutputFormat::Text, 0));
        assert_eq!(readings(&items)[0].flags, Some(Flags::VALID));
    }

    #[test]
    fn a_frame_that_is_found_late_takes_no_line_with_it() {
        let mut decoder = Decoder::default();
        let heartbeat = &mavlink(&mut Session::new(), None)[..21];
        let line = frame(OutputFormat::Text, 0);
        // What begins like a frame is none only when its last byte is there, which is the line's.
        let length = (3 + heartbeat.len() + 1 + line.len() - Mavlink::OVERHEAD) as u8;
        let start = [Mavlink::START, length, 0];
        let items = decode(&mut decoder, &[&start, heartbeat, b"\n", &line].concat());
        assert_eq!(readings(&items).len(), 1);
        assert_eq!(decoder.format(), Some(Format::Module(OutputFormat::Text)));
    }

    #[test]
    fn losses_are_counted_by_the_numbers_that_frames_have() {
        let mut decoder = Decoder::default();
        for counter in [254, 255, 0, 3] {
            decode(&mut decoder, &frame(OutputFormat::Teapot, counter));
        }
        assert_eq!((decoder.counts().readings, decoder.counts().lost), (4, 2));
        let mut decoder = Decoder::default();
        let mut session = Session::new();
        decode(&mut decoder, &mavlink(&mut session, None));
        let mut bytes = mavlink(&mut session, None);
        // A byte of the first message is wrong.
        bytes[12] ^= 1;
        decode(&mut decoder, &bytes);
        assert_eq!((decoder.counts().lost, decoder.counts().damaged), (1, 1));
    }

    #[test]
    fn what_goes_by_in_another_format_is_not_lost() {
        let mut decoder = Decoder::default();
        let mut session = Session::new();
        let burst = |number| {
            let mut buffer = [0; log::FRAME_CAPACITY];
            let burst = Burst {
                bytes: [0; 14],
                captured_at_us: 1000 * u64::from(number),
                missed_before: 0,
            };
            let burst = NumberedBurst {
                number,
                flags: BoardFlags::empty(),
                burst,
            };
            log::encode(&Frame::Burst(burst), &mut buffer).to_vec()
        };
        for number in [0, 50, 100] {
            decode(&mut decoder, &burst(number));
            decode(&mut decoder, &frame(OutputFormat::Teapot, number as u8));
            decode(&mut decoder, &mavlink(&mut session, None));
            mavlink(&mut session, None);
            decode(&mut decoder, &frame(OutputFormat::Text, 0));
        }
        let counts = decoder.counts();
        assert_eq!((counts.bursts, counts.readings, counts.lost), (3, 9, 0));
    }

    #[test]
    fn a_long_message_comes_in_pieces() {
        let mut decoder = Decoder::default();
        let text = "z".repeat(120);
        let items = decode(&mut decoder, &mavlink(&mut Session::new(), Some(&text)));
        assert_eq!(items.last(), Some(&Item::Message(text)));
    }

    #[test]
    fn a_half_line_at_the_start_is_no_damage_and_a_wrong_one_later_is() {
        let mut decoder = Decoder::default();
        let mut bytes = b"_rate:1.00\n".to_vec();
        bytes.extend(frame(OutputFormat::Text, 0));
        let items = decode(&mut decoder, &bytes);
        assert_eq!((readings(&items).len(), decoder.counts().damaged), (1, 0));
        decode(&mut decoder, b"roll:1.00\tpi\n# a message\r\n\n");
        assert_eq!(decoder.counts().damaged, 1);
    }

    #[test]
    fn a_log_gives_attitudes_sigma_and_what_is_missing() {
        let settings = Settings::new(&Part::MPU_6050);
        let mut recorder = Recorder::new(Vec::new(), Pipeline::new(&settings), 0);
        // Level and face up, at rest: 1 g along z at 2048 counts each.
        let mut bytes = [0; 14];
        bytes[4..6].copy_from_slice(&2048_i16.to_be_bytes());
        let mut pipeline = Pipeline::new(&settings);
        let mut sigma_rad = f32::NAN;
        for index in 0..12_000_u64 {
            // The last bit trembles, as in any sensor that lives.
            bytes[9] = (index * 7 % 5) as u8;
            let burst = Burst {
                bytes,
                captured_at_us: 1000 * index,
                missed_before: 0,
            };
            recorder
                .add(&burst, BoardFlags::empty())
                .expect("a vector takes everything");
            if index <= 11_980 {
                sigma_rad = update(
                    &mut pipeline,
                    &NumberedBurst {
                        number: index as u32,
                        flags: BoardFlags::empty(),
                        burst,
                    },
                )
                .tilt_sigma_rad();
            }
        }
        let log = recorder.into_inner();
        let mut decoder = Decoder::default();
        let items = decode(&mut decoder, &log);
        assert_eq!(decoder.format(), Some(Format::Module(OutputFormat::Log)));
        let counts = decoder.counts();
        assert_eq!(
            (counts.readings, counts.bursts, counts.lost, counts.damaged),
            (600, 12_000, 0, 0)
        );
        let sigma = sigma_of(&items);
        let expected = degrees(sigma_rad);
        assert_eq!(sigma, Some(expected));
        // Begun in the middle: the module's next state, ten seconds after its start, brings the same σ.
        assert_eq!(
            sigma_of(&decode(&mut Decoder::default(), &log[log.len() / 2..])),
            sigma
        );
        // A hole in it, from the middle of a frame to the middle of another.
        let mut decoder = Decoder::default();
        decode(&mut decoder, &log[..40_000]);
        decode(&mut decoder, &log[42_000..]);
        let counts = decoder.counts();
        assert_eq!(counts.lost, 12_000 - counts.bursts);
        assert!(counts.lost > 40 && counts.damaged >= 1, "{counts:?}");
    }

    #[test]
    fn a_message_in_the_log_is_put_together() {
        for length in [5, 238, 300, 476, 500] {
            let text = "°".repeat(length / 2);
            let mut buffer = [0; 1000];
            let mut output = Output::new(&mut buffer);
            assert!(log::put_text(&text, &mut output));
            log::put_attitude(&snapshot(), &mut output);
            let end = output.length();
            let items = decode(&mut Decoder::default(), &buffer[..end]);
            assert_eq!(items[0], Item::Message(text));
            assert_eq!(readings(&items[1..]).len(), 1);
        }
    }

    #[test]
    fn an_attitude_table_is_read_by_its_columns() {
        let mut decoder = Decoder::default();
        let table = "t_us,qw,roll_deg,pitch_deg,yaw_deg,tilt_sigma_deg,flags\n\
                     1000,1,1.5,-2,3,0.5,VALID|MISSED\n\
                     2000,1,1.5,-2,x,0.5,\n";
        let items = decode(&mut decoder, table.as_bytes());
        let flags = Flags::VALID | Flags::MISSED;
        assert_eq!(
            items,
            [
                Item::Reading(Reading {
                    t_us: Some(1000),
                    roll_deg: 1.5,
                    pitch_deg: -2.0,
                    yaw_deg: Some(3.0),
                    rates_deg_s: [None; 3],
                    flags: Some(flags)
                }),
                Item::TiltSigma(0.5)
            ]
        );
        assert_eq!(decoder.counts().damaged, 1);
    }
}
