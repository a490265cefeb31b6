//! Supervisor, which runs as the idle task: keeps the sensor configured, and runs the work that
//! stops the sensor.
//!
//! The supervisor configures the sensor at start and after every fault, and starts the pipeline. It
//! runs the console's jobs (save, self-test, registers) while the burst reader is paused.

use core::f32::consts::PI;

use aplomb::board::burst_reader;
use aplomb::board::delay::Delay;
use aplomb::board::flash::{CalibrationFlash, FlashError};
#[cfg(feature = "full")]
use aplomb::board::measure;
use aplomb::board::sensor::{self, NotReady, Ready, Sensor};
use aplomb::board::{retained, timebase, watchdog};
use aplomb::compass::{self, PartId};
use aplomb::console::{Job, Outcome};
use aplomb::mpu6050::{self, Config, Part, SettingsState};
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::settings::storage::{self, SaveError};
use aplomb::telemetry::Mailbox;
use aplomb::telemetry::message::Message;
use embedded_hal::delay::DelayNs;
use rtic::Mutex;

use crate::estimation::Estimation;
use crate::kept_record;
#[cfg(feature = "full")]
use crate::requests::{AFTER_PUBLICATION, FIGURES, MEASUREMENT, NEW_MEASUREMENT};
use crate::requests::{JOB, Requests, TO_SUPERVISOR};

/// Longest duration of a save, in ms. It erases up to two sectors of 16 KiB, and each erase stalls
/// the core for up to half a second (STM32F405 datasheet, table "Flash memory programming"). The
/// other jobs report progress.
const SAVE_LIMIT_MS: u32 = 2_000;
/// Shortest pause in the samples around a job, in µs. It is longer than the filter bridges, so
/// the attitude is flagged [`GAP`](aplomb::health::Flags::GAP) and restarts from gravity.
const PAUSE_US: u32 = 600_000;
/// Shortest time between two messages about a recovery, in µs: leaves room for other messages.
const RECOVERY_MESSAGE_PERIOD_US: u32 = 200_000;

/// Longest time from the start to the sensor's first answer for which the kept tilt is used, µs.
/// The time base wraps after 71 minutes; one attempt in that time is enough.
const LONGEST_WAIT_US: u32 = 200_000;

/// Runs the supervisor forever.
pub fn run(
    sensor: &mut Sensor,
    flash: &mut CalibrationFlash,
    settings: &Settings,
    mut estimation: impl Mutex<T = Estimation>,
    mut messages: impl Mutex<T = Mailbox>,
    mut requests: impl Mutex<T = Requests>,
) -> ! {
    let mut post = |message| messages.lock(|messages| messages.post(message));
    let mut last_reason = None;
    let mut has_started = false;
    let mut should_report = true;
    // The first recovery is reported however early it comes.
    let mut reported_at = timebase::now().wrapping_sub(RECOVERY_MESSAGE_PERIOD_US);
    loop {
        watchdog::report_samples();
        match sensor.make_ready() {
            Ok(ready) => {
                should_report |= last_reason.take().is_some();
                start_estimation(&ready, settings, &mut estimation, &mut requests);
                has_started = true;
                burst_reader::enable(&ready, &Config::DEFAULT);
                if should_report {
                    post(Message::SensorConfigured {
                        part: ready.part.name,
                        address: ready.address,
                    });
                }
                sleep_or_measure();
                if burst_reader::is_enabled() {
                    burst_reader::pause();
                    should_report = true;
                } else {
                    // Under a persistent fault the recovery repeats hundreds of times a second.
                    should_report = timebase::elapsed(reported_at, RECOVERY_MESSAGE_PERIOD_US);
                    if should_report {
                        reported_at = timebase::now();
                        post(Message::Recovering);
                    }
                }
            }
            Err(reason) => {
                // The sensor may have been powered up together with the processor.
                let is_starting = reason == NotReady::Sensor(mpu6050::Error::NotFound)
                    && sensor.may_be_starting();
                // One message for each reason, however many attempts.
                if !is_starting && last_reason.replace(reason) != Some(reason) {
                    post(message_for(reason));
                }
                if !has_started
                    && timebase::elapsed(0, LONGEST_WAIT_US)
                    && let Some(mut start) = retained::kept()
                {
                    start.tilt_sigma_rad = PI;
                    retained::keep(Some(&start));
                }
                Delay.delay_ms(sensor::RETRY_MS);
            }
        }
        if cfg!(feature = "full")
            && TO_SUPERVISOR.set(JOB, false)
            && let Some(job) = requests.lock(|requests| requests.job.take())
        {
            let mut compass = None;
            if compass::IS_BUILT_IN {
                compass = estimation.lock(|estimation| estimation.compass.compass_under_test());
            }
            perform_paused(&job, sensor, compass, flash, &mut requests);
            if job == Job::SelfTest && compass.is_some() {
                estimation.lock(|estimation| estimation.compass.restart());
            }
        }
    }
}

