//! The chip as a controller on its bus sees it. Register addresses and bits are written as numbers
//! here, so that a wrong entry in the model's own table shows.

use super::errors::AxisErrors;
use super::identity::Identity;
use super::*;
use crate::motion::geometry::{norm, scale, subtract};
use crate::motion::quadrotor::Quadrotor;
use crate::motion::rest::Rest;
use crate::motion::truth::STANDARD_GRAVITY_M_S2;
use crate::motion::{Motion, Mount, Quaternion, Truth, Vector};

const ADDRESS: u8 = 0x68;
const MILLISECOND: u64 = 1_000_000;
/// Longer than any start-up.
const START_UP: u64 = 100 * MILLISECOND;

/// A controller that does one transaction at a time, each byte at the same instant.
struct Controller {
    sensor: Sensor,
    now_ns: u64,
}

impl Controller {
    fn new(config: SensorConfig, motion: impl Motion + 'static) -> Self {
        Self {
            sensor: Sensor::new(config, Box::new(motion)),
            now_ns: 0,
        }
    }

    /// A chip that has started up, awake, sampling at 1 kHz with filter 1 and raising the
    /// interrupt.
    fn running(config: SensorConfig, motion: impl Motion + 'static) -> Self {
        let mut controller = Self::new(config, motion);
        controller.wait(START_UP);
        controller.write(0x6B, 0x01);
        controller.write(0x1A, 0x01);
        controller.write(0x38, 0x01);
        controller
    }

    fn wait(&mut self, duration_ns: u64) {
        self.now_ns += duration_ns;
        self.sensor.advance_to(self.now_ns);
    }

    fn acknowledges(&mut self, address: u8) -> bool {
        let acknowledged = self.sensor.start(self.now_ns, address, false);
        self.sensor.stop(self.now_ns);
        acknowledged
    }

    fn write_all(&mut self, bytes: &[u8]) {
        assert!(self.sensor.start(self.now_ns, ADDRESS, false));
        for &byte in bytes {
            assert!(self.sensor.write(self.now_ns, byte));
        }
        self.sensor.stop(self.now_ns);
    }

    fn write(&mut self, register: u8, value: u8) {
        self.write_all(&[register, value]);
    }

    fn read_all<const N: usize>(&mut self, register: u8) -> [u8; N] {
        assert!(self.sensor.start(self.now_ns, ADDRESS, false));
        assert!(self.sensor.write(self.now_ns, register));
        assert!(self.sensor.start(self.now_ns, ADDRESS, true));
        let bytes = [0; N].map(|_| self.sensor.read(self.now_ns));
        self.sensor.stop(self.now_ns);
        bytes
    }

    fn read(&mut self, register: u8) -> u8 {
        self.read_all::<1>(register)[0]
    }

    /// Accelerometer, temperature, gyroscope as counts.
    fn sample(&mut self) -> [i16; 7] {
        let bytes = self.read_all::<14>(0x3B);
        [0, 1, 2, 3, 4, 5, 6].map(|word| i16::from_be_bytes([bytes[2 * word], bytes[2 * word + 1]]))
    }
}

/// No errors, an exact clock, the filter on.
fn perfect() -> SensorConfig {
    SensorConfig {
        errors: SensorErrors::none(),
        clock: ClockErrors::NONE,
        ..SensorConfig::new(0)
    }
}

fn level() -> Rest {
    Rest::level()
}

/// Motion by two functions of time, in body axes.
struct Scripted {
    force: fn(f64) -> Vector,
    rates: fn(f64) -> Vector,
}

impl Motion for Scripted {
    fn at(&mut self, time_s: f64) -> Truth {
        Truth {
            specific_force_m_s2: (self.force)(time_s),
            body_rates_rad_s: (self.rates)(time_s),
            ..Truth::at_rest(Quaternion::IDENTITY)
        }
    }
}

fn still(_: f64) -> Vector {
    [0.0; 3]
}

fn one_g(_: f64) -> Vector {
    [0.0, 0.0, -STANDARD_GRAVITY_M_S2]
}

// Power, reset, registers.

#[test]
fn it_acknowledges_nothing_until_it_has_started_up() {
    let mut chip = Controller::new(perfect(), level());
    let start_up_ns = perfect().start_up_ns;
    assert!((20 * MILLISECOND..START_UP).contains(&start_up_ns));
    assert_eq!(chip.sensor.next_event_ns(), Some(start_up_ns));
    chip.wait(start_up_ns - 1);
    assert!(!chip.acknowledges(ADDRESS));
    chip.wait(1);
    assert!(chip.acknowledges(ADDRESS));
}

#[test]
fn it_answers_at_its_address_only() {
    let mut chip = Controller::new(perfect(), level());
    chip.wait(START_UP);
    let answering: Vec<u8> = (0..0x80)
        .filter(|&address| chip.acknowledges(address))
        .collect();
    assert_eq!(answering, [0x68]);
    let with_ad0_high = SensorConfig {
        address: 0x69,
        ..perfect()
    };
    let mut chip = Controller::new(with_ad0_high, level());
    chip.wait(START_UP);
    assert!(chip.acknowledges(0x69) && !chip.acknowledges(0x68));
}

