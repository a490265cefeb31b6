//! The proof that nothing in the library panics: it is linked here with a panic handler that does not link.
//!
//! Every function that runs after start-up is called with data that the compiler knows nothing of. If
//! any of them could reach a panic, the handler below would be needed, and with it a symbol that exists
//! nowhere: the linker then says `undefined symbol: a_panic_is_reachable`. Never run; `cargo xtask test`
//! builds it. Not called are start-up, and the readers of text for programs on a computer, whose numbers
//! are parsed by `core`.

#![no_std]
#![no_main]

use core::fmt::Write;
use core::hint::black_box;
use core::panic::PanicInfo;

use aplomb::estimator::kalman::Kalman;
use aplomb::fault::{BurstFailure, FaultClass};
use aplomb::health::Flags;
use aplomb::mpu6050::{Burst, Check, Config, Part};
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::telemetry::message::{Mailbox, Message, TextBuffer};
use aplomb::telemetry::text;
use aplomb::units::CounterExtender;

unsafe extern "C" {
    safe fn a_panic_is_reachable() -> !;
}

#[panic_handler]
fn panic(_: &PanicInfo) -> ! {
    a_panic_is_reachable()
}

#[cortex_m_rt::entry]
fn main() -> ! {
    // Making the pipeline is start-up, and its settings are constants in a firmware.
    let settings = Settings::new(&Part::MPU_6050);
    let mut pipeline = Pipeline::with_filter(&settings, Kalman::new());
    let mut extender = CounterExtender::new();
    let mut mailbox = Mailbox::new();
    loop {
        samples(&mut pipeline);
        time(&mut extender);
        texts(&mut pipeline);
        messages(&mut mailbox);
        checks();
    }
}

#[inline(never)]
fn samples(pipeline: &mut Pipeline<Kalman>) {
    let burst: Burst = black_box(Burst {
        bytes: [0; 14],
        captured_at_us: 0,
        missed_before: 0,
    });
    black_box(pipeline.update(&burst));
    let flags = Flags::from_bits(black_box(0));
    black_box(pipeline.update_with(&burst, flags, |snapshot, variance| {
        black_box((snapshot, variance));
    }));
    black_box(pipeline.stale(black_box(0), flags));
    black_box(pipeline.tilt_variance_rad2(black_box(0)));
    if let Some(known) = pipeline.known() {
        pipeline.resume(&black_box(known));
    }
    pipeline.set_armed(black_box(true));
    pipeline.confirm_scales();
}

#[inline(never)]
fn time(extender: &mut CounterExtender) {
    extender.overflow();
    black_box(extender.extend(black_box(0), black_box(false)));
    black_box(extender.extend_capture(black_box(0), black_box(0), black_box(false)));
}

#[inline(never)]
fn texts(pipeline: &mut Pipeline<Kalman>) {
    let snapshot = pipeline.stale(black_box(0), Flags::NONE);
    let mut line = [0; text::LINE_LENGTH];
    let written = text::encode(&snapshot, &mut line);
    black_box(&written);
    let mut buffer = [0; 256];
    let mut output = TextBuffer::new(black_box(&mut buffer));
    output.write_str(black_box("")).ok();
    black_box(output.length());
}

#[inline(never)]
fn messages(mailbox: &mut Mailbox) {
    if let Some(failure) = BurstFailure::from_codes(black_box(0), black_box(0)) {
        black_box(failure.class());
        mailbox.post(Message::BurstsFailed { failure, count: 1 });
    }
    black_box(FaultClass::from_number(black_box(0)));
    black_box(mailbox.take());
}

#[inline(never)]
fn checks() {
    let bytes = black_box([0; Check::LONGEST]);
    for check in Check::all(&Config::DEFAULT, &Part::MPU_6050) {
        black_box(check.of(&bytes));
    }
}
