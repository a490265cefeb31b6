//! Power cuts at every step of every save, on a model of NOR flash; the format, byte by byte.

use embedded_storage::nor_flash::{
    ErrorType, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};

use super::super::encoding::TooLong;
use super::super::preferences::{OutputFormat, Preferences};
use super::*;
use crate::attitude::{Quaternion, Vector3};
use crate::calibration::{
    AccelerometerCorrection, Calibration, CompassCorrection, GyroscopeOffset, Matrix3, Mount,
    SymmetricMatrix, TemperatureModel,
};
use crate::compass::Choice;
use crate::settings::CompassSettings;

const SLOT: usize = 512;

/// Model of NOR flash. Programming clears bits, erasing sets them. Power can fail at each
/// programmed word and each erase. The cut leaves the bits of that step old, new or neither, and
/// weak: they may read differently next time.
#[derive(Clone)]
struct Nor {
    bytes: [u8; 2 * SLOT],
    weak: [u8; 2 * SLOT],
    /// Steps until the power fails; `None` for never.
    steps_left: Option<usize>,
    has_power: bool,
    steps: usize,
    erases: usize,
    random: u64,
}

impl Nor {
    fn blank() -> Self {
        Self {
            bytes: [ERASED; 2 * SLOT],
            weak: [0; 2 * SLOT],
            steps_left: None,
            has_power: true,
            steps: 0,
            erases: 0,
            random: 1,
        }
    }

    fn cut_at(mut self, step: usize, seed: u64) -> Self {
        self.steps_left = Some(step);
        self.random = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        self
    }

    fn power_up(&mut self) {
        self.steps_left = None;
        self.has_power = true;
        self.steps = 0;
        self.erases = 0;
    }

    /// Xorshift (Marsaglia 2003).
    fn random(&mut self) -> u64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        self.random
    }

    /// Random bits, each set with a chance of 0, 1/8, ... 8/8.
    fn random_bits(&mut self, eighths: u64) -> u8 {
        (0..8).fold(0, |bits, bit| {
            bits | u8::from((self.random() >> 20) % 8 < eighths) << bit
        })
    }

    /// Returns whether the power fails at this step.
    fn step_is_cut(&mut self) -> Result<bool, NorFlashErrorKind> {
        if !self.has_power {
            return Err(NorFlashErrorKind::Other);
        }
        self.steps += 1;
        let is_cut = self.steps_left == Some(0);
        self.steps_left = self.steps_left.map(|left| left.saturating_sub(1));
        self.has_power = !is_cut;
        Ok(is_cut)
    }

    /// Leaves each changing bit of `range` old with one probability, and weak with another. An
    /// erase first programs all bits, so some of its bits are neither old nor new.
    fn half_change(&mut self, range: Range<usize>, new: &[u8], erases: bool) {
        let (changes, weak, zeros) = (self.random() % 9, self.random() % 9, self.random() % 9);
        for (index, &new) in range.zip(new) {
            let old = self.bytes[index];
            let changed = self.random_bits(changes);
            let mut bits = (old & !changed) | (new & changed);
            let mut touched = old ^ new;
            if erases {
                bits &= !(self.random_bits(zeros) & self.random_bits(4));
                touched = 0xFF;
            }
            self.bytes[index] = bits;
            self.weak[index] |= touched & self.random_bits(weak);
        }
    }

    fn set(&mut self, slot: usize, image: &[u8]) {
        self.bytes[slot * SLOT..][..image.len()].copy_from_slice(image);
    }
}

