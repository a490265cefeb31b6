//! What holds for every command of the program: its help, its exit codes, its completions.

mod common;

use std::io::Write;
use std::process::{Command, Stdio};

use common::{aplomb, file, path};

/// The names of the commands, as the help has them.
fn commands() -> Vec<String> {
    let help = String::from_utf8(aplomb(&["--help"]).stdout).unwrap();
    let (_, list) = help.split_once("Commands:\n").expect("a list of commands");
    let lines = list.lines().take_while(|line| !line.is_empty());
    let names = lines.filter_map(|line| line.split_whitespace().next());
    names
        .filter(|name| *name != "help")
        .map(str::to_owned)
        .collect()
}

#[test]
fn every_command_has_examples_in_its_help() {
    let commands = commands();
    assert!(commands.len() >= 7, "{commands:?}");
    for command in &commands {
        let result = aplomb(&[command.as_str(), "--help"]);
        let help = String::from_utf8(result.stdout).unwrap();
        assert_eq!(result.status.code(), Some(0));
        let (_, examples) = help.split_once("Examples:\n").expect(command);
        let start = format!("  aplomb {command}");
        assert!(examples.starts_with(&start), "{command}: {help}");
        // What prints JSON says what is in it.
        assert_eq!(
            help.contains("--json"),
            help.contains("\nJSON: "),
            "{command}"
        );
    }
}

#[test]
fn wrong_usage_and_failures_have_the_documented_exit_codes() {
    let help = String::from_utf8(aplomb(&["--help"]).stdout).unwrap();
    assert!(help.contains(
        "Exit codes: 0 fine, 1 failed (the reason is on standard error), 2 wrong usage."
    ));
    for (arguments, code) in [
        (&[][..], 2),
        (&["no-such-command"], 2),
        (&["replay"], 2),
        (&["replay", "x.csv", "--filter", "none"], 2),
        (&["bench", "--json", "--scan-gains"], 2),
        (&["calibrate"], 2),
        (&["simulate", "--output", "x.csv", "--seconds", "0"], 2),
        (&["completions", "none"], 2),
        (&["replay", "/no/such.csv"], 1),
        (&["plot", "/no/such.csv"], 1),
        (&["convert", "/no/such.csv", "x.csv"], 1),
        (&["calibrate", "/no/such.csv"], 1),
        (&["bench", "/no/such"], 1),
        (&["simulate", "--output", "/no/such/x.csv"], 1),
        (&["--version"], 0),
    ] {
        let result = aplomb(arguments);
        assert_eq!(result.status.code(), Some(code), "{arguments:?}");
        assert_eq!(result.stderr.is_empty(), code == 0, "{arguments:?}");
    }
}

#[test]
fn completions_name_every_command() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let result = aplomb(&["completions", shell]);
        assert!(result.status.success(), "{shell}");
        let script = String::from_utf8(result.stdout).unwrap();
        for command in commands() {
            assert!(script.contains(&command), "{shell}: {command}");
        }
        assert!(script.contains("sensor-delay-us"), "{shell}");
    }
}

#[test]
fn bash_takes_its_completions() {
    let script = aplomb(&["completions", "bash"]).stdout;
    let Ok(mut bash) = Command::new("bash")
        .arg("-s")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
    else {
        println!("skipped: there is no bash");
        return;
    };
    let mut input = bash.stdin.take().unwrap();
    input.write_all(&script).unwrap();
    input
        .write_all(b"COMP_WORDS=(aplomb sim) COMP_CWORD=1; _aplomb aplomb sim aplomb; echo \"${COMPREPLY[@]}\"\n")
        .unwrap();
    drop(input);
    let output = bash.wait_with_output().unwrap();
    assert_eq!(String::from_utf8(output.stdout).unwrap().trim(), "simulate");
}

#[test]
fn what_is_converted_is_told_as_json_too() {
    let log = "t_us,ax,ay,az,gx,gy,gz\n0,0,0,9.8,0,0,0\n1000,0,0,9.8,0,0,0\n";
    let input = file("program", "log.csv", log);
    let output = path("program", "flight-bursts.csv");
    let arguments = [
        "convert".as_ref(),
        input.as_os_str(),
        output.as_os_str(),
        "--json".as_ref(),
    ];
    let result = aplomb(&arguments);
    let summary: serde_json::Value = serde_json::from_slice(&result.stdout).unwrap();
    assert_eq!(summary["bursts"], 2);
    assert_eq!(summary["bursts_lost"], 0);
    assert_eq!(summary["damaged_pieces"], 0);
    assert_eq!(summary["output"], output.to_str().unwrap());
    assert_eq!(std::fs::read_to_string(&output).unwrap().lines().count(), 3);
    // An input is not replaced.
    let same = aplomb(&["convert".as_ref(), output.as_os_str(), output.as_os_str()]);
    assert_eq!(same.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&same.stderr).contains("replace the input"));
    assert_eq!(std::fs::read_to_string(&output).unwrap().lines().count(), 3);
}

#[test]
fn what_the_board_said_survives_a_flight_log() {
    let digits = "0f3effc2e01c0a50ffe900130004";
    let flags = [
        "",
        "MISSED",
        "",
        "BUS_FAULT|SENSOR_RESET",
        "POLLED",
        "INTERNAL_CLOCK",
    ];
    let mut text = String::from("t_us,bytes,flags\n");
    for (index, flags) in flags.iter().enumerate() {
        text += &format!("{},{digits},{flags}\n", 1_000 * (index + 1));
    }
    let input = file("program", "before-bursts.csv", &text);
    let (log, output) = (
        path("program", "flags.log"),
        path("program", "after-bursts.csv"),
    );
    for (from, to) in [(&input, &log), (&log, &output)] {
        let result = aplomb(&["convert".as_ref(), from.as_os_str(), to.as_os_str()]);
        assert!(result.status.success());
    }
    assert_eq!(std::fs::read_to_string(output).unwrap(), text);
}
