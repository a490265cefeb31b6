//! The magnetic field at a compass: the earth's by place, and what the vehicle makes of it.

use crate::motion::Truth;
use crate::motion::geometry::{Quaternion, Vector, add, dot, norm, scale, subtract};
use crate::random::Random;

/// The earth's field at a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EarthField {
    /// Strength, µT.
    pub strength_ut: f64,
    /// Dip (inclination) below the horizon, degrees: positive north of the magnetic equator.
    pub dip_deg: f64,
    /// Declination, degrees: magnetic north is east of true north.
    pub declination_deg: f64,
}

impl EarthField {
    /// Places with their fields of 2020, by the world magnetic model, rounded.
    pub const PLACES: [(&'static str, Self); 6] = [
        ("berlin", Self::new(49.7, 68.0, 4.5)),
        ("oslo", Self::new(51.5, 73.0, 4.0)),
        ("denver", Self::new(51.6, 66.0, 8.0)),
        ("singapore", Self::new(42.0, -13.0, 0.3)),
        ("rio", Self::new(23.2, -39.0, -22.5)),
        ("sydney", Self::new(57.1, -64.0, 12.7)),
    ];

    const fn new(strength_ut: f64, dip_deg: f64, declination_deg: f64) -> Self {
        Self {
            strength_ut,
            dip_deg,
            declination_deg,
        }
    }

    /// The field of a place.
    #[must_use]
    pub fn of(place: &str) -> Option<Self> {
        let found = Self::PLACES.iter().find(|(name, _)| *name == place);
        found.map(|(_, field)| *field)
    }

    /// The field, µT: magnetic north, east of it, down.
    #[must_use]
    pub fn magnetic_ned_ut(&self) -> Vector {
        let dip = self.dip_deg.to_radians();
        [
            self.strength_ut * libm::cos(dip),
            0.0,
            self.strength_ut * libm::sin(dip),
        ]
    }
}

impl Default for EarthField {
    fn default() -> Self {
        Self::PLACES[0].1
    }
}

/// A magnet that passes the vehicle on a straight line, or stands beside it until the vehicle
/// leaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassingMagnet {
    /// Time of the closest approach, s.
    pub closest_s: f64,
    /// True if it is at the closest place from the start.
    pub stands: bool,
    /// Place of the closest approach, m in earth axes from the compass.
    pub closest_m: Vector,
    /// Velocity, m/s in earth axes.
    pub velocity_m_s: Vector,
    /// Magnetic moment, A·m² in earth axes: a 10 mm cube of neodymium has about 1.
    pub moment_a_m2: Vector,
}

impl PassingMagnet {
    /// A small magnet that passes at a walking pace, 20 to 40 cm away at this time.
    #[must_use]
    pub fn passing(seed: u64, closest_s: f64) -> Self {
        let mut random = Random::new(seed, "magnet");
        let [place, way, moment] = [0; 3].map(|_| direction(&mut random));
        let across = subtract(way, scale(place, dot(way, place)));
        Self {
            closest_s,
            stands: false,
            closest_m: scale(place, random.uniform(0.2, 0.4)),
            velocity_m_s: scale(across, random.uniform(0.5, 1.5) / norm(across).max(0.1)),
            moment_a_m2: scale(moment, random.uniform(1.0, 3.0)),
        }
    }

    /// A small magnet that lies 15 to 40 cm beside the vehicle, until the vehicle leaves it at this
    /// time.
    #[must_use]
    pub fn left_behind(seed: u64, leaves_s: f64) -> Self {
        let magnet = Self::passing(seed, leaves_s);
        let mut random = Random::new(seed, "magnet left behind");
        let place = scale(magnet.closest_m, 1.0 / norm(magnet.closest_m));
        Self {
            stands: true,
            closest_m: scale(place, random.uniform(0.15, 0.4)),
            velocity_m_s: scale(place, random.uniform(0.5, 2.0)),
            ..magnet
        }
    }

    /// The dipole's field at the compass, µT in earth axes: µ₀/4π·(3(m·r̂)r̂ − m)/r³.
    #[must_use]
    pub fn field_ut(&self, time_s: f64) -> Vector {
        let mut since_s = time_s - self.closest_s;
        if self.stands {
            since_s = since_s.max(0.0);
        }
        let place = add(self.closest_m, scale(self.velocity_m_s, since_s));
        let distance_m = norm(place).max(0.02);
        let unit = scale(place, 1.0 / distance_m);
        let along = scale(unit, 3.0 * dot(self.moment_a_m2, unit));
        // µ₀/4π is 1e-7 T·m/A, which is 0.1 µT·m/A.
        scale(
            subtract(along, self.moment_a_m2),
            0.1 / (distance_m * distance_m * distance_m),
        )
    }
}

