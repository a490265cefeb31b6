//! The boards: which oscillator, which core clock; and how the emulated core of one is set up.

use std::num::{NonZeroU16, NonZeroU32, NonZeroU64};
use std::sync::{Arc, Mutex};

use rigless::cpu::armv7m::windows;
use rigless::machine::{self, Target, armv7m};
use rigless::mcu::{Mcu, Operate};
use rigless::snapshot::Store;

use crate::checks::Reserved;
use crate::crystal::HighSpeedInput;
use crate::flash::SharedCells;
use crate::mcu::Microcontroller;
use crate::profile::{PoolRequest, PooledProcessor, Profile, ProfiledProcessor};
use crate::regulator::Regulator;

/// A board that the firmware can be built for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BoardModel {
    /// Name on the command line, the same as in the firmware's features.
    pub name: &'static str,
    /// The clock source of the high-speed oscillator.
    pub input: HighSpeedInput,
    /// The core clock that the firmware sets up, in hertz. The emulated core executes one
    /// instruction per cycle of it.
    pub core_hz: u64,
    /// The chip's DEV_ID in DBGMCU_IDCODE (RM0090, RM0368, RM0383 and RM0390, MCU device ID code).
    pub device_id: u16,
    /// Peripherals of the STM32F427, which the virtual board models, that this chip lacks: tables 1
    /// of RM0090, RM0368, RM0383 and RM0390.
    pub absent: &'static [&'static [&'static str]],
    /// The regulator of the core's supply.
    pub regulator: Regulator,
}

/// Peripherals that no chip of the boards has.
const NOWHERE: &[&str] = &[
    "SPI6",
    "DMA2D",
    "UART7",
    "UART8",
    "GPIOJ",
    "GPIOK",
    "CRYP",
    "HASH",
    "Ethernet_MAC",
    "Ethernet_MMC",
    "Ethernet_PTP",
    "Ethernet_DMA",
];

/// Peripherals that the STM32F401 and the STM32F411 lack besides.
const NOT_ON_SMALL_CHIPS: &[&str] = &[
    "TIM6",
    "TIM7",
    "TIM8",
    "TIM12",
    "TIM13",
    "TIM14",
    "USART3",
    "UART4",
    "UART5",
    "SAI1",
    "CAN1",
    "CAN2",
    "DAC",
    "ADC2",
    "ADC3",
    "GPIOF",
    "GPIOG",
    "GPIOI",
    "RNG",
    "DCMI",
    "FMC",
    "OTG_HS_GLOBAL",
    "OTG_HS_HOST",
    "OTG_HS_DEVICE",
    "OTG_HS_PWRCLK",
];

/// All boards; the first is the default.
pub const BOARDS: [BoardModel; 5] = [
    BoardModel {
        name: "stm32f405",
        input: HighSpeedInput::Crystal(8_000_000),
        core_hz: 168_000_000,
        device_id: 0x413,
        absent: &[NOWHERE, &["SPI4", "SPI5", "SAI1", "DCMI"]],
        regulator: Regulator::F405,
    },
    BoardModel {
        name: "blackpill-f401",
        input: HighSpeedInput::Crystal(25_000_000),
        core_hz: 84_000_000,
        device_id: 0x423,
        absent: &[NOWHERE, NOT_ON_SMALL_CHIPS, &["SPI5"]],
        regulator: Regulator::F401,
    },
    BoardModel {
        name: "blackpill-f411",
        input: HighSpeedInput::Crystal(25_000_000),
        core_hz: 100_000_000,
        device_id: 0x431,
        absent: &[NOWHERE, NOT_ON_SMALL_CHIPS],
        regulator: Regulator::F411,
    },
    BoardModel {
        name: "nucleo-f411",
        input: HighSpeedInput::ExternalClock(8_000_000),
        core_hz: 100_000_000,
        device_id: 0x431,
        absent: &[NOWHERE, NOT_ON_SMALL_CHIPS],
        regulator: Regulator::F411,
    },
    BoardModel {
        name: "nucleo-f446",
        input: HighSpeedInput::ExternalClock(8_000_000),
        core_hz: 168_000_000,
        device_id: 0x421,
        absent: &[NOWHERE, &["SPI5", "GPIOI", "RNG"]],
        regulator: Regulator::F446,
    },
];

