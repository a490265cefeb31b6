//! An aeroplane: coordinated turns of minutes, which read like a changed offset of the gyroscope,
//! and push-overs, whose specific force points to the ground.
//!
//! The aeroplane flies where its nose points, at one speed V, without sideslip: the specific force
//! has a part f_x along the flight and a lift L along the body's up axis. With the components g of
//! gravity in body axes, the body turns at the rates (p, (L − g_z)/V, g_y/V), and f_x = −g_x
//! keeps the speed (Stevens and Lewis, *Aircraft Control and Simulation*, 1992, §2.5). The pilot
//! sets the roll rate p and the lift.

use super::Motion;
use super::geometry::{Quaternion, Vector, scale};
use super::truth::{STANDARD_GRAVITY_M_S2, Truth};
use crate::random::Random;

/// End of the rest before the take-off, s.
pub const REST_S: f64 = 10.0;

/// Step of the integration, s.
const STEP_S: f64 = 1.0e-3;
/// Time constants with which lift and roll rate follow the pilot, s.
const LIFT_LAG_S: f64 = 0.15;
const ROLL_LAG_S: f64 = 0.1;
/// Roll rate per error of the bank, and climb rate per error of the path, 1/s.
const BANK_GAIN_PER_S: f64 = 2.0;
const CLIMB_GAIN_PER_S: f64 = 1.0;
/// Load factor with which the pilot ends a push-over, until the nose is near the horizon again.
const PULL_OUT_LOAD: f64 = 2.5;
/// Largest load factor of the path's control.
const LARGEST_LOAD: f64 = 4.0;

/// Part of a flight, until some time.
#[derive(Clone, Copy, Debug)]
struct Leg {
    until_s: f64,
    bank_rad: f64,
    /// Angle of the path above the horizon.
    climb_rad: f64,
    /// Load factor that the pilot holds instead of the path: the push-over.
    push: Option<f64>,
}

/// A flight after a rest and a take-off run on a runway.
#[derive(Clone, Debug)]
pub struct Aeroplane {
    /// Parts of the flight, in turn. The last one has no end.
    legs: Vec<Leg>,
    speed_m_s: f64,
    run_s: f64,
    largest_roll_rate_rad_s: f64,
    /// Amplitude and angular frequency of the gusts' lift, and of their roll rate.
    gust_load: f64,
    gust_roll_rad_s: f64,
    gust_rad_s: f64,
    time_s: f64,
    attitude: Quaternion,
    lift_m_s2: f64,
    roll_rate_rad_s: f64,
}

impl Aeroplane {
    /// A flight at 20 to 70 m/s with coordinated turns of 20 s to 150 s to both sides. They have
    /// banks of 15° to 55°, and straight legs of 3 s to 20 s between them.
    #[must_use]
    pub fn turning(seed: u64) -> Self {
        let mut random = Random::new(seed, "turning aeroplane");
        let aeroplane = Self::taking_off(&mut random, [20.0, 70.0]);
        aeroplane.with_turns(&mut random, [20.0, 150.0], [15.0, 55.0], [3.0, 20.0])
    }

    /// A flight at 12 to 50 m/s with coordinated turns of 30 s to 240 s to both sides. They have
    /// banks of 4° to 15°, and straight legs of 3 s to 40 s between them.
    #[must_use]
    pub fn turning_wide(seed: u64) -> Self {
        let mut random = Random::new(seed, "aeroplane in wide turns");
        let aeroplane = Self::taking_off(&mut random, [12.0, 50.0]);
        aeroplane.with_turns(&mut random, [30.0, 240.0], [4.0, 15.0], [3.0, 40.0])
    }

    /// Adds eight turns of a duration in s and a bank in degrees between these limits, and straight
    /// legs of a duration in s.
    fn with_turns(
        mut self,
        random: &mut Random,
        [shortest_turn_s, longest_turn_s]: [f64; 2],
        [least_deg, largest_deg]: [f64; 2],
        [shortest_leg_s, longest_leg_s]: [f64; 2],
    ) -> Self {
        let mut until_s = REST_S + self.run_s + random.uniform(5.0, 20.0);
        self.legs.push(Leg::straight(until_s));
        for _ in 0..8 {
            let side = random.sign();
            until_s += random.uniform(shortest_turn_s, longest_turn_s);
            self.legs.push(Leg {
                bank_rad: side * random.uniform(least_deg, largest_deg).to_radians(),
                ..Leg::straight(until_s)
            });
            until_s += random.uniform(shortest_leg_s, longest_leg_s);
            self.legs.push(Leg::straight(until_s));
        }
        self
    }

    /// A flight that is in a coordinated turn at power-up, and stays in it, at 12 to 60 m/s.
    #[must_use]
    pub fn already_turning(seed: u64) -> Self {
        let mut random = Random::new(seed, "already turning aeroplane");
        let mut aeroplane = Self::taking_off(&mut random, [12.0, 60.0]);
        let side = random.sign();
        let bank_rad = side * random.uniform(15.0, 55.0).to_radians();
        aeroplane.legs.push(Leg {
            bank_rad,
            ..Leg::straight(f64::INFINITY)
        });
        aeroplane.run_s = -REST_S;
        aeroplane.lift_m_s2 = STANDARD_GRAVITY_M_S2 / bank_rad.cos();
        aeroplane.attitude = Quaternion::from_euler(bank_rad, 0.0, 0.0);
        aeroplane
    }

