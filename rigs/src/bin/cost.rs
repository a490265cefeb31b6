//! Measures an update of each filter on the Cortex-M4F: instructions, counted in QEMU, and bytes of
//! state.
//!
//! All filters get the same samples (rest, turns and accelerations at 1 kHz), each in the filter's
//! own axes and units. The interface is the same for all: sample in, quaternion and body rates out.
//! Each filter runs twice, and both runs must agree to the instruction. `APLOMB_COST_FILTER`, set
//! at build time, leaves one filter in the image, or with `none` no filter. The images' sizes give
//! the code size of a filter.
//!
//! ```text
//! qemu-system-arm -M netduinoplus2 -icount shift=0,sleep=off -kernel cost.elf \
//!     -semihosting-config enable=on,target=native
//! ```
//!
//! Prints a line `name,mean,maximum,first,bytes` for each filter. Exit status 0: both runs agreed.
//! 1: they did not, and standard error names the filter. `cargo xtask cost` runs all steps.

#![no_std]
#![no_main]

use core::hint::black_box;
use core::panic::PanicInfo;

use aplomb::attitude::{BodyVector, Quaternion, Vector3};
use aplomb::estimator::classic::{AxisKalman, Tutorial};
use aplomb::estimator::heading::{CompassKnowledge, Heading};
use aplomb::estimator::kalman::Kalman;
use aplomb::estimator::{Estimator, Filter, Sample};
use aplomb::units::{MagneticField, STANDARD_GRAVITY_M_S2, degrees, radians};
use aplomb_rigs::host_files;
use aplomb_rigs::instruction_counter::InstructionCounter;
use cortex_m_semihosting::{heprintln, hprintln};
use stm32f4xx_hal::pac;

/// Number of samples: a minute at 1 kHz.
const SAMPLES: u32 = 60_000;
/// Number of samples at rest at the start.
const REST_SAMPLES: u32 = 3_000;
const STEP_S: f32 = 1.0e-3;
/// Samples between two readings of the compass.
const COMPASS_SAMPLES: u32 = 10;
/// Age of a reading of the compass, µs.
const FIELD_AGE_US: u32 = 5_000;
/// Earth's field, µT.
const FIELD_UT: Vector3 = Vector3::new(20.0, 0.0, 45.0);
/// Delay of the default low-pass filter.
const DELAY_US: u32 = 1_900;

#[panic_handler]
fn panic(information: &PanicInfo<'_>) -> ! {
    heprintln!("{}", information);
    host_files::exit(false)
}

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(device) = pac::Peripherals::take() else {
        host_files::exit(false)
    };
    let counter = InstructionCounter::new(device.TIM2, &device.RCC);
    let bench = Bench {
        overhead: measure(&counter, &mut Nothing, &Input::default()).0,
        counter,
    };
    let mut succeeded = true;
    succeeded &= bench.run("none", || Nothing);
    succeeded &= bench.run("kalman", || kalman(0));
    succeeded &= bench.run("kalman + extrapolation", || kalman(DELAY_US));
    succeeded &= bench.run("kalman + sigma", || WithSigma(kalman(0)));
    succeeded &= bench.run("kalman + heading", || WithHeading {
        estimator: kalman(0).0,
        heading: Heading::new(CompassKnowledge::Factory),
    });
    succeeded &= bench.run("axis-kalman", || {
        Library(Estimator::with_filter(AxisKalman::new()))
    });
    succeeded &= bench.run("classic", || {
        Library(Estimator::with_filter(Tutorial::new()))
    });
    succeeded &= bench.run("fusion", Fusion::new);
    succeeded &= bench.run("madgwick", Madgwick::new);
    succeeded &= bench.run("mahony", Mahony::new);
    host_files::exit(succeeded)
}

/// Sample in the axes and units of each filter.
#[repr(C)]
#[derive(Clone, Copy, Default)]
struct Input {
    /// Forward-right-down.
    sample: Sample,
    /// Forward-left-up, rad/s.
    rates: [f32; 3],
    /// Forward-left-up, °/s.
    rates_degrees: [f32; 3],
    /// Forward-left-up, m/s².
    force: [f32; 3],
    /// Forward-left-up, g.
    force_g: [f32; 3],
    /// Reading of a compass at 100 Hz, in body axes.
    field: Option<MagneticField>,
}

/// Output of a filter: the quaternion and the body rates.
type Output = ([f32; 4], [f32; 3]);

