//! The sensor boards that can be fitted.

use aplomb_models::compass::{CompassConfig, Part};
use aplomb_models::motion::Mount;

/// A sensor board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kit {
    /// An MPU-6050 alone.
    #[default]
    Mpu6050,
    /// An MPU-9250 with its AK8963.
    Mpu9250,
    /// A GY-87: an MPU-6050, and a QMC5883L on its auxiliary bus.
    Gy87,
}

impl Kit {
    /// Every board with its name.
    pub const ALL: [(&'static str, Self); 3] = [
        ("mpu6050", Self::Mpu6050),
        ("mpu9250", Self::Mpu9250),
        ("gy87", Self::Gy87),
    ];

    /// The board with this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        let found = Self::ALL.iter().find(|(known, _)| *known == name);
        found.map(|(_, kit)| *kit)
    }

    /// The value of the IMU's WHO_AM_I.
    #[must_use]
    pub fn who_am_i(self) -> u8 {
        match self {
            Self::Mpu6050 | Self::Gy87 => 0x68,
            Self::Mpu9250 => 0x71,
        }
    }

    /// The compass of a seed, mounted as the IMU is.
    #[must_use]
    pub fn compass(self, seed: u64, mount: Mount) -> Option<CompassConfig> {
        let part = match self {
            Self::Mpu6050 => return None,
            Self::Mpu9250 => Part::Ak8963,
            Self::Gy87 => Part::Qmc5883l,
        };
        Some(CompassConfig {
            mount,
            ..CompassConfig::new(seed, part)
        })
    }
}
