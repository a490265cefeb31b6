//! A simulated compass with faults of its readings.

use std::fmt;

use aplomb::attitude::Vector3;
use aplomb::calibration::Mount;
use aplomb::units::MagneticField;
use aplomb_models::motion::Truth;
use aplomb_models::random::Random;
use aplomb_recordings::simulated_compass::SimulatedCompass;

/// Pattern of faulty readings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pattern {
    /// The last reading again and again.
    Frozen,
    /// No reading.
    Missing,
    /// Zeros.
    Zeros,
    /// A third of the readings is random.
    Garbled,
    /// An axis has the wrong sign.
    Sign,
    /// Two axes are exchanged.
    Exchanged,
    /// The mount is wrong: turned about an axis by 90°.
    Turned,
    /// An axis reads zero.
    DeadAxis,
    /// Readings are missing while a strong field grows and goes, and wrong just before and after.
    Overflow,
}

impl Pattern {
    const ALL: [Self; 9] = [
        Self::Frozen,
        Self::Missing,
        Self::Zeros,
        Self::Garbled,
        Self::Sign,
        Self::Exchanged,
        Self::Turned,
        Self::DeadAxis,
        Self::Overflow,
    ];
}

/// A fault for a time.
#[derive(Clone, Copy, Debug)]
pub struct Fault {
    pattern: Pattern,
    /// First and last time, s.
    from_s: f64,
    until_s: f64,
    /// Axis that is hit.
    axis: usize,
    /// Direction of a strong field, and of a wrong mount.
    sign: f64,
}

impl Fault {
    /// The fault of this seed: within 25 s of the start for 1 to 20 s, or from the start on.
    pub fn by_seed(seed: u64) -> Self {
        let mut random = Random::new(seed, "fault of a compass");
        let mut one_of = |number: usize| random.uniform(0.0, number as f64) as usize;
        let pattern = Pattern::ALL[one_of(Pattern::ALL.len())];
        let axis = one_of(3);
        let sign = [-1.0, 1.0][one_of(2)];
        let is_from_start = one_of(2) == 0;
        let from_s = random.uniform(1.0, 25.0);
        let length_s = random.uniform(1.0, 20.0);
        let is_wiring = matches!(
            pattern,
            Pattern::Sign | Pattern::Exchanged | Pattern::Turned | Pattern::DeadAxis
        );
        // A wrong axis stays.
        let (from_s, until_s) = if is_wiring && is_from_start {
            (0.0, f64::INFINITY)
        } else {
            (from_s, from_s + length_s)
        };
        Self {
            pattern,
            from_s,
            until_s,
            axis,
            sign,
        }
    }

    fn is_on(&self, time_s: f64) -> bool {
        (self.from_s..self.until_s).contains(&time_s)
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            pattern,
            from_s,
            until_s,
            axis,
            sign,
        } = self;
        write!(
            formatter,
            "{pattern:?} axis {axis} sign {sign} from {from_s:.1} to {until_s:.1} s"
        )
    }
}

/// Compass with a fault.
pub struct FaultyCompass {
    compass: SimulatedCompass,
    fault: Option<Fault>,
    random: Random,
    last_ut: [f64; 3],
}

impl FaultyCompass {
    /// Creates a compass with this fault. The seed decides random readings.
    pub fn new(compass: SimulatedCompass, fault: Option<Fault>, seed: u64) -> Self {
        Self {
            compass,
            fault,
            random: Random::new(seed, "garbled compass"),
            last_ut: [0.0; 3],
        }
    }

    /// Returns the new reading in body axes at this sample, if there is one.
    pub fn read(&mut self, t_us: u64, truth: &Truth) -> Option<MagneticField> {
        let reading_ut = self.compass.read(t_us, truth)?;
        let time_s = t_us as f64 * 1e-6;
        let [x, y, z] = match self.fault.filter(|fault| fault.is_on(time_s)) {
            Some(fault) => self.spoil(&fault, time_s, reading_ut)?,
            None => {
                self.last_ut = reading_ut;
                reading_ut
            }
        };
        let body = Mount::Z_UP
            .to_body(Vector3::new(x as f32, y as f32, z as f32))
            .0;
        Some(MagneticField {
            ut: [body.x, body.y, body.z],
        })
    }

    fn spoil(&mut self, fault: &Fault, time_s: f64, reading_ut: [f64; 3]) -> Option<[f64; 3]> {
        let Fault { axis, sign, .. } = *fault;
        let (second, third) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut spoiled = reading_ut;
        match fault.pattern {
            Pattern::Frozen => spoiled = self.last_ut,
            Pattern::Missing => return None,
            Pattern::Zeros => spoiled = [0.0; 3],
            Pattern::Garbled => {
                if self.random.uniform(0.0, 3.0) < 1.0 {
                    spoiled = [0; 3].map(|_| self.random.uniform(-800.0, 800.0));
                }
            }
            Pattern::Sign => spoiled[axis] = -reading_ut[axis],
            Pattern::Exchanged => spoiled.swap(second, third),
            Pattern::Turned => {
                spoiled[second] = -sign * reading_ut[third];
                spoiled[third] = sign * reading_ut[second];
            }
            Pattern::DeadAxis => spoiled[axis] = 0.0,
            Pattern::Overflow => {
                // Half of a sine up to 1,600 µT; the chip's range is 800 µT.
                let share = (time_s - fault.from_s) / (fault.until_s - fault.from_s);
                spoiled[axis] += sign * 1_600.0 * (std::f64::consts::PI * share).sin();
                if spoiled[axis].abs() > 800.0 {
                    return None;
                }
            }
        }
        Some(spoiled)
    }
}