#[test]
fn it_wakes_up_asleep_with_the_register_maps_reset_values() {
    let mut chip = Controller::new(perfect(), level());
    chip.wait(START_UP);
    for register in (0..=0x75).filter(|register| !(0x0D..=0x10).contains(register)) {
        let expected = match register {
            0x6B => 0x40,
            0x75 => 0x68,
            _ => 0,
        };
        assert_eq!(chip.read(register), expected, "{register:#04x}");
    }
    chip.write(0x38, 0x01);
    chip.wait(1000 * MILLISECOND);
    assert_eq!(chip.sample(), [0; 7]);
    assert!(chip.sensor.take_edges().is_empty());
    assert_eq!(chip.sensor.next_event_ns(), None);
}

#[test]
fn what_is_written_reads_back_where_it_may_be_written() {
    let mut chip = Controller::new(perfect(), level());
    chip.wait(START_UP);
    for (register, expected) in [
        (0x19, 0xFF),
        (0x1A, 0x3F),
        (0x1B, 0xF8),
        (0x1C, 0xF8),
        (0x1D, 0x00),
        (0x37, 0xFE),
        (0x38, 0x19),
        (0x3A, 0x00),
        (0x3B, 0x00),
        (0x68, 0x00),
        (0x6C, 0xFF),
        (0x75, 0x68),
    ] {
        chip.write(register, 0xFF);
        assert_eq!(chip.read(register), expected, "{register:#04x}");
    }
    // All but DEVICE_RESET.
    chip.write(0x6B, 0x7F);
    assert_eq!(chip.read(0x6B), 0x6F);
}

#[test]
fn a_reset_takes_its_time_clears_itself_and_restores_everything() {
    let mut chip = Controller::running(perfect(), level());
    chip.write(0x1C, 0x18);
    chip.wait(10 * MILLISECOND);
    assert_ne!(chip.sample()[2], 0);
    chip.sensor.take_edges();
    chip.write(0x6B, 0x80);
    assert!(!chip.acknowledges(ADDRESS));
    chip.wait(perfect().start_up_ns - 1);
    assert!(!chip.acknowledges(ADDRESS));
    chip.wait(1);
    assert!(chip.acknowledges(ADDRESS));
    assert_eq!(chip.read(0x6B), 0x40);
    assert_eq!(
        [0x1A, 0x1C, 0x38].map(|register| chip.read(register)),
        [0; 3]
    );
    assert_eq!(chip.sample(), [0; 7]);
    chip.wait(1000 * MILLISECOND);
    assert!(chip.sensor.take_edges().is_empty());
}

#[test]
fn a_brown_out_is_a_reset() {
    let mut chip = Controller::running(perfect(), level());
    chip.sensor.power_up(chip.now_ns);
    assert!(!chip.acknowledges(ADDRESS));
    chip.wait(START_UP);
    assert_eq!(chip.read(0x6B), 0x40);
}

#[test]
fn the_identity_is_the_parts_own() {
    for (who_am_i, power) in [
        (0x68, 0x40),
        (0x72, 0x40),
        (0x98, 0x40),
        (0x70, 0x01),
        (0x71, 0x01),
        (0x73, 0x01),
        (0x12, 0x40),
    ] {
        let config = SensorConfig {
            who_am_i,
            ..perfect()
        };
        let mut chip = Controller::new(config, level());
        chip.wait(START_UP);
        assert_eq!(
            (chip.read(0x75), chip.read(0x6B)),
            (who_am_i, power),
            "{who_am_i:#04x}"
        );
    }
}

// The bus.

#[test]
fn the_pointer_moves_on_after_every_byte() {
    let mut chip = Controller::new(perfect(), level());
    chip.wait(START_UP);
    chip.write_all(&[0x19, 9, 3, 0x10, 0x08]);
    assert_eq!(chip.read_all::<5>(0x18), [0, 9, 3, 0x10, 0x08]);
    // The FIFO's port is the one that stays.
    assert_eq!(chip.read_all::<3>(0x74), [0, 0, 0]);
    assert_eq!(chip.read_all::<3>(0x73), [0, 0, 0]);
    assert_eq!(chip.read_all::<2>(0x75), [0x68, 0]);
}

#[test]
fn a_read_goes_on_where_the_last_one_ended() {
    let mut chip = Controller::new(perfect(), level());
    chip.wait(START_UP);
    chip.write(0x1A, 0x05);
    assert_eq!(chip.read(0x19), 0);
    let now_ns = chip.now_ns;
    assert!(chip.sensor.start(now_ns, ADDRESS, true));
    assert_eq!(chip.sensor.read(now_ns), 0x05);
    chip.sensor.stop(now_ns);
}

