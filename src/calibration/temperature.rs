//! Temperature fit: the gyroscope's offset over the die temperature, a parabola through points at
//! rest.
//!
//! Each point (die temperature, offset) measures offset + slope·t + curvature·t². A learner
//! keeps the normal equations of the least squares, which do not grow with the points. The
//! datasheet's limits are the prior, so that few points give a flat line and not a wild one. The
//! learner gives a model only where its own σ is small at both ends of the range it will be used
//! in.
//!
//! ```
//! use aplomb::attitude::Vector3;
//! use aplomb::calibration::temperature::TemperatureLearner;
//!
//! let mut learner = TemperatureLearner::new();
//! for step in 0..40_u8 {
//!     // A warm-up from 20 °C; the X axis drifts by 0.001 rad/s per °C.
//!     let celsius = 20.0 + 0.5 * f32::from(step);
//!     let offset_rad_s = Vector3::new(0.001 * (celsius - 20.0), 0.0, 0.0);
//!     learner.add(celsius, offset_rad_s, 0.0001);
//! }
//! let model = learner.fit()?;
//! let (offset, weight) = model.offset_at(30.0);
//! assert!((offset.x - 0.01).abs() < 0.0002 && weight == 1.0);
//! # Ok::<(), aplomb::calibration::temperature::InsufficientData>(())
//! ```

use core::fmt;
use core::ops::RangeInclusive;

use super::matrix::SymmetricMatrix;
use super::model::{TRUSTED_BEYOND_CELSIUS, TemperatureModel};
use crate::attitude::Vector3;
use crate::units::radians;

/// Distance in temperature below which measurements are one point, °C, so that an hour at one
/// temperature does not outweigh a warm-up.
const POINT_CELSIUS: f32 = 0.5;
/// σ of an offset beyond its noise, rad/s: it changes from day to day and with the pose
/// (0.1 °/s per g, product specification §6.1).
const POINT_SIGMA_RAD_S: f32 = radians(0.03);
/// Prior σ of the slope, rad/s per °C: ±20 °/s over −40 to 85 °C (ibidem) is 0.16 °/s per
/// °C at most.
const SLOPE_SIGMA: f32 = radians(0.1);
/// Prior σ of the curvature, rad/s per °C².
const CURVATURE_SIGMA: f32 = radians(0.002);
/// Largest σ of a useful model at the ends of its range, rad/s.
const USEFUL_SIGMA_RAD_S: f32 = radians(0.15);
/// Unit of temperature in the equations, °C, which keeps their numbers near one.
const UNIT_CELSIUS: f32 = 10.0;

/// Accumulates measurements at rest and fits a [`TemperatureModel`] to them.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TemperatureLearner {
    /// Temperature of the first point, °C.
    reference_celsius: Option<f32>,
    /// Σw, Σwt, Σwt², Σwt³, Σwt⁴ with t in units of `UNIT_CELSIUS` from the reference.
    moments: [f32; 5],
    /// Σw·offset, Σwt·offset, Σwt²·offset.
    sums: [Vector3; 3],
    coldest_celsius: f32,
    warmest_celsius: f32,
    /// Point that still takes measurements.
    open: Point,
    /// Closed points.
    points: u16,
}

/// Weighted mean of measurements at about one temperature.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Point {
    /// Temperature of its first measurement, °C.
    first_celsius: f32,
    weight: f32,
    celsius: f32,
    offset_rad_s: Vector3,
}

impl Default for TemperatureLearner {
    fn default() -> Self {
        Self::new()
    }
}

impl TemperatureLearner {
    /// Creates a learner without measurements.
    pub const fn new() -> Self {
        Self {
            reference_celsius: None,
            moments: [0.0; 5],
            sums: [Vector3::ZERO; 3],
            coldest_celsius: f32::INFINITY,
            warmest_celsius: f32::NEG_INFINITY,
            open: Point {
                first_celsius: 0.0,
                weight: 0.0,
                celsius: 0.0,
                offset_rad_s: Vector3::ZERO,
            },
            points: 0,
        }
    }

    /// Creates a learner that continues from a stored model: with three points of its curve.
    pub fn from_model(model: &TemperatureModel) -> Self {
        let mut learner = Self::new();
        learner.keep_beyond(model);
        learner
    }

