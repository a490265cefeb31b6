//! VQF against the package of its authors, on a signal from formulas.
//!
//! `golden.csv` holds the attitudes and biases of the package `vqf` 2.1.2 of PyPI. `golden.py`
//! beside it writes the file, and has the same formulas as this file. The bias is below or above
//! VQF's limit.
//!
//! | time | what happens |
//! |---|---|
//! | until 6 s | rest |
//! | 6 to 30 s | motion; at 22 s a magnetic disturbance of 4 s |
//! | 30 to 42 s | rest; the force trembles for 6 s |
//! | from 42 s on | motion |
//! | 50 s | another field, which becomes the reference |
//! | 85 to 91 s | a disturbance of the dip alone |
//! | 91 to 131 s | the field grows faster than the reference can follow |
//! | 165 to 205 s | an unsteady disturbance, which is rejected |
//! | 215 to 270 s | the same, until the time of rejection is used up |

use aplomb_models::motion::geometry::{Quaternion, Vector, add, norm, scale, subtract};

use super::{FORCE_S, Vqf};

const GOLDEN: &str = include_str!("golden.csv");
const SECONDS: u32 = 280;
const NOTED_S: u32 = 10;
const SMALL_BIAS_DEG_S: Vector = [0.5, -0.7, 0.3];
const LARGE_BIAS_DEG_S: Vector = [4.0, -3.0, 1.0];
/// Step of the samples in µs, samples for each reading of the field, and bias in °/s.
const CASES: [(u32, u32, Vector); 5] = [
    (10_000, 1, SMALL_BIAS_DEG_S),
    (3_500, 3, SMALL_BIAS_DEG_S),
    (1_000, 10, SMALL_BIAS_DEG_S),
    (3_500, 3, LARGE_BIAS_DEG_S),
    (1_000, 10, LARGE_BIAS_DEG_S),
];
const DISTURBANCE_UT: Vector = [15.0, -10.0, 8.0];
/// Largest difference of an attitude's component: rounding alone.
const ATTITUDE_TOLERANCE: f64 = 1e-9;
const BIAS_TOLERANCE_RAD_S: f64 = 1e-10;

/// Returns the strength of the motion and its derivative, 1/s.
fn envelope(t_s: f64) -> (f64, f64) {
    let omega = std::f64::consts::PI / 6.0;
    let (start_s, end_s) = if t_s < 36.0 {
        (6.0, 30.0)
    } else {
        (42.0, 290.0)
    };
    if t_s < start_s || t_s >= end_s {
        (0.0, 0.0)
    } else if t_s < start_s + 3.0 {
        let phase = omega * (t_s - start_s);
        (phase.sin().powi(2), omega * (2.0 * phase).sin())
    } else if t_s >= end_s - 3.0 {
        let phase = omega * (end_s - t_s);
        (phase.sin().powi(2), -omega * (2.0 * phase).sin())
    } else {
        (1.0, 0.0)
    }
}

/// Returns an Euler angle, rad, and its derivative, rad/s.
fn angle(t_s: f64, offset: f64, size: f64, frequency: f64) -> (f64, f64) {
    let (strength, growth) = envelope(t_s);
    let (sine, cosine) = (frequency * t_s).sin_cos();
    let rate = size * (growth * sine + strength * frequency * cosine);
    (offset + size * strength * sine, rate)
}

/// Returns two coordinates after a turn from the first to the second.
fn turned(first: f64, second: f64, angle_rad: f64) -> (f64, f64) {
    let (sine, cosine) = angle_rad.sin_cos();
    (
        cosine * first - sine * second,
        sine * first + cosine * second,
    )
}

/// Returns the field in east, north, up, µT.
fn earth_field(t_s: f64) -> Vector {
    let mut field = [1.0, 20.0, -44.0];
    if (22.0..26.0).contains(&t_s) || t_s >= 50.0 {
        field = add(field, DISTURBANCE_UT);
    }
    let (mut turn, tip) = match t_s {
        85.0..91.0 => (0.3, 0.26),
        91.0..160.0 => (0.3, 0.0),
        _ => (0.0, 0.0),
    };
    let mut size = 1.0;
    if t_s >= 91.0 {
        size += 0.006 * (t_s - 91.0).min(40.0);
    }
    if (165.0..205.0).contains(&t_s) || (215.0..270.0).contains(&t_s) {
        turn = 0.5;
        size *= if ((t_s / 3.0) as u32).is_multiple_of(2) {
            1.5
        } else {
            0.7
        };
    }
    let [east, north, up] = field;
    let (north, up) = turned(north, up, tip);
    let (east, north) = turned(east, north, turn);
    scale([east, north, up], size)
}