#[test]
fn a_burst_is_one_sample_however_slow_the_bus() {
    let noisy = SensorConfig {
        errors: SensorErrors::typical(1),
        ..perfect()
    };
    let mut chip = Controller::running(noisy, level());
    chip.wait(20 * MILLISECOND);
    let before = chip.read_all::<14>(0x3B);
    chip.sensor.take_bursts();
    let newest = chip.sensor.take_edges().last().unwrap().index;
    // The same burst once more, with several samples passing during it.
    assert!(chip.sensor.start(chip.now_ns, ADDRESS, false));
    assert!(chip.sensor.write(chip.now_ns, 0x3B));
    chip.wait(2 * MILLISECOND);
    assert!(chip.sensor.start(chip.now_ns, ADDRESS, true));
    let mut slow = [0; 14];
    for byte in &mut slow {
        *byte = chip.sensor.read(chip.now_ns);
        chip.wait(MILLISECOND / 2);
    }
    chip.sensor.stop(chip.now_ns);
    assert_eq!(slow, before);
    let bursts = chip.sensor.take_bursts();
    assert_eq!(bursts.len(), 1);
    assert_eq!((bursts[0].edge, bursts[0].bytes), (Some(newest), slow));
    // After the stop condition the newest sample is there.
    assert_ne!(chip.read_all::<14>(0x3B), before);
    let edges = chip.sensor.take_edges();
    assert_eq!(
        chip.sensor.take_bursts()[0].edge,
        Some(edges.last().unwrap().index)
    );
}

#[test]
fn only_a_complete_burst_is_recorded() {
    let mut chip = Controller::running(perfect(), level());
    chip.wait(10 * MILLISECOND);
    chip.read_all::<13>(0x3B);
    chip.read_all::<14>(0x3C);
    assert!(chip.sensor.take_bursts().is_empty());
    let bytes = chip.read_all::<14>(0x3B);
    let bursts = chip.sensor.take_bursts();
    assert_eq!(bursts.len(), 1);
    assert_eq!(
        (bursts[0].bytes, bursts[0].completed_ns),
        (bytes, chip.now_ns)
    );
    // Two halves with a repeated start between them are no burst.
    assert!(chip.sensor.start(chip.now_ns, ADDRESS, false));
    assert!(chip.sensor.write(chip.now_ns, 0x3B));
    for _ in 0..2 {
        assert!(chip.sensor.start(chip.now_ns, ADDRESS, true));
        for _ in 0..7 {
            chip.sensor.read(chip.now_ns);
        }
    }
    chip.sensor.stop(chip.now_ns);
    assert!(chip.sensor.take_bursts().is_empty());
    // One that starts earlier and runs through is complete.
    chip.read_all::<20>(0x3A);
    assert_eq!(chip.sensor.take_bursts().len(), 1);
}

// The clock.

/// Edges in one second with these settings of CONFIG and SMPLRT_DIV, and the spacing of the first
/// two in ns.
fn rate(config: SensorConfig, filter: u8, divider: u8) -> (usize, u64) {
    let mut chip = Controller::running(config, level());
    chip.write(0x1A, filter);
    chip.write(0x19, divider);
    chip.sensor.take_edges();
    chip.wait(1000 * MILLISECOND);
    let edges = chip.sensor.take_edges();
    (edges.len(), edges[1].time_ns - edges[0].time_ns)
}

#[test]
fn the_sample_rate_follows_filter_and_divider() {
    for (filter, divider, expected) in [
        (1, 0, 1000),
        (6, 0, 1000),
        (0, 0, 8000),
        (7, 0, 8000),
        (1, 4, 200),
        (0, 7, 1000),
        (3, 9, 100),
        (1, 249, 4),
    ] {
        let (count, spacing) = rate(perfect(), filter, divider);
        assert_eq!(
            (count, spacing),
            (expected, 1_000_000_000 / expected as u64),
            "{filter} {divider}"
        );
    }
}

#[test]
fn the_divider_of_the_mpu_6500_family_divides_what_is_filtered_alone() {
    for who_am_i in [0x70, 0x71, 0x73, 0x98] {
        let config = || SensorConfig {
            who_am_i,
            ..perfect()
        };
        for (filter, divider, expected) in [(1, 4, 200), (6, 9, 100), (0, 7, 8000), (7, 4, 8000)] {
            let (count, _) = rate(config(), filter, divider);
            assert_eq!(count, expected, "{who_am_i:#04x} {filter} {divider}");
        }
        // FCHOICE_B leads past the filter, at 32 kHz: 8 kHz on the model's grid.
        for choice in 1..=3 {
            let mut chip = Controller::running(config(), level());
            chip.write(0x1B, choice);
            assert_eq!(chip.read(0x1B), choice, "{who_am_i:#04x}");
            chip.write(0x19, 4);
            chip.sensor.take_edges();
            chip.wait(1000 * MILLISECOND);
            let count = chip.sensor.take_edges().len();
            assert_eq!(count, 8000, "{who_am_i:#04x} {choice}");
        }
    }
}

#[test]
fn the_rate_is_off_by_the_chips_own_clock_error() {
    let config = SensorConfig {
        clock: ClockErrors {
            gyroscope: 0.008,
            internal: -0.04,
        },
        ..perfect()
    };
    assert_eq!(rate(config.clone(), 1, 0), (1008, 992_064));
    let mut chip = Controller::running(config, level());
    chip.write(0x6B, 0x00);
    chip.sensor.take_edges();
    chip.wait(1000 * MILLISECOND);
    assert_eq!(chip.sensor.take_edges().len(), 960);
}