    /// Keeps a stored model where it reaches beyond the range of the measurements: adds its middle
    /// and its ends as points. Within that range the measurements replace it. Check before that
    /// the measurements are enough for a [`fit`](Self::fit): the added points are no measurements.
    pub fn keep_beyond(&mut self, stored: &TemperatureModel) {
        let middle = 0.5 * (stored.coldest_celsius + stored.warmest_celsius);
        for celsius in [middle, stored.coldest_celsius, stored.warmest_celsius] {
            if celsius < self.coldest_celsius || celsius > self.warmest_celsius {
                self.add(celsius, stored.offset_at(celsius).0, 0.0);
            }
        }
    }

    /// Adds an offset that was measured at rest, with its σ (rad/s in sensor axes) and the die
    /// temperature (°C). Ignores values that are not finite.
    pub fn add(&mut self, temperature_celsius: f32, offset_rad_s: Vector3, sigma_rad_s: f32) {
        let is_number = temperature_celsius.abs() <= 200.0
            && offset_rad_s.is_within(radians(2000.0))
            && sigma_rad_s.abs() <= radians(2000.0);
        if !is_number {
            return;
        }
        let change_celsius = temperature_celsius - self.open.first_celsius;
        if change_celsius.abs() > POINT_CELSIUS {
            self.close_point();
        }
        if self.open.weight <= 0.0 {
            self.open.first_celsius = temperature_celsius;
        }
        self.coldest_celsius = self.coldest_celsius.min(temperature_celsius);
        self.warmest_celsius = self.warmest_celsius.max(temperature_celsius);
        let weight = (POINT_SIGMA_RAD_S * POINT_SIGMA_RAD_S)
            / (POINT_SIGMA_RAD_S * POINT_SIGMA_RAD_S + sigma_rad_s * sigma_rad_s);
        let open = &mut self.open;
        let total = open.weight + weight;
        let share = weight / total;
        open.celsius += share * (temperature_celsius - open.celsius);
        open.offset_rad_s = open.offset_rad_s + (offset_rad_s - open.offset_rad_s).scale(share);
        // The uncertainty of a point does not average out, however long it lasts.
        open.weight = total.min(1.0);
    }

    /// Fits a model to the measurements.
    ///
    /// # Errors
    ///
    /// Returns [`InsufficientData`] if the model's σ at an end of its range is above 0.15 °/s.
    pub fn fit(&self) -> Result<TemperatureModel, InsufficientData> {
        let mut all = *self;
        all.close_point();
        all.solve()
    }

    /// Returns the number of points: temperatures half a degree apart.
    pub const fn points(&self) -> u16 {
        self.points + (self.open.weight > 0.0) as u16
    }

    /// Returns the range of measured temperatures, °C.
    pub fn range_celsius(&self) -> Option<RangeInclusive<f32>> {
        (self.points() > 0).then_some(self.coldest_celsius..=self.warmest_celsius)
    }

    /// Adds the open point to the equations.
    fn close_point(&mut self) {
        let Point {
            weight,
            celsius,
            offset_rad_s,
            ..
        } = core::mem::take(&mut self.open);
        if weight <= 0.0 {
            return;
        }
        let reference = *self.reference_celsius.get_or_insert(celsius);
        let t = (celsius - reference) / UNIT_CELSIUS;
        let mut power = weight;
        for moment in &mut self.moments {
            *moment += power;
            power *= t;
        }
        let mut power = weight;
        for sum in &mut self.sums {
            *sum = *sum + offset_rad_s.scale(power);
            power *= t;
        }
        self.points = self.points.saturating_add(1);
    }

