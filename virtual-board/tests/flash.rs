//! The stored record in the flash of the real image: it lasts, and no power cut during a save loses
//! it.

mod common;

use aplomb::health::Flags;
use aplomb::settings::{OutputFormat, storage};
use aplomb_models::motion::rest::Rest;
use common::pooled_run;
use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use virtual_board::faults::Fault;
use virtual_board::flash::{FlashRecord, SLOT_BYTES, Step};
use virtual_board::flight::Outcome;
use virtual_board::schedule::Schedule;

/// Seeds of each power cut.
const SEEDS: u64 = 5;

/// Distance of the steps of a save in which the core is reset.
const RESET_STRIDE: usize = 5;

/// A run on a table with these slots, in which the commands are sent at these times.
fn run(slots: &[u8], seconds: f64, commands: &[(f64, &str)]) -> Outcome {
    let run = pooled_run()
        .motion(Rest::level())
        .seconds(seconds)
        .flash(slots.to_vec());
    let outcome = commands
        .iter()
        .fold(run, |run, (at_s, line)| run.command(*at_s, line))
        .run()
        .unwrap();
    assert_eq!(outcome.issues, Vec::<String>::new());
    outcome
}

/// Slots for the library's `load`, the same code as the firmware's.
struct Slots<'a>(&'a [u8]);

impl ErrorType for Slots<'_> {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Slots<'_> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        let stored = self
            .0
            .get(offset as usize..)
            .ok_or(NorFlashErrorKind::OutOfBounds)?;
        bytes.copy_from_slice(
            stored
                .get(..bytes.len())
                .ok_or(NorFlashErrorKind::OutOfBounds)?,
        );
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.len()
    }
}

impl NorFlash for Slots<'_> {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SLOT_BYTES;

    fn erase(&mut self, _from: u32, _to: u32) -> Result<(), Self::Error> {
        Err(NorFlashErrorKind::Other)
    }

    fn write(&mut self, _offset: u32, _bytes: &[u8]) -> Result<(), Self::Error> {
        Err(NorFlashErrorKind::Other)
    }
}

/// The rate of the record in force, and its format, which the tests tell records apart by.
fn in_force(slots: &[u8]) -> InForce {
    let record = storage::load(&mut Slots(slots)).record?;
    Some((record.preferences.rate_hz, record.preferences.format))
}

/// Preferences of a record.
type InForce = Option<(u16, OutputFormat)>;

/// Returns the slots before the third record is saved, and the preferences of the second record and
/// of the third.
fn before_third_save() -> (Vec<u8>, InForce, InForce) {
    let slots = third_save().cut_in(0, 1);
    let old = Some((20, OutputFormat::Text));
    assert_eq!(in_force(&slots), old);
    (slots, old, Some((25, OutputFormat::Classic)))
}

/// Saves three records, one run each, and returns what the slots went through in the last.
fn third_save() -> FlashRecord {
    let blank = FlashRecord::blank().bytes;
    let first = run(&blank, 3.0, &[(1.0, "rate 10"), (1.3, "save")]);
    assert_eq!(in_force(&first.flash.bytes), Some((10, OutputFormat::Text)));
    let second = run(&first.flash.bytes, 3.0, &[(1.0, "rate 20"), (1.3, "save")]);
    assert_eq!(
        in_force(&second.flash.bytes),
        Some((20, OutputFormat::Text))
    );
    let commands = [(1.0, "rate 25"), (1.2, "format classic"), (1.4, "save")];
    let third = run(&second.flash.bytes, 3.0, &commands);
    assert_eq!(
        in_force(&third.flash.bytes),
        Some((25, OutputFormat::Classic))
    );
    third.flash
}

