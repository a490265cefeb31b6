//! Runs the pipeline under real interrupts in QEMU: `-M netduinoplus2`, an STM32F405 without I2C or
//! DMA.
//!
//! Bursts come from a `bursts.csv` on the host in place of the bus. Every snapshot goes back as the
//! bits of its numbers, and a test compares them with the library on the host. The priorities are
//! those of `flight`; TIM2 replaces the sensor's INT pin.
//!
//! ```text
//! qemu-system-arm -M netduinoplus2 -kernel qemu.elf -serial file:TEXT \
//!     -semihosting-config enable=on,target=native,arg=qemu,arg=BURSTS,arg=SNAPSHOTS
//! ```
//!
//! Exit status 0: every burst gave a snapshot. 1: not, and standard error gives the reason.

#![no_std]
#![no_main]

use core::panic::PanicInfo;

use aplomb_rigs::host_files;
use cortex_m_semihosting::heprintln;

#[panic_handler]
fn panic(information: &PanicInfo<'_>) -> ! {
    heprintln!("{}", information);
    host_files::exit(false)
}

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true, dispatchers = [SPI2])]
mod app {
    use core::fmt::Write;

    use aplomb::mpu6050::Part;
    use aplomb::pipeline::{Pipeline, Settings, Snapshot};
    use aplomb::telemetry::bursts::{self, Row};
    use aplomb::telemetry::text;
    use aplomb_rigs::host_files::{self, HostFile};
    use cortex_m_semihosting::heprintln;
    use heapless::spsc::{Consumer, Producer, Queue};
    use stm32f4xx_hal::pac::{Interrupt, TIM2, USART1};
    use stm32f4xx_hal::prelude::*;
    use stm32f4xx_hal::rcc;

    /// Samples for one line of text: 50 Hz at 1 kHz.
    const SAMPLES_PER_LINE: u32 = 20;
    /// Sample rate, in virtual time.
    const SAMPLE_HZ: u32 = 1_000;
    const BAUD: u32 = 921_600;

    #[shared]
    struct Shared {}

    #[local]
    struct Local {
        timer: stm32f4xx_hal::timer::CounterHz<TIM2>,
        port: stm32f4xx_hal::serial::Tx<USART1>,
        pipeline: Pipeline,
        bursts_in: Producer<'static, Row>,
        bursts_out: Consumer<'static, Row>,
        ready_in: Producer<'static, Row>,
        ready_out: Consumer<'static, Row>,
        snapshots_in: Producer<'static, Snapshot>,
        snapshots_out: Consumer<'static, Snapshot>,
        lines_in: Producer<'static, Snapshot>,
        lines_out: Consumer<'static, Snapshot>,
    }

