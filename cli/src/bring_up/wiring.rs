//! Steps that need no movement: port, bus, registers, INT pin, self-test, temperature, and the
//! stored record.

use std::ops::RangeInclusive;
use std::time::Duration;

use aplomb::mpu6050::PARTS;
use aplomb_recordings::terminal::print_line;

use super::report::Finding;
use crate::measure::{Figures, measure};
use crate::stream::numbers;
use crate::talk::Talk;

/// Longest duration of a job of the module.
const JOB: Duration = Duration::from_secs(8);
/// Duration of the measurement, s.
const MEASUREMENT_S: u32 = 5;
/// Sample period, µs: 1 kHz with the 5 % of a cheap clone's clock.
const PERIOD_US: RangeInclusive<f64> = 950.0..=1_050.0;
/// Largest jitter of the period, µs. A sensor alone has less than 1; more is noise on the wire.
const MOST_JITTER_US: f64 = 5.0;
/// Temperature of the die in a room, °C.
const ROOM_CELSIUS: RangeInclusive<f64> = 5.0..=55.0;

/// Shows the text of a module's answer.
pub fn show(text: &str) {
    print_line(&format!("   module: {text}"));
}

/// Checks that the module answers.
pub fn port(talk: &mut Talk) -> Result<Finding, String> {
    Ok(match talk.ask("status") {
        Ok(status) => Finding::new(true, "an answer").with_details(status),
        Err(reason) => Finding::bad(
            reason,
            "connect the adapter's RX to PA2, its TX to PA3, and GND; use --baud if you have \
             changed the rate; look for messages with `aplomb view`",
        ),
    })
}

/// Checks that a sensor answers on the bus.
pub fn bus(talk: &mut Talk) -> Result<Finding, String> {
    Ok(match talk.perform("registers", JOB, |_| {})? {
        // Wrong settings are the next step's.
        Ok(_) => Finding::new(true, "a sensor answers"),
        Err(text) if text.starts_with("a setting") || text.starts_with("the sensor has") => {
            Finding::new(true, "a sensor answers")
        }
        Err(reason) => {
            let advice = advice_on_bus(&reason);
            Finding::bad(reason, advice)
        }
    })
}

/// Returns what to do if the bus does not work.
fn advice_on_bus(reason: &str) -> &'static str {
    if reason.contains("stays low") {
        "look for a short of the named line to ground; both lines need a pull-up to 3.3 V; then \
         switch the sensor's supply off and on"
    } else if reason.contains("WHO_AM_I") {
        "report the byte in an issue: this version does not know the part"
    } else if reason.contains("no sensor answers") {
        "measure 3.3 V at VCC; check GND, SCL to PB8 and SDA to PB9, which may be exchanged; AD0 \
         must be at GND or 3.3 V"
    } else {
        "shorten the wires of SCL and SDA, and add pull-ups of 2.2 to 4.7 kilohm"
    }
}

/// Reports which part it is.
pub fn identity(talk: &mut Talk) -> Result<Finding, String> {
    let status = talk.ask("status")?;
    let sensor = status
        .split_once("sensor=")
        .and_then(|(_, rest)| rest.split_once(" mount="));
    let sensor = sensor.map_or("none", |(sensor, _)| sensor);
    let part = PARTS
        .iter()
        .find(|part| sensor.starts_with(&format!("{}@", part.name)));
    let Some(part) = part else {
        return Ok(Finding::bad(
            sensor,
            "wait for `sensor configured`, then start again",
        ));
    };
    let note = match part.who_am_i {
        0x68 => "an MPU-6050, or a clone that claims to be one",
        0x72 => "a clone on modules that are sold as MPU-6050",
        0x98 => "an ICM-20689, or the commonest clone of the MPU-6050",
        _ => "a successor of the MPU-6050",
    };
    let trim = if part.has_self_test_trim {
        ""
    } else {
        ", without factory trim"
    };
    let saw = format!("{sensor}, WHO_AM_I 0x{:02x}: {note}{trim}", part.who_am_i);
    Ok(Finding::new(true, saw))
}

/// Reads the settings back.
pub fn registers(talk: &mut Talk) -> Result<Finding, String> {
    Ok(match talk.perform("registers", JOB, |_| {})? {
        Ok(text) => Finding::new(true, text),
        Err(text) => Finding::bad(
            text,
            "the sensor loses its settings: improve its supply (100 nF at VCC), shorten the wires",
        ),
    })
}

/// Measures the edges on the INT pin.
pub fn edges(talk: &mut Talk) -> Result<Finding, String> {
    print_line(&format!("   for {MEASUREMENT_S} s: keep it still"));
    let figures = match measure(talk, MEASUREMENT_S) {
        Ok(figures) => figures,
        Err(reason) => return Ok(Finding::bad(reason, "repeat; if it stays, report it")),
    };
    let is_polled = talk.ask("status")?.contains("POLLED");
    Ok(judge_edges(&figures, is_polled).with_details(figures.table()))
}

