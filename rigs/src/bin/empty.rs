//! Takes a sample and returns an estimate, without a filter: the base for the size of `kalman`.

#![no_std]
#![no_main]

use core::hint::black_box;
use core::panic::PanicInfo;

use aplomb::estimator::{Estimate, Sample};

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}

#[cortex_m_rt::entry]
fn main() -> ! {
    loop {
        black_box(Sample::default());
        black_box((Estimate::default(), 0.0_f32));
    }
}