    #[init(local = [
        bursts: Queue<Row, 16> = Queue::new(),
        ready: Queue<Row, 2> = Queue::new(),
        snapshots: Queue<Snapshot, 16> = Queue::new(),
        lines: Queue<Snapshot, 2> = Queue::new(),
    ])]
    fn init(context: init::Context) -> (Shared, Local) {
        let device = context.device;
        // QEMU has no clock tree: only the internal oscillator starts.
        let mut rcc = device.RCC.freeze(rcc::Config::hsi());
        let pins = device.GPIOA.split(&mut rcc);
        let port = device
            .USART1
            .tx(pins.pa9, BAUD.bps(), &mut rcc)
            .unwrap_or_else(|_| host_files::exit(false));
        let mut timer = device.TIM2.counter_hz(&mut rcc);
        if timer.start(SAMPLE_HZ.Hz()).is_err() {
            host_files::exit(false);
        }
        timer.listen(stm32f4xx_hal::timer::Event::Update);
        let (bursts_in, bursts_out) = context.local.bursts.split();
        let (ready_in, ready_out) = context.local.ready.split();
        let (snapshots_in, snapshots_out) = context.local.snapshots.split();
        let (lines_in, lines_out) = context.local.lines.split();
        (
            Shared {},
            Local {
                timer,
                port,
                pipeline: Pipeline::new(&Settings::new(&Part::MPU_6050)),
                bursts_in,
                bursts_out,
                ready_in,
                ready_out,
                snapshots_in,
                snapshots_out,
                lines_in,
                lines_out,
            },
        )
    }

    /// Feeds bursts from the host and writes snapshots to it, until the file ends.
    #[idle(local = [bursts_in, snapshots_out])]
    fn idle(context: idle::Context) -> ! {
        let succeeded = match host_files::arguments() {
            Some([_, input, output]) => replay(
                &input,
                &output,
                context.local.bursts_in,
                context.local.snapshots_out,
            ),
            None => {
                heprintln!(
                    "give three arguments: a name, the bursts.csv to read and the file to write"
                );
                false
            }
        };
        host_files::exit(succeeded)
    }

    fn replay(
        input: &str,
        output: &str,
        bursts_in: &mut Producer<'static, Row>,
        snapshots_out: &mut Consumer<'static, Snapshot>,
    ) -> bool {
        let (Some(mut input), Some(mut output)) = (HostFile::open(input), HostFile::create(output))
        else {
            heprintln!("cannot open {} or {}", input, output);
            return false;
        };
        let (mut fed, mut returned, mut line_number, mut ended) = (0_u32, 0_u32, 0_u32, false);
        while !ended || returned < fed {
            if !ended && bursts_in.ready() {
                let mut line = [0; bursts::LINE_LENGTH];
                match input.read_line(&mut line) {
                    None => ended = true,
                    // The header.
                    Some(_) if line_number == 0 => line_number = 1,
                    Some(line) => {
                        line_number += 1;
                        match bursts::decode(line) {
                            Ok(row) => fed += u32::from(bursts_in.enqueue(row).is_ok()),
                            Err(error) => {
                                heprintln!("line {}: {}", line_number, error);
                                return false;
                            }
                        }
                    }
                }
            }
            while let Some(snapshot) = snapshots_out.dequeue() {
                returned += 1;
                if write_bits(&mut output, &snapshot).is_err() {
                    heprintln!("cannot write the snapshots");
                    return false;
                }
            }
        }
        fed > 0
    }

    /// Writes `t_us,qw,qx,qy,qz,p,q,r,flags`: the time in decimal, the bits of the rest in
    /// hexadecimal.
    fn write_bits(output: &mut HostFile, snapshot: &Snapshot) -> core::fmt::Result {
        let attitude = snapshot.attitude;
        let rates = snapshot.body_rates_rad_s;
        write!(output, "{}", snapshot.t_us)?;
        for number in [
            attitude.w, attitude.x, attitude.y, attitude.z, rates.x, rates.y, rates.z,
        ] {
            write!(output, ",{:08x}", number.to_bits())?;
        }
        writeln!(output, ",{:08x}", snapshot.flags.bits())
    }

    /// Simulates the sensor: one sample per period.
    #[task(binds = TIM2, priority = 4, local = [timer, bursts_out, ready_in])]
    fn data_ready(context: data_ready::Context) {
        context
            .local
            .timer
            .clear_flags(stm32f4xx_hal::timer::Flag::Update);
        if context.local.ready_in.ready()
            && let Some(burst) = context.local.bursts_out.dequeue()
        {
            context.local.ready_in.enqueue(burst).ok();
            rtic::pend(Interrupt::SPI3);
        }
    }

    #[task(
        binds = SPI3,
        priority = 3,
        local = [pipeline, ready_out, snapshots_in, lines_in, samples: u32 = 0]
    )]
    fn attitude(context: attitude::Context) {
        while let Some(row) = context.local.ready_out.dequeue() {
            context.local.pipeline.set_armed(row.is_armed);
            let snapshot = context.local.pipeline.update(&row.burst, row.board);
            // A full queue loses a snapshot. Then `replay` never reaches its end, and the test
            // fails.
            context.local.snapshots_in.enqueue(snapshot).ok();
            *context.local.samples += 1;
            if context.local.samples.is_multiple_of(SAMPLES_PER_LINE) {
                context.local.lines_in.enqueue(snapshot).ok();
                telemetry::spawn().ok();
            }
        }
    }

    #[task(priority = 1, local = [port, lines_out])]
    async fn telemetry(context: telemetry::Context) {
        while let Some(snapshot) = context.local.lines_out.dequeue() {
            let mut line = [0; text::LINE_LENGTH];
            let line = text::encode(&snapshot, &mut line);
            // The text is ASCII, and the port takes one byte at a time.
            context
                .local
                .port
                .write_str(core::str::from_utf8(line).unwrap_or_default())
                .ok();
        }
    }
}
