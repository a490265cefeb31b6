//! State of the filter for flight logs.

use super::{Heading, HeadingEstimate};
use crate::serialize::StateVisitor;

impl Heading {
    /// Visits every field but the tuning, which is static.
    pub fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        self.knowledge.visit_state(visitor);
        self.next_slice.visit_state(visitor);
        let mut open = usize::from(self.open);
        visitor.index(&mut open, 2);
        self.open = open as u8;
        visitor.bool(&mut self.has_interval);
        visitor.bool(&mut self.has_reading);
        visitor.f32s(&mut self.reading_ut);
        visitor.f32(&mut self.reading_age_s);
        visitor.f32(&mut self.declination_rad);
        visitor.f32(&mut self.elapsed_s);
        visitor.f32s(&mut self.state);
        self.intervals.visit_state(visitor);
        self.covariance.visit_state(visitor);
        visitor.f32s(&mut self.cross_scratch);
        visitor.f32s(&mut self.own_scratch);
        for field in [
            &mut self.late_turn_rad,
            &mut self.inverse_variance,
            &mut self.expected_ut2,
            &mut self.noise_ut2,
            &mut self.drift_rad_s,
            &mut self.motion,
            &mut self.excess,
            &mut self.contradiction,
            &mut self.inconsistency,
            &mut self.contradicted_s,
            &mut self.silent_s,
            &mut self.verified_s,
            &mut self.since_first_s,
        ] {
            visitor.f32(field);
        }
        visitor.bool(&mut self.has_started);
        visitor.u64(&mut self.updated_us);
        visitor.u8(&mut self.changes);
        visitor.quaternion(&mut self.first_attitude);
        visitor.vector(&mut self.largest_turn);
        visitor.bool(&mut self.has_two_axes);
        visitor.bool(&mut self.is_iron_known);
        let blank = HeadingEstimate {
            yaw_offset_rad: 0.0,
            sigma_rad: 0.0,
            is_valid: false,
        };
        visitor.optional(&mut self.estimate, blank, |visitor, estimate| {
            visitor.f32(&mut estimate.yaw_offset_rad);
            visitor.f32(&mut estimate.sigma_rad);
            visitor.bool(&mut estimate.is_valid);
        });
    }
}