    /// Solves the normal equations with their prior.
    fn solve(&self) -> Result<TemperatureModel, InsufficientData> {
        let insufficient = InsufficientData {
            points: self.points,
            range_celsius: (self.warmest_celsius - self.coldest_celsius).max(0.0),
        };
        let Some(reference_celsius) = self.reference_celsius else {
            return Err(insufficient);
        };
        let inverse_variance = |sigma: f32| {
            let ratio = POINT_SIGMA_RAD_S / sigma;
            ratio * ratio
        };
        let [m0, m1, m2, m3, m4] = self.moments;
        let matrix = SymmetricMatrix {
            xx: m0,
            xy: m1,
            xz: m2,
            yy: m2 + inverse_variance(SLOPE_SIGMA * UNIT_CELSIUS),
            yz: m3,
            zz: m4 + inverse_variance(CURVATURE_SIGMA * UNIT_CELSIUS * UNIT_CELSIUS),
        };
        let inverse = matrix.inverse().ok_or(insufficient)?;
        let sigma_at = |celsius: f32| {
            let t = (celsius - reference_celsius) / UNIT_CELSIUS;
            let x = Vector3::new(1.0, t, t * t);
            POINT_SIGMA_RAD_S * libm::sqrtf(inverse.times(x).dot(x).max(0.0))
        };
        let worst = sigma_at(self.coldest_celsius - TRUSTED_BEYOND_CELSIUS)
            .max(sigma_at(self.warmest_celsius + TRUSTED_BEYOND_CELSIUS));
        let is_useful = worst <= USEFUL_SIGMA_RAD_S;
        if !is_useful {
            return Err(insufficient);
        }
        let [s0, s1, s2] = self.sums;
        let x = inverse.times(Vector3::new(s0.x, s1.x, s2.x));
        let y = inverse.times(Vector3::new(s0.y, s1.y, s2.y));
        let z = inverse.times(Vector3::new(s0.z, s1.z, s2.z));
        Ok(TemperatureModel {
            reference_celsius,
            offset_rad_s: Vector3::new(x.x, y.x, z.x),
            slope_rad_s_per_celsius: Vector3::new(x.y, y.y, z.y).scale(1.0 / UNIT_CELSIUS),
            curvature_rad_s_per_celsius2: Vector3::new(x.z, y.z, z.z)
                .scale(1.0 / (UNIT_CELSIUS * UNIT_CELSIUS)),
            coldest_celsius: self.coldest_celsius,
            warmest_celsius: self.warmest_celsius,
        })
    }
}

/// The measurements do not determine a model yet.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct InsufficientData {
    /// Number of points: temperatures half a degree apart.
    pub points: u16,
    /// Width of the measured range, °C.
    pub range_celsius: f32,
}

impl fmt::Display for InsufficientData {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "only {} temperatures over {} degrees C were seen: let it warm up at rest",
            self.points,
            (self.range_celsius + 0.5) as i32,
        )
    }
}