/// Interface of all filters.
trait Subject {
    fn update(&mut self, input: &Input) -> Output;
}

struct Bench {
    counter: InstructionCounter,
    /// Instructions of the measurement itself.
    overhead: u32,
}

impl Bench {
    /// Measures a filter twice, and prints the result.
    fn run<S: Subject>(&self, name: &str, make: impl Fn() -> S) -> bool {
        let is_chosen = match option_env!("APLOMB_COST_FILTER") {
            None | Some("") => true,
            Some(chosen) => is_same(chosen, name),
        };
        if !is_chosen {
            return true;
        }
        let pass = self.pass(&mut make());
        let agrees = self.pass(&mut make()) == pass;
        if !agrees {
            heprintln!("{}: two runs of the same samples differ", name);
        }
        // Tenths of an instruction.
        let mean = (10 * pass.total + u64::from(SAMPLES) / 2) / u64::from(SAMPLES);
        let bytes = size_of::<S>();
        let (tens, tenths) = (mean / 10, mean % 10);
        hprintln!(
            "{},{}.{},{},{},{}",
            name,
            tens,
            tenths,
            pass.maximum,
            pass.first,
            bytes
        );
        agrees
    }

    /// Runs once through all samples.
    fn pass<S: Subject>(&self, subject: &mut S) -> Pass {
        let mut motion = Motion::new();
        let mut pass = Pass::default();
        for index in 0..SAMPLES {
            let input = motion.next(index);
            let (instructions, output) = measure(&self.counter, subject, &input);
            black_box(output);
            let instructions = instructions.saturating_sub(self.overhead);
            pass.total += u64::from(instructions);
            if index == 0 {
                pass.first = instructions;
            } else {
                pass.maximum = pass.maximum.max(instructions);
            }
        }
        pass
    }
}

/// Instructions of one run.
#[derive(Clone, Copy, Default, PartialEq)]
struct Pass {
    total: u64,
    /// Instructions of the first sample, which starts the filter.
    first: u32,
    /// Instructions of the other samples.
    maximum: u32,
}

/// Returns the instructions between two reads of the counter around one update.
#[inline(never)]
fn measure<S: Subject>(
    counter: &InstructionCounter,
    subject: &mut S,
    input: &Input,
) -> (u32, Output) {
    let before = counter.now();
    let output = update(black_box(subject), black_box(input));
    let after = counter.now();
    (after.wrapping_sub(before), output)
}

#[inline(never)]
fn update<S: Subject>(subject: &mut S, input: &Input) -> Output {
    subject.update(input)
}

/// Compares strings in constants, so that only the chosen filter is in the image.
const fn is_same(left: &str, right: &str) -> bool {
    let (left, right) = (left.as_bytes(), right.as_bytes());
    if left.len() != right.len() {
        return false;
    }
    let mut index = 0;
    while index < left.len() {
        if left[index] != right[index] {
            return false;
        }
        index += 1;
    }
    true
}

/// Body that rests, then turns about all axes and accelerates along them. Its sensor has noise and
/// an offset.
struct Motion {
    attitude: Quaternion,
    noise: u32,
}

impl Motion {
    const fn new() -> Self {
        Self {
            attitude: Quaternion::IDENTITY,
            noise: 1,
        }
    }

    #[inline(never)]
    fn next(&mut self, index: u32) -> Input {
        let time_s = index.saturating_sub(REST_SAMPLES) as f32 * STEP_S;
        let share = if index < REST_SAMPLES { 0.0 } else { 1.0 };
        let swing = |amplitude: f32, rad_s: f32| share * amplitude * libm::sinf(rad_s * time_s);
        let rates = Vector3::new(swing(2.0, 1.1), swing(1.5, 1.7), swing(1.0, 0.6));
        let acceleration = Vector3::new(swing(3.0, 2.3), swing(2.0, 3.1), swing(2.0, 4.7));
        let turn = Quaternion::from_rotation_vector(rates.scale(STEP_S));
        self.attitude = self.attitude.multiply(turn).normalize();
        let gravity = Vector3::new(0.0, 0.0, STANDARD_GRAVITY_M_S2);
        let force = self.attitude.conjugate().rotate(acceleration - gravity);
        let offset = Vector3::new(radians(1.0), radians(-0.5), radians(0.7));
        let force = force + self.noise(0.1);
        let rates = rates + offset + self.noise(0.003);
        let field = self.attitude.conjugate().rotate(FIELD_UT);
        let field = MagneticField {
            ut: [field.x + 30.0, field.y, field.z],
        };
        let flip = |v: Vector3| [v.x, -v.y, -v.z];
        Input {
            sample: Sample::new(
                1_000 * u64::from(index),
                BodyVector(force),
                BodyVector(rates),
            ),
            field: index.is_multiple_of(COMPASS_SAMPLES).then_some(field),
            rates: flip(rates),
            rates_degrees: flip(rates).map(degrees),
            force: flip(force),
            force_g: flip(force).map(|part| part / STANDARD_GRAVITY_M_S2),
        }
    }

