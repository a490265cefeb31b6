//! Adds the default filter to `empty`: sample in, estimate and its σ out.
//!
//! `cargo xtask size` reports the difference in flash as the cost of the filter alone.

#![no_std]
#![no_main]

use core::hint::black_box;
use core::panic::PanicInfo;

use aplomb::estimator::{Estimator, Sample};

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}

#[cortex_m_rt::entry]
fn main() -> ! {
    let mut estimator = Estimator::new();
    loop {
        let sample = black_box(Sample::default());
        let estimate = estimator.update(&sample);
        black_box((estimate, estimate.tilt_sigma_rad()));
    }
}
