//! Drives every function of the boundary from Rust, so that Miri can watch its `unsafe` code.
//! `tests/c/boundary.c` does more, under the sanitizers.

use super::*;
use crate::state::{MARK, of_program};

/// Bytes by chance, the same in each run.
struct Chance(u32);

impl Chance {
    fn next(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        self.0 >> 8
    }

    fn bytes<const COUNT: usize>(&mut self) -> [u8; COUNT] {
        [0; COUNT].map(|_: u8| self.next() as u8)
    }

    fn numbers(&mut self) -> [f32; 3] {
        [0; 3].map(|_: u8| f32::from_bits(self.next() << 8))
    }

    fn burst(&mut self, t_us: u64) -> AplombBurst {
        AplombBurst {
            captured_at_us: t_us,
            bytes: self.bytes(),
            board_flags: self.next(),
            ..AplombBurst::default()
        }
    }

    fn sample(&mut self, t_us: u64) -> AplombSample {
        AplombSample {
            t_us,
            specific_force_m_s2: self.numbers(),
            angular_rate_rad_s: self.numbers(),
            is_force_saturated: self.next() as u8,
            is_rate_saturated: self.next() as u8,
            board_flags: self.next(),
        }
    }
}

/// Memory with any contents.
const fn memory() -> (AplombPipeline, AplombCompassPipeline) {
    let plain = AplombPipeline {
        opaque: [0xAA; APLOMB_PIPELINE_WORDS],
    };
    let with_compass = AplombCompassPipeline {
        opaque: [0xAA; APLOMB_COMPASS_PIPELINE_WORDS],
    };
    (plain, with_compass)
}

#[test]
fn updates_by_chance_give_finite_attitudes() {
    let settings = aplomb_default_settings();
    let (mut plain, mut compass) = memory();
    let (mut snapshot, mut other) = (AplombSnapshot::default(), AplombSnapshot::default());
    let refused = aplomb_stale(Some(&mut plain), 0, Some(&mut snapshot));
    assert_eq!(refused, AplombStatus::NotInitialised);
    let started = aplomb_init(Some(&mut plain), Some(&settings));
    let with_compass = aplomb_compass_init(Some(&mut compass), Some(&settings));
    assert_eq!(
        (started, with_compass),
        (AplombStatus::Ok, AplombStatus::Ok)
    );
    let mut chance = Chance(1);
    for index in 1..100 {
        let burst = chance.burst(2_000 * index);
        let sample = chance.sample(2_000 * index + 1_000);
        let field = AplombField {
            field_ut: chance.numbers(),
            age_us: chance.next() >> 3,
        };
        let statuses = [
            aplomb_update_burst(Some(&mut plain), Some(&burst), Some(&mut other)),
            aplomb_compass_update_burst(Some(&mut compass), Some(&burst), Some(&mut snapshot)),
            aplomb_update_sample(Some(&mut plain), Some(&sample), Some(&mut other)),
            aplomb_compass_update_sample(Some(&mut compass), Some(&sample), Some(&mut snapshot)),
        ];
        assert_eq!(statuses, [AplombStatus::Ok; 4]);
        // The field is a number by chance, and so is its age: few are of a second.
        let is_used = field.age_us <= 1_000_000
            && field.field_ut.iter().map(|part| part.abs()).sum::<f32>() < 15_000.0;
        let expected = if is_used {
            AplombStatus::Ok
        } else {
            AplombStatus::WrongField
        };
        let status = aplomb_compass_update_field(Some(&mut compass), Some(&field));
        assert_eq!(status, expected, "{field:?}");
        assert!(!aplomb_awaits_scale_check(Some(&mut plain)));
        assert!(!aplomb_compass_awaits_scale_check(Some(&mut compass)));
        assert!(snapshot.attitude.into_iter().all(f32::is_finite));
        assert_eq!(snapshot.attitude, other.attitude);
    }
    // A copy elsewhere goes on.
    let mut copy = compass;
    let mut learned = AplombCalibration::default();
    let status = aplomb_compass_learned(Some(&mut copy), Some(&mut learned));
    let of_plain = aplomb_learned(Some(&mut plain), Some(&mut learned));
    assert_eq!((status, of_plain), (AplombStatus::Ok, AplombStatus::Ok));
    let mut start = AplombWarmStart { bytes: [0; 64] };
    let status = aplomb_warm_start(Some(&mut plain), u64::MAX, Some(&mut start));
    assert_eq!(status, AplombStatus::NoState);
    let status = aplomb_compass_resume(Some(&mut copy), Some(&start), 0, 0);
    assert_eq!(status, AplombStatus::NoRecord);
    aplomb_compass_reading_age_us(Some(&mut copy), 0);
    aplomb_compass_set_armed(Some(&mut copy), true);
    aplomb_compass_stale(Some(&mut copy), 1_000_000, Some(&mut other));
    assert_eq!(snapshot.attitude, other.attitude);
}