impl BoardModel {
    /// Returns whether the chip lacks the peripheral of this name.
    #[must_use]
    pub fn lacks(&self, peripheral: &str) -> bool {
        let lists = self.absent.iter();
        lists.copied().any(|list| list.contains(&peripheral))
    }

    /// The board of this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        BOARDS.into_iter().find(|board| board.name == name)
    }
}

/// One board on the bench, as rigless runs it.
#[derive(Debug)]
pub struct Board {
    /// The microcontroller with everything on its pins.
    pub controller: Microcontroller,
    /// The board's model.
    pub model: BoardModel,
    core_hz: NonZeroU64,
    /// The vector table's handlers, by exception number.
    handlers: Vec<u32>,
    profile: Arc<Mutex<Profile>>,
    cells: SharedCells,
    /// The pool that the processor comes from, if any.
    pool: Option<PoolRequest>,
    has_memory_protection: bool,
}

impl Board {
    /// A board whose core counts its instructions into `profile` by exception; `handlers` are the
    /// vector table's.
    #[must_use]
    pub fn new(
        model: BoardModel,
        controller: Microcontroller,
        handlers: Vec<u32>,
        profile: Arc<Mutex<Profile>>,
        cells: SharedCells,
    ) -> Self {
        Self {
            controller,
            model,
            core_hz: NonZeroU64::new(model.core_hz).unwrap_or(NonZeroU64::MIN),
            handlers,
            profile,
            cells,
            pool: None,
            has_memory_protection: true,
        }
    }

    /// Fits the memory protection unit if `is_fitted`. A core without it ignores its set-up, which
    /// would drop all translated code of a pool.
    #[must_use]
    pub fn memory_protection(mut self, is_fitted: bool) -> Self {
        self.has_memory_protection = is_fitted;
        self
    }

    /// Takes the processor from a pool. Only for runs without an account of instructions: its
    /// breakpoints would stay.
    #[must_use]
    pub fn pool(mut self, pool: Option<PoolRequest>) -> Self {
        self.pool = pool;
        self
    }
}

/// Runs start from reset alone, so nothing keeps a board.
impl Store for Board {}

const CORE: &str = "cortex-m4";

impl machine::Board for Board {
    fn name(&self) -> &'static str {
        "virtual-board"
    }

    fn target_names(&self) -> Vec<&'static str> {
        vec![CORE]
    }

    fn mcu(&mut self, target: usize) -> Option<&mut dyn Mcu> {
        (target == 0).then_some(&mut self.controller)
    }

    fn targets(&mut self) -> Vec<Target<'_>> {
        let core = armv7m::Core {
            variant: armv7m::Variant::M4,
            clock_hz: self.core_hz,
            interrupt_lines: NonZeroU32::from(
                NonZeroU16::new(self.controller.cpu().interrupt_lines).unwrap_or(NonZeroU16::MIN),
            ),
            // PM0214, section 4.3.
            priority_bits: 4,
            // PM0214, section 4.5.
            refclk_divider: NonZeroU32::MIN.saturating_add(7),
            // One instruction per clock cycle: there is no model of wait states or of the pipeline.
            instructions_per_second: self.core_hz,
            boot: "flash",
        };
        let windows = windows(self.controller.bus());
        let regions = if self.has_memory_protection {
            armv7m::MpuRegions::Eight
        } else {
            armv7m::MpuRegions::None
        };
        let mut spec = core.spec_with_parts(&windows, armv7m::Fpu::FpV4Sp, regions);
        let make = Arc::clone(&spec.processor);
        let (handlers, profile) = (self.handlers.clone(), Arc::clone(&self.profile));
        let (cells, pool) = (self.cells.clone(), self.pool.clone());
        let checks = self.controller.checks().clone();
        let reserved = Reserved::of(self.controller.bus());
        spec.processor = Arc::new(move |endian| {
            let processor = match &pool {
                Some(request) => PooledProcessor::from_pool(request.clone(), || make(endian))?,
                None => PooledProcessor::unpooled(make(endian)?),
            };
            Ok(Box::new(ProfiledProcessor::new(
                processor,
                handlers.clone(),
                Arc::clone(&profile),
                cells.clone(),
                (checks.clone(), reserved.clone()),
            )))
        });
        vec![Target::new(CORE, &mut self.controller, spec)]
    }
}