#[test]
fn edges_stay_on_an_exact_grid_however_the_time_is_cut() {
    let config = SensorConfig::new(5);
    let mut once = Controller::running(config.clone(), Quadrotor::by_seed(5));
    let mut often = Controller::running(config.clone(), Quadrotor::by_seed(5));
    once.wait(3000 * MILLISECOND);
    for _ in 0..300_000 {
        often.wait(10_000);
    }
    assert_eq!(once.sample(), often.sample());
    let edges = once.sensor.take_edges();
    assert_eq!(edges, often.sensor.take_edges());
    let period_ns = 1e6 / (1.0 + config.clock.gyroscope);
    for edge in &edges {
        let ideal = edges[0].time_ns as f64 + edge.index as f64 * period_ns;
        assert!((edge.time_ns as f64 - ideal).abs() <= 1.0, "{edge:?}");
    }
}

#[test]
fn every_event_is_announced() {
    let mut chip = Controller::running(perfect(), level());
    let mut levels = Vec::new();
    for _ in 0..4 {
        let next_ns = chip.sensor.next_event_ns().unwrap();
        chip.sensor.advance_to(next_ns - 1);
        assert_eq!(chip.sensor.next_event_ns(), Some(next_ns));
        chip.sensor.advance_to(next_ns);
        levels.push((next_ns - chip.now_ns, chip.sensor.interrupt_level()));
    }
    assert_eq!(
        levels,
        [
            (1_000_000, true),
            (1_050_000, false),
            (2_000_000, true),
            (2_050_000, false)
        ]
    );
}

#[test]
fn asleep_or_without_a_clock_nothing_samples_and_the_data_stay() {
    // Asleep; clock stopped; external clocks that are not there.
    for power in [0x41, 0x07, 0x04, 0x05] {
        let mut chip = Controller::running(perfect(), level());
        chip.wait(50 * MILLISECOND);
        let data = chip.sample();
        chip.write(0x6B, power);
        chip.sensor.take_edges();
        chip.wait(500 * MILLISECOND);
        assert!(chip.sensor.take_edges().is_empty(), "{power:#04x}");
        assert_eq!(chip.sample(), data);
        chip.write(0x6B, 0x01);
        chip.wait(50 * MILLISECOND);
        assert_eq!(chip.sensor.take_edges().len(), 50);
    }
}

#[test]
fn in_cycle_mode_it_samples_at_the_wake_up_rate() {
    for (wake_up, expected) in [(0, 5), (1, 20), (2, 80), (3, 160)] {
        let mut chip = Controller::running(perfect(), level());
        chip.write(0x6C, wake_up << 6);
        chip.write(0x6B, 0x21);
        chip.sensor.take_edges();
        chip.wait(4000 * MILLISECOND);
        assert_eq!(chip.sensor.take_edges().len(), expected);
        assert_eq!(chip.sample()[2], 16384);
    }
}

// The interrupt.

#[test]
fn without_enable_there_is_data_but_no_interrupt() {
    let mut chip = Controller::running(perfect(), level());
    chip.write(0x38, 0x00);
    chip.read(0x3A);
    chip.sensor.take_edges();
    chip.wait(100 * MILLISECOND);
    assert!(chip.sensor.take_edges().is_empty());
    assert_eq!(chip.read(0x3A), 0);
    assert_eq!(chip.sample()[2], 16384);
    assert_eq!(chip.sensor.take_bursts()[0].edge, None);
}

#[test]
fn the_status_is_set_by_a_sample_and_cleared_by_reading_it() {
    let mut chip = Controller::running(perfect(), level());
    chip.wait(MILLISECOND);
    assert_eq!(chip.read(0x3A), 1);
    assert_eq!(chip.read(0x3A), 0);
    chip.wait(MILLISECOND);
    chip.read(0x75);
    assert_eq!(chip.read(0x3A), 1);
    // With INT_RD_CLEAR any read does.
    chip.write(0x37, 0x10);
    chip.wait(MILLISECOND);
    chip.read(0x75);
    assert_eq!(chip.read(0x3A), 0);
}

#[test]
fn a_latched_interrupt_gives_one_edge_until_it_is_cleared() {
    let mut chip = Controller::running(perfect(), level());
    chip.write(0x37, 0x20);
    chip.sensor.take_edges();
    chip.wait(5 * MILLISECOND);
    assert_eq!(chip.sensor.take_edges().len(), 1);
    assert!(chip.sensor.interrupt_level());
    chip.read(0x3A);
    assert!(!chip.sensor.interrupt_level());
    chip.wait(MILLISECOND);
    assert_eq!(chip.sensor.take_edges().len(), 1);
}

#[test]
fn the_pin_follows_its_configuration() {
    let mut chip = Controller::running(perfect(), level());
    chip.write(0x37, 0x80);
    assert_eq!(chip.sensor.interrupt_pin(), PinLevel::High);
    chip.wait(MILLISECOND);
    assert_eq!(chip.sensor.interrupt_pin(), PinLevel::Low);
    chip.wait(MILLISECOND / 2);
    chip.write(0x37, 0xC0);
    assert_eq!(chip.sensor.interrupt_pin(), PinLevel::Released);
}

// From motion to counts.

#[test]
fn at_level_rest_it_reads_one_g_at_every_range() {
    for (range, expected) in [(0x00, 16384), (0x08, 8192), (0x10, 4096), (0x18, 2048)] {
        let mut chip = Controller::running(perfect(), level());
        chip.write(0x1C, range);
        chip.wait(100 * MILLISECOND);
        let [x, y, z, ..] = chip.sample();
        assert_eq!([x, y, z], [0, 0, expected]);
    }
}

