//! Keys and their actions.

use aplomb::settings::OutputFormat;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

use super::model::Model;

/// Action of a key.
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// Send this line to the module.
    Send(String),
    /// Have the module send this format.
    SetFormat(OutputFormat),
    /// Begin or end a recording.
    Record,
    /// Pause the screen, or continue.
    Pause,
    /// Play a recording at a multiple of the present speed.
    Faster(f64),
    /// Show or hide the keys.
    Help,
    /// Begin or change a command; `None` cancels it.
    Type(Option<String>),
    /// End the program.
    Quit,
}

/// Keys with their commands for the module.
const COMMANDS: [(char, &str, &str); 7] = [
    ('g', "calibrate gyro", "the gyroscope's offset, at rest"),
    ('a', "calibrate accel", "the accelerometer, pose by pose"),
    ('l', "calibrate level", "where level is"),
    ('d', "calibrate done", "what was collected is enough"),
    ('x', "calibrate stop", "give a calibration up"),
    ('s', "save", "keep it for the next start"),
    ('i', "status", "how the module is"),
];

/// Returns the help: every key with its action, for a recording or a module.
pub fn help(is_playing: bool) -> Vec<(String, String)> {
    let mut lines = Vec::new();
    let mut add = |key: &str, what: &str| lines.push((key.to_owned(), what.to_owned()));
    if is_playing {
        add("space", "stop, or go on");
        add("+ -", "faster, slower");
    } else {
        for (key, command, what) in COMMANDS {
            add(&key.to_string(), &format!("{command}: {what}"));
        }
        add("f", "the next format");
        add("r", "record to a file here, and end it");
        add(":", "type any command (`:help` lists them)");
        add("space", "hold the screen still, or go on");
    }
    add("?", "these keys");
    add("q", "quit");
    lines
}

/// Returns the most important keys, for the last line.
pub fn summary(is_playing: bool) -> &'static [(&'static str, &'static str)] {
    if is_playing {
        &[
            ("space", "pause"),
            ("+ -", "speed"),
            ("?", "help"),
            ("q", "quit"),
        ]
    } else {
        &[
            ("g", "gyro"),
            ("a", "accel"),
            ("l", "level"),
            ("s", "save"),
            ("f", "format"),
            ("r", "record"),
            ("space", "pause"),
            (":", "say"),
            ("?", "help"),
            ("q", "quit"),
        ]
    }
}

/// Returns the action of a key in this state.
pub fn action(key: KeyEvent, model: &Model) -> Option<Action> {
    if key.modifiers.contains(KeyModifiers::CONTROL) {
        return (key.code == KeyCode::Char('c')).then_some(Action::Quit);
    }
    if let Some(typed) = &model.typed {
        return Some(match key.code {
            KeyCode::Esc => Action::Type(None),
            KeyCode::Enter if typed.trim().is_empty() => Action::Type(None),
            KeyCode::Enter => Action::Send(typed.trim().to_owned()),
            KeyCode::Backspace => {
                let mut typed = typed.clone();
                let is_empty = typed.pop().is_none();
                Action::Type((!is_empty).then_some(typed))
            }
            KeyCode::Char(letter) => Action::Type(Some(format!("{typed}{letter}"))),
            _ => return None,
        });
    }
    let KeyCode::Char(letter) = key.code else {
        return (key.code == KeyCode::Esc && model.shows_help).then_some(Action::Help);
    };
    match letter {
        'q' => Some(Action::Quit),
        '?' | 'h' => Some(Action::Help),
        ' ' | 'p' => Some(Action::Pause),
        '+' | '=' if model.is_playing() => Some(Action::Faster(2.0)),
        '-' if model.is_playing() => Some(Action::Faster(0.5)),
        _ if model.is_playing() => None,
        'f' => Some(Action::SetFormat(model.next_format())),
        'r' => Some(Action::Record),
        ':' => Some(Action::Type(Some(String::new()))),
        _ => COMMANDS
            .iter()
            .find(|(key, ..)| *key == letter)
            .map(|(_, command, _)| Action::Send((*command).to_owned())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::model::Connection;

    fn press(code: KeyCode, model: &Model) -> Option<Action> {
        action(KeyEvent::new(code, KeyModifiers::NONE), model)
    }

    #[test]
    fn keys_send_commands_to_a_module_and_not_to_a_recording() {
        let mut model = Model::new("port".into(), Connection::Open(None));
        let send = |text: &str| Some(Action::Send(text.into()));
        assert_eq!(press(KeyCode::Char('g'), &model), send("calibrate gyro"));
        assert_eq!(press(KeyCode::Char('+'), &model), None);
        model.connection = Connection::Playing {
            speed: 1.0,
            is_over: false,
        };
        assert_eq!(press(KeyCode::Char('g'), &model), None);
        assert_eq!(press(KeyCode::Char('+'), &model), Some(Action::Faster(2.0)));
        let control_c = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
        assert_eq!(action(control_c, &model), Some(Action::Quit));
    }

    #[test]
    fn the_last_line_fits_the_smallest_terminal() {
        for is_playing in [false, true] {
            let words = summary(is_playing).iter();
            let length: usize = words.map(|(key, what)| key.len() + what.len() + 2).sum();
            assert!(length <= 80, "{length}");
        }
    }

    #[test]
    fn a_command_is_typed_letter_by_letter_whatever_the_letters_mean() {
        let mut model = Model::new("port".into(), Connection::Open(None));
        let mut keys: Vec<KeyCode> = ":rate 20q".chars().map(KeyCode::Char).collect();
        keys.push(KeyCode::Backspace);
        for key in keys {
            let Some(Action::Type(typed)) = press(key, &model) else {
                panic!("{key:?}");
            };
            model.typed = typed;
        }
        assert_eq!(
            press(KeyCode::Enter, &model),
            Some(Action::Send("rate 20".into()))
        );
        assert_eq!(press(KeyCode::Esc, &model), Some(Action::Type(None)));
    }
}
