//! Data that survive a reset: the fault counters, the cause of the last reset, whether the module
//! was armed, the record in use, and the state for a warm start.
//!
//! The data lie in RAM that start-up does not clear (`.uninit`). A check word distinguishes data of
//! an earlier run from the random content after power-up. A debugger finds the health report under
//! the symbol `APLOMB_HEALTH`, in the layout of `fault::report`, and the armed state under
//! `APLOMB_ARMED`: 0 while disarmed.

use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};

use stm32f4xx_hal::pac::rcc;

use crate::estimator::kalman::{PAUSE_RATE_RAD_S, VALUES, WarmStart};
use crate::fault::{FaultClass, ResetCause, report};

/// Health report, in the layout of `fault::report`.
#[repr(C)]
struct Report {
    version: AtomicU32,
    reset_cause: AtomicU32,
    last_fault: AtomicU32,
    starts: AtomicU32,
    crash_address: AtomicU32,
    counters: [AtomicU32; FaultClass::COUNT],
    check: AtomicU32,
}

const _: () = assert!(core::mem::offset_of!(Report, reset_cause) == report::RESET_CAUSE);
const _: () = assert!(core::mem::offset_of!(Report, last_fault) == report::LAST_FAULT);
const _: () = assert!(core::mem::offset_of!(Report, starts) == report::STARTS);
const _: () = assert!(core::mem::offset_of!(Report, crash_address) == report::CRASH_ADDRESS);
const _: () = assert!(core::mem::offset_of!(Report, counters) == report::COUNTERS);
const _: () = assert!(core::mem::offset_of!(Report, check) == report::LENGTH);

// The initial value is not used: start-up does not write this section.
#[unsafe(no_mangle)]
#[unsafe(link_section = ".uninit.APLOMB_HEALTH")]
static APLOMB_HEALTH: Report = Report {
    version: AtomicU32::new(0),
    reset_cause: AtomicU32::new(0),
    last_fault: AtomicU32::new(0),
    starts: AtomicU32::new(0),
    crash_address: AtomicU32::new(0),
    counters: [const { AtomicU32::new(0) }; FaultClass::COUNT],
    check: AtomicU32::new(0),
};

/// Check word. It changes with the layout, so that another version's report is not accepted.
const CHECK: u32 = 0x4150_4C4D ^ (report::LENGTH as u32) << 8;

/// [`ARMED_WORD`] while the module is armed, otherwise 0.
#[unsafe(no_mangle)]
#[unsafe(link_section = ".uninit.APLOMB_ARMED")]
static APLOMB_ARMED: AtomicU32 = AtomicU32::new(0);

/// Content of [`APLOMB_ARMED`] while the module is armed.
const ARMED_WORD: u32 = 0x6172_6D64;

/// [`CRASHED_WORD`] from a crash to the next start. A debugger's reset sets the same bit of the
/// status register as the firmware's own, so this word distinguishes the two.
#[unsafe(link_section = ".uninit.APLOMB_CRASHED")]
static CRASHED: AtomicU32 = AtomicU32::new(0);

/// Content of [`CRASHED`] after a crash.
const CRASHED_WORD: u32 = 0x6372_7368;

/// Length of the record in use, in bytes.
pub const RECORD_LENGTH: usize = 256;

/// Record in use, with its own checksum.
#[unsafe(link_section = ".uninit.APLOMB_RECORD")]
static RECORD: [AtomicU32; RECORD_LENGTH / 4] = [const { AtomicU32::new(0) }; RECORD_LENGTH / 4];

/// State for a warm start, in two copies that are written in turn: a reset while one is written
/// leaves the other.
#[unsafe(link_section = ".uninit.APLOMB_WARM_STARTS")]
static WARM_STARTS: [Words; 2] = [const { Words([const { AtomicU32::new(0) }; LENGTH]) }; 2];

/// Index of the copy that was written last.
static NEWEST: AtomicU8 = AtomicU8::new(0);

/// The values of a [`WarmStart`], then the number of the copy and its sum.
struct Words([AtomicU32; LENGTH]);

const LENGTH: usize = VALUES + 2;

/// Typical age of the kept attitude at a warm start, in seconds. It is half the time between two
/// copies on average, plus the watchdog's limit of 0.2 to 0.56 s. The worst case of both is 0.8 s,
/// and 1 s with a sensor that answers late. After a crash the age is below 0.4 s. A hang in the
/// work that sets a longer limit exceeds this; the module is not armed then.
const TYPICAL_AGE_S: f32 = 0.5;