impl ErrorType for Nor {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Nor {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        check_read(self, offset, bytes.len())?;
        for (index, byte) in (offset as usize..).zip(bytes) {
            *byte = self.bytes[index];
            if self.weak[index] != 0 {
                *byte ^= self.random_bits(4) & self.weak[index];
            }
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl NorFlash for Nor {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SLOT;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        check_erase(self, from, to)?;
        for start in (from as usize..to as usize).step_by(SLOT) {
            let range = start..start + SLOT;
            if self.step_is_cut()? {
                self.half_change(range, &[ERASED; SLOT], true);
                return Err(NorFlashErrorKind::Other);
            }
            self.erases += 1;
            self.bytes[range.clone()].fill(ERASED);
            self.weak[range].fill(0);
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        check_write(self, offset, bytes.len())?;
        for (start, word) in (offset as usize..).step_by(4).zip(bytes.chunks(4)) {
            let is_cut = self.step_is_cut()?;
            if is_cut {
                let new: Vec<u8> = (start..)
                    .zip(word)
                    .map(|(at, byte)| self.bytes[at] & byte)
                    .collect();
                self.half_change(start..start + 4, &new, false);
                return Err(NorFlashErrorKind::Other);
            }
            for (index, byte) in (start..).zip(word) {
                self.bytes[index] &= byte;
                // A programmed bit is a firm zero; the others keep their state.
                self.weak[index] &= byte;
            }
        }
        Ok(())
    }
}

impl MultiwriteNorFlash for Nor {}

/// A record that differs in every field from the one of another number.
fn record(number: u16) -> Record {
    let x = f32::from(number);
    let vector = |y: f32| Vector3::new(x + y, -x, y);
    Record {
        calibration: Calibration {
            mount: Some(Mount::ALL[usize::from(number) % Mount::ALL.len()]),
            gyroscope: Some(GyroscopeOffset {
                offset_rad_s: vector(0.25),
                temperature_celsius: 30.0 + x,
            }),
            temperature: Some(TemperatureModel {
                reference_celsius: 25.0 - x,
                offset_rad_s: vector(0.5),
                slope_rad_s_per_celsius: vector(0.75),
                curvature_rad_s_per_celsius2: vector(0.125),
                coldest_celsius: x - 40.0,
                warmest_celsius: x + 40.0,
            }),
            accelerometer: Some(AccelerometerCorrection {
                offset_m_s2: vector(1.5),
                matrix: SymmetricMatrix {
                    xx: 1.0 + x,
                    yy: 1.5,
                    zz: 2.0,
                    xy: -x,
                    xz: 0.5,
                    yz: 0.25,
                },
            }),
            level: Some(Quaternion::new(1.0, x, -x, 0.5)),
            gyroscope_matrix: Some(Matrix3 {
                rows: [vector(1.25), vector(-1.0), vector(2.5)],
            }),
        },
        preferences: Preferences {
            format: OutputFormat::Classic,
            rate_hz: 50 + number,
            baud: 921_600 - u32::from(number),
        },
        compass: CompassSettings {
            choice: Choice::ALL[usize::from(number) % Choice::ALL.len()],
            mount: Some(Mount::ALL[usize::from(number + 1) % Mount::ALL.len()]),
            correction: Some(CompassCorrection {
                matrix: [vector(1.0), vector(2.0), vector(3.0)],
                hard_iron_ut: vector(4.0),
            }),
            declination_rad: 0.01 * x,
        },
    }
}

/// CRC-32 bit by bit (reflected, polynomial 0x04C11DB7), independent of the crate that the code
/// uses.
fn crc_32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| {
            (crc >> 1) ^ (0xEDB8_8320 & 0u32.wrapping_sub(crc & 1))
        })
    })
}

/// Bytes of a slot, encoded by hand.
fn image(version: u16, sequence: u32, body: &[u8]) -> Vec<u8> {
    let mut covered = version.to_le_bytes().to_vec();
    covered.extend((body.len() as u16).to_le_bytes());
    covered.extend(sequence.to_le_bytes());
    let header = covered.clone();
    covered.extend(body);
    [&b"APLB"[..], &header, &crc_32(&covered).to_le_bytes(), body].concat()
}

fn body_of(record: &Record) -> Vec<u8> {
    let mut body = Writer::new();
    record.encode(&mut body).expect("a record fits");
    body.to_vec()
}

