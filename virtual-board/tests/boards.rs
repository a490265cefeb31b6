//! The firmware of every board flies on the model of that board.

use aplomb::health::Flags;
use virtual_board::board::BOARDS;
use virtual_board::faults::{Fault, FaultKind, ScheduledFault};
use virtual_board::flight::{Outcome, Run};
use virtual_board::summary::larger;

/// Flies each board's own image so long, with this fault, if any.
fn fly_all(seconds: f64, fault: Option<Fault>, check: impl Fn(&str, &Outcome)) {
    for board in BOARDS {
        let variable = format!(
            "APLOMB_FLIGHT_ELF_{}",
            board.name.to_uppercase().replace('-', "_")
        );
        let Some(image) = std::env::var_os(&variable) else {
            panic!(
                "{variable} does not name the firmware image: \
                 run `cargo xtask test`, which builds it"
            );
        };
        let mut run = Run::new(image).board(board).seconds(seconds);
        if let Some(fault) = &fault {
            run = run.fault(fault.clone());
        }
        check(board.name, &run.run().unwrap());
    }
}

#[test]
fn every_board_runs_from_its_crystal() {
    fly_all(2.5, None, |name, outcome| {
        assert!(outcome.reports(&format!("on {name}, ")), "{name}");
        assert!(outcome.reports("MHz from the crystal"), "{name}");
        assert!(
            outcome.samples().len() > 2_000,
            "{name}: {} samples",
            outcome.samples().len()
        );
        assert_eq!(outcome.summary.missed, 0, "{name}");
        assert!(
            outcome
                .summary
                .timestamp_error_us_max
                .is_some_and(|error| error <= 1.0),
            "{name}"
        );
        assert!(outcome.issues.is_empty(), "{name}: {:?}", outcome.issues);
    });
}

#[test]
fn every_board_runs_without_its_crystal() {
    fly_all(1.5, Some(Fault::NoCrystal), |name, outcome| {
        assert!(outcome.reports("from the internal oscillator"), "{name}");
        assert!(
            outcome.samples().len() > 1_000,
            "{name}: {} samples",
            outcome.samples().len()
        );
        assert_eq!(outcome.summary.missed, 0, "{name}");
    });
}

#[test]
fn every_board_s_clocks_are_as_before_when_its_crystal_has_died() {
    let fault = ScheduledFault {
        start_ns: 800_000_000,
        duration_ns: 0,
        kind: FaultKind::CrystalDies,
    };
    // The firmware brings the clocks back at the next edge but one.
    let restored_ns = fault.start_ns + 3_000_000;
    fly_all(1.5, Some(Fault::Scheduled(fault)), |name, outcome| {
        let after = outcome
            .samples()
            .iter()
            .filter(|sample| sample.published_ns > restored_ns);
        let errors_us: Vec<f64> = after
            .filter_map(|sample| Some(sample.true_t_us? - sample.snapshot.t_us as f64))
            .collect();
        assert!(errors_us.len() > 600, "{name}: {}", errors_us.len());
        let first_us = errors_us[0];
        let drift_us = errors_us
            .iter()
            .map(|error_us| (error_us - first_us).abs())
            .fold(0.0, larger);
        assert!(drift_us <= 1.0, "{name}: {drift_us} us");
        for sample in outcome.samples() {
            let has_died = sample.snapshot.flags.contains(Flags::INTERNAL_CLOCK);
            let is_certain = !(fault.start_ns..restored_ns).contains(&sample.published_ns);
            assert!(
                !is_certain || has_died == (sample.published_ns >= restored_ns),
                "{name}: {sample:?}"
            );
        }
    });
}