/// Sleeps until the burst reader is disabled or a job is requested. Runs a measurement meanwhile,
/// if one is wanted.
fn sleep_or_measure() {
    while burst_reader::is_enabled() && !TO_SUPERVISOR.contains(JOB) {
        timebase::sleep_until(|| !burst_reader::is_enabled() || TO_SUPERVISOR.bits() != 0);
        #[cfg(feature = "full")]
        if TO_SUPERVISOR.contains(MEASUREMENT) {
            let is_new = TO_SUPERVISOR.set(NEW_MEASUREMENT, false);
            AFTER_PUBLICATION.set(FIGURES, true);
            measure::run(is_new, || {
                !burst_reader::is_enabled() || TO_SUPERVISOR.bits() != MEASUREMENT
            });
            AFTER_PUBLICATION.set(FIGURES, false);
        }
    }
}

/// Publishes the part and address of the sensor, and starts the pipeline if it does not run. After
/// a fault the filter continues with its state.
fn start_estimation(
    ready: &Ready,
    settings: &Settings,
    estimation: &mut impl Mutex<T = Estimation>,
    requests: &mut impl Mutex<T = Requests>,
) {
    // One lock: a command in between would change the calibration, but find no pipeline.
    requests.lock(|requests| {
        requests.sensor = Some((ready.part, ready.address));
        estimation.lock(|Estimation { pipeline, .. }| {
            if pipeline.is_none() {
                start_pipeline(pipeline, settings, ready.part);
            }
        });
    });
}

/// Compass to test: part, factory trims.
type CompassToTest = Option<(PartId, [u8; 3])>;

/// Performs a job, and publishes its outcome. Returns [`PAUSE_US`] after the start, or later.
fn perform_paused(
    job: &Job,
    sensor: &mut Sensor,
    compass: CompassToTest,
    flash: &mut CalibrationFlash,
    requests: &mut impl Mutex<T = Requests>,
) {
    let since = timebase::now();
    let outcome = perform(job, sensor, compass, flash);
    watchdog::set_limit_ms(watchdog::LIMIT_MS);
    requests.lock(|requests| requests.outcome = Some(outcome));
    timebase::sleep_until(|| {
        watchdog::report_samples();
        timebase::elapsed(since, PAUSE_US)
    });
}

/// Creates the pipeline in place. Not inlined, because the supervisor's stack frame never ends.
#[inline(never)]
fn start_pipeline(place: &mut Option<Pipeline>, settings: &Settings, part: &'static Part) {
    let mut settings = Settings { part, ..*settings };
    if let Some(record) = kept_record::get() {
        settings.calibration = record.calibration;
    }
    let pipeline = place.insert(Pipeline::new(&settings));
    pipeline.set_armed(retained::is_armed());
    if let Some(start) = retained::kept() {
        pipeline.resume(&start, u64::from(timebase::now()));
    }
}

/// Returns the message for the reason why no samples come.
fn message_for(reason: NotReady) -> Message {
    match reason {
        NotReady::BusHeldLow(held) => Message::BusHeldLow { clock: held.clock },
        NotReady::Sensor(error) => Message::SensorFailed(error),
    }
}

/// Runs a job while the burst reader is paused.
#[inline(never)]
fn perform(
    job: &Job,
    sensor: &mut Sensor,
    compass: CompassToTest,
    flash: &mut CalibrationFlash,
) -> Outcome {
    match job {
        Job::Save => match save(flash) {
            Ok(()) => Outcome::new(true, &"stored"),
            Err(error) => Outcome::new(false, &error),
        },
        Job::ReadBack => match sensor.read_back() {
            Ok(read) => Outcome::new(read.settings == SettingsState::Intact, &read),
            Err(reason) => Outcome::new(false, &message_for(reason)),
        },
        Job::SelfTest => self_test(sensor, compass),
    }
}

/// Stores the record in use. No command changes it before the end of the job. Without the
/// watchdog's long limit an erase would end in a reset, so the save is refused.
fn save(flash: &mut CalibrationFlash) -> Result<(), SaveError<FlashError>> {
    let record = kept_record::get().ok_or(SaveError::Unstorable)?;
    if watchdog::set_limit_ms(SAVE_LIMIT_MS) {
        storage::save(flash, &record)
    } else {
        Err(SaveError::Flash(FlashError::Timeout))
    }
}

/// Runs the self-test of the compass, and then that of the sensor: its reset would switch off the
/// bypass to a compass behind it.
#[inline(never)]
fn self_test(sensor: &mut Sensor, compass: CompassToTest) -> Outcome {
    let compass = compass.map(|(part, trims)| sensor.test_compass(part, trims));
    let tested = match sensor.test() {
        Ok(tested) => tested,
        Err(reason) => return Outcome::new(false, &message_for(reason)),
    };
    let is_ok = tested.has_passed() != Some(false);
    match compass {
        None => Outcome::new(is_ok, &tested),
        Some(Ok(compass)) => {
            let is_ok = is_ok && compass.has_passed() != Some(false);
            Outcome::new(is_ok, &format_args!("{tested}; {compass}"))
        }
        Some(Err(fault)) => Outcome::new(false, &format_args!("{tested}; compass: {fault}")),
    }
}
