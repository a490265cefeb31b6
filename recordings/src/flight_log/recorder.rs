//! Recorder of flight logs: bursts and readings of a compass as the module would log them.

use std::io::Write;

use aplomb::estimator::heading::{CompassKnowledge, Heading, HeadingEstimate};
use aplomb::health::BoardFlags;
use aplomb::mpu6050::Burst;
use aplomb::pipeline::{CompassReading, Pipeline, Snapshot};
use aplomb::telemetry::Output;
use aplomb::telemetry::log::{FRAME_CAPACITY, NumberedBurst, Sender, TimedHeading, put_attitude};
use aplomb::units::MagneticField;

/// Bursts from one logged attitude to the next.
const BURSTS_PER_ATTITUDE: u32 = 20;

/// Writes bursts as the module would log them, with this pipeline.
#[derive(Debug)]
pub struct Recorder<W> {
    output: W,
    sender: Sender,
    pipeline: Pipeline,
    is_armed: bool,
    number: u32,
    /// Time of the last burst, µs.
    now_us: u64,
    /// Heading filter, from the first reading on.
    heading: Option<Heading>,
    /// Time and number of the last change of the heading.
    changed: Option<(u64, u8)>,
    readings: u32,
    declination_rad: f32,
}

impl<W: Write> Recorder<W> {
    /// Creates a recorder whose first burst has this number.
    pub fn new(output: W, pipeline: Pipeline, next_number: u32) -> Self {
        Self {
            output,
            sender: Sender::new(next_number),
            pipeline,
            is_armed: false,
            number: next_number,
            now_us: 0,
            heading: None,
            changed: None,
            readings: 0,
            declination_rad: 0.0,
        }
    }

    /// Arms (`true`) or disarms the filter before the next burst. A change begins new settings in
    /// the log, as on the module.
    pub fn set_armed(&mut self, is_armed: bool) {
        if self.is_armed != is_armed {
            self.is_armed = is_armed;
            self.pipeline.set_armed(is_armed);
            self.sender.restart(self.number);
        }
    }

    /// Sets the declination, rad, east positive, from the next reading on.
    pub fn set_declination(&mut self, declination_rad: f32) {
        self.declination_rad = declination_rad;
    }

    /// Returns whether the sensor's full scales have to be read back; see
    /// [`Pipeline::awaits_scale_check`].
    pub const fn awaits_scale_check(&self) -> bool {
        self.pipeline.awaits_scale_check()
    }

    /// Adds a burst with the conditions that the board reported, and returns the attitude at its
    /// time.
    ///
    /// # Errors
    ///
    /// Returns the error of a failed write.
    pub fn add(&mut self, burst: &Burst, flags: BoardFlags) -> std::io::Result<Snapshot> {
        let now_us = burst.captured_at_us;
        self.now_us = now_us;
        if self.sender.wants_heading() {
            let heading = self.heading.as_ref();
            self.sender
                .copy_heading(heading, self.readings, self.number);
            self.sender.measure_state(now_us);
        } else if self.sender.wants_state(now_us) {
            self.sender.copy_state(&self.pipeline, self.number);
            self.sender.measure_state(now_us);
        }
        let mut burst_to_send = Some(NumberedBurst {
            number: self.number,
            flags,
            burst: *burst,
        });
        let mut buffer = [0; 8 * FRAME_CAPACITY];
        let mut output = Output::new(&mut buffer);
        self.sender
            .fill(now_us, &mut output, || burst_to_send.take(), || None);
        let snapshot = self.pipeline.update(burst, flags);
        if let Some(heading) = &mut self.heading {
            self.pipeline.update_heading(heading);
            let changes = heading.changes();
            if self.changed.is_none_or(|(_, known)| known != changes) {
                self.changed = Some((now_us, changes));
            }
        }
        if self.number.is_multiple_of(BURSTS_PER_ATTITUDE) {
            put_attitude(&snapshot, &mut output);
            if let Some((t_us, _)) = self.changed {
                let estimate = self.heading();
                self.sender
                    .put_heading(now_us, TimedHeading { t_us, estimate }, &mut output);
            }
        }
        self.number += 1;
        let length = output.length();
        self.output.write_all(&buffer[..length])?;
        Ok(snapshot)
    }

    /// Adds a reading of a compass in body axes, corrected as `knowledge` states, after the last
    /// burst. `measured_us` is the time of the middle of the measurement, µs.
    ///
    /// # Errors
    ///
    /// Returns the error of a failed write.
    pub fn add_reading(
        &mut self,
        field: MagneticField,
        measured_us: u32,
        knowledge: CompassKnowledge,
    ) -> std::io::Result<()> {
        let mut reading = Some(CompassReading {
            number: self.readings,
            sample_t_us: self.now_us,
            measured_us,
            field,
            knowledge,
            declination_rad: self.declination_rad,
            starts_filter: self.heading.is_none(),
        });
        self.readings += 1;
        let age_us = self.pipeline.reading_age_us(measured_us);
        let heading = self.heading.get_or_insert_with(|| Heading::new(knowledge));
        if heading.declination_rad() != self.declination_rad {
            heading.set_declination(self.declination_rad);
        }
        heading.add_field(field, age_us);
        let mut buffer = [0; 8 * FRAME_CAPACITY];
        let mut output = Output::new(&mut buffer);
        self.sender
            .fill(self.now_us, &mut output, || None, || reading.take());
        let length = output.length();
        self.output.write_all(&buffer[..length])
    }

    /// Returns the heading; `None` while it is unknown.
    pub fn heading(&self) -> Option<HeadingEstimate> {
        self.heading.as_ref().and_then(Heading::estimate)
    }

    /// Returns the writer.
    pub fn into_inner(self) -> W {
        self.output
    }
}