/// Returns rate, rad/s, specific force, m/s², and field, µT, in sensor axes.
fn signal(t_s: f64, bias_deg_s: Vector) -> [Vector; 3] {
    let (roll, roll_rate) = angle(t_s, 0.3, 0.9, 1.3);
    let (pitch, pitch_rate) = angle(t_s, -0.2, 0.6, 1.7);
    let (yaw, yaw_rate) = angle(t_s, 0.7, 1.5, 0.7);
    let rate = [
        roll_rate - yaw_rate * pitch.sin(),
        pitch_rate * roll.cos() + yaw_rate * pitch.cos() * roll.sin(),
        yaw_rate * pitch.cos() * roll.cos() - pitch_rate * roll.sin(),
    ];
    let (strength, _) = envelope(t_s);
    let mut force = [
        3.0 * strength * (2.1 * t_s).sin(),
        2.0 * strength * (1.9 * t_s + 1.0).sin(),
        9.81 + strength * (2.7 * t_s).sin(),
    ];
    if (30.0..36.0).contains(&t_s) {
        force[0] += 0.55 * (30.0 * t_s).sin();
    }
    let to_sensor = Quaternion::from_euler(roll, pitch, yaw).conjugate();
    let rate = add(rate, bias_deg_s.map(f64::to_radians));
    [
        rate,
        to_sensor.rotate(force),
        to_sensor.rotate(earth_field(t_s)),
    ]
}

/// Returns the larger distance of a component, of two quaternions with one sign.
fn distance(found: Quaternion, expected: &[f64]) -> f64 {
    let found = [found.w, found.x, found.y, found.z];
    let with_sign = |sign: f64| {
        let pairs = found.iter().zip(expected);
        pairs.fold(0.0_f64, |largest, (found, expected)| {
            let difference = (sign * found - expected).abs();
            assert!(difference.is_finite(), "{found} is no number");
            largest.max(difference)
        })
    };
    with_sign(1.0).min(with_sign(-1.0))
}

/// Runs one case through its rows of the golden file, and returns the largest differences of an
/// attitude's component and of the bias, rad/s.
fn largest_differences<'a>(
    (step_us, samples_a_field, bias_deg_s): (u32, u32, Vector),
    rows: &mut impl Iterator<Item = &'a str>,
) -> (f64, f64) {
    let step_s = f64::from(step_us) * 1e-6;
    let mut filter = Vqf::new(FORCE_S, step_s, step_s * f64::from(samples_a_field));
    let mut largest = (0.0_f64, 0.0_f64);
    for index in 1..=SECONDS * 1_000_000 / step_us {
        let [rate, force, field] = signal(f64::from(index) * step_s, bias_deg_s);
        filter.update(rate, force);
        if index % samples_a_field == 0 {
            filter.update_field(field);
        }
        if index % (NOTED_S * 1_000_000 / step_us) != 0 {
            continue;
        }
        let cells = rows.next().unwrap().split(',');
        let row: Vec<f64> = cells.map(|cell| cell.parse().unwrap()).collect();
        assert_eq!((row[0], row[1]), (step_us.into(), index.into()));
        let level = distance(filter.level_attitude(), &row[2..6]);
        let attitude = level.max(distance(filter.attitude(), &row[6..10]));
        let bias = norm(subtract(filter.bias_rad_s(), [row[10], row[11], row[12]]));
        assert!(bias.is_finite(), "{bias} is no number");
        largest = (largest.0.max(attitude), largest.1.max(bias));
    }
    largest
}

#[test]
fn attitudes_and_biases_are_those_of_the_authors_package() {
    let mut rows = GOLDEN.lines().skip(1);
    for case in CASES {
        let (attitude, bias) = largest_differences(case, &mut rows);
        println!("{case:?}: {attitude:e}, {bias:e} rad/s");
        assert!(attitude < ATTITUDE_TOLERANCE, "{case:?}: {attitude}");
        assert!(bias < BIAS_TOLERANCE_RAD_S, "{case:?}: {bias} rad/s");
    }
    assert_eq!(rows.next(), None);
}