#[test]
fn rates_have_the_datasheets_scale_and_saturate() {
    let spinning = || Scripted {
        force: one_g,
        rates: |_| {
            [
                300.0_f64.to_radians(),
                -10.0_f64.to_radians(),
                -2100.0_f64.to_radians(),
            ]
        },
    };
    // Chip face up: y and z turn over.
    for (range, expected) in [
        (0x00, [32767, 1310, 32767]),
        (0x08, [19650, 655, 32767]),
        (0x10, [9840, 328, 32767]),
        (0x18, [4920, 164, 32767]),
    ] {
        let mut chip = Controller::running(perfect(), spinning());
        chip.write(0x1B, range);
        chip.wait(100 * MILLISECOND);
        assert_eq!(chip.sample()[4..], expected, "{range:#04x}");
    }
    let mut chip = Controller::running(
        SensorConfig {
            mount: Mount::parse("z-down").unwrap(),
            ..perfect()
        },
        spinning(),
    );
    chip.wait(100 * MILLISECOND);
    assert_eq!(chip.sample()[4..], [32767, -1310, -32768]);
}

#[test]
fn forces_saturate_too() {
    let hard = Scripted {
        force: |_| [50.0, 0.0, -50.0],
        rates: still,
    };
    let mut chip = Controller::running(perfect(), hard);
    chip.wait(100 * MILLISECOND);
    assert_eq!(chip.sample()[..3], [32767, 0, 32767]);
}

#[test]
fn every_mount_turns_the_axes_as_its_name_says() {
    for name in Mount::names() {
        let config = SensorConfig {
            mount: Mount::parse(&name).unwrap(),
            ..perfect()
        };
        let accelerating = Scripted {
            force: |_| [0.5 * STANDARD_GRAVITY_M_S2, 0.0, -STANDARD_GRAVITY_M_S2],
            rates: |_| [10.0_f64.to_radians(), 0.0, 20.0_f64.to_radians()],
        };
        let mut chip = Controller::running(config, accelerating);
        chip.wait(100 * MILLISECOND);
        let sample = chip.sample();
        // "+x-z": forward is sensor +x, down is sensor -z.
        let along = |axes: &str, first: usize| {
            let (sign, axis) = axes.split_at(1);
            let count = sample[first + "xyz".find(axis).unwrap()];
            if sign == "-" { -count } else { count }
        };
        let (forward, down) = name.split_at(2);
        assert_eq!(
            (along(forward, 0), along(down, 0)),
            (8192, -16384),
            "{name}"
        );
        assert_eq!((along(forward, 4), along(down, 4)), (1310, 2620), "{name}");
    }
}

#[test]
fn the_filters_delay_a_ramp_by_the_datasheets_figures() {
    let delays_ms = [
        (0.98, 0.61),
        (1.9, 2.0),
        (2.8, 3.0),
        (4.8, 4.9),
        (8.3, 8.5),
        (13.4, 13.8),
        (18.6, 19.0),
    ];
    for (filter, (gyroscope_ms, accelerometer_ms)) in (0..).zip(delays_ms) {
        let ramp = Scripted {
            // 1 g and 100 °/s per second, from −1 g and −100 °/s.
            force: |time_s| [(time_s - 1.0) * STANDARD_GRAVITY_M_S2, 0.0, 0.0],
            rates: |time_s| [(time_s - 1.0) * 100.0_f64.to_radians(), 0.0, 0.0],
        };
        let mut chip = Controller::running(perfect(), ramp);
        chip.write(0x1A, filter);
        chip.wait(1500 * MILLISECOND);
        let sample = chip.sample();
        let age = chip.sensor.take_edges().last().unwrap().time_ns as f64 * 1e-9 - 1.0;
        let (force, rate) = (
            f64::from(sample[0]) / 16384.0,
            f64::from(sample[4]) / 13100.0,
        );
        // Half a count is 0.03 ms of force and 0.04 ms of rate.
        assert!(
            ((age - rate) * 1e3 - gyroscope_ms).abs() < 0.05,
            "{filter}: {}",
            (age - rate) * 1e3
        );
        assert!(
            ((age - force) * 1e3 - accelerometer_ms).abs() < 0.05,
            "{filter}: {}",
            (age - force) * 1e3
        );
    }
}

#[test]
fn the_filter_keeps_vibration_out() {
    let deviation = |filter: u8| {
        let vibrating = Scripted {
            force: one_g,
            rates: |time_s| [libm::sin(time_s * 120.0 * std::f64::consts::TAU), 0.0, 0.0],
        };
        let mut chip = Controller::running(perfect(), vibrating);
        chip.write(0x1A, filter);
        chip.wait(500 * MILLISECOND);
        let sum: f64 = (0..1000)
            .map(|_| {
                chip.wait(MILLISECOND);
                f64::from(chip.sample()[4]).powi(2)
            })
            .sum();
        (sum / 1000.0).sqrt()
    };
    // One pole: 1/√(1 + (f/fc)²) of the amplitude.
    let full = 131.0 * 1.0_f64.to_degrees() * 0.5_f64.sqrt();
    for (filter, bandwidth_hz) in [(1, 188.0), (3, 42.0), (4, 20.0)] {
        let expected = full / (1.0 + (120.0_f64 / bandwidth_hz).powi(2)).sqrt();
        let found = deviation(filter);
        assert!(
            (found / expected - 1.0).abs() < 0.02,
            "{filter}: {found} {expected}"
        );
    }
}

