//! The library's session with a compass against the model of a chip.

use aplomb::compass::{Bytes, Choice, LONGEST_READ, Outcome, PartId, Session, Transfer};
use aplomb_models::compass::{Compass, CompassConfig, EarthField, Magnetism, Part};
use aplomb_models::motion::{Mount, Quaternion, Truth};

/// Time between two turns of a session, ns: not a multiple of the chip's period.
const TURN_NS: u64 = 10_003_000;
/// Turns of the body by this rate, rad/s.
const RATE_RAD_S: f64 = 10.0;

/// Performs a transfer.
fn perform<'a>(
    chip: &mut Compass,
    now_ns: u64,
    transfer: Transfer,
    bytes: &'a mut Bytes,
) -> Outcome<'a> {
    match transfer {
        Transfer::Read {
            address,
            register,
            length,
        } => {
            if !chip.start(now_ns, address, false) {
                return Outcome::NoAnswer;
            }
            chip.write(now_ns, register);
            chip.start(now_ns, address, true);
            for byte in &mut bytes[..usize::from(length)] {
                *byte = chip.read();
            }
            Outcome::Read(bytes)
        }
        Transfer::Write {
            address,
            register,
            value,
        } => {
            if !chip.start(now_ns, address, false) {
                return Outcome::NoAnswer;
            }
            chip.write(now_ns, register);
            chip.write(now_ns, value);
            Outcome::Written
        }
    }
}

/// From power-up on each reading has the gain of the configuration. Its field is as old as the
/// chip's lag and one period allow, also after a check of the settings.
#[test]
fn each_reading_of_an_hmc5883l_is_new_and_has_its_gain() {
    for offset_ns in (0..13_000_000).step_by(1_700_000) {
        let config = CompassConfig {
            magnetism: Magnetism::clean(EarthField::default()),
            mount: Mount::parse("+x+z").unwrap(),
            ..CompassConfig::new(1, Part::Hmc5883l)
        };
        let oldest_s = (config.lag_ns + 13_400_000) as f64 * 1e-9;
        let magnetism = config.magnetism.clone();
        let mut chip = Compass::new(config);
        chip.power_up(0);
        let mut session = Session::new(Choice::Auto);
        let truth =
            |time_s: f64| Truth::at_rest(Quaternion::from_euler(0.0, 0.0, RATE_RAD_S * time_s));
        let mut readings = 0;
        let mut now_ns = 60_000_000 + offset_ns;
        let mut time_ns = 0;
        for _ in 0..600 {
            now_ns += TURN_NS;
            while time_ns < now_ns {
                time_ns = (time_ns + 500_000).min(now_ns);
                chip.advance_to(time_ns, &truth(time_ns as f64 * 1e-9));
            }
            let Some(transfer) = session.next_transfer() else {
                continue;
            };
            let mut bytes = [0; LONGEST_READ];
            let outcome = perform(&mut chip, now_ns, transfer, &mut bytes);
            let Some(field) = session.finish(&outcome) else {
                continue;
            };
            readings += 1;
            let now_s = now_ns as f64 * 1e-9;
            let angle_rad = |x: f64, y: f64| y.atan2(x);
            let [north_x, north_y, _] = magnetism.at(now_s, &truth(now_s));
            let now_rad = angle_rad(north_x, north_y);
            let shown_rad = angle_rad(f64::from(field.x), f64::from(field.y));
            // The field turns against the body: an older one is at a larger angle.
            let turn_rad = (shown_rad - now_rad).rem_euclid(std::f64::consts::TAU);
            let age_s = turn_rad / RATE_RAD_S;
            assert!(
                (0.0..oldest_s + 0.003).contains(&age_s),
                "reading {readings} at {now_s:.3} s: {age_s:.4} s old"
            );
            let strength_ut = f64::from(field.norm());
            assert!(
                (48.0..51.5).contains(&strength_ut),
                "reading {readings} at {now_s:.3} s: {strength_ut:.1} uT"
            );
        }
        assert_eq!(session.name(), Some(PartId::Hmc5883l.name()));
        assert!(readings > 280, "{readings}");
    }
}