/// Memory that has outlived an update of the firmware: its pointers are those of the former one.
#[test]
fn the_pipeline_of_another_program_is_none() {
    let (mut plain, _) = memory();
    let mut snapshot = AplombSnapshot::default();
    let settings = aplomb_default_settings();
    let started = aplomb_init(Some(&mut plain), Some(&settings));
    assert_eq!(started, AplombStatus::Ok);
    let here = aplomb::mpu6050::PARTS.as_ptr().addr();
    assert_eq!(plain.opaque[0], of_program(MARK, here));
    for of_another in [MARK, of_program(MARK, here + 0x100)] {
        plain.opaque[0] = of_another;
        let status = aplomb_stale(Some(&mut plain), 0, Some(&mut snapshot));
        assert_eq!(status, AplombStatus::NotInitialised);
    }
}

#[test]
fn steps_and_checks_are_those_of_the_driver() {
    for part in &aplomb::mpu6050::PARTS {
        let mut settings = aplomb_default_settings();
        settings.who_am_i = part.who_am_i;
        let (mut step, mut check) = (AplombStep::default(), AplombCheck::default());
        let mut registers = [0; 256];
        let mut next = 0;
        let mut steps = || {
            let status = aplomb_reconfiguration_step(Some(&settings), next, Some(&mut step));
            next += 1;
            (status == AplombStatus::Ok).then_some(step)
        };
        while let Some(step) = steps() {
            registers[usize::from(step.register_address)] = step.value;
            assert_ne!(step.value, 0x80, "a device reset takes 200 ms");
        }
        assert_eq!(next, if part.is_mpu_6500_family { 10 } else { 9 });
        for index in 0..3 {
            let status = aplomb_settings_check(Some(&settings), index, Some(&mut check));
            assert_eq!(status, AplombStatus::Ok);
            for place in 0..usize::from(check.length) {
                let found = registers[usize::from(check.register_address) + place];
                assert_eq!(found & check.masks[place], check.values[place], "{check:?}");
            }
        }
        let after = aplomb_settings_check(Some(&settings), 3, Some(&mut check));
        assert_eq!(after, AplombStatus::NoMoreSteps);
    }
}

#[test]
fn a_record_by_chance_is_none_and_a_good_one_reads_back() {
    let mut chance = Chance(2);
    let mut found = AplombCalibration::default();
    let mut record = AplombRecord {
        bytes: chance.bytes(),
    };
    let status = aplomb_decode_record(Some(&record), Some(&mut found));
    assert_eq!(status, AplombStatus::NoRecord);
    let given = AplombCalibration {
        mount: mount::padded("+y-z"),
        has_compass: 1,
        compass_matrix: [1.0, 0.5, 0.0, 0.5, 1.0, 0.0, 0.0, 0.25, 1.0],
        compass_hard_iron_ut: [10.0, -20.0, 30.0],
        has_gyroscope_matrix: 1,
        gyroscope_matrix: [0.97, -0.01, 0.02, 0.03, 1.01, -0.02, 0.0, 0.015, 0.99],
        ..AplombCalibration::default()
    };
    let status = aplomb_encode_record(Some(&given), Some(&mut record));
    assert_eq!(status, AplombStatus::Ok);
    let status = aplomb_decode_record(Some(&record), Some(&mut found));
    assert_eq!((status, found), (AplombStatus::Ok, given));
}