#[test]
fn a_power_cut_at_any_step_of_a_save_leaves_the_old_record_or_the_new_one() {
    let save = third_save();
    let erases = save
        .steps
        .iter()
        .filter(|step| matches!(step, Step::Erase { .. }));
    assert_eq!(erases.count(), 1);
    assert!(save.steps.len() > 10, "{}", save.steps.len());
    let old = Some((20, OutputFormat::Text));
    let new = Some((25, OutputFormat::Classic));
    let mut seen = [0, 0];
    for step in 0..save.steps.len() {
        for seed in 0..SEEDS {
            let found = in_force(&save.cut_in(step, seed));
            assert!(
                found == old || found == new,
                "step {step}, seed {seed}: {found:?}"
            );
            seen[usize::from(found == new)] += 1;
        }
    }
    assert!(seen[0] > 0, "a cut before the end leaves the old record");
    // The image itself starts from some of them: it has the record, and reports the damage.
    let last = save.steps.len() - 1;
    let erase = save
        .steps
        .iter()
        .position(|step| matches!(step, Step::Erase { .. }))
        .unwrap();
    for step in [0, erase, erase + 1, (erase + last) / 2, last] {
        let slots = save.cut_in(step, 1);
        let outcome = run(&slots, 1.5, &[(1.0, "show")]);
        let rates: Vec<bool> = [20, 25]
            .map(|rate| outcome.uart_reports(&format!("rate={rate} ")))
            .to_vec();
        let expected = in_force(&slots).map(|(rate, _)| [20, 25].map(|each| each == rate).to_vec());
        assert_eq!(
            Some(rates),
            expected,
            "step {step}: {:?}",
            outcome.uart_lines.last()
        );
        assert_eq!(outcome.flash.bytes, slots, "a start changes nothing");
    }
}

#[test]
fn a_save_stalls_the_core_for_the_datasheet_s_time_and_the_bursts_go_on_after_it() {
    let blank = FlashRecord::blank().bytes;
    let outcome = run(&blank, 3.5, &[(1.5, "rate 20"), (1.8, "save")]);
    let published: Vec<u64> = outcome
        .samples()
        .iter()
        .map(|sample| sample.published_ns)
        .collect();
    let gap_ns = published
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .max()
        .unwrap();
    // An erase of 500 ms, and the sensor's configuration after it.
    assert!(
        (500_000_000..900_000_000).contains(&gap_ns),
        "{gap_ns} ns: {:#?}",
        outcome
            .uart_lines
            .iter()
            .filter(|line| line.text.starts_with('#'))
            .collect::<Vec<_>>()
    );
    assert!(published.last().unwrap() > &3_400_000_000);
}

/// Saves a third record while the supply is at 2.5 V for a while.
fn save_in_a_sag(slots: &[u8], sag_s: std::ops::Range<f64>) -> Outcome {
    pooled_run()
        .motion(Rest::level())
        .seconds(3.0)
        .flash(slots.to_vec())
        .fault(Fault::Supply(2_500, sag_s))
        .command(1.0, "rate 25")
        .command(1.1, "format classic")
        .command(1.2, "save")
        .run()
        .unwrap()
}

#[test]
fn a_save_with_a_low_supply_is_refused() {
    let blank = FlashRecord::blank().bytes;
    let outcome = save_in_a_sag(&blank, 0.5..2.5);
    let expected = "the supply is below 2.8 V: check it, then save again";
    assert!(outcome.uart_reports(expected), "{:?}", outcome.uart_lines);
    assert_eq!(outcome.flash.steps, []);
    // The module goes on.
    let last_ns = outcome.samples().last().map(|sample| sample.published_ns);
    assert!(last_ns > Some(2_900_000_000));
}

