//! The firmware's microsecond timer, as its registers show it.

use rigless::mcu::Operate;
use rigless::session::Session;
use rigless::soc::stm32f427::generated::TIM5;
use rigless::soc::stm32f427::generated::tim5::{Register, cr1, egr};
use rigless::soc::{Layout, Width};
use rigless::time::VirtualNanos;

use crate::board::Board;

/// Follows the firmware's microsecond timer, so that its times can be compared with the true ones.
#[derive(Debug)]
pub(super) struct Timer {
    /// The instant at which the count was zero, or would have been; ns since power-up.
    pub(super) zero_ns: Option<i128>,
    /// The count to start with in place of zero.
    pub(super) starts_at: Option<u32>,
}

impl Timer {
    /// The firmware has written a register of the timer.
    pub(super) fn written(
        &mut self,
        session: &mut Session<Board>,
        offset: u64,
        value: u64,
        at: VirtualNanos,
    ) {
        let register = |register: Register| u64::from(register.spec().offset);
        let controller = &mut session.board_mut().controller;
        let is_started =
            offset == register(Register::Cr1) && cr1::CEN.is_set(value) && self.zero_ns.is_none();
        let is_restarted = offset == register(Register::Egr) && egr::UG.is_set(value);
        let is_set = offset == register(Register::Cnt);
        if !is_started && !(self.zero_ns.is_some() && (is_restarted || is_set)) {
            return;
        }
        let count_address = TIM5.base + register(Register::Cnt);
        if let Some(count) = self.starts_at.filter(|_| is_started) {
            controller
                .write(at, count_address, Width::W32, u64::from(count))
                .ok();
        }
        let count = controller.peek(at, count_address, Width::W32).unwrap_or(0);
        self.zero_ns = Some(i128::from(at.0) - 1000 * i128::from(count));
    }

    /// An instant in microseconds by the timer, with their fraction.
    pub(super) fn microseconds(&self, at_ns: u64) -> Option<f64> {
        self.zero_ns
            .map(|zero_ns| (i128::from(at_ns) - zero_ns) as f64 / 1000.0)
    }
}
