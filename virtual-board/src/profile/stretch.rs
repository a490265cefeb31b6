//! The bus that a processor sees while it runs for a stretch.

use rigless::emulator::{Access, AccessKind, Checked, CoreBus, InterruptLine, Queued};
use rigless::time::VirtualNanos;

use crate::checks::{Checks, Reserved};
use crate::flash::{SLOTS, SharedCells};

/// The bus of a stretch of execution. It records the end of the stretch, which an access can
/// extend.
pub(super) struct Stretch<'a> {
    pub(super) bus: &'a mut dyn CoreBus,
    pub(super) cells: SharedCells,
    pub(super) checks: (Checks, Reserved),
    pub(super) until: u64,
    /// True if the processor comes back after every instruction.
    pub(super) is_stepped: bool,
}

impl CoreBus for Stretch<'_> {
    fn carry_on(&mut self, instructions: u64, event: Option<VirtualNanos>) -> Option<u32> {
        if self.is_stepped {
            return None;
        }
        let left = self.bus.carry_on(instructions, event);
        if let Some(left) = left {
            self.until = instructions + u64::from(left);
        }
        left
    }

    fn access(&mut self, access: Access, from_code: bool) -> Option<u64> {
        if SLOTS.contains(&access.address) {
            return Some(self.cells.with(|cells| match access.kind {
                AccessKind::Read => cells.read(access.address, access.width),
                AccessKind::Write => {
                    let now = access.virtual_time;
                    cells.store(now, access.address, access.width, access.value);
                    access.value
                }
            }));
        }
        let answer = self.bus.access(access, from_code);
        if from_code {
            let (checks, reserved) = &self.checks;
            checks.complete(&access, reserved);
        }
        answer
    }

    fn time(&self, instructions: u64) -> VirtualNanos {
        self.bus.time(instructions)
    }

    fn queued(&mut self) -> Vec<Queued> {
        self.bus.queued()
    }

    fn acknowledge(&mut self, line: InterruptLine, instructions: u64) -> Option<u64> {
        self.bus.acknowledge(line, instructions)
    }

    fn read_checked(&mut self, access: Access, report: bool) -> Option<Checked> {
        self.bus.read_checked(access, report)
    }

    fn write_checked(&mut self, access: Access) -> Option<bool> {
        self.bus.write_checked(access)
    }

    fn stops_before(&mut self, access: &Access) -> bool {
        self.bus.stops_before(access)
    }

    fn send_trace(&mut self, bytes: &[u8]) {
        self.bus.send_trace(bytes);
    }
}
