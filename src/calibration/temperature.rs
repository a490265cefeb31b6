//! The gyroscope's offset over temperature: a parabola, learned from points at rest.
//!
//! Each point (die temperature, offset) is a measurement of offset + slope·t + curvature·t²; a learner keeps the normal
//! equations of the least squares, which do not grow with the points. What a chip may have by the datasheet goes in as a prior, so
//! that few points make a flat line and not a wild one. The model is given out only where it says something: its own
//! σ, at the ends of the range that it will be used in, has to be small.

use core::fmt;

use super::TemperatureModel;
use crate::attitude::Vector3;
use crate::units::radians;

/// Outside of what was seen, the model holds so far, °C.
pub const TRUSTED_BEYOND_CELSIUS: f32 = 5.0;
/// From there on it is worth less and less, down to nothing at this distance from what was seen, °C.
const FADED_BEYOND_CELSIUS: f32 = 15.0;

/// Points closer than this in temperature are one, °C, so that an hour at one temperature does not outweigh a warm-up.
const POINT_CELSIUS: f32 = 0.5;
/// σ of an offset beyond its noise, rad/s: it is not the same from day to day, nor in every pose
/// (0.1 °/s per g, product specification §6.1).
const POINT_SIGMA_RAD_S: f32 = radians(0.03);
/// What a chip may have before anything was seen, σ: ±20 °/s over −40 to 85 °C (ibidem) is 0.16 °/s per °C at most.
const SLOPE_SIGMA: f32 = radians(0.1);
/// And so much of that may be curvature, rad/s per °C².
const CURVATURE_SIGMA: f32 = radians(0.002);
/// A model that is less sure than this at the ends of its range is none, rad/s.
const USEFUL_SIGMA_RAD_S: f32 = radians(0.15);

impl TemperatureModel {
    /// The offset at this die temperature, rad/s in sensor axes, and how much that is worth: 1 within the range that was
    /// seen and 5 °C beyond, falling to 0 at 15 °C beyond. Past the 5 °C the offset stays what it is there.
    pub fn offset_at(&self, celsius: f32) -> (Vector3, f32) {
        let beyond = (celsius - self.warmest_celsius)
            .max(self.coldest_celsius - celsius)
            .max(0.0);
        let faded =
            (beyond - TRUSTED_BEYOND_CELSIUS) / (FADED_BEYOND_CELSIUS - TRUSTED_BEYOND_CELSIUS);
        if !(celsius.is_finite() && faded.is_finite()) {
            return (self.offset_rad_s, 0.0);
        }
        let held = celsius
            .max(self.coldest_celsius - TRUSTED_BEYOND_CELSIUS)
            .min(self.warmest_celsius + TRUSTED_BEYOND_CELSIUS);
        let t = held - self.reference_celsius;
        let offset = self.offset_rad_s
            + self.slope_rad_s_per_celsius.scale(t)
            + self.curvature_rad_s_per_celsius2.scale(t * t);
        (offset, (1.0 - faded).clamp(0.0, 1.0))
    }
}

/// Learns a [`TemperatureModel`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TemperatureLearner {
    reference_celsius: Option<f32>,
    /// Σw, Σwt, Σwt², Σwt³, Σwt⁴ with t in units of [`UNIT_CELSIUS`] from the reference.
    moments: [f32; 5],
    /// Σw·offset, Σwt·offset, Σwt²·offset.
    sums: [Vector3; 3],
    coldest_celsius: f32,
    warmest_celsius: f32,
    open: Point,
    points: u16,
}

/// The unit of temperature in the equations, which keeps their numbers near one, °C.
const UNIT_CELSIUS: f32 = 10.0;