#[test]
fn the_accelerometer_is_no_faster_than_1_khz() {
    let ramp = Scripted {
        force: |time_s| [time_s * 10.0, 0.0, 0.0],
        rates: |time_s| [time_s, 0.0, 0.0],
    };
    let mut chip = Controller::running(perfect(), ramp);
    chip.write(0x1A, 0x00);
    chip.wait(100 * MILLISECOND);
    let (mut forces, mut rates) = (
        std::collections::BTreeSet::new(),
        std::collections::BTreeSet::new(),
    );
    for _ in 0..80 {
        chip.wait(125_000);
        let sample = chip.sample();
        forces.insert(sample[0]);
        rates.insert(sample[4]);
    }
    assert!(rates.len() >= 70, "{}", rates.len());
    assert!((10..=11).contains(&forces.len()), "{}", forces.len());
}

#[test]
fn the_temperature_register_follows_the_parts_formula() {
    for who_am_i in [0x68, 0x72, 0x70, 0x71, 0x73, 0x98] {
        let mut chip = Controller::running(
            SensorConfig {
                who_am_i,
                ..perfect()
            },
            level(),
        );
        chip.wait(10 * MILLISECOND);
        let raw = f64::from(chip.sample()[3]);
        let found = match who_am_i {
            0x68 | 0x72 => raw / 340.0 + 36.53,
            0x98 => 0.003 * raw + 25.0,
            _ => raw / 333.87 + 21.0,
        };
        assert!((found - 25.0).abs() < 0.003, "{who_am_i:#04x}: {found} °C");
    }
}

#[test]
fn standby_and_a_disabled_thermometer_hold_their_registers() {
    let ramp = || Scripted {
        force: |time_s| [time_s, time_s, time_s],
        rates: |time_s| [time_s, time_s, time_s],
    };
    for bit in 0..6 {
        let mut chip = Controller::running(perfect(), ramp());
        chip.wait(100 * MILLISECOND);
        chip.write(0x6C, 1 << bit);
        let before = chip.sample();
        chip.wait(100 * MILLISECOND);
        let after = chip.sample();
        // Bit 5 is the accelerometer's X, bit 0 the gyroscope's Z.
        let held = [0, 1, 2, 4, 5, 6][5 - bit];
        for word in [0, 1, 2, 4, 5, 6] {
            assert_eq!(
                before[word] == after[word],
                word == held,
                "bit {bit}, word {word}"
            );
        }
    }
    let warming = SensorConfig {
        errors: SensorErrors {
            self_heating_c: 5.0,
            self_heating_time_s: 0.1,
            ..SensorErrors::none()
        },
        ..perfect()
    };
    let mut chip = Controller::running(warming, level());
    chip.wait(10 * MILLISECOND);
    let before = chip.sample()[3];
    chip.wait(10 * MILLISECOND);
    assert_ne!(chip.sample()[3], before);
    chip.write(0x6B, 0x09);
    let before = chip.sample()[3];
    chip.wait(100 * MILLISECOND);
    assert_eq!(chip.sample()[3], before);
}

#[test]
fn signal_path_resets_empty_the_filters_and_sig_cond_the_registers() {
    let mut chip = Controller::running(perfect(), level());
    chip.write(0x1A, 0x06);
    chip.wait(1000 * MILLISECOND);
    assert_eq!(chip.sample()[2], 16384);
    chip.write(0x68, 0x02);
    assert_eq!(chip.sample()[2], 16384, "the registers stay");
    chip.wait(101 * MILLISECOND);
    assert!(chip.sample()[2] < 8000, "the filter starts anew");
    chip.wait(1000 * MILLISECOND);
    chip.write(0x6A, 0x01);
    assert_eq!(chip.sample(), [0; 7]);
    chip.wait(90 * MILLISECOND);
    assert_eq!(chip.sample(), [0; 7], "the registers stay empty");
    chip.wait(11 * MILLISECOND);
    let [.., z, _, _, _, _] = chip.sample();
    assert!((1..8000).contains(&z), "the filter starts anew: {z}");
    // A bit that changes without a transfer resets just the same.
    chip.wait(1000 * MILLISECOND);
    chip.sensor.corrupt_register(chip.now_ns, 0x6A, 0x01);
    assert_eq!(chip.sample(), [0; 7]);
}

#[test]
fn a_signal_path_reset_takes_the_time_that_the_register_map_asks_to_wait() {
    // SIGNAL_PATH_RESET, and SIG_COND_RESET in USER_CTRL. Their bits clear themselves.
    for (register, reset) in [(0x68, 0x04), (0x68, 0x02), (0x68, 0x07), (0x6A, 0x01)] {
        let mut chip = Controller::running(perfect(), level());
        chip.wait(1000 * MILLISECOND);
        chip.sensor.take_edges();
        chip.write(register, reset);
        assert_eq!(chip.read(register), 0, "{register:#04x} {reset}");
        let begin_ns = chip.now_ns;
        chip.wait(200 * MILLISECOND);
        let edges = chip.sensor.take_edges();
        let first_ns = edges.first().expect("samples again").time_ns - begin_ns;
        let expected = 100 * MILLISECOND..=101 * MILLISECOND;
        let what = format!("{register:#04x} {reset}: {first_ns}");
        assert!(expected.contains(&first_ns), "{what}");
    }
    // The temperature's path is not modelled.
    let mut chip = Controller::running(perfect(), level());
    chip.write(0x68, 0x01);
    chip.sensor.take_edges();
    chip.wait(10 * MILLISECOND);
    assert_eq!(chip.sensor.take_edges().len(), 10);
    // A device reset ends it.
    chip.write(0x68, 0x07);
    chip.write(0x6B, 0x80);
    chip.wait(START_UP - 10 * MILLISECOND);
    chip.write(0x6B, 0x01);
    chip.write(0x38, 0x01);
    chip.sensor.take_edges();
    chip.wait(2 * MILLISECOND);
    assert!(!chip.sensor.take_edges().is_empty());
}