/// The field at a compass that is fixed in a vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct Magnetism {
    /// The earth's field.
    pub earth: EarthField,
    /// Hard iron, µT in body axes.
    pub hard_iron_ut: Vector,
    /// Soft iron and gains: the matrix on the field in body axes, by rows.
    pub soft_iron: [Vector; 3],
    /// Field of the motors' currents in a hover, µT in body axes. It grows with the thrust.
    pub motors_ut: Vector,
    /// A passing magnet.
    pub magnet: Option<PassingMagnet>,
}

/// The identity matrix.
const NO_SOFT_IRON: [Vector; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

impl Magnetism {
    /// The earth's field alone.
    #[must_use]
    pub fn clean(earth: EarthField) -> Self {
        Self {
            earth,
            hard_iron_ut: [0.0; 3],
            soft_iron: NO_SOFT_IRON,
            motors_ut: [0.0; 3],
            magnet: None,
        }
    }

    /// A vehicle with hard iron of some 20 µT, gains that differ by some 10 %, and no motors.
    #[must_use]
    pub fn typical(seed: u64) -> Self {
        let mut random = Random::new(seed, "magnetism");
        let hard_iron_ut = [0; 3].map(|_| 20.0 * random.normal());
        let mut soft_iron = NO_SOFT_IRON;
        for (row, line) in soft_iron.iter_mut().enumerate() {
            for (column, element) in line.iter_mut().enumerate() {
                let sigma = if row == column { 0.06 } else { 0.02 };
                *element += sigma * random.normal();
            }
        }
        Self {
            hard_iron_ut,
            soft_iron,
            ..Self::clean(EarthField::default())
        }
    }

    /// A [`typical`](Self::typical) vehicle whose hard iron is known from an earlier flight:
    /// some 4 µT are left.
    #[must_use]
    pub fn without_most_hard_iron(seed: u64) -> Self {
        let typical = Self::typical(seed);
        Self {
            hard_iron_ut: scale(typical.hard_iron_ut, 0.2),
            ..typical
        }
    }

    /// A vehicle after a calibration: 0.5 µT of hard iron and 1 % of soft iron are left.
    #[must_use]
    pub fn calibrated(seed: u64) -> Self {
        let mut random = Random::new(seed, "calibrated magnetism");
        let hard_iron_ut = [0; 3].map(|_| 0.5 * random.normal());
        let mut soft_iron = NO_SOFT_IRON;
        for element in soft_iron.iter_mut().flatten() {
            *element += 0.01 * random.normal();
        }
        Self {
            hard_iron_ut,
            soft_iron,
            ..Self::clean(EarthField::default())
        }
    }

    /// Adds motors whose field in a hover has this strength, µT. The seed decides its direction.
    #[must_use]
    pub fn with_motors(self, seed: u64, strength_ut: f64) -> Self {
        let mut random = Random::new(seed, "motors");
        Self {
            motors_ut: scale(direction(&mut random), strength_ut),
            ..self
        }
    }

    /// The field at the compass, µT in body axes. Earth axes have north at magnetic north.
    #[must_use]
    pub fn at(&self, time_s: f64, truth: &Truth) -> Vector {
        let attitude = truth.attitude.unwrap_or(Quaternion::IDENTITY);
        let mut earth_ut = self.earth.magnetic_ned_ut();
        if let Some(magnet) = &self.magnet {
            earth_ut = add(earth_ut, magnet.field_ut(time_s));
        }
        let body_ut = attitude.conjugate().rotate(earth_ut);
        let distorted_ut = self.soft_iron.map(|row| dot(row, body_ut));
        let motors_ut = scale(self.motors_ut, truth.thrust_g);
        add(add(distorted_ut, self.hard_iron_ut), motors_ut)
    }
}

/// Returns a unit vector in any direction.
fn direction(random: &mut Random) -> Vector {
    let vector = [0; 3].map(|_| random.normal());
    scale(vector, 1.0 / norm(vector).max(1e-6))
}