    /// A flight at 20 to 40 m/s that climbs, pushes over for this time, and pulls out; three times.
    /// In the push-over its load factor is −0.8 to −1.3.
    #[must_use]
    pub fn pushing_over(seed: u64, push_s: f64) -> Self {
        let mut random = Random::new(seed, "aeroplane that pushes over");
        let mut aeroplane = Self::taking_off(&mut random, [20.0, 40.0]);
        let mut until_s = REST_S + aeroplane.run_s + random.uniform(5.0, 20.0);
        aeroplane.legs.push(Leg::straight(until_s));
        for _ in 0..3 {
            until_s += random.uniform(2.0, 5.0);
            aeroplane.legs.push(Leg {
                climb_rad: random.uniform(10.0, 40.0).to_radians(),
                ..Leg::straight(until_s)
            });
            until_s += push_s;
            aeroplane.legs.push(Leg {
                push: Some(random.uniform(-1.3, -0.8)),
                ..Leg::straight(until_s)
            });
            until_s += 20.0;
            aeroplane.legs.push(Leg::straight(until_s));
        }
        aeroplane
    }

    /// An aeroplane that rests, level, and then runs along a runway.
    fn taking_off(random: &mut Random, [slowest, fastest]: [f64; 2]) -> Self {
        let speed_m_s = random.uniform(slowest, fastest);
        Self {
            legs: Vec::new(),
            speed_m_s,
            run_s: speed_m_s / random.uniform(2.0, 5.0),
            largest_roll_rate_rad_s: random.uniform(20.0, 80.0).to_radians(),
            gust_load: random.uniform(0.02, 0.15),
            gust_roll_rad_s: random.uniform(1.0, 8.0).to_radians(),
            gust_rad_s: random.uniform(1.0, 4.0),
            time_s: 0.0,
            attitude: Quaternion::from_euler(0.0, 0.0, random.uniform(-3.0, 3.0)),
            lift_m_s2: STANDARD_GRAVITY_M_S2,
            roll_rate_rad_s: 0.0,
        }
    }

    /// End of the take-off run, s.
    #[must_use]
    pub fn airborne_s(&self) -> f64 {
        REST_S + self.run_s
    }

    /// Returns the components of gravity in body axes, m/s².
    fn gravity_m_s2(&self) -> Vector {
        let down = [0.0, 0.0, STANDARD_GRAVITY_M_S2];
        self.attitude.conjugate().rotate(down)
    }

    fn rates_rad_s(&self) -> Vector {
        let [_, y, z] = self.gravity_m_s2();
        [
            self.roll_rate_rad_s,
            (self.lift_m_s2 - z) / self.speed_m_s,
            y / self.speed_m_s,
        ]
    }

    /// Flies one step in the air.
    fn step(&mut self) {
        let turned = Quaternion::from_rotation_vector(scale(self.rates_rad_s(), STEP_S));
        self.attitude = self.attitude.multiply(turned).normalized();
        let time_s = self.time_s;
        let leg = self
            .legs
            .iter()
            .find(|leg| time_s < leg.until_s)
            .or(self.legs.last())
            .copied()
            .unwrap_or(Leg::straight(0.0));
        let [x, y, z] = self.gravity_m_s2();
        let phase = self.gust_rad_s * time_s;
        let load = leg.push.unwrap_or_else(|| {
            if z < 0.5 * STANDARD_GRAVITY_M_S2 && leg.bank_rad == 0.0 {
                return PULL_OUT_LOAD;
            }
            let climb_rad = libm::asin((-x / STANDARD_GRAVITY_M_S2).clamp(-1.0, 1.0));
            let climbing = CLIMB_GAIN_PER_S * (leg.climb_rad - climb_rad) * self.speed_m_s;
            let lift = (STANDARD_GRAVITY_M_S2 + climbing) * STANDARD_GRAVITY_M_S2 / z.max(3.0);
            (lift / STANDARD_GRAVITY_M_S2).min(LARGEST_LOAD)
        });
        let lift = (load + self.gust_load * libm::sin(phase)) * STANDARD_GRAVITY_M_S2;
        self.lift_m_s2 += STEP_S / LIFT_LAG_S * (lift - self.lift_m_s2);
        // With the lift towards the ground the bank is not defined, so the roll stays.
        let bank_error_rad = if z > 0.0 {
            leg.bank_rad - libm::atan2(y, z)
        } else {
            0.0
        };
        let limit = self.largest_roll_rate_rad_s;
        let roll_rate = (BANK_GAIN_PER_S * bank_error_rad).clamp(-limit, limit)
            + self.gust_roll_rad_s * libm::sin(1.7 * phase);
        self.roll_rate_rad_s += STEP_S / ROLL_LAG_S * (roll_rate - self.roll_rate_rad_s);
    }
}