/// Readings at about one temperature, with their weights.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Point {
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
    /// A learner that has seen nothing.
    pub const fn new() -> Self {
        Self {
            reference_celsius: None,
            moments: [0.0; 5],
            sums: [Vector3::ZERO; 3],
            coldest_celsius: f32::INFINITY,
            warmest_celsius: f32::NEG_INFINITY,
            open: Point {
                weight: 0.0,
                celsius: 0.0,
                offset_rad_s: Vector3::ZERO,
            },
            points: 0,
        }
    }

    /// A learner that goes on where a stored model stands: with three points of its curve.
    pub fn from_model(model: &TemperatureModel) -> Self {
        let mut learner = Self::new();
        let middle = 0.5 * (model.coldest_celsius + model.warmest_celsius);
        for celsius in [model.coldest_celsius, middle, model.warmest_celsius] {
            learner.add(celsius, model.offset_at(celsius).0, 0.0);
        }
        learner
    }

    /// Takes an offset that was measured at rest (rad/s in sensor axes) with its σ and the die temperature.
    /// What is not finite is ignored.
    pub fn add(&mut self, temperature_celsius: f32, offset_rad_s: Vector3, sigma_rad_s: f32) {
        let is_number = temperature_celsius.abs() <= 200.0
            && offset_rad_s.is_within(radians(2000.0))
            && sigma_rad_s.abs() <= radians(2000.0);
        if !is_number {
            return;
        }
        if self.open.weight > 0.0 && (temperature_celsius - self.open.celsius).abs() > POINT_CELSIUS
        {
            self.close();
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
        // However long it lasts, it is one point: what makes a point uncertain does not average out.
        open.weight = total.min(1.0);
    }

    /// The model of what was seen so far.
    ///
    /// # Errors
    ///
    /// [`TooLittleSeen`] while it could not be relied on at the ends of its range.
    pub fn fit(&self) -> Result<TemperatureModel, TooLittleSeen> {
        let mut all = *self;
        all.close();
        all.solve()
    }

    /// The points so far: temperatures half a degree apart.
    pub const fn points(&self) -> u16 {
        self.points + (self.open.weight > 0.0) as u16
    }

    /// The range of temperatures seen so far, °C: coldest and warmest.
    pub fn range_celsius(&self) -> Option<(f32, f32)> {
        (self.points() > 0).then_some((self.coldest_celsius, self.warmest_celsius))
    }

    fn close(&mut self) {
        let Point {
            weight,
            celsius,
            offset_rad_s,
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

    fn solve(&self) -> Result<TemperatureModel, TooLittleSeen> {
        let too_little = TooLittleSeen {
            points: self.points,
            range_celsius: (self.warmest_celsius - self.coldest_celsius).max(0.0),
        };
        let Some(reference_celsius) = self.reference_celsius else {
            return Err(too_little);
        };
        let inverse_variance = |sigma: f32| {
            let ratio = POINT_SIGMA_RAD_S / sigma;
            ratio * ratio
        };
        let [m0, m1, m2, m3, m4] = self.moments;
        let matrix = Symmetric {
            xx: m0,
            xy: m1,
            xz: m2,
            yy: m2 + inverse_variance(SLOPE_SIGMA * UNIT_CELSIUS),
            yz: m3,
            zz: m4 + inverse_variance(CURVATURE_SIGMA * UNIT_CELSIUS * UNIT_CELSIUS),
        };
        let inverse = matrix.inverse().ok_or(too_little)?;
        let sigma_at = |celsius: f32| {
            let t = (celsius - reference_celsius) / UNIT_CELSIUS;
            let x = Vector3::new(1.0, t, t * t);
            POINT_SIGMA_RAD_S * libm::sqrtf(inverse.times(x).dot(x).max(0.0))
        };
        let worst = sigma_at(self.coldest_celsius - TRUSTED_BEYOND_CELSIUS)
            .max(sigma_at(self.warmest_celsius + TRUSTED_BEYOND_CELSIUS));
        let is_useful = worst <= USEFUL_SIGMA_RAD_S;
        if !is_useful {
            return Err(too_little);
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

/// What was seen does not make a model yet.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TooLittleSeen {
    /// Temperatures, half a degree apart, that were seen.
    pub points: u16,
    /// From the coldest to the warmest, °C.
    pub range_celsius: f32,
}

impl fmt::Display for TooLittleSeen {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "only {} temperatures over {} degrees C were seen: let it warm up at rest",
            self.points,
            (self.range_celsius + 0.5) as i32,
        )
    }
}

impl core::error::Error for TooLittleSeen {}

/// A symmetric 3×3 matrix.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Symmetric {
    xx: f32,
    xy: f32,
    xz: f32,
    yy: f32,
    yz: f32,
    zz: f32,
}

impl Symmetric {
    fn times(&self, v: Vector3) -> Vector3 {
        Vector3::new(
            self.xx * v.x + self.xy * v.y + self.xz * v.z,
            self.xy * v.x + self.yy * v.y + self.yz * v.z,
            self.xz * v.x + self.yz * v.y + self.zz * v.z,
        )
    }

    /// The inverse by cofactors; `None` where it is as good as singular.
    fn inverse(&self) -> Option<Self> {
        let xx = self.yy * self.zz - self.yz * self.yz;
        let xy = self.xz * self.yz - self.xy * self.zz;
        let xz = self.xy * self.yz - self.xz * self.yy;
        let determinant = self.xx * xx + self.xy * xy + self.xz * xz;
        let scale = self.xx * self.yy * self.zz;
        // A NaN fails every comparison.
        let is_regular = determinant > 1.0e-6 * scale && scale > 0.0;
        is_regular.then(|| {
            let factor = 1.0 / determinant;
            Self {
                xx: xx * factor,
                xy: xy * factor,
                xz: xz * factor,
                yy: (self.xx * self.zz - self.xz * self.xz) * factor,
                yz: (self.xy * self.xz - self.xx * self.yz) * factor,
                zz: (self.xx * self.yy - self.xy * self.xy) * factor,
            }
        })
    }
}

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
    fn beyond_its_range_it_fades_and_holds_its_value() {
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
    fn too_little_seen_makes_no_model() {
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
    fn what_is_no_measurement_is_ignored() {
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

    #[test]
    fn a_stored_model_is_where_a_new_learner_goes_on() {
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
