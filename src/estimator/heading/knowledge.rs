//! Knowledge of the compass's hard iron before a run.

use crate::serialize::StateVisitor;

/// Knowledge of the compass's hard iron before the first reading.
///
/// | knowledge | σ per axis | source |
/// |---|---|---|
/// | factory | 200 µT | boards with speakers, screws and batteries: 60 to 300 µT |
/// | hard iron | 6 µT | 1.5 times the error of the filter's hard iron after 40 simulated flights |
/// | calibrated | 0.5 µT | the calibration of BROAD's recordings; a rough one leaves some 2 µT |
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CompassKnowledge {
    /// Nothing: it was never calibrated in this vehicle. A valid heading needs turns about 2 axes.
    #[default]
    Factory,
    /// Hard iron alone, which the filter found in an earlier run:
    /// [`certain_hard_iron_ut`](super::Heading::certain_hard_iron_ut).
    HardIron,
    /// Calibrated.
    Calibrated,
}

impl CompassKnowledge {
    /// Every level. Flight logs hold the index, so a new level comes last.
    pub(crate) const ALL: [Self; 3] = [Self::Factory, Self::Calibrated, Self::HardIron];

    /// Returns the knowledge of this name: `factory`, `hard-iron` or `calibrated`.
    ///
    /// ```
    /// use aplomb::estimator::heading::CompassKnowledge;
    ///
    /// let knowledge = CompassKnowledge::from_name("calibrated");
    /// assert_eq!(knowledge, Some(CompassKnowledge::Calibrated));
    /// ```
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|knowledge| knowledge.name() == name)
    }

    /// Returns the name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Factory => "factory",
            Self::HardIron => "hard-iron",
            Self::Calibrated => "calibrated",
        }
    }

    /// Visits the level, one byte.
    pub(crate) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let mut number = Self::ALL
            .iter()
            .position(|level| level == self)
            .unwrap_or(0);
        visitor.index(&mut number, Self::ALL.len());
        if let Some(level) = Self::ALL.get(number) {
            *self = *level;
        }
    }

    /// Returns σ of the hard iron per axis, µT.
    pub const fn sigma_ut(self) -> f32 {
        match self {
            Self::Factory => 200.0,
            Self::HardIron => 6.0,
            Self::Calibrated => 0.5,
        }
    }
}
