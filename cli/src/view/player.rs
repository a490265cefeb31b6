//! Recording as a source: decoded items at the pace at which they were recorded.

use std::collections::VecDeque;
use std::io::{BufReader, ErrorKind, Read};
use std::ops::RangeInclusive;
use std::path::Path;

use aplomb_recordings::flight_log;

use crate::stream::{Counts, Decoder, Format, Item};

/// Speeds of a recording, as multiples of real time.
pub const SPEEDS: RangeInclusive<f64> = 0.01..=1000.0;

/// Attitudes a second in recordings that have no time: the module's default.
pub const ASSUMED_HZ: f64 = 50.0;

/// Longest step of time. A longer one, or one backwards, is a restart or a gap: the clock continues
/// from there.
const LONGEST_STEP_US: u64 = 5_000_000;

/// Player of a file.
pub struct Player {
    name: String,
    file: BufReader<Box<dyn Read>>,
    decoder: Decoder,
    /// Decoded items that are not due yet, with their time from the beginning, s.
    waiting: VecDeque<(f64, Item)>,
    /// Time of the last decoded attitude.
    clock: Option<Clock>,
    count: u64,
    position_s: f64,
    is_read: bool,
    /// Reason why the file cannot be read to its end, until it is reported.
    error: Option<String>,
}

impl Player {
    /// Opens a recording, plain or gzipped, that has an attitude in it.
    pub fn open(path: &Path) -> Result<Self, String> {
        let name = path.display().to_string();
        if path.is_dir() {
            return Err(format!("{name} is a folder: name a recording in it"));
        }
        let mut player = Self {
            name,
            file: BufReader::new(flight_log::open(path)?),
            decoder: Decoder::default(),
            waiting: VecDeque::new(),
            clock: None,
            count: 0,
            position_s: 0.0,
            is_read: false,
            error: None,
        };
        while player.decoder.format().is_none() && !player.is_read {
            player.read();
        }
        if player.decoder.format().is_none() {
            if let Some(error) = player.error {
                return Err(error);
            }
            return Err(format!(
                "{}: there is no attitude in it. It has to be a flight log, what the module sent \
                 in any format, or a CSV with t_us and roll_deg, pitch_deg, yaw_deg or \
                 qw, qx, qy, qz; `aplomb replay` makes such a CSV of sensor data",
                path.display()
            ));
        }
        Ok(player)
    }

    /// Advances by `seconds`, and returns the items that are due with their times.
    pub fn advance(&mut self, seconds: f64) -> Vec<(f64, Item)> {
        self.position_s += seconds;
        let mut due = Vec::new();
        loop {
            while let Some(next) = self
                .waiting
                .pop_front_if(|(at_s, _)| *at_s <= self.position_s)
            {
                due.push(next);
            }
            if self.is_read || !self.waiting.is_empty() {
                return due;
            }
            self.read();
        }
    }

    /// Returns the position, s.
    pub fn position_s(&self) -> f64 {
        self.position_s
    }

    /// Returns whether every item has been returned.
    pub fn is_over(&self) -> bool {
        self.is_read && self.waiting.is_empty()
    }

    /// Returns once why the file could not be read to its end, after the last item.
    pub fn take_error(&mut self) -> Option<String> {
        if self.is_over() {
            self.error.take()
        } else {
            None
        }
    }

    /// Returns the counts of the decoder, which is a little ahead.
    pub fn counts(&self) -> Counts {
        self.decoder.counts()
    }

    /// Returns the format.
    pub fn format(&self) -> Option<Format> {
        self.decoder.format()
    }

    fn read(&mut self) {
        // Small pieces, because items count when they are decoded, before they are due.
        let mut buffer = [0; 512];
        let length = match self.file.read(&mut buffer) {
            Ok(length) => length,
            Err(error) if error.kind() == ErrorKind::Interrupted => return,
            Err(error) => {
                self.error = Some(format!("{} cannot be read to its end: {error}", self.name));
                0
            }
        };
        let mut items = Vec::new();
        if length == 0 {
            self.is_read = true;
            // A file may end without the end of its last line or frame.
            self.decoder.push(b"\n\0", &mut items);
        } else {
            self.decoder.push(&buffer[..length], &mut items);
        }
        for item in items {
            if let Item::Attitude(attitude) = &item {
                self.time(attitude.t_us);
            }
            let at_s = self.clock.as_ref().map_or(0.0, Clock::seconds);
            self.waiting.push_back((at_s, item));
        }
    }

