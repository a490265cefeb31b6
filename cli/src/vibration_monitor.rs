//! Monitor of a recording: measures its vibration, and warns if it is too strong.

use std::error::Error;

use aplomb_recordings::vibration::Vibration;

use crate::source::{Point, Source};

/// Source that passes its points on, and measures the vibration on the way.
pub struct VibrationMonitor<'a> {
    source: &'a mut dyn Source,
    vibration: Vibration,
}

impl<'a> VibrationMonitor<'a> {
    /// Monitors a source.
    pub fn new(source: &'a mut dyn Source) -> Self {
        let vibration = Vibration::new(source.full_scale_g().into());
        Self { source, vibration }
    }
}

impl Source for VibrationMonitor<'_> {
    fn next(&mut self) -> Result<Option<Point>, Box<dyn Error>> {
        let point = self.source.next()?;
        if let Some(point) = &point
            && let Some(force) = point.specific_force_m_s2
        {
            let force = [force.x, force.y, force.z].map(f64::from);
            self.vibration.add(point.t_us, force);
        }
        Ok(point)
    }

    fn has_flags(&self) -> bool {
        self.source.has_flags()
    }

    fn full_scale_g(&self) -> u16 {
        self.source.full_scale_g()
    }

    fn warnings(&self) -> Vec<String> {
        let mut warnings = self.source.warnings();
        warnings.extend(self.vibration.message());
        warnings
    }
}