/// σ of the turn about one axis in [`TYPICAL_AGE_S`], rad.
const UNSEEN_RAD: f32 = PAUSE_RATE_RAD_S * TYPICAL_AGE_S;

/// Smallest σ of a bias after a reset, in rad/s: 0.05 °/s. A larger one lets the accelerations of
/// a flight move the bias before the next rest.
const BIAS_SIGMA_RAD_S: f32 = 8.7e-4;

/// Data found at start-up.
#[derive(Clone, Copy)]
pub struct Start {
    /// Cause of the processor's reset.
    pub cause: ResetCause,
    /// Last fault before the reset, if RAM has survived it.
    pub last_fault: Option<FaultClass>,
    /// Number of starts since power-up, this one included.
    pub starts: u32,
    /// Program counter of the crash; 0 without one.
    pub crash_address: u32,
}

/// Reads the cause of the reset, and the data of the previous run. Called once, in init, before any
/// interrupt.
pub fn start(rcc: &rcc::RegisterBlock) -> Start {
    let status = rcc.csr().read();
    rcc.csr().modify(|_, w| w.rmvf().set_bit());
    let has_crashed = CRASHED.swap(0, Ordering::Relaxed) == CRASHED_WORD;
    // Every other cause pulls the reset pin too (RM0090, 6.1.1).
    let cause = if status.wdgrstf().bit() || status.wwdgrstf().bit() {
        ResetCause::Watchdog
    } else if status.sftrstf().bit() && has_crashed {
        ResetCause::Software
    } else if status.porrstf().bit() || status.borrstf().bit() {
        ResetCause::Power
    } else if status.sftrstf().bit() || status.padrstf().bit() {
        ResetCause::Pin
    } else {
        ResetCause::Other
    };
    let report = &APLOMB_HEALTH;
    let is_kept = report.check.load(Ordering::Relaxed) == CHECK && cause != ResetCause::Power;
    let is_warm = is_kept && cause.is_warm();
    if !is_warm {
        set_armed(false);
        forget();
        keep_record(&[0; RECORD_LENGTH]);
    }
    if !is_kept {
        for word in [&report.starts, &report.crash_address] {
            word.store(0, Ordering::Relaxed);
        }
        report.last_fault.store(report::NO_FAULT, Ordering::Relaxed);
        for counter in &report.counters {
            counter.store(0, Ordering::Relaxed);
        }
        report.check.store(CHECK, Ordering::Relaxed);
    }
    report.version.store(report::VERSION, Ordering::Relaxed);
    report.reset_cause.store(cause as u32, Ordering::Relaxed);
    let starts = report.starts.load(Ordering::Relaxed).wrapping_add(1);
    report.starts.store(starts, Ordering::Relaxed);
    let last_fault = FaultClass::from_number(report.last_fault.load(Ordering::Relaxed));
    if cause == ResetCause::Watchdog {
        count(FaultClass::Watchdog);
    }
    // A second reset before the next copy finds this one.
    keep(kept().map(aged).as_ref());
    Start {
        cause,
        last_fault,
        starts,
        crash_address: report.crash_address.swap(0, Ordering::Relaxed),
    }
}

/// Counts a fault. May be called at any priority.
#[inline(never)]
pub fn count(class: FaultClass) {
    if let Some(counter) = APLOMB_HEALTH.counters.get(class as usize) {
        counter.fetch_add(1, Ordering::Relaxed);
    }
    APLOMB_HEALTH
        .last_fault
        .store(class as u32, Ordering::Relaxed);
}

/// Returns the number of these faults since power-up.
pub fn counted(class: FaultClass) -> u32 {
    APLOMB_HEALTH
        .counters
        .get(class as usize)
        .map_or(0, |counter| counter.load(Ordering::Relaxed))
}

/// Records a crash for the next start.
pub fn note_crash(class: FaultClass, address: u32) {
    CRASHED.store(CRASHED_WORD, Ordering::Relaxed);
    count(class);
    APLOMB_HEALTH
        .crash_address
        .store(address, Ordering::Relaxed);
}

/// Returns whether the module is armed, which a warm reset does not change.
pub fn is_armed() -> bool {
    APLOMB_ARMED.load(Ordering::Relaxed) == ARMED_WORD
}