#[test]
fn a_changed_range_leaves_the_filter_alone_and_a_changed_filter_starts_settled() {
    let turning = Scripted {
        force: one_g,
        rates: |_| [100.0_f64.to_radians(), 0.0, 0.0],
    };
    let mut chip = Controller::running(perfect(), turning);
    chip.wait(1000 * MILLISECOND);
    for (register, value) in [(0x1C, 0x08), (0x1A, 0x05), (0x1A, 0x01), (0x1C, 0x00)] {
        chip.write(register, value);
        chip.wait(MILLISECOND);
        let expected = if chip.read(0x1C) == 0 { 16384 } else { 8192 };
        let sample = chip.sample();
        assert!(
            (sample[2] - expected).abs() <= 1,
            "{register:#04x}: {sample:?}"
        );
        assert!(
            (sample[4] - 13100).abs() <= 1,
            "{register:#04x}: {sample:?}"
        );
    }
}

#[test]
fn what_exceeds_the_range_is_cut_off_before_the_filter() {
    // Every other millisecond +3 g and −1 g: the filter's mean is 1 g, but of the cut-off signal
    // 0.5 g.
    let hammering = Scripted {
        force: |time_s| {
            let up = (time_s * 1000.0) as i64 % 2 == 0;
            [
                if up { 3.0 } else { -1.0 } * STANDARD_GRAVITY_M_S2,
                0.0,
                0.0,
            ]
        },
        rates: still,
    };
    let mut chip = Controller::running(perfect(), hammering);
    chip.write(0x1A, 0x06);
    chip.wait(2000 * MILLISECOND);
    let mean = f64::from(chip.sample()[0]) / 16384.0;
    assert!((mean - 0.5).abs() < 0.05, "{mean}");
}

#[test]
fn the_self_test_deflects_every_axis_as_its_trim_promises() {
    // The procedure of register map r4.2, section 4.1: gyroscope at ±250 °/s, accelerometer at
    // ±8 g, response = on − off.
    let mut chip = Controller::running(perfect(), level());
    chip.write_all(&[0x1B, 0x00, 0x10]);
    chip.wait(300 * MILLISECOND);
    let off = chip.sample();
    chip.write_all(&[0x1B, 0xE0, 0xF0]);
    chip.wait(300 * MILLISECOND);
    let on = chip.sample();
    let trims = chip.read_all::<4>(0x0D);
    for axis in 0..3 {
        let gyroscope_code = f64::from(trims[axis] & 0x1F);
        let accelerometer_code =
            f64::from((trims[axis] >> 5) << 2 | trims[3] >> (4 - 2 * axis) & 3);
        assert!(gyroscope_code > 0.0 && accelerometer_code > 0.0);
        let sign = if axis == 1 { -1.0 } else { 1.0 };
        let gyroscope_trim = sign * 25.0 * 131.0 * 1.046_f64.powf(gyroscope_code - 1.0);
        let accelerometer_trim =
            4096.0 * 0.34 * (0.92_f64 / 0.34).powf((accelerometer_code - 1.0) / 30.0);
        for (word, trim) in [(axis, accelerometer_trim), (4 + axis, gyroscope_trim)] {
            let response = f64::from(on[word]) - f64::from(off[word]);
            let change = (response - trim) / trim;
            assert!(change.abs() <= 0.14, "axis {axis}: {response} for {trim}");
        }
    }
}

// Errors.

#[test]
fn noise_has_the_datasheets_density() {
    let config = SensorConfig {
        errors: SensorErrors {
            accelerometer: AxisErrors {
                noise_density: 0.4e-3 * STANDARD_GRAVITY_M_S2,
                ..AxisErrors::NONE
            },
            gyroscope: AxisErrors {
                noise_density: 0.005_f64.to_radians(),
                ..AxisErrors::NONE
            },
            ..SensorErrors::none()
        },
        ..perfect()
    };
    for (filter, gyroscope_hz, accelerometer_hz) in [(2, 98.0, 94.0), (4, 20.0, 21.0)] {
        let mut chip = Controller::running(config.clone(), level());
        chip.write(0x1A, filter);
        chip.wait(500 * MILLISECOND);
        let samples: Vec<[i16; 7]> = (0..20_000)
            .map(|_| {
                chip.wait(MILLISECOND);
                chip.sample()
            })
            .collect();
        let deviation = |word: usize| {
            let mean = samples
                .iter()
                .map(|sample| f64::from(sample[word]))
                .sum::<f64>()
                / samples.len() as f64;
            let square = samples
                .iter()
                .map(|sample| (f64::from(sample[word]) - mean).powi(2))
                .sum::<f64>();
            (square / samples.len() as f64).sqrt()
        };
        // The noise bandwidth of one pole is π/2 times its bandwidth.
        let expected = |density: f64, bandwidth_hz: f64| {
            density * (std::f64::consts::FRAC_PI_2 * bandwidth_hz).sqrt()
        };
        let gyroscope = deviation(5) / 131.0 / expected(0.005, gyroscope_hz);
        let accelerometer = deviation(0) / 16384.0 / expected(0.4e-3, accelerometer_hz);
        assert!(
            (gyroscope - 1.0).abs() < 0.05,
            "filter {filter}: {gyroscope}"
        );
        assert!(
            (accelerometer - 1.0).abs() < 0.05,
            "filter {filter}: {accelerometer}"
        );
    }
}

