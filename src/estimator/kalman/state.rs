//! State of the filter for flight logs.

use super::propagation::PARAMETERS;
use super::{Kalman, Tilt};
use crate::serialize::StateVisitor;

impl Kalman {
    /// Visits every field but the tuning, which is static. The pattern names all fields, so a new
    /// one does not compile before it is here.
    pub(crate) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let Self {
            tuning: _,
            delay_s,
            pause_after_s,
            long_after_s,
            saturated_s,
            rate_saturated_s,
            is_armed,
            tilt,
            is_step_pending,
            is_tilt_checked,
            is_bias_known,
            has_rested,
            is_first_rest,
            last_measured_axis,
            last_relaxed,
            has_measured_prior,
            confirmation,
            is_from_one_sample,
            nominal_tilt_rad2,
            steady_until_s,
            rested_s,
            nominal,
            interval,
            rest_detector,
            recent,
            consistency,
            bias_prior,
            force_sum,
            parameter_priors,
            rest_watch,
            extra_tilt_rad2,
            step,
            added_bias_walk,
        } = self;
        visitor.f32(delay_s);
        visitor.f32(pause_after_s);
        visitor.f32(long_after_s);
        visitor.f32(saturated_s);
        visitor.f32(rate_saturated_s);
        visitor.bool(is_armed);
        tilt.visit_state(visitor);
        visitor.bool(is_step_pending);
        visitor.bool(is_tilt_checked);
        visitor.bool(is_bias_known);
        visitor.bool(has_measured_prior);
        confirmation.visit_state(visitor);
        visitor.bool(has_rested);
        visitor.bool(is_first_rest);
        visitor.bool(is_from_one_sample);
        nominal.visit_state(visitor);
        step.visit_state(visitor);
        interval.visit_state(visitor);
        rest_detector.visit_state(visitor);
        recent.visit_state(visitor);
        consistency.visit_state(visitor);
        rest_watch.visit_state(visitor);
        visitor.f32(extra_tilt_rad2);
        visitor.f32(added_bias_walk);
        parameter_priors.visit_state(visitor);
        bias_prior.visit_state(visitor);
        force_sum.visit_state(visitor);
        visit_index(visitor, last_measured_axis, 3);
        visit_index(visitor, last_relaxed, PARAMETERS);
        visitor.f32(nominal_tilt_rad2);
        visitor.f32(steady_until_s);
        visitor.f32(rested_s);
    }
}

fn visit_index(visitor: &mut impl StateVisitor, value: &mut u8, end: usize) {
    let mut index = usize::from(*value);
    visitor.index(&mut index, end);
    *value = index as u8;
}

impl Tilt {
    /// Visits the variant, as its number.
    fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let mut number = *self as usize;
        visitor.index(&mut number, 4);
        *self = match number {
            0 => Self::Unknown,
            1 => Self::Restarting,
            2 => Self::Lost,
            _ => Self::Known,
        };
    }
}
