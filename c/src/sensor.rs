//! The sensor's registers for C: what to write, and what to read back.

use aplomb::mpu6050::{Check, Config, Part, Step, Steps};

use crate::{AplombSettings, AplombStatus, not_null, status_of};

/// Largest number of registers that are read together.
pub const APLOMB_CHECK_BYTES: usize = 5;

/// Register to write to the sensor, and the wait after it.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct AplombStep {
    /// Address of the register.
    pub register_address: u8,
    /// Value to write.
    pub value: u8,
    /// Wait before the next step, ms.
    pub wait_ms: u16,
}

/// Neighbouring registers to read back in one transfer. The settings are intact if
/// (byte & mask) == value for each byte that was read.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct AplombCheck {
    /// Address of the first register.
    pub register_address: u8,
    /// Number of registers, 2 to 5.
    pub length: u8,
    /// Bits that count in each byte.
    pub masks: [u8; APLOMB_CHECK_BYTES],
    /// Values of these bits.
    pub values: [u8; APLOMB_CHECK_BYTES],
}

/// Writes the step of this index, from 0, of the sensor's configuration. Write its value to the
/// sensor, wait, and go on with the next. After the last one returns `APLOMB_STATUS_NO_MORE_STEPS`.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_configuration_step(
    settings: Option<&AplombSettings>,
    index: u32,
    step: Option<&mut AplombStep>,
) -> AplombStatus {
    status_of(nth(settings, index, step, Step::configuration))
}

/// Writes a step like `aplomb_configuration_step`, for a sensor that has reset itself or has lost a
/// setting. All steps take 30 ms, because none resets the sensor. Check the settings after them.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_reconfiguration_step(
    settings: Option<&AplombSettings>,
    index: u32,
    step: Option<&mut AplombStep>,
) -> AplombStatus {
    status_of(nth(settings, index, step, Step::reconfiguration))
}

/// Writes the check of this index, from 0, of the sensor's settings: together they cover each
/// setting that `aplomb_configuration_step` writes. After the last one returns
/// `APLOMB_STATUS_NO_MORE_STEPS`.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_settings_check(
    settings: Option<&AplombSettings>,
    index: u32,
    check: Option<&mut AplombCheck>,
) -> AplombStatus {
    status_of(nth_check(settings, index, check))
}

fn nth(
    settings: Option<&AplombSettings>,
    index: u32,
    out: Option<&mut AplombStep>,
    steps: fn(&Config, &Part) -> Steps,
) -> Result<(), AplombStatus> {
    let (settings, out) = (not_null(settings)?.checked()?, not_null(out)?);
    let mut steps = steps(&settings.sensor, settings.part);
    let step = steps.nth(index as usize).ok_or(AplombStatus::NoMoreSteps)?;
    *out = AplombStep {
        register_address: step.register.address(),
        value: step.value,
        wait_ms: step.wait_ms as u16,
    };
    Ok(())
}

fn nth_check(
    settings: Option<&AplombSettings>,
    index: u32,
    out: Option<&mut AplombCheck>,
) -> Result<(), AplombStatus> {
    let (settings, out) = (not_null(settings)?.checked()?, not_null(out)?);
    let checks = Check::all(&settings.sensor, settings.part);
    let check = checks.get(index as usize);
    let check = check.ok_or(AplombStatus::NoMoreSteps)?;
    let (masks, values) = check.registers();
    *out = AplombCheck {
        register_address: check.first.address(),
        length: check.length as u8,
        masks,
        values,
    };
    Ok(())
}
