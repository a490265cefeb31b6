//! Properties of the sensor that is monitored.

/// Properties of a sensor that a [`Monitor`](super::Monitor) needs.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MonitoredSensor {
    /// Sample rate, Hz.
    pub sample_rate_hz: f32,
    /// Bandwidth of the gyroscope's low-pass filter, Hz.
    pub bandwidth_hz: u16,
    /// Sensitivity of the accelerometer, counts per g.
    pub counts_per_g: f32,
    /// Sensitivity of the gyroscope, counts per °/s.
    pub counts_per_degree_s: f32,
    /// Scale of the temperature, °C per count.
    pub celsius_per_count: f32,
    /// Temperature at zero counts, °C.
    pub celsius_at_zero: f32,
}

impl MonitoredSensor {
    /// An MPU-6050 at 1 kHz, ±16 g and ±2000 °/s, with its filter of 188 Hz.
    pub const MPU_6050: Self = Self {
        sample_rate_hz: 1_000.0,
        bandwidth_hz: 188,
        counts_per_g: 2048.0,
        counts_per_degree_s: 16.4,
        celsius_per_count: 1.0 / 340.0,
        celsius_at_zero: 36.53,
    };
}