#[test]
fn a_supply_that_sags_during_a_save_leaves_the_old_record_or_the_new_one() {
    let (slots, old, new) = before_third_save();
    // The steps: the old record once more, an erase of half a second, the new record.
    let ends = save_in_a_sag(&slots, 2.8..2.9);
    assert_eq!(in_force(&ends.flash.bytes), new);
    let mut seen = [0, 0];
    for nth in 0..9 {
        let start_s = 1.2 + 0.08 * f64::from(nth);
        let outcome = save_in_a_sag(&slots, start_s..2.5);
        let found = in_force(&outcome.flash.bytes);
        assert!(found == old || found == new, "{start_s}: {found:?}");
        let is_refused = outcome.uart_reports("the supply is below 2.8 V");
        assert_eq!(found == old, is_refused, "{start_s}: {found:?}");
        seen[usize::from(found == new)] += 1;
    }
    assert!(seen[0] > 0 && seen[1] > 0, "{seen:?}");
}

#[test]
fn a_supply_that_fails_during_a_save_leaves_the_old_record_or_the_new_one() {
    let (slots, old, new) = before_third_save();
    let mut seen = [0, 0];
    for nth in 0..5 {
        let start_s = 1.2 + 0.15 * f64::from(nth);
        let fault = format!("{start_s} 0.05 supply-sag:800");
        let outcome = pooled_run()
            .motion(Rest::level())
            .seconds(start_s + 1.8)
            .flash(slots.clone())
            .schedule(&Schedule::parse("test", &fault).unwrap())
            .command(1.0, "rate 25")
            .command(1.1, "format classic")
            .command(1.2, "save")
            .run()
            .unwrap();
        let found = in_force(&outcome.flash.bytes);
        assert!(found == old || found == new, "{start_s}: {found:?}");
        seen[usize::from(found == new)] += 1;
        // The core starts with the supply, and so does the sensor.
        let reset_s = outcome.record.resets_ns.iter().map(|&ns| ns as f64 * 1e-9);
        let reset_s: Vec<f64> = reset_s.collect();
        assert!(reset_s.len() == 1, "{start_s}: {reset_s:?}");
        assert!((reset_s[0] - start_s - 0.05).abs() < 1e-3, "{reset_s:?}");
        let last = outcome.samples().last().map(|sample| sample.snapshot.flags);
        assert_eq!(last, Some(Flags::VALID), "{start_s}");
    }
    assert!(seen[0] > 0 && seen[1] > 0, "{seen:?}");
}

/// Resets by the watchdog and after a hard fault, in some steps of a save in turn.
#[test]
fn a_reset_in_a_step_of_a_save_leaves_the_old_record_or_the_new_one() {
    let (slots, old, new) = before_third_save();
    let commands = [(1.0, "rate 25"), (1.2, "format classic"), (1.4, "save")];
    let steps = run(&slots, 3.0, &commands).flash.begun_ns;
    let mut seen = [0, 0];
    let faults = ["watchdog-hang", "crash"];
    // From the last step back, so that the last one is among them.
    let reset_steps = steps.iter().enumerate().rev().step_by(RESET_STRIDE);
    for (fault, (nth, begun_ns)) in faults.into_iter().cycle().zip(reset_steps) {
        // Halfway through the programming of a word.
        let start_s = (begun_ns + 50_000) as f64 * 1e-9;
        let schedule = Schedule::parse("test", &format!("{start_s} 0 {fault}")).unwrap();
        let outcome = commands
            .iter()
            .fold(pooled_run(), |run, (at_s, line)| run.command(*at_s, line))
            .motion(Rest::level())
            .seconds(if fault == "watchdog-hang" { 8.5 } else { 3.0 })
            .flash(slots.clone())
            .schedule(&schedule)
            .run()
            .unwrap();
        let what = format!("{fault} in step {nth}");
        assert_eq!(outcome.record.resets_ns.len(), 1, "{what}");
        let found = in_force(&outcome.flash.bytes);
        assert!(found == old || found == new, "{what}: {found:?}");
        seen[usize::from(found == new)] += 1;
        let last = outcome.samples().last().map(|sample| sample.snapshot.flags);
        assert!(
            last.is_some_and(|flags| flags.contains(Flags::VALID)),
            "{what}: {last:?}"
        );
    }
    assert!(seen[0] > 0 && seen[1] > 0, "{seen:?}");
}