    /// Uniform noise on three axes.
    fn noise(&mut self, amplitude: f32) -> Vector3 {
        let mut next = || {
            // Numerical Recipes' linear congruential generator.
            self.noise = self
                .noise
                .wrapping_mul(1_664_525)
                .wrapping_add(1_013_904_223);
            amplitude * (self.noise >> 8) as f32 / (1 << 23) as f32 - amplitude
        };
        Vector3::new(next(), next(), next())
    }
}

struct Nothing;

impl Subject for Nothing {
    fn update(&mut self, _: &Input) -> Output {
        Default::default()
    }
}

struct Library<F>(Estimator<F>);

fn kalman(delay_us: u32) -> Library<Kalman> {
    let mut estimator = Estimator::new();
    estimator.filter_mut().set_delay_us(delay_us);
    Library(estimator)
}

impl<F: Filter> Subject for Library<F> {
    fn update(&mut self, input: &Input) -> Output {
        let estimate = self.0.update(&input.sample);
        let (q, rates) = (estimate.attitude, estimate.body_rates_rad_s);
        ([q.w, q.x, q.y, q.z], [rates.x, rates.y, rates.z])
    }
}

/// Kalman filter whose σ is read after each sample.
struct WithSigma(Library<Kalman>);

impl Subject for WithSigma {
    fn update(&mut self, input: &Input) -> Output {
        let output = self.0.update(input);
        black_box(self.0.0.filter().tilt_sigma_rad());
        output
    }
}

/// Kalman filter with the heading filter beside it.
struct WithHeading {
    estimator: Estimator,
    heading: Heading,
}

impl Subject for WithHeading {
    fn update(&mut self, input: &Input) -> Output {
        let estimate = self.estimator.update(&input.sample);
        let kalman = self.estimator.filter();
        self.heading.update(kalman, STEP_S);
        if let Some(field) = input.field {
            self.heading.add_field(field, FIELD_AGE_US);
        }
        let (q, rates) = (estimate.attitude, estimate.body_rates_rad_s);
        ([q.w, q.x, q.y, q.z], [rates.x, rates.y, rates.z])
    }
}

struct Madgwick(ahrs::Madgwick<f32>);

impl Madgwick {
    fn new() -> Self {
        Self(ahrs::Madgwick::new(STEP_S, 0.02))
    }
}

impl Subject for Madgwick {
    fn update(&mut self, input: &Input) -> Output {
        use ahrs::Ahrs as _;
        let result = self.0.update_imu(&input.rates.into(), &input.force.into());
        (
            result.map_or([0.0; 4], |q| [q.w, q.i, q.j, q.k]),
            input.rates,
        )
    }
}

struct Mahony(ahrs::Mahony<f32>);

impl Mahony {
    fn new() -> Self {
        Self(ahrs::Mahony::new(STEP_S, 0.15, 0.0))
    }
}

impl Subject for Mahony {
    fn update(&mut self, input: &Input) -> Output {
        use ahrs::Ahrs as _;
        let result = self.0.update_imu(&input.rates.into(), &input.force.into());
        (
            result.map_or([0.0; 4], |q| [q.w, q.i, q.j, q.k]),
            input.rates,
        )
    }
}

struct Fusion(fusion_ahrs::Ahrs);

impl Fusion {
    fn new() -> Self {
        Self(fusion_ahrs::Ahrs::with_settings(
            fusion_ahrs::AhrsSettings {
                sample_rate: 1.0 / STEP_S,
                gain: 0.2,
                ..Default::default()
            },
        ))
    }
}

impl Subject for Fusion {
    fn update(&mut self, input: &Input) -> Output {
        self.0
            .update_no_magnetometer(input.rates_degrees, input.force_g);
        let q = self.0.quaternion();
        ([q.w, q.x, q.y, q.z], input.rates)
    }
}
