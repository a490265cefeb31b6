//! Compass of a recording.

use aplomb::attitude::Vector3;
use aplomb::calibration::Mount;
use aplomb::estimator::heading::CompassKnowledge;
use aplomb::units::MagneticField;
use aplomb_models::motion::geometry::Quaternion as Truth;
use aplomb_recordings::log::Row;

/// Compass of a recording, with the truth of the heading.
#[derive(Clone, Debug, Default)]
pub struct Compass {
    /// Reading in body axes for each sample, if it has one.
    pub fields: Vec<Option<MagneticField>>,
    /// True attitude, sensor to east, north, up, for each sample, where it is known and counts.
    pub truth: Vec<Option<Truth>>,
    /// Mount of the sensors.
    pub mount: Mount,
    /// Age of a reading against its row's sample, µs.
    pub delay_us: u32,
    /// Knowledge of the hard iron.
    pub knowledge: CompassKnowledge,
}

impl Compass {
    /// Adds a row.
    pub fn add(&mut self, row: &Row, mount: Mount) {
        self.mount = mount;
        self.add_reading(row.field_ut, row.attitude.filter(|_| row.scored));
    }

    /// Adds a sample: its reading in µT and sensor axes, if it has one, and its truth, if it is
    /// known and counts.
    pub fn add_reading(&mut self, field_ut: Option<[f64; 3]>, truth: Option<Truth>) {
        let mount = self.mount;
        self.fields.push(field_ut.map(|[x, y, z]| {
            let Vector3 { x, y, z } = mount.to_body(Vector3::new(x as f32, y as f32, z as f32)).0;
            MagneticField { ut: [x, y, z] }
        }));
        self.truth.push(truth);
    }
}
