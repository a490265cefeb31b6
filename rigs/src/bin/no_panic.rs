//! Proves that nothing in the library panics, by a panic handler that does not link.
//!
//! Every function that runs after start-up is called with data unknown to the compiler. A reachable
//! panic needs the handler, and with it a symbol that does not exist. The linker then reports
//! `undefined symbol: a_panic_is_reachable`. `cargo xtask test` builds the image; nothing runs it.
//! Start-up is not called, and neither are the readers of text for programs on a computer, whose
//! numbers are parsed by `core`.

#![no_std]
#![no_main]

use core::hint::black_box;
use core::panic::PanicInfo;

use aplomb::fault::{BurstFailure, FaultClass};
use aplomb::health::BoardFlags;
use aplomb::mpu6050::{Burst, Check, Config, Part};
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::telemetry::message::Message;
use aplomb::telemetry::{Mailbox, Output, text};
use aplomb::units::CounterExtender;

#[allow(
    unsafe_code,
    reason = "no such function exists: an image that refers to it does not link"
)]
unsafe extern "C" {
    safe fn a_panic_is_reachable() -> !;
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    a_panic_is_reachable()
}

#[cortex_m_rt::entry]
fn main() -> ! {
    // The pipeline is created at start-up, from settings that are constants in a firmware.
    let settings = Settings::new(&Part::MPU_6050);
    let mut pipeline = Pipeline::new(&settings);
    let mut extender = CounterExtender::new(0);
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
fn samples(pipeline: &mut Pipeline) {
    let burst: Burst = black_box(Burst {
        bytes: [0; 14],
        captured_at_us: 0,
        missed_before: 0,
    });
    let flags = BoardFlags::from_bits_truncate(black_box(0));
    let snapshot = black_box(pipeline.update(&burst, flags));
    black_box(pipeline.stale(black_box(0), flags));
    if let Some(start) = pipeline.warm_start(&snapshot) {
        pipeline.resume(&black_box(start), black_box(0));
    }
    pipeline.set_armed(black_box(true));
    black_box(pipeline.awaits_scale_check());
}

#[inline(never)]
fn time(extender: &mut CounterExtender) {
    black_box(extender.extend(black_box(0)));
}

#[inline(never)]
fn texts(pipeline: &mut Pipeline) {
    let snapshot = pipeline.stale(black_box(0), BoardFlags::empty());
    let mut line = [0; text::LINE_LENGTH];
    let written = text::encode(&snapshot, &mut line);
    black_box(&written);
    let mut buffer = [0; 256];
    let mut output = Output::new(black_box(&mut buffer));
    output.put(written);
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
        black_box(check.evaluate(&bytes));
    }
}