/// Content of a slot before a save: a name, the bytes, and the record with its sequence number if
/// this firmware reads it.
type Content = (&'static str, Vec<u8>, Option<(u32, Record)>);

fn prior_contents() -> Vec<Content> {
    let valid = |sequence, number| {
        let record = record(number);
        (
            image(4, sequence, &body_of(&record)),
            Some((sequence, record)),
        )
    };
    let (older, older_record) = valid(7, 1);
    let (newer, newer_record) = valid(8, 2);
    let mut torn = older.clone();
    torn.truncate(100);
    let mut flipped = newer.clone();
    flipped[30] ^= 4;
    vec![
        ("blank", vec![], None),
        ("zeros", vec![0; SLOT], None),
        (
            "noise",
            (0..SLOT).map(|n| (n * 167 + n / 7) as u8).collect(),
            None,
        ),
        ("torn", torn, None),
        ("one bit flipped", flipped, None),
        ("older", older, older_record),
        ("newer", newer, newer_record),
        ("later format, newest", image(5, 9, &[5; 200]), None),
        ("later format, oldest", image(6, 3, &[5; 20]), None),
        ("no sequence", image(4, 0, &body_of(&record(3))), None),
        (
            "last sequence",
            image(4, u32::MAX, &body_of(&record(3))),
            None,
        ),
        ("whole but empty", image(4, 9, &[]), None),
    ]
}

/// Runs `work` with a power cut at each of its steps and several seeds; `check` tests the result.
fn cut_everywhere(
    flash: &Nor,
    seeds: u64,
    work: impl Fn(&mut Nor) -> bool,
    check: impl Fn(&mut Nor, usize),
) {
    let mut whole = flash.clone();
    whole.power_up();
    assert!(work(&mut whole), "it works with power");
    assert!(whole.steps > 0);
    for step in 0..whole.steps {
        for seed in 0..seeds {
            let mut flash = flash.clone().cut_at(step, seed * 1000 + step as u64);
            assert!(!work(&mut flash), "step {step} is not the last");
            flash.power_up();
            check(&mut flash, step);
        }
    }
}

#[test]
fn a_power_cut_at_any_step_leaves_the_old_record_or_the_new_one() {
    let new = record(100);
    for (name_a, a, in_a) in prior_contents() {
        for (name_b, b, in_b) in prior_contents() {
            let mut flash = Nor::blank();
            flash.set(0, &a);
            flash.set(1, &b);
            let old = match (in_a, in_b) {
                (Some((first, _)), Some((second, record))) if second > first => Some(record),
                (Some((_, record)), _) | (None, Some((_, record))) => Some(record),
                (None, None) => None,
            };
            assert_eq!(load(&mut flash).record, old, "{name_a}, {name_b}");
            cut_everywhere(
                &flash,
                4,
                |flash| save(flash, &new).is_ok(),
                |flash, step| {
                    for _boot in 0..2 {
                        let found = load(flash).record;
                        assert!(
                            found == old || found == Some(new),
                            "{name_a}, {name_b}, cut at {step}: {found:?}"
                        );
                    }
                    assert_eq!(save(flash, &record(101)), Ok(()));
                    let loaded = load(flash);
                    assert_eq!(loaded.record, Some(record(101)));
                },
            );
        }
    }
}

#[test]
fn a_weakly_programmed_record_is_refreshed_before_the_other_is_erased() {
    for seed in 0..20 {
        let mut flash = Nor::blank();
        flash.set(0, &image(4, 7, &body_of(&record(1))));
        flash.set(1, &image(4, 8, &body_of(&record(2))));
        // A barely programmed bit of the newer record: it reads right half of the time.
        let is_programmed = |place: &usize| flash.bytes[*place] & 1 == 0;
        let place = (SLOT + 12..SLOT + 16).find(is_programmed);
        let place = place.expect("the checksum has a zero");
        flash.weak[place] = 1;
        let steps = 2 * 52 + 1;
        for step in 0..steps {
            let mut flash = flash.clone().cut_at(step, seed);
            let _ = save(&mut flash, &record(3));
            flash.power_up();
            for _boot in 0..4 {
                assert!(
                    load(&mut flash).record.is_some(),
                    "seed {seed}, cut at {step}"
                );
            }
        }
    }
}

#[test]
fn repeated_power_cuts_never_lose_the_record() {
    for seed in 0..400 {
        let mut flash = Nor::blank().cut_at(usize::MAX, seed);
        let mut possible: Vec<Option<Record>> = vec![None];
        for number in 0..12 {
            // A save has up to some 80 steps; a later cut lets it end.
            let step = (flash.random() % 110) as usize;
            let seed = flash.random();
            flash = flash.cut_at(step, seed);
            let forgets = seed.is_multiple_of(8);
            let new = (!forgets).then(|| record(number));
            let is_done = match new {
                Some(new) => save(&mut flash, &new).is_ok(),
                None => forget(&mut flash).is_ok(),
            };
            flash.power_up();
            if is_done {
                possible.clear();
            }
            possible.push(new);
            for _boot in 0..3 {
                let found = load(&mut flash).record;
                assert!(
                    possible.contains(&found),
                    "seed {seed}, save {number}: {found:?}"
                );
            }
        }
    }
}

#[test]
fn a_power_cut_while_forgetting_never_brings_an_older_record_back() {
    for swap in [false, true] {
        let mut flash = Nor::blank();
        flash.set(swap.into(), &image(4, 7, &body_of(&record(1))));
        flash.set((!swap).into(), &image(4, 8, &body_of(&record(2))));
        cut_everywhere(
            &flash,
            100,
            |flash| forget(flash).is_ok(),
            |flash, step| {
                let found = load(flash).record;
                assert!(found.is_none() || found == Some(record(2)), "cut at {step}");
                assert_eq!(forget(flash), Ok(()));
                assert_eq!(
                    load(flash),
                    Loaded {
                        record: None,
                        problem: None
                    }
                );
            },
        );
    }
}

#[test]
fn saves_alternate_and_the_same_record_erases_nothing() {
    let mut flash = Nor::blank();
    for number in 0..5 {
        flash.power_up();
        assert_eq!(save(&mut flash, &record(number)), Ok(()));
        assert_eq!(flash.erases, 1);
        let slot = usize::from(number % 2);
        let sequence = u32::from(number) + 1;
        let written = image(4, sequence, &body_of(&record(number)));
        assert_eq!(flash.bytes[slot * SLOT..][..written.len()], written);
        flash.power_up();
        assert_eq!(save(&mut flash, &record(number)), Ok(()));
        assert_eq!(flash.erases, 0);
        assert_eq!(load(&mut flash).record, Some(record(number)));
    }
}

/// Every problem that `load` reports ends with one save, of the active record too.
#[test]
fn a_save_ends_every_problem() {
    let mut both_damaged = 0;
    for (name_a, a, _) in prior_contents() {
        for (name_b, b, _) in prior_contents() {
            let mut flash = Nor::blank();
            flash.set(0, &a);
            flash.set(1, &b);
            let loaded = load(&mut flash);
            both_damaged += u8::from(loaded.problem == Some(LoadProblem::BothDamaged));
            let record = loaded.record.unwrap_or_default();
            assert_eq!(save(&mut flash, &record), Ok(()));
            let expected = Loaded {
                record: Some(record),
                problem: None,
            };
            assert_eq!(load(&mut flash), expected, "{name_a}, {name_b}");
        }
    }
    // Seven of the contents are damaged.
    assert_eq!(both_damaged, 7 * 7);
}

/// Record of a later firmware: one number more.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Later {
    record: Record,
    more: u32,
}