fn judge_edges(figures: &Figures, is_polled: bool) -> Finding {
    if is_polled {
        return Finding::bad(
            "no edge on the INT pin: the module polls the sensor",
            "check the wire from the sensor's INT to PA1, and that nothing holds it high or low",
        );
    }
    let (period_us, jitter_us) = (figures.period_us_mean, figures.period_us_sigma);
    let saw = format!(
        "{period_us:.1} us from edge to edge, jitter {jitter_us:.2} us, {} of {} samples lost",
        figures.missed, figures.samples
    );
    let is_good = PERIOD_US.contains(&period_us)
        && jitter_us <= MOST_JITTER_US
        && figures.missed == 0
        && figures.samples > 0;
    Finding::new(is_good, saw).advise(
        "shorten the wire from INT to PA1 and lay it apart from SCL; improve the supply; a period \
         beside 1000 us by more than 5 % means a damaged part",
    )
}

/// Runs the self-test.
pub fn self_test(talk: &mut Talk) -> Result<Finding, String> {
    print_line("   keep it still for two seconds");
    Ok(match talk.perform("self-test", JOB, |_| {})? {
        Ok(text) => Finding::new(true, text),
        Err(text) => Finding::bad(
            text,
            "repeat it with the sensor at rest; a part that fails again is damaged or a clone \
             with wrong trim",
        ),
    })
}

/// Checks the temperature.
pub fn temperature(talk: &mut Talk) -> Result<Finding, String> {
    let status = talk.ask("status")?;
    let celsius = numbers(&status, "temperature_c")
        .first()
        .copied()
        .unwrap_or(f64::NAN);
    let finding = Finding::new(ROOM_CELSIUS.contains(&celsius), format!("{celsius:.1} C"));
    Ok(finding.advise(
        "compare with the room: a clone may have another formula; report it with the identity",
    ))
}

/// Stores the record, and reads it back after the supply was off.
pub fn power_cycle(talk: &mut Talk, patience: Duration) -> Result<Finding, String> {
    let saved = talk.ask("save")?;
    if !saved.contains("nothing has changed") {
        let ended = talk.message(JOB, |text| {
            (text.starts_with("done save") || text.starts_with("failed save"))
                .then(|| text.to_owned())
        })?;
        let ended = ended.unwrap_or_else(|| "no end of `save`".to_owned());
        if !ended.starts_with("done") {
            return Ok(Finding::bad(
                ended,
                "improve the supply: flash needs 2.7 V; repeat",
            ));
        }
    }
    let before = talk.ask("show")?;
    print_line("   you: disconnect the board's supply, wait a second, connect it again");
    let started = talk.message(patience, |text| {
        text.starts_with("aplomb ").then(|| text.to_owned())
    })?;
    let Some(started) = started else {
        return Ok(Finding::skipped("the board was not switched off and on"));
    };
    let after = talk.ask("show")?;
    let is_stored = talk.ask("status")?.contains(" unsaved=no");
    let details = format!("{started}\nbefore: {before}\nafter:  {after}");
    let finding = if after == before && is_stored {
        Finding::new(true, format!("{started}; the record is as it was saved"))
    } else {
        Finding::bad(
            "the record is not as it was saved",
            "repeat `save`; report it with this file if it happens again",
        )
    };
    Ok(finding.with_details(details))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bring_up::report::Verdict;
    use crate::measure::tests::ANSWER;

    #[test]
    fn edges_are_judged_by_period_jitter_and_loss() {
        let figures = |from: &str, to: &str| {
            Figures::parse(&ANSWER.replace("missed=2", "missed=0").replace(from, to))
                .expect("figures")
        };
        for (from, to, verdict) in [
            ("", "", Verdict::Good),
            ("missed=0", "missed=1", Verdict::Bad),
            ("period_us=1006.984", "period_us=1100.0", Verdict::Bad),
            ("period_sigma_us=0.13", "period_sigma_us=9.0", Verdict::Bad),
        ] {
            let finding = judge_edges(&figures(from, to), false);
            assert_eq!(finding.verdict, verdict, "{to}");
            assert_eq!(finding.advice.is_empty(), verdict == Verdict::Good, "{to}");
        }
        assert_eq!(judge_edges(&figures("", ""), true).verdict, Verdict::Bad);
    }

    #[test]
    fn each_failure_of_the_bus_has_its_advice() {
        for (reason, part) in [
            ("SDA (PB9) stays low: check", "short"),
            ("no sensor answers at 0x68 or 0x69", "3.3 V at VCC"),
            ("the chip at 0x68 has WHO_AM_I 0x19", "report the byte"),
            ("the bus failed", "pull-ups of"),
        ] {
            assert!(advice_on_bus(reason).contains(part), "{reason}");
        }
    }
}
