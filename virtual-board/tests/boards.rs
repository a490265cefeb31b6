//! The firmware of every board flies on the model of that board.

use virtual_board::board::BOARDS;
use virtual_board::faults::Fault;
use virtual_board::flight::{Outcome, Run};

/// Flies each board's own image with this fault, if any.
fn fly_all(fault: Option<Fault>, check: impl Fn(&str, &Outcome)) {
    for board in BOARDS {
        let variable = format!(
            "APLOMB_FLIGHT_ELF_{}",
            board.name.to_uppercase().replace('-', "_")
        );
        let Some(image) = std::env::var_os(&variable) else {
            panic!(
                "{variable} does not name the firmware image: run `cargo xtask test`, which builds it"
            );
        };
        let mut run = Run::new(image).board(board).seconds(2.5);
        if let Some(fault) = &fault {
            run = run.fault(fault.clone());
        }
        check(board.name, &run.run().unwrap());
    }
}

#[test]
fn every_board_runs_from_its_crystal() {
    fly_all(None, |name, outcome| {
        assert!(outcome.says(&format!("on {name}, ")), "{name}");
        assert!(outcome.says("MHz from the crystal"), "{name}");
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
        assert!(outcome.remarks.is_empty(), "{name}: {:?}", outcome.remarks);
    });
}

#[test]
fn every_board_runs_without_its_crystal() {
    fly_all(Some(Fault::NoCrystal), |name, outcome| {
        assert!(outcome.says("from the internal oscillator"), "{name}");
        assert!(
            outcome.samples().len() > 2_000,
            "{name}: {} samples",
            outcome.samples().len()
        );
        assert_eq!(outcome.summary.missed, 0, "{name}");
    });
}