impl Leg {
    /// Level flight, straight on.
    const fn straight(until_s: f64) -> Self {
        Self {
            until_s,
            bank_rad: 0.0,
            climb_rad: 0.0,
            push: None,
        }
    }
}

impl Motion for Aeroplane {
    fn at(&mut self, time_s: f64) -> Truth {
        while self.time_s + STEP_S <= time_s {
            if self.time_s >= self.airborne_s() {
                self.step();
            }
            self.time_s += STEP_S;
        }
        let truth = Truth::at_rest(self.attitude);
        if self.time_s < REST_S.min(self.airborne_s()) {
            return truth;
        }
        let [x, ..] = self.gravity_m_s2();
        if self.time_s < self.airborne_s() {
            let acceleration = self.speed_m_s / self.run_s;
            let [_, y, z] = truth.specific_force_m_s2;
            return Truth {
                specific_force_m_s2: [acceleration, y, z],
                scored: true,
                ..truth
            };
        }
        // Between two steps the attitude goes on at the present rates.
        let rates = self.rates_rad_s();
        let since_s = time_s - self.time_s;
        let turned = Quaternion::from_rotation_vector(scale(rates, since_s));
        Truth {
            specific_force_m_s2: [-x, 0.0, -self.lift_m_s2],
            body_rates_rad_s: rates,
            attitude: Some(self.attitude.multiply(turned)),
            scored: true,
            ..truth
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::geometry::{add, angle_between, norm, subtract};
    use super::super::truth::up_in_body;
    use super::*;

    /// Returns the velocity of a flight: along the nose.
    fn velocity(aeroplane: &Aeroplane, truth: &Truth) -> Vector {
        let attitude = truth.attitude.unwrap();
        attitude.rotate([aeroplane.speed_m_s, 0.0, 0.0])
    }

    #[test]
    fn force_and_rates_belong_to_one_flight() {
        for seed in 0..6 {
            for mut aeroplane in [
                Aeroplane::turning(seed),
                Aeroplane::turning_wide(seed),
                Aeroplane::already_turning(seed),
                Aeroplane::pushing_over(seed, 2.5),
            ] {
                let start_s = aeroplane.airborne_s().max(0.0) + 1.0;
                aeroplane.at(start_s);
                for step in 0..4_000 {
                    let time_s = start_s + f64::from(step) * 0.02;
                    let before = aeroplane.at(time_s);
                    let old = velocity(&aeroplane, &before);
                    let after = aeroplane.at(time_s + 1.0e-3);
                    let new = velocity(&aeroplane, &after);
                    let acceleration = scale(subtract(new, old), 1.0e3);
                    let attitude = before.attitude.unwrap();
                    let felt = add(
                        attitude.rotate(before.specific_force_m_s2),
                        [0.0, 0.0, STANDARD_GRAVITY_M_S2],
                    );
                    assert!(norm(subtract(acceleration, felt)) < 0.2, "{seed} {time_s}");
                }
            }
        }
    }

    #[test]
    fn it_rests_runs_turns_and_pushes_over() {
        let mut aeroplane = Aeroplane::turning(1);
        assert_eq!(norm(aeroplane.at(9.0).body_rates_rad_s), 0.0);
        assert!(aeroplane.at(REST_S + 1.0).specific_force_m_s2[0] > 1.9);
        let (mut banked_s, mut level_s) = (0, 0);
        for second in 20..400 {
            let attitude = aeroplane.at(f64::from(second)).attitude.unwrap();
            let tilt = angle_between(up_in_body(attitude), [0.0, 0.0, -1.0]);
            assert!(tilt.to_degrees() < 65.0, "{second}");
            banked_s += u32::from(tilt.to_degrees() > 12.0);
            level_s += u32::from(tilt.to_degrees() < 5.0);
        }
        assert!(banked_s > 150 && level_s > 20, "{banked_s} {level_s}");
        let mut aeroplane = Aeroplane::pushing_over(1, 2.0);
        let (mut pushed_ms, mut turned_ms) = (0, 0);
        for ms in 0..120_000 {
            let truth = aeroplane.at(f64::from(ms) * 1.0e-3);
            pushed_ms += u32::from(truth.specific_force_m_s2[2] > 7.0);
            turned_ms += u32::from(up_in_body(truth.attitude.unwrap())[2] > 0.9);
        }
        assert!((3_000..6_500).contains(&pushed_ms), "{pushed_ms}");
        assert_eq!(turned_ms, 0, "it never flies on its back");
    }

    #[test]
    fn it_is_banked_at_power_up_if_it_is_already_turning() {
        for seed in 0..10 {
            let truth = Aeroplane::already_turning(seed).at(0.0);
            let tilt = angle_between(up_in_body(truth.attitude.unwrap()), [0.0, 0.0, -1.0]);
            assert!((14.0..56.0).contains(&tilt.to_degrees()));
            assert!(norm(truth.body_rates_rad_s) > 0.03);
        }
    }
}