/// Arms or disarms the module. The filter has a copy of its own.
pub fn set_armed(is_armed: bool) {
    let word = if is_armed { ARMED_WORD } else { 0 };
    APLOMB_ARMED.store(word, Ordering::Relaxed);
}

/// Keeps the bytes of the record in use.
pub fn keep_record(bytes: &[u8; RECORD_LENGTH]) {
    for (place, word) in RECORD.iter().zip(bytes.as_chunks().0) {
        place.store(u32::from_le_bytes(*word), Ordering::Relaxed);
    }
}

/// Returns the bytes of the record in use, of this run or of the one before a reset. They are zeros
/// or random if RAM has not survived.
pub fn record() -> [u8; RECORD_LENGTH] {
    let mut bytes = [0; RECORD_LENGTH];
    for (word, place) in bytes.as_chunks_mut().0.iter_mut().zip(&RECORD) {
        *word = place.load(Ordering::Relaxed).to_le_bytes();
    }
    bytes
}

/// Keeps the state for a start after a reset. `None` forgets the earlier one: its σ does not cover
/// what happens from now on. The supervisor calls this before the first sample, and then the
/// attitude task.
#[inline(never)]
pub fn keep(start: Option<&WarmStart>) {
    let Some(start) = start else {
        forget();
        return;
    };
    let newest = NEWEST.load(Ordering::Relaxed);
    let next = newest ^ 1;
    let number = copy(newest).number().unwrap_or(0).wrapping_add(1);
    copy(next).write(number, start);
    NEWEST.store(next, Ordering::Relaxed);
}

/// Returns the state to continue from, if RAM has survived the reset and the run before had a
/// state.
#[inline(never)]
pub fn kept() -> Option<WarmStart> {
    let [first, second] = &WARM_STARTS;
    // A damaged copy has no number, and `None` is less than any.
    let is_first_newest = first.number() > second.number();
    let newest = if is_first_newest { first } else { second };
    newest.number().map(|_| newest.start())
}

/// Returns the state with σ inflated for its age at a reset.
fn aged(start: WarmStart) -> WarmStart {
    let tilt = start.tilt_sigma_rad;
    WarmStart {
        // Both axes together, and independent of the kept σ.
        tilt_sigma_rad: libm::sqrtf(tilt * tilt + 2.0 * UNSEEN_RAD * UNSEEN_RAD),
        bias_sigma_rad_s: start.bias_sigma_rad_s.max(BIAS_SIGMA_RAD_S),
        ..start
    }
}

/// Forgets the kept state.
#[inline(never)]
fn forget() {
    for copy in &WARM_STARTS {
        copy.invalidate();
    }
}

/// Returns the copy with this sequence number.
fn copy(number: u8) -> &'static Words {
    &WARM_STARTS[usize::from(number & 1)]
}

impl Words {
    // Out of line, this and the functions below save hundreds of bytes of flash.
    #[inline(never)]
    fn invalidate(&self) {
        let [.., sum] = &self.0;
        sum.store(!self.sum(), Ordering::Relaxed);
    }

    /// Returns the sequence number; `None` if the copy is damaged.
    #[inline(never)]
    fn number(&self) -> Option<u32> {
        let [.., number, sum] = &self.0;
        let is_whole = sum.load(Ordering::Acquire) == self.sum();
        is_whole.then(|| number.load(Ordering::Relaxed))
    }

    #[inline(never)]
    fn sum(&self) -> u32 {
        let [words @ .., _] = &self.0;
        words.iter().fold(CHECK, |sum, word| {
            sum.rotate_left(5) ^ word.load(Ordering::Relaxed)
        })
    }

    fn write(&self, number: u32, start: &WarmStart) {
        // A half-written copy fails its check, because its sum is written last.
        let [places @ .., place, _] = &self.0;
        for (place, value) in places.iter().zip(start.values()) {
            place.store(value.to_bits(), Ordering::Relaxed);
        }
        place.store(number, Ordering::Relaxed);
        let [.., sum] = &self.0;
        sum.store(self.sum(), Ordering::Release);
    }

    /// Returns the contents.
    fn start(&self) -> WarmStart {
        let [words @ .., _, _] = &self.0;
        let values = words
            .each_ref()
            .map(|word| f32::from_bits(word.load(Ordering::Relaxed)));
        WarmStart::from_values(&values)
    }
}