#[test]
fn at_rest_it_reads_its_own_offsets() {
    let config = SensorConfig::new(11);
    let errors = config.errors;
    let mut chip = Controller::running(config, level());
    chip.wait(1000 * MILLISECOND);
    let mut sums = [0.0; 7];
    let mut chip_c = 0.0;
    for _ in 0..10_000 {
        chip.wait(MILLISECOND);
        for (sum, count) in sums.iter_mut().zip(chip.sample()) {
            *sum += f64::from(count) / 10_000.0;
        }
        chip_c += errors.chip_temperature_c(25.0, chip.now_ns as f64 * 1e-9 - 0.1) / 10_000.0;
    }
    let force = [0.0, 0.0, STANDARD_GRAVITY_M_S2];
    let rates = scale([sums[4], sums[5], sums[6]], 1.0_f64.to_radians() / 131.0);
    let expected = errors.distort_rates([0.0; 3], force, chip_c, 10.0);
    assert!(norm(expected) > 0.01);
    assert!(
        norm(subtract(rates, expected)) < 1e-4,
        "{rates:?} {expected:?}"
    );
    let found = scale([sums[0], sums[1], sums[2]], STANDARD_GRAVITY_M_S2 / 16384.0);
    let expected = errors.distort_specific_force(force, chip_c);
    assert!(
        norm(subtract(found, expected)) < 2e-3,
        "{found:?} {expected:?}"
    );
}

#[test]
fn a_chip_for_recordings_only_quantises() {
    let config = SensorConfig {
        mount: Mount::parse("z-down").unwrap(),
        ..SensorConfig::for_recording(3)
    };
    let turning = Scripted {
        force: |time_s| [time_s, 0.0, -9.0],
        rates: |time_s| [0.0, 0.1 * time_s, 0.0],
    };
    let mut chip = Controller::running(config, turning);
    chip.wait(777_777_777);
    let sample = chip.sample();
    let time_s = chip.sensor.take_edges().last().unwrap().time_ns as f64 * 1e-9;
    let expected = (time_s / STANDARD_GRAVITY_M_S2 * 16384.0).round() as i16;
    assert_eq!(sample[0], expected);
    assert_eq!(
        sample[5],
        (0.1 * time_s.to_degrees() * 131.0).round() as i16
    );
}

#[test]
fn edges_carry_the_truth_of_their_instant() {
    let mut chip = Controller::running(SensorConfig::new(2), Quadrotor::by_seed(2));
    chip.wait(6000 * MILLISECOND);
    let mut reference = Quadrotor::by_seed(2);
    let edges = chip.sensor.take_edges();
    assert!(edges.len() > 5000);
    for edge in edges.iter().step_by(97) {
        assert_eq!(edge.truth, reference.at(edge.time_ns as f64 * 1e-9));
    }
    assert!(chip.sensor.take_edges().is_empty(), "taken out");
}

#[test]
fn one_seed_is_one_chip() {
    let fly = |seed: u64| {
        let mut chip = Controller::running(SensorConfig::new(seed), Quadrotor::by_seed(1));
        chip.wait(5000 * MILLISECOND);
        (chip.sample(), chip.sensor.take_edges().len())
    };
    assert_eq!(fly(1), fly(1));
    assert_ne!(fly(1), fly(2));
}

#[test]
fn successors_filter_the_accelerometer_by_a_register_of_their_own() {
    assert_eq!(Identity::of(0x70).accelerometer_filter_register, 0x1D);
    let delay_ms = |accelerometer_filter: u8| {
        let ramp = Scripted {
            force: |time_s| [(time_s - 1.0) * STANDARD_GRAVITY_M_S2, 0.0, 0.0],
            rates: still,
        };
        let mut chip = Controller::running(
            SensorConfig {
                who_am_i: 0x70,
                ..perfect()
            },
            ramp,
        );
        chip.write(0x1D, accelerometer_filter);
        assert_eq!(chip.read(0x1D), accelerometer_filter);
        chip.wait(1500 * MILLISECOND);
        let force = f64::from(chip.sample()[0]) / 16384.0;
        (chip.sensor.take_edges().last().unwrap().time_ns as f64 * 1e-9 - 1.0 - force) * 1e3
    };
    assert!((delay_ms(1) - 5.8).abs() < 0.05);
    assert!((delay_ms(6) - 66.96).abs() < 0.05);
}