impl Stored for Later {
    const VERSION: u16 = 5;

    fn encode(&self, body: &mut Writer) -> Result<(), TooLong> {
        self.record.encode(body)?;
        body.extend_from_slice(&self.more.to_le_bytes())
            .map_err(|_| TooLong)
    }

    fn decode(version: u16, body: &[u8]) -> Option<Self> {
        match version {
            1..=4 => Record::decode(version, body).map(|record| Self { record, more: 0 }),
            5 => {
                let (body, more) = body.split_last_chunk::<4>()?;
                Some(Self {
                    record: Record::decode(4, body)?,
                    more: u32::from_le_bytes(*more),
                })
            }
            _ => None,
        }
    }
}

#[test]
fn a_later_firmware_reads_what_this_one_wrote() {
    let mut flash = Nor::blank();
    save(&mut flash, &record(1)).expect("it works with power");
    let read = Later {
        record: record(1),
        more: 0,
    };
    let expected = Loaded {
        record: Some(read),
        problem: None,
    };
    assert_eq!(load_as(&mut flash), expected);
    let changed = Later { more: 5, ..read };
    cut_everywhere(
        &flash,
        20,
        |flash| save_as(flash, &changed).is_ok(),
        |flash, step| {
            let found = load_as::<_, Later>(flash).record;
            assert!(
                found == Some(read) || found == Some(changed),
                "cut at {step}"
            );
        },
    );
}

