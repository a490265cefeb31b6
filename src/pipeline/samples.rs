//! Samples in SI units: the steps of a burst without those that need the sensor's bytes.

use super::{Pipeline, Snapshot};
use crate::estimator::Sample;
#[cfg(not(feature = "firmware"))]
use crate::health::Sampling;
use crate::health::{BoardFlags, Flags};

impl Pipeline {
    /// Processes one calibrated sample in body axes, such as from a recording in SI units. Returns
    /// the attitude at the sample's time. Times increase, as for [`update`](Self::update).
    ///
    /// Applies no calibration and no mount: [`calibrated_sample`](Self::calibrated_sample) does.
    /// The calibration of the settings counts as applied already.
    ///
    /// Skips the checks that need the sensor's bytes: blank data and the temperature. Frozen data
    /// and a stuck axis are flagged [`Flags::FROZEN`] only after a rest of 200 samples, one in each
    /// 1/bandwidth. Their noise shows that the values do not repeat for another reason. With a
    /// feature `board-…` neither they nor late samples are checked: the firmware takes bursts.
    pub fn update_sample(&mut self, sample: &Sample) -> Snapshot {
        self.update_sample_with(sample, BoardFlags::empty())
    }

    /// Processes one sample like [`update_sample`](Self::update_sample), with the conditions that
    /// the board reports, as [`update`](Self::update) takes them with a burst.
    ///
    /// With [`Settings::verifies_scales`](super::Settings::verifies_scales) no attitude is valid
    /// after a jump of the rate, until a sample brings [`BoardFlags::SCALES_VERIFIED`].
    pub fn update_sample_with(&mut self, sample: &Sample, board: BoardFlags) -> Snapshot {
        let flags = Flags::from(board);
        self.take_scale_check(board);
        #[cfg(not(feature = "firmware"))]
        if self.is_late(sample.t_us) {
            return self.skip(sample.t_us, flags | Flags::TIME);
        }
        #[cfg(not(feature = "firmware"))]
        if self.is_frozen(sample) {
            // Frozen rates have turned the attitude for a while.
            self.kalman_mut().lose_tilt();
            return self.skip(sample.t_us, flags | Flags::FROZEN);
        }
        if board.contains(BoardFlags::INTERNAL_CLOCK) {
            self.follow_sensor_clock(sample.t_us, board);
        }
        self.process(sample, flags)
    }

    #[cfg(not(feature = "firmware"))]
    #[inline]
    fn is_frozen(&mut self, sample: &Sample) -> bool {
        let values = [&sample.specific_force_m_s2, &sample.angular_rate_rad_s];
        let is_saturated = [sample.is_force_saturated, sample.is_rate_saturated];
        let sensor = &self.settings.sensor;
        let sampling = || Sampling {
            rate_hz: sensor.sample_rate_hz(),
            bandwidth_hz: sensor.low_pass.gyroscope_bandwidth_hz(),
        };
        (self.sample_monitor).is_frozen(values, is_saturated, sampling)
    }
}