    /// Sets the time of the next attitude: the module's, or else by the number of attitudes.
    fn time(&mut self, t_us: Option<u64>) {
        let t_us = t_us.unwrap_or((self.count as f64 * 1e6 / ASSUMED_HZ) as u64);
        self.count += 1;
        let clock = self.clock.get_or_insert(Clock {
            start_us: t_us,
            start_s: 0.0,
            last_us: t_us,
        });
        let last_s = clock.seconds();
        let step_us = t_us.checked_sub(clock.last_us);
        clock.last_us = t_us;
        if step_us.is_none_or(|step_us| step_us > LONGEST_STEP_US) {
            *clock = Clock {
                start_us: t_us,
                start_s: last_s,
                last_us: t_us,
            };
        }
    }
}

/// Returns a speed changed by a factor, within [`SPEEDS`].
pub fn changed_speed(speed: f64, factor: f64) -> f64 {
    (speed * factor).clamp(*SPEEDS.start(), *SPEEDS.end())
}

/// Time of the module, and of the recording without gaps.
struct Clock {
    start_us: u64,
    start_s: f64,
    last_us: u64,
}

impl Clock {
    fn seconds(&self) -> f64 {
        self.start_s + (self.last_us - self.start_us) as f64 / 1e6
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn player(name: &str, text: impl AsRef<[u8]>) -> Result<Player, String> {
        let path = std::env::temp_dir().join(format!("aplomb-{name}-{}", std::process::id()));
        std::fs::write(&path, text).expect("a file");
        let player = Player::open(&path);
        std::fs::remove_file(&path).expect("it was there");
        player
    }

    #[test]
    fn a_table_is_played_by_its_times() {
        let mut text = "t_us,roll_deg,pitch_deg,yaw_deg\n".to_owned();
        for t_us in [
            5_000_000, 5_100_000, 5_200_000, 90_000_000, 90_050_000, 1_000,
        ] {
            text += &format!("{t_us},1,2,3\n");
        }
        let mut player = player("table", &text).expect("it can be played");
        let times = |items: &[(f64, Item)]| items.iter().map(|(at_s, _)| *at_s).collect::<Vec<_>>();
        assert_eq!(times(&player.advance(0.0)), [0.0]);
        assert_eq!(times(&player.advance(0.15)), [0.1]);
        let rest = times(&player.advance(1.0));
        let expected = [0.2, 0.2, 0.25, 0.25];
        assert_eq!(rest.len(), expected.len());
        for (time, expected) in rest.iter().zip(expected) {
            assert!((time - expected).abs() < 1e-9, "{rest:?}");
        }
        assert!(player.is_over());
    }

    #[test]
    fn lines_without_time_come_fifty_a_second() {
        let line = "Roll:1.00(0.00),\tPitch:2.00(0.00)\n";
        let mut player = player("classic", line.repeat(100)).expect("it can be played");
        assert_eq!(player.advance(1.0).len(), 51);
        assert!(!player.is_over());
        assert_eq!(player.advance(1.0).len(), 49);
        assert!(player.is_over());
    }

    #[test]
    fn a_file_that_is_cut_off_says_so_when_it_is_played_out() {
        use std::io::Write as _;
        let line = "Roll:1.00(0.00),\tPitch:2.00(0.00)\n";
        let mut zipped = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::none());
        zipped
            .write_all(line.repeat(1000).as_bytes())
            .expect("a vector takes everything");
        let zipped = zipped.finish().expect("a vector takes everything");
        let mut player = player("cut", &zipped[..zipped.len() / 2]).expect("it can be played");
        assert_eq!(player.advance(1.0).len(), 51);
        assert_eq!(player.take_error(), None);
        player.advance(100.0);
        let error = player.take_error();
        assert!(error.is_some_and(|error| error.contains("cannot be read to its end")));
        assert_eq!(player.take_error(), None);
    }

    #[test]
    fn what_has_no_attitude_is_refused() {
        let error = player("other", "t_us,ax,ay,az\n1,2,3,4\n").err();
        assert!(error.is_some_and(|error| error.contains("there is no attitude in it")));
    }
}
