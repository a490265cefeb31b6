//! Recorder of flight logs: bursts as the module would log them.

use std::io::Write;

use aplomb::health::BoardFlags;
use aplomb::mpu6050::Burst;
use aplomb::pipeline::{Pipeline, Snapshot};
use aplomb::telemetry::Output;
use aplomb::telemetry::log::{FRAME_CAPACITY, NumberedBurst, Sender, put_attitude};

/// Bursts from one logged attitude to the next.
const BURSTS_PER_ATTITUDE: u32 = 20;

/// Writes bursts as the module would log them, with this pipeline.
#[derive(Debug)]
pub struct Recorder<W> {
    output: W,
    sender: Sender,
    pipeline: Pipeline,
    number: u32,
}

impl<W: Write> Recorder<W> {
    /// Creates a recorder whose first burst has this number.
    pub fn new(output: W, pipeline: Pipeline, next_number: u32) -> Self {
        Self {
            output,
            sender: Sender::new(next_number),
            pipeline,
            number: next_number,
        }
    }

    /// Adds a burst with the conditions that the board reported, and returns the attitude at its
    /// time.
    ///
    /// # Errors
    ///
    /// Returns the error of a failed write.
    pub fn add(&mut self, burst: &Burst, flags: BoardFlags) -> std::io::Result<Snapshot> {
        let now_us = burst.captured_at_us;
        if self.sender.wants_state(now_us) {
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
            .fill(now_us, &mut output, || burst_to_send.take());
        let snapshot = self.pipeline.update(burst, flags);
        if self.number.is_multiple_of(BURSTS_PER_ATTITUDE) {
            put_attitude(&snapshot, &mut output);
        }
        self.number += 1;
        let length = output.length();
        self.output.write_all(&buffer[..length])?;
        Ok(snapshot)
    }

    /// Returns the writer.
    pub fn into_inner(self) -> W {
        self.output
    }
}