/// The body of version 3 has no gyroscope matrix before the compass. That of version 2 ends where
/// the declination begins now, that of version 1 where the compass begins.
#[test]
fn a_record_of_an_earlier_firmware_is_read() {
    let mut third = record(1);
    third.calibration.gyroscope_matrix = None;
    let mut body = body_of(&third);
    // Choice, mount and correction of the compass, and the declination.
    let compass_length = 1 + 5 + 49 + 4;
    let matrix = body.remove(body.len() - compass_length - 1);
    assert_eq!(matrix, 0, "no matrix");
    assert_read(3, &body, third);

    let mut second = third;
    second.compass.declination_rad = 0.0;
    assert_eq!(body.split_off(body.len() - 4).len(), 4);
    assert_read(2, &body, second);

    let mut first = second;
    first.compass = CompassSettings::default();
    body.truncate(body.len() - (compass_length - 4));
    assert_read(1, &body, first);
    // The parts of another version are no record.
    for (version, body) in [
        (1, body_of(&second)),
        (2, body),
        (3, body_of(&second)),
        (4, body_of(&first)[4..].into()),
    ] {
        let mut flash = Nor::blank();
        flash.set(0, &image(version, 1, &body));
        assert_eq!(load(&mut flash).problem, Some(LoadProblem::Damaged));
    }
}

fn assert_read(version: u16, body: &[u8], record: Record) {
    let mut flash = Nor::blank();
    flash.set(0, &image(version, 1, body));
    let expected = Loaded {
        record: Some(record),
        problem: None,
    };
    assert_eq!(load(&mut flash), expected, "version {version}");
}

#[test]
fn a_later_format_is_reported_and_left_alone() {
    let mut flash = Nor::blank();
    save(&mut flash, &record(1)).expect("it works with power");
    let later = Later {
        record: record(2),
        more: 5,
    };
    save_as(&mut flash, &later).expect("it works with power");
    let problem = Some(LoadProblem::NewerFormat { version: 5 });
    let both = Loaded {
        record: Some(record(1)),
        problem,
    };
    assert_eq!(load(&mut flash), both);
    assert_eq!(
        problem.map(|problem| problem.to_string()).as_deref(),
        Some(
            "the newest stored record has format 5, this firmware reads up to 4: update it or \
             save anew"
        )
    );

    // Without an older record, a save uses the other slot.
    let mut flash = Nor::blank();
    save_as(&mut flash, &later).expect("it works with power");
    let alone = Loaded {
        record: None,
        problem,
    };
    assert_eq!(load(&mut flash), alone);
    save(&mut flash, &record(3)).expect("it works with power");
    let saved = Loaded {
        record: Some(record(3)),
        problem: None,
    };
    assert_eq!(load(&mut flash), saved);
    let kept = image(
        5,
        1,
        &[&body_of(&record(2))[..], &5u32.to_le_bytes()].concat(),
    );
    assert_eq!(flash.bytes[..kept.len()], kept);
}

#[test]
fn the_stored_format_is_the_documented_one() {
    let mut small = Record::default();
    small.compass.declination_rad = 0.0625;
    small.calibration.mount = Mount::parse("+x+z");
    small.calibration.gyroscope = Some(GyroscopeOffset {
        offset_rad_s: Vector3::new(1.0, -2.0, 0.5),
        temperature_celsius: 25.0,
    });
    let body = [
        1, b'+', b'x', b'+', b'z', // mount
        1, 0, 0, 0x80, 0x3F, 0, 0, 0, 0xC0, 0, 0, 0, 0x3F, 0, 0, 0xC8, 0x41, // gyroscope
        0, 0, 0, // temperature, accelerometer, level
        0, 50, 0, 0x00, 0xC2, 0x01, 0x00, // text, 50 Hz, 115,200 baud
        0,    // no gyroscope matrix
        0, 0, 0, // compass found by itself, no mount, no correction
        0, 0, 0x80, 0x3D, // declination, rad
    ];
    let mut flash = Nor::blank();
    save(&mut flash, &small).expect("it works with power");
    let expected = image(4, 1, &body);
    assert_eq!(flash.bytes[..expected.len()], expected);
    // The result of Python's zlib.crc32.
    assert_eq!(expected[12..16], [150, 96, 110, 32]);
}