impl core::error::Error for InsufficientData {}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chip's offset: 2 °/s at 25 °C with slope and curve, another on each axis.
    fn offset(celsius: f32) -> Vector3 {
        let t = celsius - 25.0;
        let axis = |a: f32, b: f32, c: f32| radians(a + b * t + c * t * t);
        Vector3::new(
            axis(2.0, 0.1, 0.002),
            axis(-5.0, -0.05, 0.001),
            axis(0.0, 0.0, -0.002),
        )
    }

    fn learned(from: f32, to: f32) -> TemperatureLearner {
        let mut learner = TemperatureLearner::new();
        let steps = ((to - from).abs() * 4.0) as u32;
        for step in 0..=steps {
            let celsius = from + (to - from) * step as f32 / steps.max(1) as f32;
            learner.add(celsius, offset(celsius), radians(0.01));
        }
        learner
    }

    #[test]
    fn a_curve_is_learned_from_one_warm_up_and_holds_five_degrees_beyond() {
        let model = learned(15.0, 40.0).fit().expect("enough");
        for tenths in 100..=450 {
            let celsius = tenths as f32 * 0.1;
            let (found, weight) = model.offset_at(celsius);
            assert!((weight - 1.0).abs() < 1e-5, "{celsius}");
            let error = (found - offset(celsius)).norm().to_degrees();
            assert!(error < 0.05, "{celsius}: {error}");
        }
    }

    #[test]
    fn the_model_fades_beyond_its_range_and_holds_its_value() {
        let model = learned(15.0, 40.0).fit().expect("enough");
        let (edge, _) = model.offset_at(45.0);
        for (celsius, weight) in [(45.0, 1.0), (50.0, 0.5), (55.0, 0.0), (200.0, 0.0)] {
            let (found, found_weight) = model.offset_at(celsius);
            assert!(
                (found_weight - weight).abs() < 1e-3,
                "{celsius}: {found_weight}"
            );
            assert!((found - edge).norm() < 1e-6);
        }
        assert!(model.offset_at(5.0).1 < 0.51 && model.offset_at(-10.0).1 == 0.0);
        for celsius in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let (found, weight) = model.offset_at(celsius);
            assert_eq!(weight, 0.0);
            assert!(found.is_within(1.0));
        }
    }

    #[test]
    fn too_few_points_give_no_model() {
        assert!(TemperatureLearner::new().fit().is_err());
        assert_eq!(TemperatureLearner::new().range_celsius(), None);
        let error = learned(25.0, 25.4).fit().unwrap_err();
        assert_eq!(error.points, 1);
        assert!(
            error
                .to_string()
                .starts_with("only 1 temperatures over 0 degrees C"),
            "{error}"
        );
        assert!(learned(25.0, 26.5).fit().is_err());
        assert!(learned(25.0, 33.0).fit().is_ok());
    }

    #[test]
    fn an_hour_at_one_temperature_does_not_outweigh_a_warm_up() {
        let mut learner = learned(15.0, 40.0);
        for _ in 0..10_000 {
            learner.add(
                40.0,
                offset(40.0) + Vector3::new(radians(0.02), 0.0, 0.0),
                radians(0.01),
            );
        }
        let model = learner.fit().expect("enough");
        let error = (model.offset_at(15.0).0 - offset(15.0)).norm().to_degrees();
        assert!(error < 0.05, "{error}");
        assert!(learner.points() < 60);
    }

    #[test]
    fn values_that_are_not_finite_are_ignored() {
        let mut learner = learned(15.0, 40.0);
        let before = learner;
        for (celsius, rate, sigma) in [
            (f32::NAN, 0.1, 0.01),
            (1e9, 0.1, 0.01),
            (25.0, f32::INFINITY, 0.01),
            (25.0, 0.1, f32::NAN),
        ] {
            learner.add(celsius, Vector3::new(rate, 0.0, 0.0), sigma);
        }
        assert_eq!(learner, before);
    }

    /// Rests come every 2 s, and a die warms up by 2 °C a minute.
    #[test]
    fn a_slow_warm_up_has_as_many_points_as_a_fast_one() {
        for step_celsius in [0.001, 0.02, 0.07, 0.2] {
            let mut learner = TemperatureLearner::new();
            let mut celsius = 20.0;
            while celsius < 35.0 {
                learner.add(celsius, offset(celsius), radians(0.01));
                celsius += step_celsius;
            }
            let points = learner.points();
            assert!((24..=31).contains(&points), "{step_celsius}: {points}");
            let model = learner.fit().expect("enough");
            let error = model.offset_at(28.0).0 - offset(28.0);
            assert!(
                error.norm().to_degrees() < 0.05,
                "{step_celsius}: {error:?}"
            );
        }
    }

    #[test]
    fn a_second_warm_up_keeps_the_model_beyond_its_range() {
        let stored = learned(0.0, 50.0).fit().expect("enough");
        let shift = Vector3::new(radians(0.1), 0.0, 0.0);
        for (from, to) in [
            (20.0, 32.0),
            (32.0, 20.0),
            (-10.0, 20.0),
            (30.0, 60.0),
            (55.0, 65.0),
        ] {
            let mut learner = TemperatureLearner::new();
            for step in 0..=80_u8 {
                let celsius = from + (to - from) * f32::from(step) / 80.0;
                learner.add(celsius, offset(celsius) + shift, radians(0.01));
            }
            learner.keep_beyond(&stored);
            let model = learner.fit().expect("enough");
            let (coldest, warmest) = (from.min(to), from.max(to));
            assert_eq!(model.coldest_celsius, coldest.min(0.0));
            assert_eq!(model.warmest_celsius, warmest.max(50.0));
            for tenth in 0..=10_u8 {
                let share = 0.1 * f32::from(tenth);
                let celsius =
                    model.coldest_celsius + share * (model.warmest_celsius - model.coldest_celsius);
                // Beyond its range, the model goes over from the new offset to the stored one.
                let is_measured = (coldest..=warmest).contains(&celsius);
                let least = if is_measured { shift.x } else { 0.0 };
                let found = model.offset_at(celsius).0 - offset(celsius);
                let expected = Vector3::new(found.x.clamp(least, shift.x), 0.0, 0.0);
                let error = (found - expected).norm().to_degrees();
                assert!(error < 0.05, "{from} to {to}, {celsius}: {error}");
            }
        }
        // A wider warm-up replaces the stored model.
        let mut learner = learned(-5.0, 55.0);
        let alone = learner;
        learner.keep_beyond(&stored);
        assert_eq!(learner, alone);
    }

    #[test]
    fn a_learner_continues_from_a_stored_model() {
        let model = learned(15.0, 40.0).fit().expect("enough");
        let again = TemperatureLearner::from_model(&model)
            .fit()
            .expect("the same");
        for celsius in [12.0, 20.0, 27.5, 33.0, 44.0] {
            let difference = model.offset_at(celsius).0 - again.offset_at(celsius).0;
            assert!(
                difference.norm().to_degrees() < 0.03,
                "{celsius}: {difference:?}"
            );
        }
    }
}
