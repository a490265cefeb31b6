//! A macro that forwards calls of a decorator to the emulated device inside.
//!
//! Six devices decorate one of rigless. Each implements the calls that it changes, and names the
//! others in [`delegate!`](crate::delegate::delegate), which forwards them to the field `model`. A
//! call that a decorator leaves out goes to the trait's empty default, so the model misses it.

macro_rules! delegate {
    ($($method:ident)+) => { $($crate::delegate::delegate!(@ $method);)+ };
    (@ layout) => {
        fn layout(&self) -> &'static [rigless::soc::RegisterSpec] {
            rigless::device::Device::layout(&self.model)
        }
    };
    (@ peek) => {
        fn peek(
            &self,
            register: Self::Register,
            registers: &rigless::device::RegisterFile,
            now: rigless::time::VirtualNanos,
        ) -> Option<u64> {
            rigless::device::Device::peek(&self.model, register, registers, now)
        }
    };
    (@ reset) => {
        fn reset(&mut self) {
            rigless::device::Device::reset(&mut self.model);
        }
    };
    (@ read) => { $crate::delegate::delegate!(@@ read(register: Self::Register) -> Option<u64>); };
    (@ write) => { $crate::delegate::delegate!(@@ write(register: Self::Register, value: u64)); };
    (@ on_event) => { $crate::delegate::delegate!(@@ on_event(event: rigless::time::EventId)); };
    (@ on_request) => {
        $crate::delegate::delegate!(@@ on_request(request: rigless::device::RequestChange));
    };
    (@ on_access) => { $crate::delegate::delegate!(@@ on_access(token: u64, value: u64)); };
    (@ on_refused) => { $crate::delegate::delegate!(@@ on_refused(token: u64)); };
    (@ on_clock) => { $crate::delegate::delegate!(@@ on_clock(hz: u64)); };
    (@ reset_line) => { $crate::delegate::delegate!(@@ reset_line()); };
    (@@ $method:ident($($name:ident: $kind:ty),*) $(-> $result:ty)?) => {
        fn $method(
            &mut self,
            $($name: $kind,)*
            registers: &mut rigless::device::RegisterFile,
            context: &mut rigless::device::DeviceContext<'_>,
        ) $(-> $result)? {
            rigless::device::Device::$method(&mut self.model, $($name,)* registers, context)
        }
    };
}
pub(crate) use delegate;