#[test]
fn bytes_are_a_record_or_blank_or_damaged_or_newer() {
    let number = 7;
    let bytes = to_bytes(&record(number)).expect("storable");
    let found = from_bytes(&bytes);
    assert_eq!((found.record, found.problem), (Some(record(number)), None));

    let blank = from_bytes(&[0xFF; LONGEST_RECORD]);
    assert_eq!((blank.record, blank.problem), (None, None));

    let mut damaged = bytes;
    damaged[20] ^= 1;
    for bytes in [damaged, [0; LONGEST_RECORD]] {
        let found = from_bytes(&bytes);
        assert_eq!(
            (found.record, found.problem),
            (None, Some(LoadProblem::Damaged))
        );
    }

    let version = Record::VERSION + 1;
    let mut newer = [0xFF; LONGEST_RECORD];
    let image = image(version, 1, &body_of(&record(number)));
    newer[..image.len()].copy_from_slice(&image);
    let found = from_bytes(&newer);
    let expected = Some(LoadProblem::NewerFormat { version });
    assert_eq!((found.record, found.problem), (None, expected));
}

#[test]
fn a_full_record_leaves_room_for_more() {
    assert_eq!(HEADER_LENGTH + body_of(&record(1)).len(), 244);
}

#[test]
fn every_flip_of_one_or_two_bits_is_refused() {
    let whole = image(4, 1, &body_of(&record(1)));
    let bits = whole.len() * 8;
    for first in 0..bits {
        // All pairs in one word, and one far away.
        for second in (first..(first + 32).min(bits)).chain([(first + 397) % bits]) {
            let mut flipped = whole.clone();
            flipped[first / 8] ^= 1 << (first % 8);
            if second != first {
                flipped[second / 8] ^= 1 << (second % 8);
            }
            let mut slot = [ERASED; LONGEST_RECORD];
            slot[..flipped.len()].copy_from_slice(&flipped);
            let is_refused = matches!(decode::<Record>(&slot), Slot::Damaged);
            assert!(is_refused, "bits {first} and {second}");
        }
    }
}

#[test]
fn a_record_that_could_not_be_read_back_is_not_saved() {
    let mut flash = Nor::blank();
    save(&mut flash, &record(1)).expect("it works with power");
    let before = flash.clone();
    let mut not_finite = record(2);
    not_finite.calibration.level = Some(Quaternion::new(1.0, f32::NAN, 0.0, 0.0));
    let mut no_rate = record(2);
    no_rate.preferences.rate_hz = 0;
    let mut no_baud = record(2);
    no_baud.preferences.baud = 0;
    for bad in [not_finite, no_rate, no_baud] {
        assert_eq!(save(&mut flash, &bad), Err(SaveError::Unstorable));
        assert_eq!(flash.bytes, before.bytes);
    }
}

#[test]
fn worn_flash_is_reported() {
    /// Flash with a bit that cannot be programmed any more.
    struct Worn(Nor);
    impl ErrorType for Worn {
        type Error = NorFlashErrorKind;
    }
    impl ReadNorFlash for Worn {
        const READ_SIZE: usize = 1;
        fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
            self.0.read(offset, bytes)
        }
        fn capacity(&self) -> usize {
            self.0.capacity()
        }
    }
    impl NorFlash for Worn {
        const WRITE_SIZE: usize = 4;
        const ERASE_SIZE: usize = SLOT;
        fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
            self.0.erase(from, to)
        }
        fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
            self.0.write(offset, bytes)?;
            self.0.bytes[SLOT + 40] |= 0xFF;
            Ok(())
        }
    }
    impl MultiwriteNorFlash for Worn {}

    let mut flash = Worn(Nor::blank());
    assert_eq!(save(&mut flash, &record(1)), Ok(()));
    assert_eq!(save(&mut flash, &record(2)), Err(SaveError::NotKept));
    let expected = Loaded {
        record: Some(record(1)),
        problem: Some(LoadProblem::Damaged),
    };
    assert_eq!(load(&mut flash), expected);
}
