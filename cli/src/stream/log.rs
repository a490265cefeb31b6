//! Flight log, with the filter that runs along to know its σ.

use std::collections::VecDeque;

use aplomb::estimator::heading::HeadingEstimate;
use aplomb::health::BoardFlags;
use aplomb::mpu6050::{Part, RawSample};
use aplomb::pipeline::{Pipeline, Snapshot};
use aplomb::serialize::StateReader;
use aplomb::telemetry::heading;
use aplomb::telemetry::log::{self, Frame, NumberedBurst};
use aplomb::units::degrees;
use aplomb_recordings::flight_log::{StateCollector, TextJoiner, is_new_start};

use super::item::{Attitude, Counts, Item};

/// Bursts that are kept until the pieces of a state have come: they take a second or two.
const BURSTS_KEPT: usize = 8192;

/// Decoder of the flight log, with the filter that runs along to know its σ.
#[derive(Default)]
pub struct Log {
    decoder: log::Decoder,
    damaged: u64,
    part: Option<&'static Part>,
    pipeline: Option<Pipeline>,
    recent: VecDeque<NumberedBurst>,
    heading: Option<HeadingEstimate>,
    collector: StateCollector,
    joiner: TextJoiner,
}

impl Log {
    /// Takes a byte, and returns whether it completes a frame.
    pub fn push(&mut self, byte: u8, counts: &mut Counts, items: &mut Vec<Item>) -> bool {
        match self.decoder.push(byte) {
            Some(frame) => {
                self.frame(frame, counts, items);
                true
            }
            None => false,
        }
    }

    /// Returns the damaged pieces since the last call.
    pub fn take_damaged(&mut self) -> u64 {
        let damaged = self.decoder.counts().damaged;
        damaged - std::mem::replace(&mut self.damaged, damaged)
    }

    fn frame(&mut self, frame: Frame, counts: &mut Counts, items: &mut Vec<Item>) {
        let message = match &frame {
            Frame::Text(piece) => self.joiner.add(piece),
            _ => self.joiner.end(),
        };
        items.extend(message.map(Item::Message));
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
                items.push(Item::Attitude(Attitude::of_snapshot(&snapshot)));
                if let Some(heading) = &self.heading {
                    items.push(Item::Heading(heading::Line::new(&snapshot, heading)));
                }
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
                    self.restore(number, &state);
                }
            }
            Frame::Heading(heading) => self.heading = heading.estimate,
            _ => {}
        }
    }

    fn burst(&mut self, burst: NumberedBurst, counts: &mut Counts) {
        counts.bursts += 1;
        if let Some(last) = self.recent.back() {
            if is_new_start((last.number, last.burst.captured_at_us), &burst) {
                self.recent.clear();
                self.pipeline = None;
                self.heading = None;
            } else {
                counts.lost += u64::from(burst.number - last.number - 1);
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

    /// Continues from the module's own state, with the bursts that came after it.
    fn restore(&mut self, number: u32, state: &[u8]) {
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

/// Updates with a burst. The log does not hold the module's checks of the full scales, so they
/// count as passed.
pub fn update(pipeline: &mut Pipeline, burst: &NumberedBurst) -> Snapshot {
    pipeline.update(&burst.burst, burst.flags | BoardFlags::SCALES_VERIFIED)
}
